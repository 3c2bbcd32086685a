"""The motion of the estimate and, by differences, what becomes of its errors."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from baselines.dynamic_estimator.filter_state import DynamicFilterState, Errors
from baselines.dynamic_estimator.settings import DynamicEstimatorSettings
from baselines.dynamic_estimator.sway_basis import count_ways, sway_at
from baselines.dynamic_estimator.swivel_sag import swivel_sag
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import CarosacError
from carosac_toolkit.base.scaled import Scaled
from carosac_toolkit.physics.motion.propagation import Arrived, Motions, Propagation
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.robot.robot import Robot

SWAY_STEP = Scaled(1e-4, "m")  # of the centre of mass
SWAY_SPEED_STEP = Scaled(1e-4, "m/s")
WIND_STEP = Scaled(1e-2, "N")
LOG_MASS_STEP = 1e-4
LENGTH_STEP = Scaled(1e-5, "m")  # also of the centre of mass in P


class NoMotion(CarosacError):
    """The dynamics have no finite motion from where the estimate stands."""


@dataclass(frozen=True, kw_only=True, eq=False)
class LinearisedStep:
    """A step of the estimate, to first order in the errors at its start, k of which move it.

    Attributes:
        state: At the end; covariance as at the start.
        sway: Errors of sway and its speed at the end per error, shape (2 m, k).
        felt: What an IMU without bias would read: angular rate [rad/s], specific force [m/s^2] in
            its axes, shape (6,).
        felt_by: Its change per error, shape (6, k).
        pulled: What it would read more per tension of a cable, shape (6, n).
        stretched: What it would read more per rate at which a cable gets shorter, shape (6, n).
    """

    state: DynamicFilterState
    sway: Array
    felt: Array
    felt_by: Array
    pulled: Array
    stretched: Array


class DynamicModel:
    """The dynamics of one robot, for one estimate and its neighbours.

    The stretch of the cables is damped more than it is in truth: the noise of the readings would
    excite its vibrations.

    Attributes:
        robot: The nominal one.
        errors: Their order.
    """

    def __init__(
        self, robot: Robot, settings: DynamicEstimatorSettings, *, soft: bool = True
    ) -> None:
        """Allocate for a robot of n cables.

        Args:
            robot: The nominal one.
            settings: Of the estimator.
            soft: Whether motions on cables that sag and stretch are ways to sway.
        """
        self.robot, self._settings = robot, settings
        ways = count_ways(robot) if soft else max(0, 6 - robot.n)
        self.errors = Errors(
            robot.n, ways, cells=settings.load_cells, swivels=settings.swivels,
            attitude=settings.attitude_rotation is not None,
        )  # fmt: skip
        where, ratios = self.errors, Scales(robot).ratios
        steps = np.zeros(where.moving)
        steps[where.sway] = SWAY_STEP.of(ratios) * np.sqrt(robot.mass)
        steps[where.speed] = SWAY_SPEED_STEP.of(ratios) * np.sqrt(robot.mass)
        steps[where.wind], steps[where.mass] = WIND_STEP.of(ratios), LOG_MASS_STEP
        steps[where.center] = steps[where.bias] = LENGTH_STEP.of(ratios)
        self._steps = steps
        damping = robot.axial_damping + robot.axial_stiffness * settings.stretch_damping
        self._propagation = Propagation(
            replace(robot, axial_damping=damping), 1 + where.moving, time_step=settings.time_step
        )
        self._lever = np.array(settings.imu_position)
        self._mount = turns(np.array([settings.imu_rotation]))[0]

    def step(
        self, state: DynamicFilterState, reading: Array, end: Array, duration: float
    ) -> LinearisedStep:
        """Move the estimate and its neighbours while the readings go straight to others.

        Args:
            state: At the start.
            reading: Length readings at the start [m], shape (n,).
            end: Length readings at the end [m], shape (n,).
            duration: [s].

        Raises:
            NoMotion: A time step had no finite solution.
        """
        where, steps = self.errors, self._steps[:, None]
        start, mass, center, bias = self._neighbours(state)
        self._propagation.load(mass, center)
        ends = self._propagation.run(start, reading - bias, end - bias, duration)
        if ends.failed.any():
            raise NoMotion(f"no finite motion after {state.time:.3f} s")
        pose = np.hstack([
            ends.position[1:] - ends.position[0],
            _small_turns(ends.rotation[1:] @ ends.rotation[0].T),
        ])  # fmt: skip
        arrived = self._arrived(state, ends, end - bias[0], duration)
        pose[where.bias] -= steps[where.bias] * arrived.sway.slaved.T
        moved = np.hstack([pose, ends.twist[1:] - ends.twist[0]]) / steps
        out = arrived.sway.momentum
        felt = self._felt(ends)
        return LinearisedStep(
            state=arrived,
            sway=np.vstack([out @ moved[:, :6].T, out @ moved[:, 6:].T]),
            felt=felt[0],
            felt_by=((felt[1:] - felt[0]) / steps).T,
            pulled=self._pulled(arrived),
            stretched=self._stretched(arrived),
        )

    def unknown_motion(
        self, settings: DynamicEstimatorSettings, duration: float, *, felt: bool = False
    ) -> Array:
        """Return what accelerations that the model does not know add to the covariance.

        Args:
            settings: Say how large they are.
            duration: For which they act [s].
            felt: Whether an IMU feels them, with the waves of the cables.

        Returns:
            Of sway and speed, shape (2 m, 2 m).
        """
        density = np.full(self.errors.m, settings.acceleration_noise)
        if felt:
            most = max(settings.soft_acceleration_noise, settings.acceleration_noise)
            density[self.errors.soft] = most
        rates = np.array([
            [duration**3 / 3.0, duration**2 / 2.0], [duration**2 / 2.0, duration]
        ])  # fmt: skip
        return np.kron(rates, self.robot.mass * np.diag(density**2))

    def _neighbours(self, state: DynamicFilterState) -> tuple[Motions, Array, Array, Array]:
        """Return the estimate and one neighbour per error: motions, masses, centres and biases."""
        where = self.errors
        size = 1 + where.moving
        change = np.zeros((size, where.moving))
        change[1:] = np.diag(self._steps)
        sway = state.sway
        pose = change[:, where.sway] @ sway.ways.T + change[:, where.bias] @ sway.slaved.T
        start = Motions(
            position=state.position + pose[:, :3],
            rotation=turns(pose[:, 3:]) @ state.rotation,
            twist=state.twist + change[:, where.speed] @ sway.ways.T,
            force=np.hstack([state.wind + change[:, where.wind], np.zeros((size, 1))]),
            exit_tension=np.tile(state.exit_tension, (size, 1, 1)),
            bristles=None if state.bristles is None else np.tile(state.bristles, (size, 1)),
        )
        mass = self.robot.mass * np.exp(state.log_mass + change[:, where.mass.start])
        bias = state.length_bias + change[:, where.bias]
        return start, mass, state.center + change[:, where.center], bias

    def _arrived(
        self, state: DynamicFilterState, ends: Arrived, length: Array, duration: float
    ) -> DynamicFilterState:
        """Return the estimate at the end of the step."""
        pull = np.asarray(ends.exit_tension)[0]
        return replace(
            state,
            time=state.time + duration,
            position=ends.position[0],
            rotation=ends.rotation[0],
            twist=ends.twist[0],
            tension=ends.tension[0],
            exit_tension=pull,
            swivel_sag=swivel_sag(
                self._settings, self.robot, ends.position[0], ends.rotation[0], pull
            ),
            bristles=None if ends.bristles is None else ends.bristles[0],
            sway=sway_at(
                self.robot,
                ends.position[0],
                ends.rotation[0],
                length,
                ends.tension[0],
                self.errors.m,
            ),
        )

    def _felt(self, ends: Arrived) -> Array:
        """Return the readings of an IMU without bias, shape (B, 6)."""
        omega, alpha = ends.twist[:, 3:], ends.acceleration[:, 3:]
        arm = ends.rotation @ self._lever
        force = ends.acceleration[:, :3] + np.array([0.0, 0.0, self.robot.gravity])
        if self._lever.any():
            force = force + np.cross(alpha, arm) + np.cross(omega, np.cross(omega, arm))
        axes = ends.rotation @ self._mount  # of the IMU in W
        return np.hstack([
            np.einsum("bji,bj->bi", axes, omega), np.einsum("bji,bj->bi", axes, force)
        ])  # fmt: skip

    def _pulled(self, state: DynamicFilterState) -> Array:
        """Return the change of the IMU readings per tension, shape (6, n)."""
        pulls = state.sway.pulls
        arm = state.rotation @ self._lever
        force = pulls[:3]
        if self._lever.any():
            force = force + np.cross(pulls[3:], arm, axisa=0, axisc=0)
        return np.vstack([np.zeros_like(force), (state.rotation @ self._mount).T @ force])

    def _stretched(self, state: DynamicFilterState) -> Array:
        """Return the change of the IMU readings per rate of stretch, shape (6, n)."""
        turn = state.sway.slaved[3:]
        return np.vstack([(state.rotation @ self._mount).T @ turn, np.zeros_like(turn)])


def _small_turns(rotation: Array) -> Array:
    """Return the rotation vectors of tiny rotations (B, 3, 3) [rad], shape (B, 3)."""
    return 0.5 * np.stack(
        [
            rotation[:, 2, 1] - rotation[:, 1, 2],
            rotation[:, 0, 2] - rotation[:, 2, 0],
            rotation[:, 1, 0] - rotation[:, 0, 1],
        ],
        axis=1,
    )


def turns(vectors: Array) -> Array:
    """Return the rotations by rotation vectors (B, 3) [rad], shape (B, 3, 3)."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_rotvec(vectors).as_matrix())
