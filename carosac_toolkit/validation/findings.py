"""What the numbers of a validation say, in sentences computed from them."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from carosac_toolkit.validation.result import ModelResult, ValidationResult

SWAY_MIN = 2e-3  # [m]: a smaller swing is not worth a sentence
DELAY_MIN = 3e-3  # [s]
OFFSET_MIN = 2e-3  # [m]
OFFSET_SHARE = 0.1  # of the RMSE in norm
EXIT_POINT_MAX = 0.01  # [m]
NATURAL_MAX = 0.25  # of the observed frequency: farther is no agreement


def conclusions(result: ValidationResult) -> list[str]:
    """Say what a validation shows; the causes are those of the best model's error."""
    lines = [*_warnings(result)]
    scored = [model for model in result.models.values() if model.scores is not None]
    if not scored:
        return lines
    best = min(scored, key=_norm)
    lines += _ranking(best, scored)
    lines += _rest_and_motion(result, best)
    lines += _sway(result, best)
    lines += _delay(best)
    lines += _offset(best)
    lines += _sag(best)
    return lines


def _norm(model: ModelResult) -> float:
    assert model.scores is not None
    return float(model.scores.rmse[3])


def _warnings(result: ValidationResult) -> Iterator[str]:
    """What makes the numbers doubtful."""
    distance = result.exit_point_distance
    if distance is not None and distance > EXIT_POINT_MAX:
        yield (
            f"Check the robot: its exit points lie up to {distance * 1e3:.0f} mm from those "
            "measured in the recording."
        )
    for model in result.models.values():
        if model.reason is not None:
            yield f"{model.name} has no scores: {model.reason}."
        elif model.failures:
            yield (
                f"{model.name} found no pose at {model.failures} of {result.samples} samples; "
                f"they are not in its scores (with its last pose kept there, the RMSE would be "
                f"{model.rmse_with_failures * 1e3:.1f} mm)."
            )
    if result.unscored:
        yield f"{result.unscored} samples have no measured pose nearby and were not scored."


def _ranking(best: ModelResult, scored: list[ModelResult]) -> Iterator[str]:
    """Which model is nearest."""
    others = ", ".join(f"{m.name} {_norm(m) * 1e3:.1f} mm" for m in scored if m is not best)
    compared = f" (others: {others})" if others else ""
    yield f"{best.name} comes nearest: RMSE {_norm(best) * 1e3:.1f} mm in norm{compared}."


def _rest_and_motion(result: ValidationResult, best: ModelResult) -> Iterator[str]:
    """Whether standing still helps."""
    if not best.moving or not best.resting or not best.moving.samples or not best.resting.samples:
        return
    moving, resting = best.moving.rmse[3], best.resting.rmse[3]
    ratio = resting / moving if moving > 0.0 else np.inf
    if ratio >= 0.8:
        saying = "it does not go away when the winches stop"
    elif ratio <= 0.4:
        saying = "most of the error comes with the motion"
    else:
        saying = "part of the error comes with the motion"
    yield (
        f"With the winches at rest its error is {resting * 1e3:.1f} mm, in motion "
        f"{moving * 1e3:.1f} mm: {saying}."
    )


def _sway(result: ValidationResult, best: ModelResult) -> Iterator[str]:
    """Whether the platform swings while the winches rest."""
    sway = best.sway
    if sway is None or not sway.clear or sway.amplitude < SWAY_MIN:
        return
    text = (
        f"At rest the error in {sway.axis} swings by {sway.amplitude * 1e3:.0f} mm with a period "
        f"of {1.0 / sway.frequency:.2f} s, which explains {sway.explained:.0%} of its variation: "
        "the platform sways, which no quasi-static model can follow"
    )
    natural = result.natural_frequency
    if natural is not None:
        nearest = float(natural[np.argmin(np.abs(natural - sway.frequency))])
        text += (
            f" (observed {sway.frequency:.2f} Hz; nearest natural frequency of the robot there "
            f"{nearest:.2f} Hz"
        )
        far = abs(nearest - sway.frequency) > NATURAL_MAX * sway.frequency
        text += ": check its centre of mass and inertia)" if far else ")"
    yield text + "."


def _delay(best: ModelResult) -> Iterator[str]:
    """Whether the error goes with the velocity."""
    delay, moving = best.delay, best.moving
    if delay is None or moving is None:
        return
    clear = (np.nan_to_num(delay.explained) >= 0.25) & (np.abs(delay.seconds) >= DELAY_MIN)
    if not clear.any():
        return
    axes = " and ".join(axis for axis, use in zip("xyz", clear, strict=True) if use)
    seconds = ", ".join(f"{value * 1e3:.0f}" for value in delay.seconds[clear])
    shares = ", ".join(f"{value:.0%}" for value in delay.explained[clear])
    late = "poses are late against the lengths" if (delay.seconds[clear] > 0).all() else (
        "lengths and poses are not of the same time"
    )  # fmt: skip
    yield (
        f"In motion the error in {axes} goes with the velocity ({shares} of its variance): {late}, "
        f"by {seconds} ms."
    )


def _offset(best: ModelResult) -> Iterator[str]:
    """Whether a constant error remains at rest."""
    resting = best.resting
    if resting is None or not resting.samples:
        return
    least = max(OFFSET_MIN, OFFSET_SHARE * float(resting.rmse[3]))
    large = (np.abs(resting.bias) >= 0.6 * resting.rmse[:3]) & (np.abs(resting.bias) >= least)
    if large.any():
        values = ", ".join(
            f"{axis} {bias * 1e3:+.1f} mm"
            for axis, bias, use in zip("xyz", resting.bias, large, strict=True)
            if use
        )
        yield (
            f"At rest most of the error in some axes is constant ({values}): geometry, lengths or "
            "poses have an offset, which calibration can find."
        )


def _sag(best: ModelResult) -> Iterator[str]:
    """Whether sag is large enough to matter."""
    if best.sag is None or best.stretch is None or best.length_scores is None:
        return
    sag, total = best.sag * 1e3, best.length_scores.rmse * 1e3
    verdict = "sag is too small to explain it" if sag < 0.3 * total else "sag must be in the model"
    yield (
        f"Sag lengthens a cable by {sag:.2f} mm and tension by {best.stretch * 1e3:.2f} mm on "
        f"average; the length error is {total:.1f} mm: {verdict}."
    )
