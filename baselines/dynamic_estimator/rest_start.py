"""Initial state of the filter: on the first lengths at rest or in motion, with its covariance."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from baselines.dynamic_estimator.filter_state import DynamicFilterState, Errors
from baselines.dynamic_estimator.settings import DynamicEstimatorSettings
from baselines.dynamic_estimator.sway_basis import SwayBasis, sway_at
from baselines.dynamic_estimator.swivel_sag import swivel_sag
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.rotations import from_rotation_vector
from carosac_toolkit.base.scaled import Scaled
from carosac_toolkit.physics.cable.straight_line import straight_length
from carosac_toolkit.physics.fleet import Fleet
from carosac_toolkit.physics.rest.held_lengths import poses_on_lengths
from carosac_toolkit.physics.rest.statics import Equilibrium, forward_kinematics
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.robot.robot import Robot

LOG_MASS_STEP = 1e-3  # of the differences
UNKNOWN_ANGLE = 1.0  # [rad]: sigma of the zero of an angle, which the first reading tells
DIFFERENCE_STEP = Scaled(1e-4, "m")  # of centre of mass and lengths


class RestStart:
    """The equilibrium on given lengths, and its derivatives by what is not known."""

    def __init__(self, robot: Robot, settings: DynamicEstimatorSettings, errors: Errors) -> None:
        """Take the robot of n cables, and the order of the errors."""
        self._robot, self._errors = robot, errors
        self._settings = settings
        self._step = DIFFERENCE_STEP.of(Scales(robot).ratios)
        loads = [replace(robot, mass=robot.mass * np.exp(LOG_MASS_STEP))]
        for axis in range(3):
            center = robot.center_of_mass + self._step * np.eye(3)[axis]
            loads.append(replace(robot, center_of_mass=center))
        self._fleet = Fleet([robot, *loads, *[robot] * robot.n])

    def state(
        self, time: float, reading: Array, speed: float | None = None
    ) -> DynamicFilterState | None:
        """Return the estimate at rest; None where the robot cannot rest on these lengths.

        Args:
            time: [s].
            reading: Length readings [m], shape (n,).
            speed: At which the platform may move nevertheless [m/s]; None: `start_speed`.
        """
        robot, n = self._robot, self._robot.n
        lengths = np.tile(reading, (5 + n, 1))
        lengths[5:] -= self._step * np.eye(n)
        if not (lengths > 0.0).all():
            return None
        alone = forward_kinematics(robot, reading[None])
        if not (alone.converged & alone.stable).all():
            return None
        rests = forward_kinematics(self._fleet, lengths, guess=_tiled(alone, 5 + n))
        if not (rests.converged & rests.stable).all():
            return None
        sway = sway_at(
            robot,
            alone.position[0],
            alone.rotation[0],
            reading,
            alone.tension[0],
            self._errors.m,
        )
        return DynamicFilterState(
            time=time,
            position=alone.position[0],
            rotation=alone.rotation[0],
            twist=np.zeros(6),
            wind=np.zeros(2),
            log_mass=0.0,
            center=robot.center_of_mass,
            length_bias=np.zeros(n),
            imu_bias=np.zeros(6),
            cell_bias=np.zeros(n if self._settings.load_cells else 0),
            swivel_offset=self._swivel_offset(),
            swivel_sag=swivel_sag(
                self._settings, robot, alone.position[0], alone.rotation[0], alone.exit_tension[0]
            ),
            mounting=self._mounting(),
            covariance=self._covariance(alone, sway, self._derivatives(rests), speed),
            sway=sway,
            tension=alone.tension[0],
            exit_tension=alone.exit_tension[0],
        )

    def _swivel_offset(self) -> Array:
        """Return the zeros of swivel angles, as far as they are known before a reading."""
        s = self._settings
        count = self._robot.n if s.swivels else 0
        return np.full(count, np.nan if s.swivel_offset is None else 0.0)

    def _mounting(self) -> Array | None:
        """Return how an AHRS or inclinometer is mounted; None: none is used."""
        stated = self._settings.attitude_rotation
        return None if stated is None else from_rotation_vector(np.array(stated))

    def moving(
        self, rest: DynamicFilterState, reading: Array, position: Array, rotation: Array,
        twist: Array,
    ) -> DynamicFilterState:  # fmt: skip
        """Return the estimate that moves through a measured pose with a twist.

        The pose is moved to where straight cables are as long as at rest: one that is off by
        millimetres would stretch them.

        Args:
            rest: The estimate at rest on the same lengths.
            reading: Length readings [m], shape (n,).
            position: Platform origin in W [m], shape (3,).
            rotation: From P to W, shape (3, 3).
            twist: Of the platform origin in W, linear first, shape (6,).
        """
        robot, where, s = self._robot, rest.errors, self._settings
        straight = straight_length(robot, rest.position[None], rest.rotation[None]).length
        place, turn = poses_on_lengths(robot, position[None], rotation[None], straight)
        position, rotation = place[0], turn[0]
        sway = sway_at(robot, position, rotation, reading, rest.tension, where.m)
        noise = np.repeat([s.position_noise**2, s.rotation_noise**2], 3)
        covariance = np.array(rest.covariance)
        covariance[where.sway] = covariance[:, where.sway] = 0.0
        covariance[where.sway, where.sway] = sway.momentum @ np.diag(noise) @ sway.momentum.T
        return replace(
            rest, position=position, rotation=rotation, twist=twist, sway=sway,
            covariance=covariance,
        )  # fmt: skip

    def _derivatives(self, rests: Equilibrium) -> Array:
        """Return the pose per log mass, centre of mass and length bias, shape (6, 4 + n)."""
        from scipy.spatial.transform import Rotation

        turn = Rotation.from_matrix(rests.rotation[1:] @ rests.rotation[0].T).as_rotvec()
        moved = np.hstack([rests.position[1:] - rests.position[0], turn])
        steps = np.array([LOG_MASS_STEP, *[self._step] * (3 + self._robot.n)])
        return np.asarray((moved / steps[:, None]).T)

    def _covariance(
        self, rest: Equilibrium, sway: SwayBasis, by: Array, speed: float | None
    ) -> Array:
        """Return the covariance of all errors: unknowns move the rest, motion comes on top."""
        s = self._settings
        where = self._errors
        spread = np.zeros(where.size)
        spread[where.wind] = s.wind_force
        spread[where.mass] = s.mass
        spread[where.center] = s.center_of_mass
        spread[where.bias] = s.bias_deviation
        spread[where.imu] = np.repeat([s.angular_rate_bias, s.specific_force_bias], 3)
        spread[where.cells] = s.load_cell_bias
        spread[where.swivels] = UNKNOWN_ANGLE if s.swivel_offset is None else s.swivel_offset
        spread[where.mounting], spread[where.heading] = s.attitude_mounting, s.attitude_heading
        carry = np.eye(where.size)
        free = np.array(by)
        free[:, 4:] -= sway.slaved
        carry[where.sway, where.mass.start : where.bias.stop] = sway.momentum @ free
        matrix = carry @ np.diag(spread**2) @ carry.T
        energy = self._robot.mass * (s.start_speed if speed is None else speed) ** 2
        stiffness = sway.ways.T @ rest.stiffness[0] @ sway.ways
        matrix[where.sway, where.sway] += energy * np.linalg.inv(stiffness)
        matrix[where.speed, where.speed] += energy * np.eye(where.m)
        return np.asarray(0.5 * (matrix + matrix.T))


def _tiled(rest: Equilibrium, size: int) -> Equilibrium:
    """Repeat an equilibrium."""
    return Equilibrium(**{k: np.repeat(v, size, axis=0) for k, v in vars(rest).items()})
