"""What a survey gave: exit points, blunders, residuals, and what they are worth."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2 as chi2_law

from calibration.estimate import ParameterEstimate
from calibration.observability import Observability
from calibration.tachymeter.observations import ARCSEC_RAD, READING_NAMES, Survey
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.robot.robot import Robot

CHI2_PROBABILITY = 0.99  # of the band in which chi2 falls if all noise is as stated
BLUNDER_SHARE_MAX = (
    0.1  # share of readings left out above which they are no blunders: the accuracy is wrong
)
EXIT_SHIFT_MAX_M = (
    0.5  # [m] from the robot file's exit point, beyond which something else was sighted
)
_NORMAL_MEDIAN = 0.6745  # of the size of a standard normal number


@dataclass(frozen=True, kw_only=True)
class ReadingBlunder:
    """A reading that does not fit and was left out.

    Attributes:
        shot: Its number, from 1; None for a known coordinate.
        setup: Set-up; empty for a known coordinate.
        target: Cable or reference point.
        reading: Hz, V, distance, or ``known x``, ``known y``, ``known z``.
        error: Measured minus what all else says [rad] or [m].
        sigmas: Its size over its standard deviation.
        or_else: Another reading that would explain the misfit as well, or empty.
        source: File and line.
    """

    shot: int | None
    setup: str
    target: str
    reading: str
    error: float
    sigmas: float
    or_else: str
    source: str

    @property
    def size(self) -> str:
        """The error in a unit for people."""
        if self.reading in ("Hz", "V"):
            return f"{self.error / ARCSEC_RAD:+.0f} arcsec"
        return f"{self.error * 1e3:+.1f} mm"

    def sentence(self) -> str:
        """Name the blunder."""
        if self.shot is None:
            what = f"{self.reading} of reference {self.target}"
        else:
            what = f"shot {self.shot}, set-up {self.setup}, target {self.target}: {self.reading}"
        where = f" [{self.source}]" if self.source else ""
        other = f"; {self.or_else} would explain it as well" if self.or_else else ""
        return f"{what} is off by {self.size}, {self.sigmas:.0f} sigmas{where}{other}"


@dataclass(frozen=True, kw_only=True, eq=False)
class Station:
    """A set-up as it was found.

    Attributes:
        values: x, y, z in W [m], heading [rad], tilt about its own x and y [rad], shape (6,).
        sigma: Standard deviations, shape (6,).
    """

    values: Array
    sigma: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Residuals:
    """Residuals of all shots; columns Hz, V, distance.

    Attributes:
        value: Measured minus model [rad, rad, m], shape (shots, 3).
        sigma: Stated standard deviation of the readings, shape (shots, 3).
        test: Residual over its own standard deviation, shape (shots, 3).
        used: False where a reading was left out, shape (shots, 3).
        redundancy: Share of a reading that others check, shape (shots, 3).
    """

    value: Array
    sigma: Array
    test: Array
    used: NDArray[np.bool_]
    redundancy: Array

    def rms(self) -> Array:
        """Root mean square of the residuals in use [rad, rad, m], shape (3,); 0 if none is."""
        count = np.maximum(self.used.sum(axis=0), 1)
        found: Array = np.sqrt((self.value**2 * self.used).sum(axis=0) / count)
        return found


@dataclass(frozen=True, kw_only=True, eq=False)
class TachymeterResult:
    """All that a survey gave.

    Attributes:
        robot: Before the calibration.
        survey: What was measured.
        cables: Cables that were sighted, in the robot's order, c of them.
        estimate: Their exit points, 3 c parameters with their joint covariance; and the tilt of
            the references' frame where it was estimated.
        points: Every sighted point in W [m], by name, (3,).
        stations: Set-ups by name.
        swivels: Turn of each pulley beyond its cable's direction [rad], by cable.
        blunders: Readings left out, the worst first.
        unchecked: Targets with readings whose blunders nothing would show.
        residuals: Of all shots.
        observability: How well the survey determines the exit points.
        chi2: Sum of squared whitened residuals.
        freedom: Its degrees of freedom.
        converged: Whether the choice of blunders came to rest.
    """

    robot: Robot
    survey: Survey
    cables: tuple[str, ...]
    estimate: ParameterEstimate
    points: Mapping[str, Array]
    stations: Mapping[str, Station]
    swivels: Mapping[str, float]
    blunders: tuple[ReadingBlunder, ...]
    unchecked: tuple[str, ...]
    residuals: Residuals
    observability: Observability
    chi2: float
    freedom: int
    converged: bool

    def misplaced(self) -> list[str]:
        """Name exit points that are far from where the robot file has them."""
        lines = []
        before = {
            name: self.robot.exit_points[self.robot.cable_names.index(name)] for name in self.cables
        }
        for name, point in zip(self.cables, self.exit_points, strict=True):
            away = float(np.linalg.norm(point - before[name]))
            if away <= EXIT_SHIFT_MAX_M:
                continue
            others = {o: float(np.linalg.norm(point - p)) for o, p in before.items() if o != name}
            near = min(others, key=lambda other: others[other], default=name)
            hint = "is it the right robot, and the right known points?"
            if others.get(near, np.inf) <= EXIT_SHIFT_MAX_M:
                hint = f"that is where the file has {near}: are these targets swapped?"
            lines.append(f"{name} is {away:.2f} m from where the robot file has it; {hint}")
        return lines

    @property
    def exit_points(self) -> Array:
        """Exit points of `cables` in W [m], shape (c, 3)."""
        return np.array([self.points[name] for name in self.cables])

    @property
    def exit_covariance(self) -> Array:
        """Joint covariance of the exit points of `cables` [m^2], shape (3 c, 3 c)."""
        size = 3 * len(self.cables)
        return self.estimate.covariance[:size, :size]

    @property
    def exit_sigma(self) -> Array:
        """Standard deviations of the exit points' coordinates [m], shape (c, 3)."""
        found: Array = np.sqrt(np.diag(self.exit_covariance)).reshape(-1, 3)
        return found

    @property
    def unmeasured(self) -> tuple[str, ...]:
        """Cables that nobody sighted; their exit points stay as they were."""
        return tuple(name for name in self.robot.cable_names if name not in self.cables)

    @property
    def chi2_band(self) -> tuple[float, float]:
        """Where chi2 lies with probability `CHI2_PROBABILITY` if all noise is as stated."""
        low, high = chi2_law.interval(CHI2_PROBABILITY, max(self.freedom, 1))
        return float(low), float(high)

    @property
    def left_out(self) -> float:
        """Share of the readings that were left out."""
        return float(1.0 - self.residuals.used.mean())

    @property
    def spread(self) -> float:
        """Residuals over what the stated accuracy explains, by the median of all readings."""
        checked = self.residuals.test[self.residuals.test != 0.0]
        return float(np.median(np.abs(checked)) / _NORMAL_MEDIAN) if len(checked) else 0.0

    @property
    def fits(self) -> bool:
        """Whether the residuals are no larger than the stated accuracy explains."""
        return (
            self.freedom > 0
            and self.chi2 <= self.chi2_band[1]
            and self.left_out <= BLUNDER_SHARE_MAX
        )

    def data(self) -> dict[str, Any]:
        """Everything for JSON."""
        rms = self.residuals.rms()
        return {
            "exit_points_m": dict(zip(self.cables, self.exit_points, strict=True)),
            "exit_sigma_m": dict(zip(self.cables, self.exit_sigma, strict=True)),
            "covariance_m2": self.exit_covariance,
            "covariance_order": list(self.estimate.names[: 3 * len(self.cables)]),
            "parameters": self.estimate.data(),
            "unmeasured": list(self.unmeasured),
            "stations": {
                name: {
                    "position_m": station.values[:3],
                    "heading_rad": station.values[3],
                    "tilt_rad": station.values[4:],
                    "sigma": station.sigma,
                }
                for name, station in self.stations.items()
            },
            "points_m": dict(self.points),
            "blunders": [
                {
                    "shot": b.shot, "setup": b.setup, "target": b.target, "reading": b.reading,
                    "error": b.error, "unit": "rad" if b.reading in ("Hz", "V") else "m",
                    "sigmas": b.sigmas, "or_else": b.or_else, "source": b.source,
                }
                for b in self.blunders
            ],
            "unchecked": list(self.unchecked),
            "residual_rms": {
                f"{name}_{unit}": value
                for name, unit, value in zip(READING_NAMES, ("rad", "rad", "m"), rms, strict=True)
            },
            "chi2": self.chi2,
            "degrees_of_freedom": self.freedom,
            "chi2_band": list(self.chi2_band),
            "fits": self.fits,
            "observability": self.observability.data(),
        }  # fmt: skip
