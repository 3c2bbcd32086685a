r"""Load that the prediction model does not know: its centre of mass, and an acceleration.

Speed that the believed twist gains beyond a prediction, in the ways that the cables leave free, has
two causes. An unknown force such as wind accelerates the platform whatever is done. A centre of
mass that is elsewhere by :math:`\delta` turns it the more, the more the cables pull:

.. math:: \Delta\dot\omega = J^{-1} \left(\delta \times F_w - \mu\, \delta \times F\right), \qquad
          \Delta\dot v = -\Delta\dot\omega \times c - \mu \left(\dot\omega \times \delta
          + \omega \times (\omega \times \delta)\right)

with F the sum of all forces, F_w the weight, c the centre of mass from the origin, J the inertia
about it, and :math:`\mu` the share of the platform in the mass that moves. Left out are air drag,
and what the shift does to J beside cables that ride along.

A controller that took the second for the first would answer itself: what it pulls changes what it
has learned, and a disturbance that is learned quickly then makes the platform swing ever more. A
Kalman filter tells them apart.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from baselines.mpc.geometry import Geometry
from baselines.mpc.model import moving_body
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.scaled import Scaled
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.robot.robot import Robot

SPEED_NOISE = Scaled(0.012, "m/s")  # of the speed gained in a command, alike for the whole platform
# At the start, and in ways that are not seen for long.
ACCELERATION_DEVIATION = Scaled(0.25, "m/s^2")
# Model errors seen as a centre of mass vary with the place.
CENTER_WALK = Scaled(1e-3, "m/sqrt(s)")
# Or a rotation of the same energy: more is no disturbance.
DISTURBANCE_MAX = Scaled(2.0, "m/s^2")
UNTOLD_TIME_RATIO = 4.0  # times slower the acceleration is followed with an unknown centre of mass
WIND_DIRECTIONS = np.array([1.0, 1.0, 0.0, 0.0, 0.0, 0.0])  # in which a wind pushes
CENTER_DEVIATIONS_MAX = 3.0  # bound of the estimated centre of mass
# Of the centre of mass, before the robot is rebuilt with it.
CENTER_STEP_MIN = Scaled(1e-4, "m")


@dataclass(frozen=True, kw_only=True, eq=False)
class PlannedMotion:
    """Motion that was planned for a command.

    Attributes:
        rotation: From P to W at its start, shape (3, 3).
        spin: Angular velocity at its start in W [rad/s], shape (3,).
        spin_rate: Its planned derivative [rad/s^2], shape (3,).
        force: Of the cables on the platform in W, half of their weight included [N], shape (3,).
        length: Of the cables, a third of which moves with its anchor point [m], shape (n,).
    """

    rotation: Array
    spin: Array
    spin_rate: Array
    force: Array
    length: Array

    @classmethod
    def of(
        cls, robot: Robot, geometry: Geometry, tension: Array, *, rotation: Array, spin: Array,
        spin_rate: Array,
    ) -> PlannedMotion:  # fmt: skip
        """Describe a motion with cables of chord tensions (n,) [N]."""
        hanging = 0.5 * robot.weight_per_length @ geometry.free
        return cls(
            rotation=rotation, spin=spin, spin_rate=spin_rate,
            force=-tension @ geometry.direction - np.array([0.0, 0.0, hanging]),
            length=geometry.free,
        )  # fmt: skip


def equal_energy(robot: Robot) -> Array:
    """Return accelerations (6,) [m/s^2, rad/s^2] that change the energy of a platform alike."""
    gyration = np.sqrt(np.trace(robot.inertia) / (3.0 * robot.mass))
    return np.repeat([1.0, 1.0 / gyration], 3)


class AccelerationGain:
    """Gain of `UnknownLoad` for the acceleration alone, taken to be the same in all ways.

    At the start, where nothing is known, a gained speed tells more than later.
    """

    def __init__(self, robot: Robot, *, period: float, disturbance_time: float) -> None:
        """Take the robot, and the other arguments of `UnknownLoad`."""
        ratios = Scales(robot).ratios
        self._period, self._time = period, disturbance_time
        self._noise = SPEED_NOISE.of(ratios) ** 2
        self._most = ACCELERATION_DEVIATION.of(ratios) ** 2
        self.reset()

    def reset(self) -> None:
        """Forget that anything was learned."""
        self._variance = self._most

    def next(self, *, told: bool) -> float:
        """Return the acceleration per gained speed [1/s], and take note that it is learned from.

        Args:
            told: Whether somebody else knows the centre of mass.
        """
        time = self._time * (1.0 if told else UNTOLD_TIME_RATIO)
        before = min(self._variance + self._noise / time**2, self._most)
        gain = before * self._period / (before * self._period**2 + self._noise)
        self._variance = (1.0 - gain * self._period) * before
        return gain


class UnknownLoad:
    """A Kalman filter of centre of mass and acceleration.

    Attributes:
        robot: The nominal one with the centre of mass that was learned or told.
    """

    def __init__(
        self, robot: Robot, *, period: float, center_of_mass: float, disturbance_time: float
    ) -> None:
        """Start with nothing known.

        Args:
            robot: The nominal robot.
            period: Between two commands [s].
            center_of_mass: Standard deviation per axis [m]; 0: as in the robot file.
            disturbance_time: Time constant by which the acceleration is followed [s].
        """
        self._nominal, self._period = robot, period
        self._spread = center_of_mass
        ratios = Scales(robot).ratios
        self._noise = SPEED_NOISE.of(ratios)
        self._deviation = ACCELERATION_DEVIATION.of(ratios)
        self._center_walk = CENTER_WALK.of(ratios)
        self._center_step = CENTER_STEP_MIN.of(ratios)
        self._limit = DISTURBANCE_MAX.of(ratios)
        self._unit = equal_energy(robot)
        self._follow = self._noise / disturbance_time * self._unit  # a walk that has that gain
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self.robot, self._told = self._nominal, False
        self._found = np.zeros(9)  # in P [m], shape (3,); in W [m/s^2, rad/s^2], shape (6,)
        walk = self._center_walk * np.sqrt(self._period)
        self._begin(
            np.repeat(self._spread, 3),
            np.repeat(walk, 3),
            WIND_DIRECTIONS,
            WIND_DIRECTIONS / UNTOLD_TIME_RATIO,
        )
        if self._spread == 0.0:
            self.tell(self._nominal.center_of_mass)

    def _begin(self, shift: Array, walk: Array, seen: Array, quick: Array) -> None:
        """Begin with standard deviations of the shift, and shares of those of the acceleration."""
        self._most = np.concatenate([shift, self._deviation * self._unit * seen])
        self._covariance = np.diag(self._most**2)
        self._walk = np.diag(np.concatenate([walk, self._follow * quick]) ** 2)

    @property
    def shift(self) -> Array:
        """Offset of the centre of mass from the robot file, in P [m], shape (3,)."""
        return np.asarray(self._found[:3])

    @property
    def acceleration(self) -> Array:
        """Of the centre of mass and of the rotation, beyond the model, in W, shape (6,).

        In [m/s^2] and [rad/s^2], as the disturbance of `baselines.mpc.model`.
        """
        return np.asarray(self._found[3:])

    def learn(
        self,
        gained: Array,
        free: Array,
        mass: Array,
        motion: PlannedMotion,
        *,
        turning: bool = True,
    ) -> None:
        """Take in what a twist gained beyond its prediction.

        Args:
            gained: In the free ways, linear first, in W, shape (6,).
            free: Projection onto these ways, shape (6, 6).
            mass: Mass matrix of the platform, shape (6, 6), whose metric that projection has.
            motion: What was planned.
            turning: Whether the twist was measured; one that follows from poses says nothing of
                the centre of mass.
        """
        root = np.linalg.cholesky(mass).T
        by = self._period * root @ free @ self._by(motion)
        covariance = self._bounded(self._covariance + self._walk)
        noise = self._noise**2 * self._nominal.mass * np.eye(6)
        gain = np.linalg.solve(by @ covariance @ by.T + noise, by @ covariance).T
        if not turning:
            gain[:3] = 0.0
        change = gain @ by
        keep = np.eye(9) - change
        covariance = keep @ covariance @ keep.T + gain @ noise @ gain.T
        self._covariance = 0.5 * (covariance + covariance.T)
        shift = CENTER_DEVIATIONS_MAX * self._spread
        farthest = np.concatenate([np.repeat(shift, 3), self._limit * self._unit])
        estimate = self._found + gain @ (root @ gained)
        learned = np.clip(estimate, -farthest, farthest)
        self._found = np.where(self._most > 0.0, learned, self._found)
        self._place(self._nominal.center_of_mass + self.shift)

    def _bounded(self, covariance: Array) -> Array:
        """Limit deviations to those of the start, so that unseen ways do not become unknown."""
        now = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
        share = np.minimum(1.0, self._most / now)
        return np.asarray(covariance * np.outer(share, share))

    def tell(self, center_of_mass: Array | None) -> bool:
        """Take a centre of mass in P [m], shape (3,), that somebody else knows.

        Then all accelerations are learned, moments as well as pushes. None: nobody knows it any
        more, and everything begins anew.

        Returns:
            Whether that is news, so that the last prediction was made with something else.
        """
        if center_of_mass is None:
            forgotten = self._told and self._spread > 0.0
            if forgotten:
                self.reset()
            return forgotten
        new = not self._told
        if new:
            self._told = True
            whole = np.ones(6)
            self._begin(np.zeros(3), np.zeros(3), whole, whole)
        self._found[:3] = center_of_mass - self._nominal.center_of_mass
        self._place(center_of_mass)
        return new

    def _place(self, center_of_mass: Array) -> None:
        """Put the centre of mass of the robot there [m], unless it is there already."""
        if np.abs(center_of_mass - self.robot.center_of_mass).max() > self._center_step:
            self.robot = replace(self._nominal, center_of_mass=center_of_mass)

    def _by(self, motion: PlannedMotion) -> Array:
        """Return the acceleration in W per shift in P and per `acceleration`, shape (6, 9)."""
        robot, rotation = self.robot, motion.rotation
        body = moving_body(robot, motion.length)
        share = robot.mass / body.mass
        weight = _cross(np.array([0.0, 0.0, -robot.weight]))
        force = _cross(motion.force) + weight
        inertia = rotation @ body.inertia @ rotation.T
        turned = np.linalg.solve(inertia, share * force - weight)
        spin, center = _cross(motion.spin), _cross(rotation @ body.center_of_mass)
        moved = center @ turned - share * (_cross(motion.spin_rate) + spin @ spin)
        disturbed = np.eye(6)
        disturbed[:3, 3:] = center  # a moment turns it about the centre of mass
        return np.hstack([np.vstack([moved, turned]) @ rotation, disturbed])


def _cross(vector: Array) -> Array:
    """Return the matrix of the cross product with a vector, shape (3, 3)."""
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
