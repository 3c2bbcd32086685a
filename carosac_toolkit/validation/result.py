"""Results of `validate`, as values."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.loop.values import Pose
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.validation.diagnostics import Delay, RestSway
from carosac_toolkit.validation.phases import (
    PLATFORM_REST_SPEED_MAX,
    REST_DURATION_MIN_S,
    REST_SPEED_MAX_M_S,
)
from carosac_toolkit.validation.residual_effects import ResidualEffects
from carosac_toolkit.validation.scores import LengthScores, PoseScores


@dataclass(frozen=True, kw_only=True, eq=False)
class ModelResult:
    """Result of one model; S samples had a measured pose, n cables.

    Scores are over the samples that the model solved. A model that raised has `reason` and every
    other field None.

    Attributes:
        name: Name as given.
        reason: Why it has no scores, or None where it has.
        pose: Estimated poses.
        moves: True if it estimates a twist: a model of motion, not of rest.
        converged: True where it reports a solution, shape (S,); elsewhere it keeps its last pose.
        scores: Scores of all samples.
        moving: Scores of the samples with winches in motion.
        resting: Scores of the samples with winches at rest.
        rmse_with_failures: In norm, over all S samples, kept poses included [m].
        length_error: Measured minus predicted unstrained length [m], shape (S, n). Predicted is the
            length at the *measured* pose of a straight cable (chord and wrapped arc) or, for a
            model with tensions, of a hanging cable that pulls with the model's tension there, so
            that sag and stretch count; NaN where there is none or the cable is slack.
        length_scores: Scores of `length_error`.
        sag: Mean over samples and cables of the length as it hangs less the chord [m]; None for a
            model without tensions.
        stretch: Mean elongation of cable and run [m]; None for a model without tensions.
        delay: Apparent delay, from the samples in motion.
        rmse_without_delay: RMSE of `moving`, in norm, corrected for that delay [m].
        sway: Swing of the error with winches at rest, or None where the rests are too short.
        nees: Mean normalised square of the pose error over the covariance that the model claims,
            per degree of freedom, noise of the measured poses included; 1 is honest, less too
            cautious, more too sure. None for a model that claims none.
        update_time: Median wall time of an update [s].
    """

    name: str
    reason: str | None = None
    pose: Pose | None = None
    moves: bool = False
    converged: NDArray[np.bool_] | None = None
    scores: PoseScores | None = None
    moving: PoseScores | None = None
    resting: PoseScores | None = None
    rmse_with_failures: float = np.nan
    length_error: Array | None = None
    length_scores: LengthScores | None = None
    sag: float | None = None
    stretch: float | None = None
    delay: Delay | None = None
    rmse_without_delay: float = np.nan
    sway: RestSway | None = None
    nees: float | None = None
    update_time: float = np.nan

    @property
    def failures(self) -> int:
        """Number of samples without a pose of this model's own."""
        return 0 if self.converged is None else int((~self.converged).sum())

    def data(self, cables: tuple[str, ...]) -> dict[str, Any]:
        """Return all numbers under names with units, for JSON; a model that raised has nulls."""
        if self.scores is None or self.length_scores is None or self.delay is None:
            axes = dict.fromkeys(("x", "y", "z", "norm"))
            empty: dict[str, Any] = {key: axes for key in ("rmse_m", "mae_m", "max_m")}
            nothing = {"orientation_rmse_rad": None, "length_rmse_m": None}
            return {"error": self.reason, **empty, **nothing}
        return {
            "error": None,
            **self.scores.data(),
            "length_rmse_m": self.length_scores.rmse,
            "failures": self.failures,
            "rmse_with_failures_m": self.rmse_with_failures,
            "moving": self.moving.data() if self.moving else None,
            "resting": self.resting.data() if self.resting else None,
            "length": self.length_scores.data(cables),
            "mean_sag_m": self.sag,
            "mean_stretch_m": self.stretch,
            **self.delay.data(),
            "moving_rmse_without_delay_m": self.rmse_without_delay,
            "sway": self.sway.data() if self.sway else None,
            "nees": self.nees,
            "median_update_s": self.update_time,
        }


