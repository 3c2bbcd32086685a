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
ACCELERATION_MAX = 2.0  # [m/s^2]: more is no disturbance
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
    """A Kalman filter of five numbers.

    Attributes:
        robot: The nominal one with the centre of mass that was learned.
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
        follow = NOISE / disturbance_time  # [m/s^2], a random walk a command with that gain
        walk = WALK * np.sqrt(period) * (center_of_mass > 0.0)
        self._walk = np.diag(np.repeat([walk, follow], (3, 2)) ** 2)
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self.robot = self._nominal
        self._found = np.zeros(5)  # in P [m], shape (3,); horizontal [m/s^2], shape (2,)
        self._covariance = np.diag(np.repeat([self._spread, START], (3, 2)) ** 2)

    @property
    def shift(self) -> Array:
        """By how much the centre of mass is elsewhere, in P [m], shape (3,)."""
        return np.asarray(self._found[:3])

    @property
    def acceleration(self) -> Array:
        """Of the free platform, beyond what the model says, in W [m/s^2], shape (3,)."""
        return np.append(self._found[3:], 0.0)

    def learn(self, gained: Array, free: Array, mass: Array, motion: Motion) -> None:
        """Take in what a twist gained beyond its prediction.

        Args:
            gained: In the free ways, linear first, in W, shape (6,).
            free: Projection onto these ways, shape (6, 6).
            mass: Mass matrix of the platform, shape (6, 6), whose metric that projection has.
            motion: What was planned.
        """
        root = np.linalg.cholesky(mass).T
        per_acceleration = np.eye(6)[:, :2]
        by = np.hstack([self._by_shift(motion), per_acceleration])
        by = self._period * root @ free @ by
        covariance = self._covariance + self._walk
        noise = NOISE**2 * self._nominal.mass * np.eye(6)
        gain = np.linalg.solve(by @ covariance @ by.T + noise, by @ covariance).T
        found = self._found + gain @ (root @ gained)
        left = covariance - gain @ by @ covariance
        self._covariance = 0.5 * (left + left.T)
        most = np.repeat([FARTHEST * self._spread, ACCELERATION_MAX], (3, 2))
        self._found = np.clip(found, -most, most)
        known = self._nominal.center_of_mass + self.shift
        if np.abs(known - self.robot.center_of_mass).max() > MOVED:
            self.robot = replace(self._nominal, center_of_mass=known)

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
