"""Results of a validation as readable rows: mm, degrees, ms."""

from __future__ import annotations

import numpy as np

from carosac_toolkit.base.tables import Rows
from carosac_toolkit.validation.effect_signatures import START
from carosac_toolkit.validation.quantities import say_length, unit_for
from carosac_toolkit.validation.residual_effects import ResidualEffects
from carosac_toolkit.validation.result import ModelResult, ValidationResult
from carosac_toolkit.validation.scores import PoseScores

PART_HEADER = (
    "model", "samples", "count", "RMSE x", "y", "z", "norm", "orient.", "MAE x", "y", "z", "norm",
    "max x", "y", "z", "norm",
)  # fmt: skip
PART_GROUPS = (2, 1, 4, 1, 4, 4)  # columns that stay together; the first are on every block
CAUSE_HEADER = (
    "model", "failures", "update [ms]", "NEES", "length RMSE", "sag", "stretch", "delay x [ms]",
    "y", "z", "sway",
)  # fmt: skip
CAUSE_GROUPS = (1, 3, 3, 3, 1)
EFFECT_HEADER = ("effect", "share", "added last", "alone", "looks like")
EFFECT_MEANINGS = {
    "delay": "poses late against the lengths",
    "sway phase": "frequency or start of the sway: inertia, height of the centre of mass",
    "damping law": "drag or dry friction",
    "hysteresis": "paid-out lengths lag behind the encoders; or capstan friction on pulleys",
    "tilt": "of the frame of the poses, or of gravity in it",
    "centre of mass": "its horizontal place on the platform",
    "length offset or scale": "of each cable",
    START: "a sway that is wrong from the first pose of a recording on",
    "jitter": "of the time stamps from sample to sample",
    "sensor": "white noise",
    "other": "none of these",
}


def part_units(result: ValidationResult) -> str:
    """Explain the numbers of `part_rows`."""
    unit, _ = _part_unit(result)
    return f"RMSE, MAE and max of the position error in {unit}; orientation RMSE in degrees"


def part_rows(result: ValidationResult) -> Rows:
    """Return the scores per model of all samples, and with winches moving and resting."""
    rows: Rows = []
    _, factor = _part_unit(result)
    for name, model in result.models.items():
        parts = {
            "all": model.scores,
            "winches moving": model.moving,
            "winches resting": model.resting,
        }
        for k, (part, scores) in enumerate(parts.items()):
            if scores is None:
                if k == 0:
                    rows.append((name, "failed", "0", *["-"] * (len(PART_HEADER) - 3)))
                continue
            rows.append(
                (name if k == 0 else "", part, str(scores.samples), *_cells(scores, factor))
            )
    return rows


def cause_rows(result: ValidationResult) -> Rows:
    """Return possible explanations of the errors, one row per model."""
    return [_cause(model) for model in result.models.values()]


def effect_rows(effects: ResidualEffects) -> Rows:
    """Return the share of each effect in an error, and what is left, as readable rows."""
    rows: Rows = [
        (
            name,
            *(f"{max(x, 0.0):.1%}" for x in (share, *effects.ranges[name])),
            EFFECT_MEANINGS[name],
        )
        for name, share in effects.shares.items()
    ]
    return [*rows, ("other", f"{effects.other:.1%}", "-", "-", EFFECT_MEANINGS["other"])]


def _part_unit(result: ValidationResult) -> tuple[str, float]:
    """Return the unit for the largest RMSE, and its number per metre."""
    scores = [model.scores for model in result.models.values() if model.scores is not None]
    return unit_for(max((float(score.rmse[3]) for score in scores), default=0.0))


def _cells(scores: PoseScores, factor: float) -> list[str]:
    """Return the numbers of one part."""
    numbers = [
        [_plain(value * factor) for value in values]
        for values in (scores.rmse, scores.mae, scores.max)
    ]
    return [*numbers[0], _degrees(scores.orientation_rmse), *numbers[1], *numbers[2]]


def _degrees(angle: float) -> str:
    """Format an angle [rad] in degrees; less than 0.01 is 0."""
    return f"{np.degrees(angle):.2f}" if np.isfinite(angle) else "-"


def _cause(model: ModelResult) -> tuple[str, ...]:
    """Return the numbers of one model."""
    if model.length_scores is None or model.delay is None:
        return (model.name, *["-"] * (len(CAUSE_HEADER) - 1))
    swing, sway = model.sway, "-"
    if swing is not None:
        sway = f"{swing.axis} {say_length(swing.amplitude)} {swing.frequency:.2f} Hz"
        sway += "" if swing.clear else " (unclear)"
    lengths = (model.length_scores.rmse, model.sag, model.stretch)
    return (
        model.name,
        str(model.failures),
        f"{model.update_time * 1e3:.3f}",
        "-" if model.nees is None else f"{model.nees:.2g}",
        *(
            "-" if value is None or not np.isfinite(value) else say_length(value)
            for value in lengths
        ),
        *_delays(model),
        sway,
    )


def _delays(model: ModelResult) -> list[str]:
    """Format the delay per axis with its standard deviation [ms]."""
    assert model.delay is not None
    pairs = zip(1e3 * model.delay.seconds, 1e3 * model.delay.deviation, strict=True)
    # adding 0.0 turns -0.0 into 0.0
    return [f"{round(v, 1) + 0.0:.1f} +-{d:.1f}" if np.isfinite(v) else "-" for v, d in pairs]


def _plain(value: float) -> str:
    """Format a number, a small one with enough digits; almost zero becomes a bound."""
    if not np.isfinite(value):
        return "-"
    if abs(value) >= 0.05 or value == 0.0:
        return f"{value:.1f}"
    return f"{value:.3f}" if abs(value) >= 5e-4 else "<0.001"
