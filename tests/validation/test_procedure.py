from dataclasses import replace

import numpy as np
import pytest

import carosac_toolkit as ct
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.loop.values import Stamped
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.recordings.poses import PoseSamples
from carosac_toolkit.robot.model_error import ModelError
from carosac_toolkit.validation import validate
from tests.robots import eight_cable_robot
from tests.validation.models import NAME, Spying
from tests.validation.runs import ROBOT, STEP, perfect, shifted

KS = "kinematic_solver"


def test_the_kinematic_solver_explains_a_recording_made_with_its_own_statics():
    model = validate(perfect(), ROBOT).models[KS]
    assert model.scores.max.max() < 1e-6
    assert model.scores.orientation_max < 1e-6
    assert model.length_scores.rmse < 1e-9
    assert model.failures == 0
    assert model.update_time > 0.0


def test_a_constant_offset_is_the_rmse_the_mae_and_the_largest_error():
    offset = np.array([0.03, -0.02, 0.01])
    result = validate(shifted(perfect(), offset), ROBOT, [KS])
    expected = [*np.abs(offset), np.linalg.norm(offset)]
    for scores in (result.models[KS].scores, result.models[KS].moving, result.models[KS].resting):
        assert scores.samples > 10
        assert scores.bias == pytest.approx(-offset, abs=1e-6)
        for numbers in (scores.rmse, scores.mae, scores.max):
            assert numbers == pytest.approx(expected, abs=1e-6)


def test_moving_and_resting_samples_add_up_and_the_rests_are_those_of_the_trajectory():
    result = validate(perfect(), ROBOT, [KS])
    model = result.models[KS]
    assert model.moving.samples + model.resting.samples == result.samples == len(perfect().time)
    assert len(result.rests) == 4
    square = (model.moving.samples * model.moving.rmse**2
              + model.resting.samples * model.resting.rmse**2) / result.samples  # fmt: skip
    assert square == pytest.approx(model.scores.rmse**2)


@pytest.mark.parametrize("delay", [0.03, -0.02])
def test_an_injected_delay_is_found(delay):
    model = validate(perfect(delay), ROBOT, [KS]).models[KS]
    assert model.delay.seconds == pytest.approx(np.full(3, delay), abs=1e-3)
    assert (model.delay.explained > 0.98).all()
    assert model.rmse_without_delay < 0.1 * model.moving.rmse[3]


def test_a_swing_at_rest_is_found_with_its_frequency_and_amplitude():
    recording = perfect()
    swing = np.zeros((len(recording.time), 3))
    swing[:, 1] = 0.02 * np.sin(2 * np.pi * 0.6 * recording.time + 0.3)
    sway = validate(shifted(recording, swing), ROBOT, [KS]).models[KS].sway
    assert sway.axis == "y" and sway.clear
    assert sway.frequency == pytest.approx(0.6, rel=0.02)
    assert sway.amplitude == pytest.approx(0.02, rel=0.02)
    noise = np.random.default_rng(1).normal(scale=0.02, size=swing.shape)
    assert not validate(shifted(recording, noise), ROBOT, [KS]).models[KS].sway.clear


def test_the_natural_frequencies_are_those_at_the_rests():
    result = validate(perfect(), ROBOT, [KS])
    from carosac_toolkit.physics.rest.modes import natural_frequencies

    rests = statics.inverse_kinematics(
        ROBOT, result.measured.position[[a for a, _ in result.rests]]
    )
    expected = np.median(natural_frequencies(ROBOT, rests), axis=0)
    assert result.natural_frequency == pytest.approx(expected, rel=1e-3)


def test_start_and_stop_limit_the_scores_but_models_run_from_the_first_sample():
    name = f"{NAME}:Counting"
    whole = validate(perfect(), ROBOT, [name, KS])
    part = validate(perfect(), ROBOT, [name, KS], start=40, stop=60)
    assert part.samples == 20
    assert (part.index == np.arange(40, 60)).all()
    counted = part.models[name].pose.position[:, 0] - ROBOT.home_position[0]
    assert counted == pytest.approx(np.arange(40.0, 60.0))
    same = whole.models[KS].pose.position[40:60]
    assert (part.models[KS].pose.position == same).all()
    spoilt = shifted(perfect(), np.where(np.arange(len(perfect().time)) == 39, 5.0, 0.0)[:, None])
    assert validate(spoilt, ROBOT, [KS], start=40, stop=60).models[KS].scores.max[3] < 1e-6