@dataclass(frozen=True, kw_only=True, eq=False)
class ValidationResult:
    """Models against a recording; S of the samples start <= i < stop have a measured pose.

    Attributes:
        robot: The robot that the models were given.
        start: First sample that could be scored.
        stop: One past the last.
        seed: Seed of everything random in the models.
        index: Indices of the samples with a measured pose, shape (S,).
        time: Time of these samples [s], shape (S,).
        measured: Measured poses at these times.
        resting: True where the winches rest, shape (S,).
        rests: First and one past the last of these samples for each rest.
        models: By name, in the order asked for.
        starts_moving: True if the platform moves at sample 0; models that can start from its pose
            and speed there.
        rest_speed: Speed of the fastest anchor point while the winches rest, RMS [m/s]; None where
            they never do.
        natural_frequency: Predictions of statics at the rests [Hz], medians, slowest first, (6,);
            None where there is no rest or no stable equilibrium.
        exit_point_distance: Largest distance of an exit point measured in the run from the
            robot's [m], or None where none was measured.
        effects: Effects that the error of the best model that moves looks like; None where they
            were not asked for, or cannot be told.
        effects_model: Name of that model; empty where none was examined.
        effects_reason: Why effects is None; empty where it is not.
        warnings: Evidence that lengths and poses do not belong together, such as wrong units;
            empty for a plausible recording.
    """

    robot: Robot
    start: int
    stop: int
    seed: int
    index: NDArray[np.int64]
    time: Array
    measured: Pose
    resting: NDArray[np.bool_]
    rests: tuple[tuple[int, int], ...]
    models: Mapping[str, ModelResult]
    starts_moving: bool = False
    rest_speed: float | None = None
    natural_frequency: Array | None = None
    exit_point_distance: float | None = None
    effects: ResidualEffects | None = None
    effects_model: str = ""
    effects_reason: str = ""
    warnings: tuple[str, ...] = ()

    @property
    def typical_length(self) -> float:
        """Median distance of the exit points from the measured positions [m]."""
        away = self.measured.position[:, None] - self.robot.exit_points
        return float(np.median(np.linalg.norm(away, axis=2)))

    @property
    def sways_at_rest(self) -> bool:
        """True if the platform moves while the winches rest."""
        limit = PLATFORM_REST_SPEED_MAX.of(Scales(self.robot).ratios)
        return self.rest_speed is not None and self.rest_speed > limit

    @property
    def samples(self) -> int:
        """Number of samples that were scored, for a model without failures."""
        return len(self.index)

    @property
    def unscored(self) -> int:
        """Number of samples of the range without a measured pose nearby."""
        return self.stop - self.start - self.samples

    def _effects_data(self) -> dict[str, Any]:
        """Return the effects and the model whose error they are shares of."""
        assert self.effects is not None
        return {"model": self.effects_model, **self.effects.data()}

    def data(self) -> dict[str, Any]:
        """Return all numbers under names with units, for JSON; a model that raised has nulls."""
        names = self.robot.cable_names
        return {
            "samples": self.samples,
            "samples_without_pose": self.unscored,
            "samples_resting": int(self.resting.sum()),
            "start": self.start,
            "stop": self.stop,
            "seed": self.seed,
            "robot": self.robot.name,
            "rest": {
                "count": len(self.rests),
                "speed_below_m_per_s": REST_SPEED_MAX_M_S,
                "for_at_least_s": REST_DURATION_MIN_S,
                "platform_speed_rms_m_per_s": self.rest_speed,
                "natural_frequencies_Hz": self.natural_frequency,
            },
            "starts_moving": self.starts_moving,
            "exit_point_distance_m": self.exit_point_distance,
            "effects": None if self.effects is None else self._effects_data(),
            "effects_reason": self.effects_reason,
            "warnings": self.warnings,
            "models": {name: model.data(names) for name, model in self.models.items()},
        }
