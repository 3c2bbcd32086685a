"""Measurement model of load cells: tensions, as far as they balance a wrench.

The change of tensions with an error is that of cables that do not stretch: the stretch settles
within some hundredths of a second, far slower than a step and far faster than sway. That it
vibrates is noise here; who would read it out of tensions must know lengths to some micrometres.
With more than six cables, tensions against each other depend on tenths of a millimetre of length,
which no estimate knows, and do not move the platform: the residual leaves them out.
"""

from __future__ import annotations

import numpy as np

from baselines.dynamic_estimator.filter_state import DynamicFilterState
from baselines.dynamic_estimator.measurement_models import LinearisedMeasurement
from baselines.dynamic_estimator.model import turns
from baselines.dynamic_estimator.settings import DynamicEstimatorSettings
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.scaled import Scaled
from carosac_toolkit.physics.rest.structure import structure_matrix
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.robot.robot import Robot

STEP = 1e-5  # of finite differences, in the units of the errors
TURN_STEP = Scaled(1e-4, "s")  # of the change of the structure matrix along the motion


def measured_tension(
    robot: Robot, state: DynamicFilterState, tension: Array, settings: DynamicEstimatorSettings
) -> LinearisedMeasurement:
    """Linearise tensions that were measured at the time of a state.

    Args:
        robot: The nominal one.
        state: The estimate.
        tension: As measured at the platform [N], shape (n,).
        settings: Noise of the load cells, and of the model's tensions.
    """
    where = state.errors
    by = np.zeros((where.n, where.size))
    by[:, : where.moving] = _changes(robot, state)
    by[:, where.cells] = np.eye(where.n)
    _, strength, rows = np.linalg.svd(state.sway.pulls, full_matrices=False)
    balancing = rows[strength > 1e-9 * strength[0]]
    noise = settings.load_cell_noise**2 + (settings.tension_vibration * robot.weight) ** 2
    return LinearisedMeasurement(
        residual=balancing @ (tension - state.tension - state.cell_bias),
        by=balancing @ by,
        noise=noise * np.eye(len(balancing)),
    )


def _changes(robot: Robot, state: DynamicFilterState) -> Array:
    """Return the change of the tensions per error that moves the platform, shape (n, k)."""
    where = state.errors
    change = np.zeros((1 + where.moving, where.moving))
    change[1:] = STEP * np.eye(where.moving)
    pose = change[:, where.sway] @ state.sway.ways.T + change[:, where.bias] @ state.sway.slaved.T
    tensions = rigid_tensions(
        robot,
        position=state.position + pose[:, :3],
        rotation=turns(pose[:, 3:]) @ state.rotation,
        twist=state.twist + change[:, where.speed] @ state.sway.ways.T,
        wind=state.wind + change[:, where.wind],
        mass=robot.mass * np.exp(state.log_mass + change[:, where.mass.start]),
        center=state.center + change[:, where.center],
    )
    changes: Array = ((tensions[1:] - tensions[0]) / STEP).T
    return changes


def rigid_tensions(
    robot: Robot, *, position: Array, rotation: Array, twist: Array, wind: Array, mass: Array,
    center: Array,
) -> Array:  # fmt: skip
    """Return tensions of cables without stretch whose lengths change steadily [N], shape (B, n).

    With more than six cables they are the least squared ones.

    Args:
        robot: For geometry, inertia and gravity.
        position: Platform origin in W [m], shape (B, 3).
        rotation: From P to W, shape (B, 3, 3).
        twist: In W at the platform origin, shape (B, 6).
        wind: Force along x and y of W, at the centre of mass [N], shape (B, 2).
        mass: [kg], shape (B,).
        center: Centre of mass in P [m], shape (B, 3).
    """
    lever = np.einsum("bij,bj->bi", rotation, center)
    cross = _crosses(lever)
    inertia = rotation @ robot.inertia @ rotation.swapaxes(1, 2)
    heavy = mass[:, None, None]
    matrix = np.zeros((len(mass), 6, 6))
    matrix[:, :3, :3] = heavy * np.eye(3)
    matrix[:, :3, 3:] = -heavy * cross
    matrix[:, 3:, :3] = heavy * cross
    matrix[:, 3:, 3:] = inertia - heavy * cross @ cross
    spin = twist[:, 3:]
    force = np.zeros((len(mass), 3))
    force[:, :2] = wind
    force[:, 2] -= mass * robot.gravity
    force -= mass[:, None] * np.cross(spin, np.cross(spin, lever))
    gyroscopic = np.cross(spin, np.einsum("bij,bj->bi", inertia, spin))
    load = np.hstack([force, np.cross(lever, force) - gyroscopic])
    columns = structure_matrix(robot, position, rotation)
    instant = TURN_STEP.of(Scales(robot).ratios)
    later = structure_matrix(
        robot, position + instant * twist[:, :3], turns(instant * spin) @ rotation
    )
    turning = np.einsum("bij,bi->bj", (later - columns) / instant, twist)
    light = np.linalg.solve(matrix, columns)  # M^-1 A
    asked = -np.einsum("bij,bi->bj", light, load) - turning
    tension: Array = np.einsum(
        "bij,bj->bi", np.linalg.pinv(columns.swapaxes(1, 2) @ light, hermitian=True), asked
    )
    return tension


def _crosses(vectors: Array) -> Array:
    """Return the matrices [a]x, shape (B, 3, 3)."""
    x, y, z = vectors.T
    zero = np.zeros_like(x)
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)
