"""State of the filter of one robot, and the order of its errors."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from baselines.dynamic_estimator.sway_basis import SwayBasis
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.rotations import wrapped_angle


class Errors:
    """The order of errors, truth minus estimate, of a robot of n cables with m ways to sway.

    Attributes:
        soft: Which ways to sway are on cables that give way, by their place among the ways.
        sway: Along the ways to sway, in `SwayBasis` coordinates, m of them [m kg^0.5].
        speed: Their rates [m kg^0.5/s].
        motion: Both.
        wind: Force along x and y of W [N].
        mass: Logarithm of the platform's mass.
        center: Centre of mass in P [m].
        bias: What the length readings say too much, n of them [m].
        imu: Biases of gyroscope [rad/s] and accelerometer [m/s^2].
        cells: Biases of the load cells, n of them or none [N].
        swivels: Zeros of the swivel angles, n of them or none [rad].
        mounting: Rotation vector of an AHRS or inclinometer in its own frame, 3 or none [rad].
        heading: Of its level frame in W, one or none [rad].
        moving: How many errors change the motion: all before `imu`.
        size: All of them.
    """

    def __init__(
        self, n: int, m: int, *, cells: bool = False, swivels: bool = False, attitude: bool = False
    ) -> None:
        """Lay out the errors for n cables and m ways to sway.

        Args:
            n: Number of cables.
            m: Number of ways to sway.
            cells: Whether there are load cells.
            swivels: Whether there are swivel angles.
            attitude: Whether there is an AHRS or an inclinometer.
        """
        self.m, self.n = m, n
        self.soft = slice(0, m - max(0, 6 - n))
        self.sway = slice(0, m)
        self.speed = slice(m, 2 * m)
        self.motion = slice(0, 2 * m)
        self.wind = slice(2 * m, 2 * m + 2)
        self.mass = slice(2 * m + 2, 2 * m + 3)
        self.center = slice(2 * m + 3, 2 * m + 6)
        self.bias = slice(2 * m + 6, 2 * m + 6 + n)
        self.moving = 2 * m + 6 + n
        self.imu = slice(self.moving, self.moving + 6)
        self.cells = slice(self.moving + 6, self.moving + 6 + (n if cells else 0))
        after = self.cells.stop
        self.swivels = slice(after, after + (n if swivels else 0))
        after = self.swivels.stop
        self.mounting = slice(after, after + (3 if attitude else 0))
        after = self.mounting.stop
        self.heading = slice(after, after + (1 if attitude else 0))
        self.size = self.heading.stop


@dataclass(frozen=True, kw_only=True, eq=False)
class DynamicFilterState:
    """Estimate of one robot at one time; no batch.

    Attributes:
        time: [s].
        position: Platform origin in W [m], shape (3,).
        rotation: From P to W, shape (3, 3).
        twist: Of the platform origin in W, linear first, shape (6,).
        wind: Force of the wind along x and y [N], shape (2,).
        log_mass: Logarithm of the mass over that of the robot file.
        center: Centre of mass in P [m], shape (3,).
        length_bias: What the readings say too much [m], shape (n,).
        imu_bias: Of gyroscope [rad/s] and accelerometer [m/s^2], shape (6,).
        cell_bias: Of the load cells [N], shape (n,), or (0,) where they are not used.
        covariance: In the order of `Errors`.
        sway: The coordinates that it refers to.
        tension: At the platform [N], shape (n,).
        exit_tension: Tension vectors at the exits [N], shape (n, 3).
        swivel_offset: What swivel angles say too much [rad], shape (n,), or (0,) where they are not
            used; NaN where no reading has told it yet.
        swivel_sag: By how much sag turns the pulleys beyond straight cables [rad], shape (n,), or
            (0,) where swivel angles are not used.
        mounting: Rotation from the frame of an AHRS or inclinometer to P, shape (3, 3); None where
            none is used.
        heading: Of its level frame in W [rad].
        bristles: Bend of the bristles of dry friction, as `Motions` has it, shape (n,); None:
            unknown, where nothing has moved yet.
    """

    time: float
    position: Array
    rotation: Array
    twist: Array
    wind: Array
    log_mass: float
    center: Array
    length_bias: Array
    imu_bias: Array
    cell_bias: Array
    covariance: Array
    sway: SwayBasis
    tension: Array
    exit_tension: Array
    swivel_offset: Array = field(default_factory=lambda: np.zeros(0))
    swivel_sag: Array = field(default_factory=lambda: np.zeros(0))
    mounting: Array | None = None
    heading: float = 0.0
    bristles: NDArray[Any] | None = None

    @property
    def errors(self) -> Errors:
        """The order of its errors."""
        n, m = self.sway.slaved.shape[1], self.sway.ways.shape[1]
        return Errors(
            n, m, cells=len(self.cell_bias) > 0, swivels=len(self.swivel_offset) > 0,
            attitude=self.mounting is not None,
        )  # fmt: skip

    def pose_by(self) -> Array:
        """Return the pose error per error, shape (6, size); there is no other."""
        where = self.errors
        by = np.zeros((6, where.size))
        by[:, where.sway] = self.sway.ways
        by[:, where.bias] = self.sway.slaved
        return by

    def corrected(self, error: Array, covariance: Array) -> DynamicFilterState:
        """Return the state with an estimated error removed.

        Args:
            error: Truth minus estimate, in the order of `Errors`.
            covariance: Of what is left of it.
        """
        import pinocchio

        where = self.errors
        moved = self.pose_by() @ error
        mounting, heading = self.mounting, self.heading
        if mounting is not None:
            mounting = mounting @ pinocchio.exp3(np.ascontiguousarray(error[where.mounting]))
            heading = float(wrapped_angle(heading + error[where.heading])[0])
        return replace(
            self,
            position=self.position + moved[:3],
            rotation=pinocchio.exp3(np.ascontiguousarray(moved[3:])) @ self.rotation,
            twist=self.twist + self.sway.ways @ error[where.speed],
            wind=self.wind + error[where.wind],
            log_mass=self.log_mass + float(error[where.mass][0]),
            center=self.center + error[where.center],
            length_bias=self.length_bias + error[where.bias],
            imu_bias=self.imu_bias + error[where.imu],
            cell_bias=self.cell_bias + error[where.cells],
            swivel_offset=self.swivel_offset + error[where.swivels],
            mounting=mounting,
            heading=heading,
            covariance=0.5 * (covariance + covariance.T),
        )

    def loosened(self, deviation: Array) -> DynamicFilterState:
        """Return the state with length biases less certain, by deviations (n,) [m]."""
        matrix = np.array(self.covariance)
        where = self.errors.bias
        matrix[where, where] += np.diag(deviation**2)
        return replace(self, covariance=matrix)

    def slipped(self, slip: Array, deviation: float) -> DynamicFilterState:
        """Return the state after encoders slipped; the platform stays where it was.

        Args:
            slip: By how much [m], shape (n,).
            deviation: Of that, where it is not 0 [m].
        """
        doubt = np.where(slip == 0.0, 0.0, deviation)
        return replace(self, length_bias=self.length_bias + slip).loosened(doubt)

    def platform_covariance(self, reading: float, speed: float) -> Array:
        """Return the covariance of pose and twist as in `Belief`, shape (12, 12).

        Args:
            reading: Error of the lengths themselves, beside their biases [m].
            speed: Error of their rates, with what the cables vibrate by [m/s].
        """
        where = self.errors
        by = np.zeros((12, where.size))
        by[:6] = self.pose_by()
        by[6:, where.speed] = self.sway.ways
        covariance = by @ self.covariance @ by.T
        rigid = self.sway.slaved @ self.sway.slaved.T
        covariance[:6, :6] += reading**2 * rigid
        covariance[6:, 6:] += speed**2 * rigid
        return np.asarray(covariance)
