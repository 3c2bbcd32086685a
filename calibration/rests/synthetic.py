"""Rests of a robot that differs from its description, and what its sensors read there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from calibration.rest_readings import RestReadings
from calibration.rests.settings import RestSettings
from calibration.rests.unknowns import find_unknowns
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import CarosacError
from carosac_toolkit.base.rotations import from_matrix, wrapped_angle
from carosac_toolkit.loop.values import Pose, Stamped
from carosac_toolkit.physics.cable.swivel import swivel_angle
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.recordings.encoders import readings as length_readings
from carosac_toolkit.recordings.metadata import RecordingMetadata
from carosac_toolkit.recordings.recording import Recording
from carosac_toolkit.robot.parameters import with_values
from carosac_toolkit.robot.robot import Robot

SAMPLE_PERIOD_S, REST_DURATION_S, MOVE_DURATION_S = 0.1, 2.0, 4.0
JITTER_SHARE = 0.9  # of a cell of the workspace box, within which a rest is drawn
TRIES_MAX = 200


@dataclass(frozen=True, kw_only=True, eq=False)
class RestScene:
    """A recording of K rests and the truth behind it.

    Attributes:
        recording: The measurements.
        plant: The robot that it was measured on.
        truth: Values of all parameters by name, those of the sensors included.
        position: Platform origin at each rest in W [m], shape (K, 3).
        rotation: From P to W, shape (K, 3, 3).
    """

    recording: Recording
    plant: Robot
    truth: dict[str, float]
    position: Array
    rotation: Array


@dataclass(frozen=True, kw_only=True)
class RestSceneSettings:
    """Settings of synthetic rests.

    Attributes:
        rests: Number of rests, spread through the workspace box.
        turn: Largest rotation of a platform that can be turned, per axis [rad].
        tension: True for load cells.
        tension_scale: Largest error of their scales [1].
        attitude: True for an AHRS of any heading.
        swivel: True for swivel angles.
    """

    rests: int = 27
    turn: float = 0.3
    tension: bool = True
    tension_scale: float = 0.2
    attitude: bool = True
    swivel: bool = True


def draw_rest_scene(
    robot: Robot,
    rng: np.random.Generator,
    *,
    settings: RestSceneSettings | None = None,
    noise: RestSettings | None = None,
) -> RestScene:
    """Draw a plant from the robot's covariances, let it rest at some poses, and measure.

    The lengths are relative: zero at the first rest. Noise is drawn once for each rest, as errors
    of winding, of friction and of an AHRS do not average out while the platform rests.

    Args:
        robot: The description.
        rng: Source of everything random.
        settings: Settings of the rests.
        noise: Noise of the sensors, and spread of their errors.

    Raises:
        CarosacError: The robot cannot rest in a part of its workspace box.
    """
    made, known = settings or RestSceneSettings(), noise or RestSettings()
    count, n = made.rests, robot.n
    there = RestReadings(
        time=np.zeros(count), length=np.zeros((count, n)), skipped={},
        tension=np.zeros((count, n)), attitude=np.tile(np.eye(3), (count, 1, 1)),
        swivel_angle=np.zeros((count, n)),
    )  # fmt: skip
    unknowns = find_unknowns(robot, there, known, relative=False)
    drawn = rng.multivariate_normal(unknowns.prior.mean, unknowns.prior.covariance)
    scales = unknowns.prior.rows("tension_scale")
    drawn[scales] = rng.uniform(-made.tension_scale, made.tension_scale, len(scales))
    drawn[unknowns.prior.rows("length_offset")] = 0.0
    turned = unknowns.prior.rows("heading")
    drawn[turned] = wrapped_angle(drawn[turned])
    plant = with_values(robot, unknowns.robot_names, drawn[: len(unknowns.robot_names)])
    errors = unknowns.sensors_at(drawn)
    rest = _rests(plant, made, rng)
    noisy = rng.standard_normal
    length = length_readings(plant, rest.unstrained_length)
    zero = length[0]
    reading = length - zero + known.length_noise * noisy((count, n))
    tension = (1.0 + errors.tension_scale) * rest.tension + errors.tension_offset
    tension *= 1.0 + known.tension_noise * noisy((count, n))
    shaken = Rotation.from_rotvec(known.attitude_noise * noisy((count, 3))).as_matrix()
    attitude = from_matrix(errors.heading @ rest.rotation @ errors.mounting @ shaken)
    swivel = swivel_angle(plant, -rest.exit_tension) + errors.swivel_offset
    swivel = swivel + known.swivel_noise * noisy((count, n))
    truth = dict(zip(unknowns.prior.names, drawn.tolist(), strict=True))
    truth |= {
        f"length_offset[{c}]": -float(z) for c, z in zip(robot.cable_names, zero, strict=True)
    }
    samples = round(REST_DURATION_S / SAMPLE_PERIOD_S)
    begins = (REST_DURATION_S + MOVE_DURATION_S) * np.arange(count)
    time = (begins[:, None] + SAMPLE_PERIOD_S * np.arange(samples)).ravel()

    def channel(value: Array, wanted: bool) -> Stamped | None:
        return Stamped(time=time, value=np.repeat(value, samples, axis=0)) if wanted else None

    recording = Recording(
        time=time,
        unstrained_length=np.repeat(reading, samples, axis=0),
        tension=channel(tension, made.tension),
        attitude=channel(attitude, made.attitude),
        swivel_angle=channel(swivel, made.swivel),
        metadata=RecordingMetadata(
            robot=robot.name, length_kind="relative", created_by="calibration.rests.synthetic",
            description="synthetic: rests of a robot that differs from its file",
        ),
    )  # fmt: skip
    return RestScene(
        recording=recording, plant=plant, truth=truth, position=rest.position,
        rotation=rest.rotation,
    )  # fmt: skip


def _rests(plant: Robot, made: RestSceneSettings, rng: np.random.Generator) -> statics.Equilibrium:
    """Draw stable rests, each in a cell of its own of the workspace box."""
    side = int(np.ceil(made.rests ** (1.0 / 3.0)))
    cells = np.stack(np.unravel_index(rng.permutation(side**3)[: made.rests], (side,) * 3), axis=1)
    extent = plant.workspace_max - plant.workspace_min
    lengths, positions, rotations = [], [], []
    for cell in cells:
        for _ in range(TRIES_MAX):
            within = 0.5 + JITTER_SHARE * rng.uniform(-0.5, 0.5, 3)
            place = plant.workspace_min + extent * (cell + within) / side
            turn = Rotation.from_rotvec(made.turn * rng.uniform(-1.0, 1.0, 3)).as_matrix()
            held = (turn @ plant.home_rotation)[None] if plant.n >= 6 else None
            rest = statics.inverse_kinematics(plant, place[None], held)
            if rest.converged[0] and rest.stable[0]:
                break
        else:
            spot = np.round(place, 2).tolist()
            raise CarosacError(f"robot {plant.name} cannot rest around {spot} m, turned at random")
        lengths.append(rest.unstrained_length[0])
        positions.append(rest.position[0])
        rotations.append(rest.rotation[0])
    near = Pose(position=np.array(positions), rotation=np.array(rotations))
    return statics.forward_kinematics(plant, np.array(lengths), guess=near)
