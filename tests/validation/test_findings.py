from dataclasses import replace

import numpy as np
import pytest

from carosac_toolkit.validation import validate
from carosac_toolkit.validation.findings import _sag, conclusions
from tests.calibration.identification.oscillations import free_oscillation
from tests.validation.models import NAME
from tests.validation.runs import ROBOT, perfect, shifted

KS = "kinematic_solver"


def said(recording, models=(KS,)):
    return " ".join(conclusions(validate(recording, ROBOT, list(models))))


def test_nothing_is_blamed_where_nothing_is_wrong():
    text = said(perfect(), ("straight_line", KS))
    assert "kinematic_solver is the most accurate" in text
    for word in ("sways", "late", "offset", "found no pose"):
        assert word not in text


def test_a_delay_is_named_with_its_size():
    assert "as if poses were late against the lengths, by 30, 30, 30 ms" in said(perfect(0.03))
    assert "lengths and poses were not of the same time, by -20, -20, -20 ms" in said(
        perfect(-0.02)
    )


def test_sag_and_stretch_are_judged_each_against_the_error_left():
    best = validate(perfect(), ROBOT, [KS]).models[KS]
    cases = {
        (4e-6, 1.2e-3, 1.5e-3): "stretch is large enough to matter, sag is not",
        (1.2e-3, 4e-6, 1.5e-3): "sag is large enough to matter, stretch is not",
        (4e-6, 1.2e-3, 13.6e-3): "neither is large enough to explain it",
        (5e-3, 6e-3, 4e-3): "leaving out either would change the error",
        (4e-6, 5e-6, 1e-9): "neither is large enough",
    }
    for (sag, stretch, left), verdict in cases.items():
        scores = replace(best.length_scores, rmse=left)
        model = replace(best, sag=sag, stretch=stretch, length_scores=scores)
        (sentence,) = _sag(model)
        assert verdict in sentence


def test_a_perfect_or_a_tiny_recording_has_no_causes():
    text = said(perfect())
    assert "too little to look for causes" in text and "Sag" not in text
    few = said(shifted(perfect(), [0.02, 0.0, 0.0]).slice(0, 3))
    assert "Only 3 samples scored: too few" in few and "constant" not in few
    assert "Only 1 sample scored" in said(perfect().slice(0, 1))


def test_an_implausible_recording_or_a_huge_error_has_no_causes():
    late = perfect(0.03)
    far = replace(late, unstrained_length=1e3 * late.unstrained_length)
    text = said(far, ("straight_line",))
    assert "Causes of the error are not examined" in text and "late" not in text
    text = said(late, (f"{NAME}:Counting",))
    assert "more than 10% of the cable lengths" in text and "swings" not in text


def test_sway_is_named_with_its_period():
    recording = perfect()
    swing = np.zeros((len(recording.time), 3))
    swing[:, 0] = 0.05 * np.sin(2 * np.pi * 0.5 * recording.time)
    text = said(shifted(recording, swing))
    assert "swings by 50 mm with a period of 2.0" in text
    assert "it remains when the winches stop" in text
    assert "nearest natural frequency" in text


def test_a_platform_that_moves_while_the_winches_rest_is_named():
    recording = perfect()
    assert "The platform moves while the winches rest" not in said(recording)
    swing = np.zeros((len(recording.time), 3))
    swing[:, 0] = 0.05 * np.sin(2 * np.pi * 0.5 * recording.time)
    result = validate(shifted(recording, swing), ROBOT, [KS])
    assert result.rest_speed == pytest.approx(0.05 * np.pi / np.sqrt(2.0), rel=0.1)
    assert "its fastest anchor point by 0.11 m/s RMS" in " ".join(conclusions(result))


def test_a_model_that_moves_is_not_blamed_for_knowing_rest_alone():
    recording = perfect()
    swing = np.zeros((len(recording.time), 3))
    swing[:, 0] = 0.05 * np.sin(2 * np.pi * 0.5 * recording.time)
    shaken = shifted(recording, swing)
    assert "no quasi-static model can follow" in said(shaken)
    assert "with another phase or amplitude than in the model" in said(shaken, ("simulator",))


def test_a_constant_error_is_an_offset():
    text = said(shifted(perfect(), [0.02, 0.0, 0.0]))
    assert "constant (x -20.0 mm)" in text
    assert "sways" not in text


def test_failures_and_their_price_are_named():
    text = said(perfect(), (f"{NAME}:Failing", f"{NAME}:Raising"))
    assert "found no pose at" in text and "has no scores: RuntimeError: no luck" in text


def test_another_robot_is_suspected():
    moved = replace(perfect(), exit_points=ROBOT.exit_points + np.array([0.05, 0.0, 0.0]))
    assert "exit points lie up to 50 mm" in said(moved)
    near = replace(perfect(), exit_points=ROBOT.exit_points + 1e-3)
    assert "exit points" not in said(near)


@pytest.mark.parametrize("models", [(f"{NAME}:Raising",)])
def test_without_any_score_only_the_reason_is_left(models):
    assert said(perfect(), models) == f"{models[0]} has no scores: RuntimeError: no luck."


def test_models_of_motion_start_from_the_measured_one_of_a_free_oscillation():
    """At rest they would miss by the whole swing; the other model is not told the first pose."""
    recording, (position, _) = free_oscillation(ROBOT, 1, swing=0.15, duration=6.0)
    result = validate(recording, ROBOT, [KS, "simulator", "dynamic_estimator"])
    swing = np.sqrt(((position - position.mean(axis=0)) ** 2).sum(axis=1).mean())
    assert result.models[KS].scores.rmse[3] > 0.9 * swing
    for name in ("simulator", "dynamic_estimator"):
        assert result.models[name].scores.rmse[3] < 0.15 * swing
    assert result.starts_moving
    assert "start from its measured pose and speed" in " ".join(conclusions(result))
    assert not validate(perfect(), ROBOT, [KS]).starts_moving