def test_measured_poses_are_withheld_and_commands_are_those_applied():
    recording = perfect()
    validate(recording, ROBOT, [f"{NAME}:Spying"], stop=5)
    seen = Spying.seen
    assert len(seen) == 5
    assert all(measurement.pose is None for _, measurement in seen)
    for k in range(1, 5):
        assert (seen[k][0].unstrained_length[0] == recording.unstrained_length[k - 1]).all()
    command = Stamped(time=recording.time[::2], value=recording.unstrained_length[::2] + 1.0)
    validate(replace(recording, command=command), ROBOT, [f"{NAME}:Spying"], stop=5)
    assert (Spying.seen[3][0].unstrained_length[0] == command.value[1]).all()
    assert (Spying.seen[4][0].unstrained_length[0] == command.value[2]).all()


def test_samples_without_a_pose_nearby_are_counted_and_not_scored():
    recording = perfect()
    keep = np.ones(len(recording.time), dtype=bool)
    keep[30:80] = False
    poses = recording.poses
    cut = PoseSamples(
        time=poses.time[keep], position=poses.position[keep], quaternion=poses.quaternion[keep]
    )
    result = validate(replace(recording, poses=cut), ROBOT, [KS])
    assert result.unscored == 50 and result.samples == len(recording.time) - 50
    assert result.models[KS].scores.samples == result.samples
    assert result.models[KS].scores.max[3] < 1e-6


def test_a_model_that_raises_costs_its_own_row_only():
    result = validate(perfect(), ROBOT, [f"{NAME}:Raising", KS, f"{NAME}:Hopeless"])
    assert result.models[f"{NAME}:Raising"].reason == "RuntimeError: no luck"
    assert "no pose" in result.models[f"{NAME}:Hopeless"].reason
    assert result.models[KS].scores.max[3] < 1e-6
    data = result.data()["models"][f"{NAME}:Raising"]
    assert data["error"] == "RuntimeError: no luck"
    assert data["rmse_m"] == {"x": None, "y": None, "z": None, "norm": None}


@pytest.mark.parametrize(
    ("model", "reason"),
    [
        ("TwoRows", "BadPlugin: estimator: got 2 poses; allowed: 1"),
        ("WrongTension", "BadPlugin: estimator: got tensions of shape (1, 3); allowed: (1, 4)"),
        ("NoBelief", "BadPlugin: estimator: got SimpleNamespace; allowed: a Belief"),
        ("Quitting", "SystemExit: 0"),
    ],
)
def test_a_model_that_misbehaves_costs_its_own_row_only(model, reason):
    result = validate(perfect(), ROBOT, [f"{NAME}:{model}", KS])
    assert result.models[f"{NAME}:{model}"].reason == reason
    assert result.models[KS].scores.max[3] < 1e-6


def test_failures_are_counted_and_kept_out_of_the_scores():
    model = validate(perfect(), ROBOT, [f"{NAME}:Failing"]).models[f"{NAME}:Failing"]
    assert model.failures == len(perfect().time) // 4
    assert model.scores.samples == len(perfect().time) - model.failures
    assert model.scores.max[3] < 5.0
    assert model.rmse_with_failures > 50.0


def test_the_seed_reaches_the_model():
    name = f"{NAME}:Seeded"
    first = validate(perfect(), ROBOT, [name], seed=3).models[name]
    assert first.pose.position[0] == pytest.approx(ROBOT.home_position + 3.0)


@pytest.mark.parametrize(
    ("channels", "shift"), [((), 0.0), (("swivel_angle",), 1.0), (("inclination",), 0.0)]
)
def test_models_are_told_which_sensors_a_recording_has(channels, shift):
    recording = perfect()
    columns = {"swivel_angle": recording.n, "inclination": 2}
    more = {
        name: Stamped(time=recording.time, value=np.zeros((len(recording.time), columns[name])))
        for name in channels
    }
    model = validate(replace(recording, **more), ROBOT, [f"{NAME}:Using"]).models[f"{NAME}:Using"]
    assert model.pose.position[0] == pytest.approx(ROBOT.home_position + shift)


def test_straight_lengths_are_predicted_for_models_without_tensions():
    result = validate(perfect(), ROBOT)
    straight = result.models["straight_line"]
    chords = ct.straight_line.inverse_kinematics(
        ROBOT, result.measured.position, result.measured.rotation
    )
    assert straight.length_error == pytest.approx(perfect().unstrained_length - chords, abs=1e-12)
    assert straight.sag is None
    hanging = result.models[KS]
    difference = (perfect().unstrained_length - chords).mean()
    assert hanging.sag - hanging.stretch == pytest.approx(difference, abs=1e-9)


