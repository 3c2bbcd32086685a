"""Settings of a self-calibration: what is known before it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from carosac_toolkit.base.arrays import Array, frozen_array
from carosac_toolkit.base.errors import InvalidField

HOME = "home"  # name of the home position among the ends of a distance


def positive(value: ArrayLike) -> bool:
    """Return whether all values are above 0 and finite."""
    array = np.asarray(value)
    return bool((np.isfinite(array) & (array > 0.0)).all())


@dataclass(frozen=True, kw_only=True)
class Distance:
    """A measured straight distance between two points of the set-up.

    Attributes:
        first: Name of a cable, which means its exit point, or ``home``.
        second: The same; another point.
        length: [m].
        sigma: One standard deviation [m].
    """

    first: str
    second: str
    length: float
    sigma: float

    def __post_init__(self) -> None:
        """Refuse a distance of a point from itself, and lengths that are not positive."""
        if self.first == self.second:
            raise InvalidField("distance", f"{self.first} to {self.second}", "two different points")
        for name in ("length", "sigma"):
            value = getattr(self, name)
            if not positive(value):
                raise InvalidField(f"{name} of the distance {self}", f"{value:g} m", "> 0 m")

    def __str__(self) -> str:
        """Return the two ends in words."""
        return f"{self.first} to {self.second}"


@dataclass(frozen=True, kw_only=True, eq=False)
class SelfCalibrationSettings:
    """One standard deviation of what is known before, and what counts as a blunder.

    Attributes:
        exit_sigma: Of exit points per axis, where the robot file says nothing [m].
        length_at_zero: Lengths of the cables at motor angle 0, roughly measured [m], shape (n,);
            None: those that the robot file has at home.
        length_at_zero_sigma: Of these lengths [m].
        drum_radius_sigma: Of the radius that alike drums share [m].
        drum_buildup_share: Of the build-up, as a share of it [1].
        stiffness_share: Of the stiffness EA, as a share of it, where tensions are measured [1].
        friction_share: Largest error of a measured tension by friction, as a share of it [1].
        distances: Measured distances between exit points, or from one to home.
        x_through: Cable through whose exit point the x axis of W runs, seen from above and from
            home, where nothing that was measured tells the heading; None: the exit points of the
            robot file tell it.
        keeps_rotation: True if the platform is built to keep its rotation from home, though its
            cables end apart from each other. With up to six cables, such a platform is refused
            otherwise.
        accuracy: Wanted standard deviation of the exit points, the mean of their distances from
            the truth [m]; None: 1 % of the longest cable.
        known_sigma: Of known positions per axis, where the file says nothing [m], shape (3,).
        line_sigma: Of the line paid out by a drum [m]; None: estimated from the residuals.
        blunder: Probability of a good sample's misfit below which it counts as a blunder [1].
    """

    exit_sigma: float = 0.5
    length_at_zero: Array | None = None
    length_at_zero_sigma: float = 0.02
    drum_radius_sigma: float = 2e-3
    drum_buildup_share: float = 0.15
    stiffness_share: float = 0.3
    friction_share: float = 0.1
    distances: tuple[Distance, ...] = ()
    x_through: str | None = None
    keeps_rotation: bool = False
    accuracy: float | None = None
    known_sigma: Array | tuple[float, float, float] = (1e-3, 1e-3, 1e-3)
    line_sigma: float | None = None
    blunder: float = 1e-5

    def __post_init__(self) -> None:
        """Freeze arrays and refuse deviations that are none."""
        object.__setattr__(self, "known_sigma", frozen_array("known_sigma", self.known_sigma, (3,)))
        object.__setattr__(self, "distances", tuple(self.distances))
        for name in (
            "exit_sigma", "known_sigma", "line_sigma", "length_at_zero_sigma",
            "drum_radius_sigma", "drum_buildup_share", "stiffness_share", "accuracy",
        ):  # fmt: skip
            value = getattr(self, name)
            if value is not None and not positive(value):
                raise InvalidField(name, value, "> 0, finite")
        if not 0.0 <= self.friction_share < 1.0:
            raise InvalidField("friction_share", self.friction_share, "0 <= friction_share < 1")
        if not 0.0 < self.blunder < 0.1:
            raise InvalidField("blunder", self.blunder, "0 < blunder < 0.1")
