r"""What the prediction model does not know of the load: its centre of mass, and an acceleration.

Speed that the believed twist gains beyond a prediction, in the ways that the cables leave free, has
two causes. An unknown force such as wind accelerates the platform whatever is done. A centre of
mass that is elsewhere by :math:`\delta` turns it the more, the more the cables pull:

.. math:: \Delta\dot\omega = J^{-1} \left(\delta \times F_w - \mu\, \delta \times F\right), \qquad
          \Delta\dot v = -\Delta\dot\omega \times c - \mu \left(\dot\omega \times \delta
          + \omega \times (\omega \times \delta)\right)

with F the sum of all forces, F_w the weight, c the centre of mass from the origin, J the inertia
about it, and :math:`\mu` the share of the platform in the mass that moves; air drag is left out. A
controller that took the second for the first would answer itself: what it pulls changes what it has
learned, and a disturbance that is learned quickly then makes the platform swing ever more. A Kalman
filter tells them apart.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from baselines.mpc.geometry import Geometry
from carosac_toolkit.arrays import Array
from carosac_toolkit.robot import RigidBody, Robot, combine_bodies

NOISE = 0.012  # [m/s], of the speed gained in a command, for all of the platform alike
START = 0.2  # [m/s^2], of the acceleration when nothing is known
WALK = 1e-3  # [m/sqrt(s)], of the centre of mass: what else is wrong changes from place to place
ACCELERATION_MAX = 2.0  # [m/s^2], or a rotation of the same energy: more is no disturbance
CAREFUL = 4.0  # times slower the acceleration is followed where nobody tells the centre of mass
PUSH = np.array([1.0, 1.0, 0.0, 0.0, 0.0, 0.0])  # what a wind can do
FARTHEST = 3.0  # of the standard deviations of the centre of mass: farther out it is not
MOVED = 1e-4  # [m] by which the centre of mass moves before the robot is made anew


@dataclass(frozen=True, kw_only=True, eq=False)
class Motion:
    """What was planned for a command.

    Attributes:
        rotation: From P to W at its start, shape (3, 3).
        spin: Angular velocity there in W [rad/s], shape (3,).
        spin_rate: Its planned derivative [rad/s^2], shape (3,).
        force: Of the cables on the platform in W, half of their weight included [N], shape (3,).
        riding: Mass of each cable that moves with its anchor point [kg], shape (n,).
    """

    rotation: Array
    spin: Array
    spin_rate: Array
    force: Array
    riding: Array

    @classmethod
    def of(
        cls, robot: Robot, geometry: Geometry, tension: Array, *, rotation: Array, spin: Array,
        spin_rate: Array,
    ) -> Motion:  # fmt: skip
        """With cables of a geometry and of tensions along their chords [N], shape (n,)."""
        hanging = 0.5 * robot.weight_per_length @ geometry.free
        return cls(
            rotation=rotation, spin=spin, spin_rate=spin_rate,
            force=-tension @ geometry.direction - np.array([0.0, 0.0, hanging]),
            riding=robot.linear_density * geometry.free / 3.0,
        )  # fmt: skip


class UnknownLoad:
    """A Kalman filter of centre of mass and acceleration.

    Attributes:
        robot: The nominal one with the centre of mass that was learned or told.
    """

    def __init__(
        self, robot: Robot, *, period: float, center_of_mass: float, disturbance_time: float
    ) -> None:
        """Nothing is known yet.

        Args:
            robot: The nominal robot.
            period: Between two commands [s].
            center_of_mass: Standard deviation per axis [m]; 0: as in the robot file.
            disturbance_time: Time constant by which the acceleration is followed [s].
        """
        self._nominal, self._period = robot, period
        self._spread = center_of_mass
        gyration = np.sqrt(np.trace(robot.inertia) / (3.0 * robot.mass))
        self._unit = np.repeat([1.0, 1.0 / gyration], 3)  # of accelerations of equal energy
        self._follow = NOISE / disturbance_time * self._unit  # a walk that has that gain
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self.robot, self._told = self._nominal, False
        self._found = np.zeros(9)  # in P [m], shape (3,); in W [m/s^2, rad/s^2], shape (6,)
        walk = WALK * np.sqrt(self._period) * (self._spread > 0.0)
        self._set(np.repeat(self._spread, 3), START * self._unit * PUSH)
        follow = PUSH * self._follow / CAREFUL
        self._walk = np.diag(np.concatenate([np.repeat(walk, 3), follow]) ** 2)

    def _set(self, shift: Array, acceleration: Array) -> None:
        """Begin with standard deviations, shapes (3,) and (6,)."""
        self._covariance = np.diag(np.concatenate([shift, acceleration]) ** 2)

    @property
    def shift(self) -> Array:
        """By how much the centre of mass is elsewhere, in P [m], shape (3,)."""
        return np.asarray(self._found[:3])

    @property
    def acceleration(self) -> Array:
        """Of the free platform, beyond what the model says, in W [m/s^2, rad/s^2], shape (6,)."""
        return np.asarray(self._found[3:])

    def learn(self, gained: Array, free: Array, mass: Array, motion: Motion) -> None:
        """Take in what a twist gained beyond its prediction.

        Args:
            gained: In the free ways, linear first, in W, shape (6,).
            free: Projection onto these ways, shape (6, 6).
            mass: Mass matrix of the platform, shape (6, 6), whose metric that projection has.
            motion: What was planned.
        """
        root = np.linalg.cholesky(mass).T
        by = np.hstack([self._by_shift(motion), np.eye(6)])
        by = self._period * root @ free @ by
        covariance = self._covariance + self._walk
        noise = NOISE**2 * self._nominal.mass * np.eye(6)
        gain = np.linalg.solve(by @ covariance @ by.T + noise, by @ covariance).T
        found = self._found + gain @ (root @ gained)
        left = covariance - gain @ by @ covariance
        self._covariance = 0.5 * (left + left.T)
        shift = FARTHEST * self._spread
        most = np.concatenate([np.repeat(shift, 3), ACCELERATION_MAX * self._unit])
        found = np.clip(found, -most, most)
        if self._told:
            found[:3] = self.shift
        self._found = found
        self._place(self._nominal.center_of_mass + self.shift)

    def tell(self, center_of_mass: Array) -> None:
        """Take a centre of mass in P [m], shape (3,), that somebody else knows.

        Then all accelerations are learned, moments as well as pushes.
        """
        if not self._told:
            self._told = True
            self._set(np.zeros(3), START * self._unit)
            self._walk = np.diag(np.concatenate([np.zeros(3), self._follow]) ** 2)
        self._found[:3] = center_of_mass - self._nominal.center_of_mass
        self._place(center_of_mass)

    def _place(self, center_of_mass: Array) -> None:
        """Put the centre of mass of the robot there [m], unless it is there already."""
        if np.abs(center_of_mass - self.robot.center_of_mass).max() > MOVED:
            self.robot = replace(self._nominal, center_of_mass=center_of_mass)

    def _by_shift(self, motion: Motion) -> Array:
        """Acceleration per shift of the centre of mass in P, linear first, in W, shape (6, 3)."""
        robot, rotation = self.robot, motion.rotation
        points = [
            RigidBody(float(m), b, np.zeros((3, 3)))
            for m, b in zip(motion.riding, robot.anchor_points, strict=True)
        ]
        body = combine_bodies([RigidBody(robot.mass, robot.center_of_mass, robot.inertia), *points])
        share = robot.mass / body.mass
        weight = _cross(np.array([0.0, 0.0, -robot.weight]))
        force = _cross(motion.force) + weight
        inertia = rotation @ body.inertia @ rotation.T
        turned = np.linalg.solve(inertia, share * force - weight)
        spin = _cross(motion.spin)
        moved = _cross(rotation @ body.center_of_mass) @ turned
        moved -= share * (_cross(motion.spin_rate) + spin @ spin)
        return np.vstack([moved, turned]) @ rotation


def _cross(vector: Array) -> Array:
    """Matrix of the cross product with a vector, shape (3, 3)."""
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