def test_eight_cables_are_scored_like_four():
    robot = eight_cable_robot()
    position = robot.home_position + 0.1 * np.sin(np.arange(40.0)[:, None] * [0.1, 0.2, 0.15])
    rest = statics.inverse_kinematics(robot, position)
    time = STEP * np.arange(40)
    recording = ct.Recording(
        time=time,
        unstrained_length=rest.unstrained_length,
        poses=PoseSamples.from_rotation(time, rest.position, rest.rotation),
    )
    model = validate(recording, robot, [KS]).models[KS]
    assert model.scores.max[3] < 1e-6 and model.length_scores.rmse < 1e-9
    assert model.sway is None and model.resting.samples == 0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"models": ["kinematic_solvr"]}, "did you mean 'kinematic_solver'"),
        ({"models": [KS, KS]}, "each once"),
        ({"models": []}, "at least one"),
        ({"models": [f"{NAME}:Unbuildable"]}, r"something with build\(robot"),
        ({"start": -1}, "start: got -1"),
        ({"start": 100_000}, "start: got 100000"),
        ({"start": 5, "stop": 5}, "stop: got 5"),
        ({"stop": 100_000}, "stop: got 100000"),
    ],
)
def test_wrong_arguments_are_refused(change, message):
    arguments = {"models": [KS]} | change
    with pytest.raises(InvalidField, match=message):
        validate(perfect(), ROBOT, arguments.pop("models"), **arguments)


def test_recordings_that_cannot_be_scored_are_refused():
    recording = perfect()
    with pytest.raises(InvalidField, match="measured poses"):
        validate(replace(recording, poses=None), ROBOT, [KS])
    relative = replace(recording.metadata, length_kind="relative")
    with pytest.raises(InvalidField, match="relative lengths fix no pose"):
        validate(replace(recording, metadata=relative), ROBOT, [KS])
    with pytest.raises(InvalidField, match="8 cables"):
        validate(recording, eight_cable_robot(), [KS])
    late = replace(recording.poses, time=recording.poses.time + 1e4)
    with pytest.raises(InvalidField, match="none in samples 0:"):
        validate(replace(recording, poses=late), ROBOT, [KS])


@pytest.mark.parametrize("suffix", ["csv", "mat"])
def test_the_published_solvers_figures_on_the_real_recording(real_data, suffix):
    recording = ct.load_recording(real_data / f"scampi_run_part.{suffix}")
    robot = ct.load_robot("scampi")
    published = np.array([0.0317, 0.0107, 0.0112, 0.0353])
    same_moment = replace(robot, center_of_mass=(0.0, 0.0, -0.0764))
    scores = validate(recording, same_moment, [KS]).models[KS].scores
    assert scores.samples == 600
    assert scores.rmse == pytest.approx(published, abs=1.5e-3)
    result = validate(recording, robot, [KS])
    model = result.models[KS]
    assert model.scores.rmse[3] <= published[3]
    # sway in x, delay in y and z, no sag
    assert model.sway.axis == "x" and model.sway.clear
    assert 1.0 / model.sway.frequency == pytest.approx(2.0, abs=0.3)
    assert model.sway.frequency == pytest.approx(result.natural_frequency[0], rel=0.15)
    assert model.resting.rmse[0] > 0.9 * model.moving.rmse[0]
    assert model.delay.seconds[1:] == pytest.approx([0.034, 0.034], abs=3e-3)
    assert (model.delay.explained[1:] > 0.7).all()
    assert model.sag < 1e-3


def test_what_a_model_claims_is_held_against_its_errors():
    """One that errs by nothing and claims centimetres is too cautious; one without claims has none.

    The platform of the recording never sways, which the estimator does not know.
    """
    models = validate(perfect(), ROBOT, [KS, "dynamic_estimator"]).models
    assert models[KS].nees is None and models[KS].data(ROBOT.cable_names)["nees"] is None
    usual = models["dynamic_estimator"].nees
    assert 0.0 < usual < 0.5
    error = ModelError(
        mass=0.02, length=1e-4, force=0.01, acceleration=1e-3, position=1e-3, rotation=5e-4
    )
    informed = replace(ROBOT, model_error=error)
    sure = validate(perfect(), informed, ["dynamic_estimator"])
    assert sure.models["dynamic_estimator"].nees > 3.0 * usual


def test_the_result_says_why_it_has_no_effects():
    part = {"stop": 50, "effects": True}
    short = validate(shifted(perfect(), [1e-3, 0.0, 0.0]), ROBOT, ["simulator"], **part)
    assert short.models["simulator"].scores is not None and short.effects is None
    assert "samples: got 50" in short.data()["effects_reason"]
    still = validate(perfect(), ROBOT, [KS], **part)
    assert still.effects_reason == "no model that moves solved every sample"
    assert validate(perfect(), ROBOT, [KS]).effects_reason == "not asked for"
