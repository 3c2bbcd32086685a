"""The numbers of a validation as rows for people: mm, degrees, ms."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from carosac_toolkit.validation.result import ModelResult, ValidationResult
from carosac_toolkit.validation.scores import PoseScores

Rows = list[tuple[str, ...]]
PART_HEADER = (
    "model", "samples", "count", "RMSE x", "y", "z", "norm", "MAE x", "y", "z", "norm",
    "max x", "y", "z", "norm", "orient.",
)  # fmt: skip
PART_UNITS = "RMSE, MAE and max of the position error in mm; orientation RMSE in degrees"
CAUSE_HEADER = (
    "model", "failures", "length RMSE [mm]", "sag [mm]", "stretch [mm]", "delay x [ms]", "y", "z",
    "sway", "update [ms]",
)  # fmt: skip


def part_rows(result: ValidationResult) -> Rows:
    """Scores of all, moving and resting samples per model."""
    rows: Rows = []
    for name, model in result.models.items():
        parts = {"all": model.scores, "moving": model.moving, "resting": model.resting}
        for k, (part, scores) in enumerate(parts.items()):
            if scores is None:
                if k == 0:
                    rows.append((name, "failed", "0", *["-"] * (len(PART_HEADER) - 3)))
                continue
            rows.append((name if k == 0 else "", part, str(scores.samples), *_cells(scores)))
    return rows


def cause_rows(result: ValidationResult) -> Rows:
    """What may explain the errors, one row per model."""
    return [_cause(model) for model in result.models.values()]


def align(header: tuple[str, ...], rows: Rows, left: int) -> str:
    """Lay out a table: the first columns to the left, the rest to the right."""
    lines = [header, *rows]
    widths = [max(len(line[i]) for line in lines) for i in range(len(header))]
    lines.insert(1, tuple("-" * width for width in widths))
    return "\n".join(
        "  ".join(
            cell.ljust(width) if i < left else cell.rjust(width)
            for i, (cell, width) in enumerate(zip(line, widths, strict=True))
        ).rstrip()
        for line in lines
    )


def _cells(scores: PoseScores) -> list[str]:
    """Numbers of one part."""
    values = np.concatenate([scores.rmse, scores.mae, scores.max])
    angle = _number(scores.orientation_rmse, np.degrees, "{:.2f}")
    return [_mm(value) for value in values] + [angle]


def _cause(model: ModelResult) -> tuple[str, ...]:
    """Numbers of one model."""
    if model.length_scores is None or model.delay is None:
        return (model.name, *["-"] * (len(CAUSE_HEADER) - 1))
    swing, sway = model.sway, "-"
    if swing is not None:
        sway = f"{swing.axis} {swing.amplitude * 1e3:.0f} mm {swing.frequency:.2f} Hz"
        sway += "" if swing.clear else " (unclear)"
    return (
        model.name,
        str(model.failures),
        _mm(model.length_scores.rmse),
        _mm(model.sag, "{:.2f}"),
        _mm(model.stretch, "{:.2f}"),
        *_delays(model),
        sway,
        _number(model.update_time, lambda s: s * 1e3, "{:.3f}"),
    )


def _delays(model: ModelResult) -> list[str]:
    """Delay per axis with its standard deviation [ms]."""
    assert model.delay is not None
    pairs = zip(1e3 * model.delay.seconds, 1e3 * model.delay.deviation, strict=True)
    return [f"{v:.0f} +-{d:.1f}" if np.isfinite(v) else "-" for v, d in pairs]


def _mm(value: float | None, form: str = "{:.1f}") -> str:
    """Write metres as millimetres; small ones with enough digits to be seen."""
    if value is not None and 0.0 < abs(value) < 5e-5:
        form = "{:.1e}" if abs(value) < 5e-7 else "{:.3f}"
    return _number(value, lambda metres: metres * 1e3, form)


def _number(value: float | None, convert: Callable[[float], float], form: str) -> str:
    """Write a number in another unit, or a dash where it is unknown."""
    return "-" if value is None or not np.isfinite(value) else form.format(convert(value))
