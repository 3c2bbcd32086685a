"""The result of a survey: exit points, blunders and residuals."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2 as chi2_law

from calibration.result import CalibrationResult
from calibration.robust import NORMAL_MEDIAN
from calibration.tachymeter.observations import ARCSEC_RAD, READING_NAMES, Survey
from carosac_toolkit.base.arrays import Array

CHI2_PROBABILITY = 0.99  # of the band in which chi2 falls if all noise is as stated
READING_SCALE = np.array([1.0 / ARCSEC_RAD, 1.0 / ARCSEC_RAD, 1e3])  # to arcsec and mm
BLUNDERS_NAMED_MAX = 10  # blunders that are named in sentences
BLUNDER_SHARE_MAX = (
    0.1  # share of readings left out above which they are no blunders: the accuracy is wrong
)
EXIT_SHIFT_MAX_M = (
    0.5  # [m] from the robot file's exit point, beyond which something else was sighted
)


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
        what = (
            f"{self.reading} of reference {self.target}"
            if self.shot is None
            else f"shot {self.shot}, set-up {self.setup}, target {self.target}: {self.reading}"
        )
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
        """Return the RMS of the residuals in use [rad, rad, m], shape (3,); 0 if none is."""
        count = np.maximum(self.used.sum(axis=0), 1)
        return np.asarray(np.sqrt((self.value**2 * self.used).sum(axis=0) / count))


@dataclass(frozen=True, kw_only=True, eq=False)
class TachymeterResult(CalibrationResult):
    """All that a survey gave.

    Attributes:
        survey: The measurements.
        cables: Cables that were sighted, in the robot's order, c of them.
        points: Every sighted point in W [m], by name, (3,).
        stations: Set-ups by name.
        swivels: Turn of each pulley beyond its cable's direction [rad], by cable.
        blunders: Readings left out, the worst first.
        unchecked: Targets with readings whose blunders nothing would show.
        residuals: Of all shots.
        chi2: Sum of squared whitened residuals.
        freedom: Its degrees of freedom.
        converged: True if the choice of blunders came to rest.
    """

    survey: Survey
    cables: tuple[str, ...]
    points: Mapping[str, Array]
    stations: Mapping[str, Station]
    swivels: Mapping[str, float]
    blunders: tuple[ReadingBlunder, ...]
    unchecked: tuple[str, ...]
    residuals: Residuals
    chi2: float
    freedom: int
    converged: bool

    def __post_init__(self) -> None:
        """Add the warnings, which follow from all else."""
        object.__setattr__(self, "warnings", tuple(self._warnings()))

    def misplaced(self) -> list[str]:
        """Name exit points that are far from where the robot file has them."""
        lines = []
        before = {
            name: self.before.exit_points[self.before.cable_names.index(name)]
            for name in self.cables
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
        return np.asarray(np.sqrt(np.diag(self.exit_covariance)).reshape(-1, 3))

    @property
    def unmeasured(self) -> tuple[str, ...]:
        """Cables that nobody sighted; their exit points stay as they were."""
        return tuple(name for name in self.before.cable_names if name not in self.cables)

    @property
    def chi2_band(self) -> tuple[float, float]:
        """Band that holds chi2 with probability `CHI2_PROBABILITY` if all noise is as stated."""
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
        return float(np.median(np.abs(checked)) / NORMAL_MEDIAN) if len(checked) else 0.0

    @property
    def fits(self) -> bool:
        """True if the residuals are no larger than the stated accuracy explains."""
        return (
            self.freedom > 0
            and self.chi2 <= self.chi2_band[1]
            and self.left_out <= BLUNDER_SHARE_MAX
        )

    def data(self) -> dict[str, Any]:
        """Return everything for JSON."""
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

    def sentences(self) -> list[str]:
        """Return what was found, in words."""
        survey = self.survey
        known, ties = len(survey.known), len(survey.targets) - len(self.cables)
        rms = self.residuals.rms() * READING_SCALE
        low, high = self.chi2_band
        lines = [
            f"{len(survey.shots)} shots from {len(survey.setups)} set-ups to {len(self.cables)} "
            f"exit points, {known} known points and {ties - known} tie points",
            f"residuals (RMS): Hz {rms[0]:.1f} arcsec, V {rms[1]:.1f} arcsec, "
            f"distance {rms[2]:.2f} mm",
            f"chi2 {self.chi2:.1f} with {self.freedom} degrees of freedom; "
            f"{CHI2_PROBABILITY:.0%} of surveys with the stated accuracy lie between {low:.1f} and "
            f"{high:.1f}",
            f"exit points known to {1e3 * self.exit_sigma.min():.2f} to "
            f"{1e3 * self.exit_sigma.max():.2f} mm per axis (one standard deviation)",
        ]
        if "pose_tilt.x" in self.estimate.names:
            tilt = self.estimate.select(["pose_tilt.x", "pose_tilt.y"])
            x, y = 1e3 * tilt.value
            lines.append(
                f"the frame of the known points is tilted against gravity by {x:+.2f} mrad about x "
                f"and {y:+.2f} mrad about y, known to {1e3 * tilt.sigma.max():.2f} mrad"
            )
        return lines

    def _warnings(self) -> list[str]:
        """Return what must not be overlooked."""
        lines = self.misplaced()
        if self.freedom < 1:
            lines.append("nothing is measured twice, so nothing here is checked: sight more points")
        elif not self.fits:
            size = max(self.spread, np.sqrt(self.chi2 / self.freedom))
            many = f", and {self.left_out:.0%} of the readings were left out"
            lines.append(
                f"the residuals are {size:.1f} times larger than the stated accuracy explains"
                + (many if self.left_out > BLUNDER_SHARE_MAX else "")
                + ": do not use these exit points before it is clear why. Is the instrument's "
                "right, was it level, did a set-up or a point move, is the frame of the known "
                "points level (--frame-tilt-deg)?"
            )
        elif self.chi2 < self.chi2_band[0]:
            lines.append(
                "the residuals are smaller than the stated accuracy explains: the sigmas are "
                "cautious"
            )
        lines += [
            f"left out: {blunder.sentence()}" for blunder in self.blunders[:BLUNDERS_NAMED_MAX]
        ]
        if len(self.blunders) > BLUNDERS_NAMED_MAX:
            more = len(self.blunders) - BLUNDERS_NAMED_MAX
            lines.append(f"left out: {more} more readings, in report and JSON")
        if self.unchecked:
            lines.append(
                "a blunder would pass unseen in: "
                + "; ".join(self.unchecked)
                + ". Sight them again, best from another set-up"
            )
        if len(self.survey.known) < 3:
            lines.append(
                "fewer than three known points: a wrong coordinate among them may not show"
            )
        if self.unmeasured:
            lines.append(f"not sighted, left as they were: {', '.join(self.unmeasured)}")
        if not self.converged:
            lines.append(
                "the choice of blunders did not come to rest: look at the residuals yourself"
            )
        return lines
