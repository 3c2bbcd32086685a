"""Conclusions of a validation, in sentences computed from its numbers."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from carosac_toolkit.validation.plausibility import doubt_exit_points
from carosac_toolkit.validation.quantities import say_length
from carosac_toolkit.validation.residual_effects import effects_sentence
from carosac_toolkit.validation.result import ModelResult, ValidationResult

NEES_HONEST = (0.5, 2.0)  # per degree of freedom: what a model claims is about what it errs
SWAY_MIN_M = 2e-3  # [m]: a smaller swing is not worth a sentence
DELAY_MIN_S = 3e-3  # [s]
DELAY_SIGMAS_MIN = 3.0  # standard deviations from none
OFFSET_MIN_M = 2e-3  # [m]
OFFSET_SHARE_MIN = 0.1  # of the RMSE in norm
FREQUENCY_MISMATCH_MAX = 0.25  # of the observed frequency: farther is no agreement
CAUSE_SAMPLES_MIN = 10  # fewer say nothing about causes
CAUSE_ERROR_MIN_M = 1e-4  # [m]: a smaller error needs no cause
CAUSE_ERROR_RATIO_MAX = (
    0.1  # of the typical cable length: causes of a larger error cannot be told apart
)
CAUSE_SHARE_MIN = 0.3  # of the length error


def conclusions(result: ValidationResult) -> list[str]:
    """State the conclusions; the causes are those of the best model's error.

    Causes are left out where the numbers do not support any: an implausible recording, an error as
    large as the workspace or next to none, and few samples.
    """
    lines = [*_doubts(result)]
    scored = [model for model in result.models.values() if model.scores is not None]
    if not scored:
        return lines
    best = min(scored, key=_norm)
    lines += _ranking(best, scored)
    lines += _claims(scored)
    reason = _no_causes(result, best)
    if reason is not None:
        return [*lines, reason]
    return [
        *lines,
        *_rest_and_motion(result, best),
        *_sway(result, best),
        *_delay(best),
        *_offset(best),
        *_sag(best),
        *_effects(result),
    ]


def _no_causes(result: ValidationResult, best: ModelResult) -> str | None:
    """Return why no cause of the error is named, or None if causes may be."""
    if result.warnings:
        return "Causes of the error are not examined until lengths and poses are consistent."
    if result.samples < CAUSE_SAMPLES_MIN:
        count = f"{result.samples} sample" + ("s" if result.samples > 1 else "")
        return f"Only {count} scored: too few to say anything about causes, or about other poses."
    if _norm(best) > CAUSE_ERROR_RATIO_MAX * result.typical_length:
        return (
            f"The error is more than {CAUSE_ERROR_RATIO_MAX:.0%} of the cable lengths: too large "
            "to tell its causes apart."
        )
    if _norm(best) < CAUSE_ERROR_MIN_M:
        return "That is too little to look for causes."
    return None


def _norm(model: ModelResult) -> float:
    assert model.scores is not None
    return float(model.scores.rmse[3])


def _doubts(result: ValidationResult) -> Iterator[str]:
    """List reasons to doubt the numbers."""
    yield from doubt_exit_points(result.exit_point_distance)
    for model in result.models.values():
        if model.reason is not None:
            yield f"{model.name} has no scores: {model.reason}."
        elif model.failures:
            yield (
                f"{model.name} found no pose at {model.failures} of {result.samples} samples; "
                f"they are not in its scores (with its last pose kept there, the RMSE would be "
                f"{say_length(model.rmse_with_failures)})."
            )
    if result.sways_at_rest:
        yield (
            "The platform moves while the winches rest: its fastest anchor point by "
            f"{result.rest_speed:.2g} m/s RMS. These samples do not show a platform at rest."
        )
    if result.starts_moving:
        yield (
            "The platform moves at the first sample: models that can, such as simulator, start "
            "from its measured pose and speed there."
        )
    if result.unscored:
        yield f"{result.unscored} samples have no measured pose nearby and were not scored."


def _claims(scored: list[ModelResult]) -> Iterator[str]:
    """Name models whose errors are not what they claim."""
    for model in scored:
        if model.nees is None or NEES_HONEST[0] <= model.nees <= NEES_HONEST[1]:
            continue
        sure = "too sure" if model.nees > 1.0 else "too cautious"
        ratio = np.sqrt(max(model.nees, 1.0 / model.nees))
        yield (
            f"{model.name} is {sure} of its poses: its errors are "
            f"{'larger' if model.nees > 1.0 else 'smaller'} than it claims, by a factor of about "
            f"{ratio:.2g} (NEES {model.nees:.2g} per degree of freedom, 1 is honest)."
        )


def _ranking(best: ModelResult, scored: list[ModelResult]) -> Iterator[str]:
    """Name the most accurate model."""
    others = ", ".join(f"{m.name} {say_length(_norm(m))}" for m in scored if m is not best)
    if others:
        others = f" (others: {others})"
        yield f"{best.name} is the most accurate: RMSE {say_length(_norm(best))} in norm{others}."
    else:
        yield f"RMSE of {best.name}: {say_length(_norm(best))} in norm."


def _rest_and_motion(result: ValidationResult, best: ModelResult) -> Iterator[str]:
    """Compare the errors with winches at rest and in motion."""
    if best.moving is None or best.resting is None:
        return
    if min(best.moving.samples, best.resting.samples) < CAUSE_SAMPLES_MIN:
        return
    moving, resting = best.moving.rmse[3], best.resting.rmse[3]
    ratio = resting / moving if moving > 0.0 else np.inf
    if ratio >= 0.8:
        saying = "it remains when the winches stop"
    elif ratio <= 0.4:
        saying = "most of the error comes with the motion"
    else:
        saying = "part of the error comes with the motion"
    yield (
        f"With the winches at rest its error is {say_length(resting)}, with moving ones "
        f"{say_length(moving)}: {saying}."
    )


def _sway(result: ValidationResult, best: ModelResult) -> Iterator[str]:
    """Tell whether the platform sways while the winches rest."""
    sway = best.sway
    if sway is None or not sway.clear or sway.amplitude < SWAY_MIN_M:
        return
    text = (
        f"With the winches at rest the error in {sway.axis} swings by "
        f"{sway.amplitude * 1e3:.0f} mm with a period of {1.0 / sway.frequency:.2f} s, which "
        f"explains {sway.explained:.0%} of its variation: "
    )
    if best.moves:
        text += "the platform seems to sway with another phase or amplitude than in the model"
    else:
        text += "the platform seems to sway, which no quasi-static model can follow"
    natural = result.natural_frequency
    if natural is not None:
        nearest = float(natural[np.argmin(np.abs(natural - sway.frequency))])
        text += (
            f" (observed {sway.frequency:.2f} Hz; nearest natural frequency of the robot there "
            f"{nearest:.2f} Hz"
        )
        far = abs(nearest - sway.frequency) > FREQUENCY_MISMATCH_MAX * sway.frequency
        text += ": far from it, so check mass, centre of mass and inertia)" if far else ")"
    yield text + "."


def _delay(best: ModelResult) -> Iterator[str]:
    """Tell whether the error grows with the velocity."""
    delay, moving = best.delay, best.moving
    if delay is None or moving is None:
        return
    size = np.abs(np.nan_to_num(delay.seconds))
    clear = (np.nan_to_num(delay.explained) >= 0.25) & (size >= DELAY_MIN_S)
    clear &= size >= DELAY_SIGMAS_MIN * np.nan_to_num(delay.deviation)
    if not clear.any():
        return
    axes = " and ".join(axis for axis, use in zip("xyz", clear, strict=True) if use)
    seconds = ", ".join(f"{value * 1e3:.0f}" for value in delay.seconds[clear])
    shares = ", ".join(f"{value:.0%}" for value in delay.explained[clear])
    late = "as if poses were late against the lengths"
    if not (delay.seconds[clear] > 0).all():
        late = "as if lengths and poses were not of the same time"
    yield (
        f"In motion the error in {axes} goes with the velocity ({shares} of its variance): {late}, "
        f"by {seconds} ms."
    )


def _offset(best: ModelResult) -> Iterator[str]:
    """Tell whether a constant error remains at rest."""
    resting = best.resting
    if resting is None or not resting.samples:
        return
    least = max(OFFSET_MIN_M, OFFSET_SHARE_MIN * float(resting.rmse[3]))
    large = (np.abs(resting.bias) >= 0.6 * resting.rmse[:3]) & (np.abs(resting.bias) >= least)
    if large.any():
        values = ", ".join(
            f"{axis} {bias * 1e3:+.1f} mm"
            for axis, bias, use in zip("xyz", resting.bias, large, strict=True)
            if use
        )
        yield (
            "With the winches at rest most of the error in some axes is constant "
            f"({values}): geometry, lengths or poses have an offset."
        )


def _sag(best: ModelResult) -> Iterator[str]:
    """Compare the effect of sag and stretch on the predicted lengths with the remaining error."""
    if best.sag is None or best.stretch is None or best.length_scores is None:
        return
    left = best.length_scores.rmse
    least = max(CAUSE_ERROR_MIN_M, CAUSE_SHARE_MIN * left)
    parts = {"sag": best.sag, "stretch": best.stretch}
    large = [name for name, size in parts.items() if abs(size) >= least]
    if not large:
        verdict = "neither is large enough to explain it"
    elif len(large) == 2:
        verdict = "leaving out either would change the error"
    else:
        small = next(name for name in parts if name not in large)
        verdict = f"{large[0]} is large enough to matter, {small} is not"
    yield (
        f"In the model, sag lengthens a cable by {say_length(best.sag)} and tension by "
        f"{say_length(best.stretch)} on average; the remaining length error is {say_length(left)}: "
        f"{verdict}."
    )


def _effects(result: ValidationResult) -> Iterator[str]:
    """Name the effects that the error of the best model of motion looks like."""
    if result.effects_model:
        yield effects_sentence(result.effects or result.effects_reason, result.effects_model)
