"""Shots of levelled set-ups, the points that they sight, and their accuracy.

Angles are as instruments count them: the horizontal direction Hz grows clockwise, seen from above,
from a zero that is arbitrary in each set-up; the zenith angle V is 0 straight up.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from carosac_toolkit.base.arrays import Array, set_frozen
from carosac_toolkit.base.errors import InvalidField

SIGHTING_KINDS = ("centre", "axle", "rim", "tangent")
READING_NAMES = ("Hz", "V", "distance")
ARCSEC_RAD = np.pi / 648000.0


@dataclass(frozen=True, kw_only=True)
class Instrument:
    """Accuracy of a total station, as one standard deviation each.

    Attributes:
        angle: Of a direction or zenith angle read once, in one face [rad].
        distance: Constant part of a slope distance [m].
        distance_ppm: Part that grows with the distance, in parts per million [1].
        pointing: Across the line of sight, of pointing and of centring the target [m].
        compensator: Of the levelling, about each of two horizontal axes [rad].
    """

    angle: float = 3.0 * ARCSEC_RAD
    distance: float = 1e-3
    distance_ppm: float = 1.5
    pointing: float = 0.3e-3
    compensator: float = 1e-5

    def __post_init__(self) -> None:
        """Refuse accuracies that are none."""
        for name in ("angle", "distance", "compensator"):
            if not 0.0 < getattr(self, name) < np.inf:
                raise InvalidField(f"instrument.{name}", getattr(self, name), f"{name} > 0")
        for name in ("distance_ppm", "pointing"):
            if not 0.0 <= getattr(self, name) < np.inf:
                raise InvalidField(f"instrument.{name}", getattr(self, name), f"{name} >= 0")

    def sigma(self, reading: Array) -> Array:
        """Return the standard deviations of polar readings.

        An error across the line of sight turns Hz the more, the steeper the sight: its standard
        deviation grows as 1 / sin V.

        Args:
            reading: Hz [rad], V [rad], slope distance [m], shape (B, 3).

        Returns:
            Standard deviations in the same units, shape (B, 3).
        """
        distance = reading[:, 2]
        across = np.hypot(self.angle, self.pointing / distance)
        steep = np.maximum(np.abs(np.sin(reading[:, 1])), 1e-6)
        along = np.hypot(self.distance, 1e-6 * self.distance_ppm * distance)
        return np.stack([across / steep, across, along], axis=1)


@dataclass(frozen=True)
class Sighting:
    """Part of a target that was sighted.

    Attributes:
        kind: ``centre``: the point itself, for a cable its exit point (the datum). On a pulley,
            ``axle``: the axle on the wheel's middle plane; ``rim``: a point of the wheel's circle;
            ``tangent``: where the cable leaves the groove towards the platform.
        rim_angle: Of a ``rim`` point, about the axle from the datum in the sense in which the cable
            wraps [rad]: 0 the datum, pi / 2 farthest along the swivel axis, pi farthest from it.
        rim_radius: Of the circle on which a ``rim`` point lies [m]; None: that of the groove.
        side: Distance of the sighted point from the wheel's middle plane, on the side of the
            instrument [m], as for the face of an axle or of a flange.
    """

    kind: str = "centre"
    rim_angle: float | None = None
    rim_radius: float | None = None
    side: float = 0.0

    def __post_init__(self) -> None:
        """Refuse combinations that mean nothing."""
        if self.kind not in SIGHTING_KINDS:
            raise InvalidField("sighted", repr(self.kind), f"one of {', '.join(SIGHTING_KINDS)}")
        if (self.rim_angle is None) != (self.kind != "rim"):
            got = f"sighted: {self.kind} {'without' if self.kind == 'rim' else 'with'} a rim angle"
            raise InvalidField("rim angle", got, "given with sighted: rim, and only there")
        if self.rim_radius is not None and not (self.kind == "rim" and self.rim_radius > 0.0):
            raise InvalidField("rim radius", self.rim_radius, "a positive one, with sighted: rim")
        if self.kind == "centre" and self.side != 0.0:
            raise InvalidField("side", f"{self.side} m", "0 with sighted: centre")

    @property
    def on_pulley(self) -> bool:
        """True if only a pulley has such a point."""
        return self.kind != "centre"


@dataclass(frozen=True, kw_only=True)
class Shot:
    """One sight to one target.

    Attributes:
        setup: Name of the set-up.
        target: A cable or a reference point, by name.
        hz: Horizontal direction, clockwise [rad].
        v: Zenith angle, in face I [rad].
        distance: Slope distance with the prism constant in it [m].
        sighting: Part of the target that was sighted.
        source: File and line, for messages.
    """

    setup: str
    target: str
    hz: float
    v: float
    distance: float
    sighting: Sighting = field(default_factory=Sighting)
    source: str = ""

    def __post_init__(self) -> None:
        """Refuse what no instrument reads."""
        if not np.isfinite(self.hz):
            raise InvalidField(f"{self.where}: Hz", self.hz, "a finite angle")
        if not 0.0 < self.v < np.pi:
            raise InvalidField(f"{self.where}: V", f"{self.v} rad", "0 < V < pi, in face I")
        if not 0.0 < self.distance < np.inf:
            raise InvalidField(f"{self.where}: distance", f"{self.distance} m", "distance > 0")

    @property
    def where(self) -> str:
        """Name of the shot in messages."""
        return self.source or f"shot from {self.setup} to {self.target}"


@dataclass(frozen=True, eq=False)
class ReferencePoint:
    """A point other than an exit point that set-ups have in common.

    Attributes:
        name: Its name.
        position: Known coordinates in the robot's frame W [m], shape (3,), or None for a tie point.
        sigma: Their standard deviation per axis [m], shape (3,), or None.
    """

    name: str
    position: Array | None = None
    sigma: Array | None = None

    def __post_init__(self) -> None:
        """Freeze the arrays."""
        if (self.position is None) != (self.sigma is None):
            raise InvalidField(f"reference {self.name}", "one of two", "position and sigma")
        if self.position is None or self.sigma is None:
            return
        set_frozen(self, {"position": (3,), "sigma": (3,)})
        if (self.sigma <= 0.0).any():
            raise InvalidField(f"reference {self.name}: sigma", self.sigma, "sigma > 0")


@dataclass(frozen=True, kw_only=True, eq=False)
class Survey:
    """All that was measured, with what is known about it.

    Attributes:
        shots: In the order in which they are numbered, from 1.
        references: Common points by name.
        instrument: Accuracy of the readings.
        towards: Anchor point in W [m] to which each cable ran during the survey, by cable, (3,):
            a pulley swivels towards it. Needed where an axle, rim or tangent point was sighted.
        swivel_sigma: Standard deviation of a pulley's direction about its swivel axis [rad].
    """

    shots: tuple[Shot, ...]
    references: Mapping[str, ReferencePoint]
    instrument: Instrument = field(default_factory=Instrument)
    towards: Mapping[str, Array] = field(default_factory=dict)
    swivel_sigma: float = np.deg2rad(2.0)

    def __post_init__(self) -> None:
        """Refuse a survey without shots."""
        if not self.shots:
            raise InvalidField("shots", "none", "at least one shot")
        if not 0.0 < self.swivel_sigma < np.inf:
            raise InvalidField("swivel_sigma", f"{self.swivel_sigma} rad", "swivel_sigma > 0")

    @property
    def setups(self) -> tuple[str, ...]:
        """Names of the set-ups, in order of their first shots."""
        return tuple(dict.fromkeys(shot.setup for shot in self.shots))

    @property
    def targets(self) -> tuple[str, ...]:
        """Names of the sighted cables and references, in order of their first shots."""
        return tuple(dict.fromkeys(shot.target for shot in self.shots))

    @property
    def reading(self) -> Array:
        """Hz [rad], V [rad], distance [m] of every shot, shape (B, 3)."""
        return np.array([[shot.hz, shot.v, shot.distance] for shot in self.shots])

    @property
    def known(self) -> tuple[ReferencePoint, ...]:
        """Sighted references with known coordinates."""
        seen = set(self.targets)
        return tuple(
            ref for ref in self.references.values() if ref.position is not None and ref.name in seen
        )


def face_one(hz: float, v: float) -> tuple[float, float]:
    """Bring an observation in face II (V > pi) to face I, with Hz in [0, 2 pi)."""
    v = v % (2.0 * np.pi)
    if v > np.pi:
        hz, v = hz + np.pi, 2.0 * np.pi - v
    return float(hz % (2.0 * np.pi)), float(v)


def polar(point: Array) -> Array:
    """Return the Hz [rad], V [rad] and distance [m] of points in a set-up's frame.

    Args:
        point: In a frame with z up, y where Hz is 0 and x to the right of it [m], shape (B, 3).

    Returns:
        Shape (B, 3); Hz in [0, 2 pi).
    """
    x, y, z = point.T
    flat = np.hypot(x, y)
    hz = np.arctan2(x, y) % (2.0 * np.pi)
    return np.stack([hz, np.arctan2(flat, z), np.hypot(flat, z)], axis=1)


def cartesian(reading: Array) -> Array:
    """Undo `polar`, shapes (B, 3)."""
    hz, v, distance = reading.T
    flat = distance * np.sin(v)
    return np.stack([flat * np.sin(hz), flat * np.cos(hz), distance * np.cos(v)], axis=1)
