"""The result of an identification."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from calibration.identification.cross_validation import Candidate, Folds
from calibration.identification.frequencies import ComparedFrequencies
from calibration.identification.measured_poses import MeasuredPoses
from calibration.identification.sway import FreeSway
from calibration.result import CalibrationResult
from calibration.robot_update import updated
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.numbers import plain
from carosac_toolkit.robot.model_error import ModelError
from carosac_toolkit.robot.parameter_names import field_of
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.validation.first_motion import FirstSpeed
from carosac_toolkit.validation.scores import PoseScores

CONTRADICTION_SIGMAS = 2.0  # sigmas: a parameter that moved further contradicts what was known
LEARNT_SIGMA_SHARE = 0.7  # of its prior sigma: a parameter that keeps more was hardly learnt


@dataclass(frozen=True, kw_only=True, eq=False)
class Samples:
    """A range of samples of one recording, or several whole recordings.

    Attributes:
        start: First length sample.
        stop: One past the last, of all recordings together.
        runs: Number of recordings.
        name: Of the recording, where it is one of several.
    """

    start: int
    stop: int
    runs: int
    name: str | None = None

    @property
    def words(self) -> str:
        """Name what was scored."""
        if self.runs > 1:
            return f"{self.runs} recordings"
        if self.name is not None:
            return self.name
        return f"samples {self.start}:{self.stop}"

    def data(self) -> dict[str, Any]:
        """Return the numbers, ready for JSON."""
        return {"start": self.start, "stop": self.stop, "recordings": self.runs}


@dataclass(frozen=True, kw_only=True, eq=False)
class ScoredRange(Samples):
    """Scores of samples before and after.

    Attributes:
        before: Of the robot as it was known.
        after: Of the identified robot.
    """

    before: PoseScores
    after: PoseScores

    def data(self) -> dict[str, Any]:
        """Return the scores after, and those before under ``before``, ready for JSON."""
        return {**super().data(), **self.after.data(), "before": self.before.data()}


@dataclass(frozen=True, kw_only=True, eq=False)
class RestErrors:
    """Mean pose of each rest phase against the equilibrium of its lengths (kinematic solver).

    Attributes:
        before: Distance for the robot as it was known [m], shape (R,); NaN without equilibrium.
        after: For the identified robot [m], shape (R,).
        starts: First sample of each rest, shape (R,).
    """

    before: Array
    after: Array
    starts: Array

    def data(self) -> dict[str, Any]:
        """Return all numbers, ready for JSON."""
        return {
            "first_sample": self.starts,
            "before_m": self.before,
            "after_m": self.after,
            "before_rms_m": _rms(self.before),
            "after_rms_m": _rms(self.after),
            "after_max_m": float(np.nanmax(self.after)) if len(self.after) else None,
        }


@dataclass(frozen=True, kw_only=True, eq=False)
class FirstMotion:
    """Motion at the start of a simulation, estimated beside the robot.

    Attributes:
        time: When it starts: at the first reading, or half a sway before the first pose that
            counts [s].
        frequency: Of the free modes there [Hz], shape (m,): for the robot before, or where errors
            are averaged for one near to the identified one.
        displacement: From the equilibrium along these modes, of the anchor point that moves most
            [m], shape (m,).
        speed: Of the same [m/s], shape (m,).
        measured_speed: Of the fastest anchor point in the first samples, RMS [m/s].
        moves: True if that is no rest.
    """

    time: float
    frequency: Array
    displacement: Array
    speed: Array
    measured_speed: float
    moves: bool

    @classmethod
    def of(cls, sway: FreeSway, coordinates: Array, first: FirstSpeed, time: float) -> FirstMotion:
        """Return the motion of coordinates (2 m,) along free directions at a time [s]."""
        displacement, speed = sway.values(coordinates)
        return cls(
            time=time,
            frequency=sway.frequency / (2.0 * np.pi),
            displacement=displacement,
            speed=speed,
            measured_speed=first.speed,
            moves=first.moves,
        )

    def data(self) -> dict[str, Any]:
        """Return all numbers, ready for JSON."""
        return {
            "time_s": self.time,
            "moves": self.moves,
            "measured_speed_m_per_s": self.measured_speed,
            "frequency_Hz": self.frequency,
            "displacement_m": self.displacement,
            "speed_m_per_s": self.speed,
        }


@dataclass(frozen=True, kw_only=True, eq=False)
class MeanPoseComparison(Samples):
    """Simulated against constant poses, on what was kept back if anything was.

    Attributes:
        missed: RMS distance of simulated from measured anchor points [m].
        spread: RMS distance of the measured anchor points from their means [m].
    """

    missed: float
    spread: float

    @property
    def useless(self) -> bool:
        """True if a platform that stands still would be no worse."""
        return not self.missed < self.spread

    def data(self) -> dict[str, Any]:
        """Return all numbers, ready for JSON."""
        return {**super().data(), "missed_m": self.missed, "spread_m": self.spread}


@dataclass(frozen=True, kw_only=True, eq=False)
class IdentifiedRun:
    """One recording, and how well the identified robot moves as measured in it.

    Attributes:
        name: Of the recording.
        train: Samples that were fitted; None where none were.
        test: Samples that were not; None where none were kept back.
        rests: Mean poses while the winches rest.
        first_motion: Sway at the start of its simulation.
        left_out: Time at first that is not looked at, as cables vibrated [s].
        measured: All other measured poses, K of them, in W.
        position_before: Of the robot as it was known [m], shape (K, 3).
        position_after: Of the identified robot [m], shape (K, 3).
        errors: Of the identified robot, shape (K, 6): [m] and [rad].
    """

    name: str
    train: ScoredRange | None
    test: ScoredRange | None
    rests: RestErrors
    first_motion: FirstMotion
    left_out: float
    measured: MeasuredPoses
    position_before: Array
    position_after: Array
    errors: Array

    @property
    def rmse(self) -> tuple[float, float]:
        """RMS distances of all positions, before and after [m]."""
        away = (self.position_before - self.measured.position, self.errors[:, :3])
        before, after = (float(np.sqrt((each**2).sum(axis=1).mean())) for each in away)
        return before, after

    def data(self) -> dict[str, Any]:
        """Return all numbers, ready for JSON."""
        return {
            "name": self.name,
            "train": None if self.train is None else self.train.data(),
            "test": None if self.test is None else self.test.data(),
            "rests": self.rests.data(),
            "first_motion": self.first_motion.data(),
            "left_out_s": self.left_out,
        }


@dataclass(frozen=True, kw_only=True, eq=False)
class Identification(CalibrationResult):
    """An identified robot and how well it moves as measured.

    Attributes:
        train: What was fitted, of all recordings.
        test: What was not; None where nothing was kept back.
        runs: One for each recording, first those that were fitted.
        against_mean: Comparison with the mean poses; the robot is of no use if these are better.
        iterations: Steps of the search.
        converged: True if it ended by itself.
        excess: Factor by which the data count for less than independent innovations [1].
        unfollowed: Names of recordings that seem to tell by chance; only their start was fitted.
        mixed: Names of recordings in which sway and vibrations are not told apart, for which the
            vibrations of all are fitted too.
        fitted_samples: Poses that were fitted.
        model_error: What the identified robot misses, for the estimators; None: not known.
        nees: Squares of the errors over what `model_error` says of them, per degree of freedom; of
            the samples kept back, or of the fitted ones where there are none.
        folds: Parts of the data about the estimate, of which each may be held out.
        frequencies: Measured ones beside those of both robots; None: none were given.
        candidates: Parameters that were to be kept only where they predict.
    """

    train: ScoredRange
    test: ScoredRange | None
    runs: tuple[IdentifiedRun, ...]
    against_mean: MeanPoseComparison
    iterations: int
    converged: bool
    excess: float
    unfollowed: tuple[str, ...]
    mixed: tuple[str, ...]
    fitted_samples: int
    model_error: ModelError | None
    nees: float | None
    folds: Folds
    frequencies: ComparedFrequencies | None = None
    candidates: tuple[Candidate, ...] = ()

    @cached_property
    def robot(self) -> Robot:
        """The identified robot, with the covariance of its parameters and what its model misses."""
        return replace(updated(self.before, self.estimate), model_error=self.model_error)

    @property
    def rests(self) -> RestErrors:
        """Rests of all recordings."""
        return RestErrors(
            before=np.concatenate([run.rests.before for run in self.runs]),
            after=np.concatenate([run.rests.after for run in self.runs]),
            starts=np.concatenate([run.rests.starts for run in self.runs]),
        )

    @property
    def first_motion(self) -> FirstMotion:
        """Sway at the start of the first recording."""
        return self.runs[0].first_motion

    @property
    def worst(self) -> int:
        """Index of the recording with the largest RMS error."""
        return int(np.argmax([run.rmse[1] for run in self.runs]))

    def data(self) -> dict[str, Any]:
        """Return all numbers under names with units, ready for JSON."""
        return {
            "train": self.train.data(),
            "test": None if self.test is None else self.test.data(),
            "parameters": self.estimate.data(),
            "observability": self.observability.data(),
            "rests": self.rests.data(),
            "first_motion": self.first_motion.data(),
            "recordings": [run.data() for run in self.runs],
            "against_mean_pose": self.against_mean.data(),
            "iterations": self.iterations,
            "converged": self.converged,
            "unfollowed": list(self.unfollowed),
            "mixed": list(self.mixed),
            "fitted_samples": self.fitted_samples,
            "excess": self.excess,
            "model_error": None if self.model_error is None else asdict(self.model_error),
            "nees": self.nees,
            "candidates": {one.name: one.data() for one in self.candidates},
            "frequencies": None if self.frequencies is None else self.frequencies.data(),
        }

    def sentences(self) -> list[str]:
        """Return what was found, and what the data cannot tell."""
        lines = [self._scores("fitted", self.train)]
        if self.test is not None:
            lines.append(self._scores("kept back", self.test))
        else:
            lines.append("no samples were kept back: nothing says how well this carries over")
        lines += [] if self.frequencies is None else self.frequencies.sentences()
        lines += self._candidates()
        lines += self._first_motion() if len(self.runs) == 1 else self._each_run()
        if len(self.rests.after):
            lines.append(
                f"mean pose of {len(self.rests.after)} rests of the winches against the "
                f"equilibrium of their lengths: {_rms(self.rests.before) * 1e3:.1f} mm before, "
                f"{_rms(self.rests.after) * 1e3:.1f} mm after (largest "
                f"{np.nanmax(self.rests.after) * 1e3:.1f} mm)"
            )
        lines.append(
            f"{self.fitted_samples} poses were fitted; sigmas take into account that their errors "
            f"last for many samples{self._excess()}"
        )
        lines += self._claims()
        return [*lines, *self._untaught(), *self._contradictions()]

    def _scores(self, word: str, part: ScoredRange) -> str:
        x, y, z, norm = part.after.rmse * 1e3
        return (
            f"{part.words} ({word}), open loop: {norm:.1f} mm RMS in norm "
            f"({x:.1f}/{y:.1f}/{z:.1f} mm), {np.degrees(part.after.orientation_rmse):.2f} degrees; "
            f"before: {part.before.rmse[3] * 1e3:.1f} mm"
        )

    def _each_run(self) -> list[str]:
        """Say how the recordings differ."""
        moving = sum(run.first_motion.moves for run in self.runs)
        followed = [run for run in self.runs if run.name not in self.unfollowed]
        errors = [run.rmse[1] for run in followed]
        worst = int(np.argmax(errors))
        shaken = [run.left_out for run in self.runs if run.left_out > 0.0]
        left_out = [
            f"of {len(shaken)} recordings up to {max(shaken, default=0.0):.1f} s at first do not "
            "count, neither fitted nor kept back: their cables still vibrate"
        ]
        return [
            f"{moving} of {len(self.runs)} recordings begin in motion; the start of each was "
            "estimated beside the robot",
            f"RMS errors of the recordings: {np.median(errors) * 1e3:.1f} mm in the median, "
            f"{errors[worst] * 1e3:.1f} mm at worst ({followed[worst].name})",
            *(left_out if shaken else []),
            *([self._mixed()] if self.mixed else []),
        ]

    def _mixed(self) -> str:
        """Say why vibrations were fitted too."""
        some = len(self.mixed) < sum(run.train is not None for run in self.runs)
        return (
            "vibrations of the cables were fitted beside the sway: in "
            f"{', '.join(self.mixed) if some else 'all recordings'} they are less than twice as "
            "fast, or poses are too rare to tell them apart"
        )

    def _first_motion(self) -> list[str]:
        """Say that the recording begins in motion, or nothing."""
        motion = self.first_motion
        if not motion.moves:
            return []
        line = f"the platform moves at the first samples, by {motion.measured_speed:.2g} m/s"
        modes = [
            f"{frequency:.2f} Hz: {place * 1e3:.0f} mm, {speed:.2g} m/s"
            for frequency, place, speed in zip(
                motion.frequency, motion.displacement, motion.speed, strict=True
            )
        ]
        if modes:
            line += f"; its sway there was estimated too ({'; '.join(modes)})"
        return [line]

    def _candidates(self) -> list[str]:
        """Say which parameters predict what is held out."""
        if not self.candidates:
            return []
        words = "; ".join(one.words for one in self.candidates)
        return [
            "squared errors of what cross-validation holds out, with candidates, which are kept "
            f"where these fall by more than their standard error: {words}"
        ]

    def _claims(self) -> list[str]:
        """Say what estimators will claim of this robot."""
        error = self.model_error
        if error is None:
            return ["what the model misses could not be told: estimators keep their own guesses"]
        where = "fitted" if self.test is None else "kept back"
        assert self.nees is not None, "it is of these errors"
        return [
            f"what the model misses, one sigma, for the estimators: {plain(error.length * 1e3, 2)} "
            f"mm of each cable, {plain(error.force, 2)} N on the platform, {plain(error.mass, 2)} "
            f"of its mass, accelerations of {plain(error.acceleration, 2)} m/s^2/sqrt(Hz); poses "
            f"are noisy by {plain(error.position * 1e3, 2)} mm and "
            f"{plain(np.degrees(error.rotation), 2)} degrees (NEES, the mean square of errors over "
            f"what is claimed, is {plain(self.nees, 2)} on the samples that were {where}: 1 is "
            "honest, above it claims are too bold)"
        ]

    def _excess(self) -> str:
        """Return what the noise model does not explain, or nothing."""
        if self.excess < 1.05:
            return ""
        return f", and are {np.sqrt(self.excess):.2f} times larger for what that does not explain"

    def _untaught(self) -> list[str]:
        """Return the parameters that the data say little about."""
        kept = self.estimate.kept
        fields = [field_of(name) for name in self.estimate.names]
        words = []
        for field in dict.fromkeys(fields):
            rows = [k for k, other in enumerate(fields) if other == field]
            known = int((kept[rows] > LEARNT_SIGMA_SHARE).sum())
            if known:
                words.append(field if len(rows) == 1 else f"{field} ({known} of {len(rows)})")
        if not words:
            return []
        return [f"weakly determined by the data, so that the prior decides: {', '.join(words)}"]

    def _contradictions(self) -> list[str]:
        """Return the parameters that moved further than was thought possible."""
        far = [
            f"{name} ({share:.1f} sigmas)"
            for name, share in zip(self.estimate.names, np.abs(self.estimate.moved), strict=True)
            if share > CONTRADICTION_SIGMAS
        ]
        if not far:
            return []
        return [f"moved further than their priors suggest: {', '.join(far)}"]


def _rms(values: Array) -> float:
    """Return the root mean square of the finite values; NaN where there are none."""
    known = values[np.isfinite(values)]
    return float(np.sqrt((known**2).mean())) if len(known) else float("nan")
