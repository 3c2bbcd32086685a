"""Circles and spirals, run through at constant angular speed between smooth ramps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from carosac_toolkit.base.arrays import Array, frozen_array
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.trajectories.timing import timed
from carosac_toolkit.trajectories.trajectory import Trajectory

RAMP_TURNS = 0.25  # how far it turns while speeding up; then the ramp is no harder than the curve


@dataclass(frozen=True, kw_only=True, eq=False)
class Helix:
    """Helix about an axis; radius and height change linearly with the angle.

    Attributes:
        center: Of the start circle, in W [m], shape (3,).
        axes: Orthonormal columns: towards angle 0, towards a quarter turn, the axis; (3, 3).
        radius: At the start and at the end [m], shape (2,).
        height: Travel along the axis [m].
        angles: At the start and at the end [rad], shape (2,).
        ramp: Share of the nominal duration of 1 s that each ramp takes, 0 < ramp <= 0.5.
    """

    center: Array
    axes: Array
    radius: Array
    height: float
    angles: Array
    ramp: float

    @property
    def breaks(self) -> Array:
        """Ends of the ramps, and further marks four times a turn, where peaks may lie."""
        turns = abs(self.angles[1] - self.angles[0]) / (2 * np.pi)
        cruise = np.linspace(self.ramp, 1.0 - self.ramp, 1 + max(1, int(np.ceil(4 * turns))))
        inner = cruise if self.ramp < 0.5 else [0.5]
        return np.concatenate([[0.0], inner, [1.0]])

    def derivatives(self, time: Array) -> Array:
        """Evaluate position and three derivatives, shape (K, 4, 3); see `Curve`."""
        u, u1, u2, u3 = self._progress(time)
        r0, slope = self.radius[0], self.radius[1] - self.radius[0]
        w = self.angles[1] - self.angles[0]
        r = r0 + slope * u
        turn = np.exp(1j * (self.angles[0] + w * u))
        # derivatives with respect to the progress u, in the plane as complex numbers
        z = r * turn
        z1 = (slope + 1j * r * w) * turn
        z2 = (2j * slope * w - r * w**2) * turn
        z3 = (-3 * slope * w**2 - 1j * r * w**3) * turn
        plane = [z, z1 * u1, z2 * u1**2 + z1 * u2, z3 * u1**3 + 3 * z2 * u1 * u2 + z1 * u3]
        axial = [self.height * value for value in (u, u1, u2, u3)]
        local = np.stack(
            [np.stack([p.real, p.imag, a], axis=1) for p, a in zip(plane, axial, strict=True)],
            axis=1,
        )
        world = local @ self.axes.T
        world[:, 0] += self.center
        return np.asarray(world)

    def _progress(self, time: Array) -> tuple[Array, Array, Array, Array]:
        """Return the share of the way done and its derivatives, from rest to rest in 1 s.

        The rate rises as 10 x^3 - 15 x^4 + 6 x^5 over a ramp, is constant, and falls likewise.
        """
        rate = 1.0 / (1.0 - self.ramp)
        mirrored = time > 0.5
        x = np.clip(np.where(mirrored, 1.0 - time, time) / self.ramp, 0.0, None)
        y = np.minimum(x, 1.0)
        done = y**4 * (2.5 - 3 * y + y**2) + np.maximum(x - 1.0, 0.0)
        u = rate * self.ramp * done
        u1 = rate * y**3 * (10 - 15 * y + 6 * y**2)
        u2 = rate / self.ramp * 30 * y**2 * (1 - y) ** 2
        u3 = rate / self.ramp**2 * 60 * y * (1 - y) * (1 - 2 * y)
        return (
            np.where(mirrored, 1.0 - u, u), u1, np.where(mirrored, -u2, u2), u3
        )  # fmt: skip


def circle(
    center: ArrayLike,
    radius: float,
    *,
    speed_max: float,
    acceleration_max: float,
    turns: float = 1.0,
    start_angle: float = 0.0,
    normal: ArrayLike = (0.0, 0.0, 1.0),
    duration: float | None = None,
) -> Trajectory:
    """Run along a circle: at constant speed, but for smooth ramps of a quarter turn at the ends.

    Args:
        center: In world frame W [m], shape (3,).
        radius: [m].
        speed_max: [m/s].
        acceleration_max: [m/s^2]; speed^2 / radius at constant speed.
        turns: Number of turns; negative: clockwise seen against the normal.
        start_angle: From the projection of W's x axis (y, if x is the normal) [rad].
        normal: Of the circle's plane, in W, shape (3,); any length.
        duration: [s]; None: as fast as the limits allow.
    """
    return spiral(
        center, radius, radius, 0.0,
        speed_max=speed_max, acceleration_max=acceleration_max, turns=turns,
        start_angle=start_angle, normal=normal, duration=duration, name="circle",
    )  # fmt: skip


def spiral(
    center: ArrayLike,
    radius_start: float,
    radius_end: float,
    height: float,
    *,
    speed_max: float,
    acceleration_max: float,
    turns: float = 3.0,
    start_angle: float = 0.0,
    normal: ArrayLike = (0.0, 0.0, 1.0),
    duration: float | None = None,
    name: str = "spiral",
) -> Trajectory:
    """Run along a helix whose radius and height change linearly with the angle.

    Args:
        center: Of the first turn, in world frame W [m], shape (3,).
        radius_start: [m], >= 0.
        radius_end: [m], >= 0.
        height: Travel along the normal [m].
        speed_max: [m/s].
        acceleration_max: [m/s^2].
        turns: Number of turns; negative: clockwise seen against the normal.
        start_angle: From the projection of W's x axis (y, if x is the normal) [rad].
        normal: The axis, in W, shape (3,); any length.
        duration: [s]; None: as fast as the limits allow.
        name: Of the trajectory.
    """
    radius = frozen_array("radius", [radius_start, radius_end], (2,))
    if (radius < 0.0).any() or not radius.any():
        raise InvalidField("radius", f"{radius_start} m, {radius_end} m", "both >= 0, one > 0")
    if not 0.0 < abs(turns) < np.inf:
        raise InvalidField("turns", turns, "a finite number of turns, not 0")
    travel = min(RAMP_TURNS / abs(turns), 0.5)  # share of the way within each ramp
    curve = Helix(
        center=frozen_array("center", center, (3,)),
        axes=_axes(normal),
        radius=radius,
        height=float(frozen_array("height", height, ())),
        angles=start_angle + np.array([0.0, 2 * np.pi * turns]),
        ramp=2 * travel / (1 + 2 * travel),
    )
    return timed(
        curve,
        name=name,
        speed_max=speed_max,
        acceleration_max=acceleration_max,
        duration=duration,
    )


def _axes(normal: ArrayLike) -> Array:
    """Return orthonormal columns (3, 3), the last along the normal."""
    axis = frozen_array("normal", normal, (3,))
    length = np.linalg.norm(axis)
    if not length > 0.0:
        raise InvalidField("normal", axis, "a non-zero vector")
    third = axis / length
    first = np.eye(3)[0] if abs(third[0]) < 0.99 else np.eye(3)[1]
    first = first - (first @ third) * third
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(third, first), third], axis=1)
