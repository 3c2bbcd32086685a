from __future__ import annotations

import json
import sys
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from carosac_toolkit.base.errors import CarosacError, InvalidField
from carosac_toolkit.loop.loop import Log
from carosac_toolkit.recordings.files import save_recording
from carosac_toolkit.robot.condition_file import condition_digest, find_condition
from carosac_toolkit.robot.file import robot_text
from carosac_toolkit.studies import Case
from carosac_toolkit.studies.run.rows import checked_values
from carosac_toolkit.studies.run.run_case import (
    SERIES_SAMPLES_MAX,
    Truth,
    build_part,
    condition_of,
    estimator_of,
    file_digests,
    given_to_driver,
    robot_digest,
    run_case,
)
from carosac_toolkit.studies.run.scores import score
from tests.recordings.synthetic import full_recording
from tests.robots import simple_robot

module = sys.modules["carosac_toolkit.studies.run.run_case"]
FAST = {"speed_max": 2.0, "acceleration_max": 3.0}
LENGTHS = {"estimation_rmse_norm_m", "tracking_rmse_norm_m", "tracking_max_m", "residual_sway_m"}


def case(controller="kinematic_solver", estimator="kinematic_solver", seed=1, **changes):
    fields = {"robot": "carosac", "sensors": "lengths", "trajectory": "line",
              "perturbation": "nominal-1", "settings": FAST} | changes  # fmt: skip
    return Case(controller=controller, estimator=estimator, seed=seed, **fields)


@lru_cache
def row_of(controller="kinematic_solver", estimator="kinematic_solver", seed=1, sensors="lengths"):
    """Row of a case, which several tests look at; the same every time, as the first test says."""
    return run_case(case(controller, estimator, seed, sensors=sensors))


def without_latency(row):
    return {name: value for name, value in row.items() if not name.startswith("latency")}


@pytest.fixture
def watched(monkeypatch):
    """Every (driver, log) of the cases that ran."""
    seen = []

    def watch(driver, estimator, controller, path, **options):
        log = original(driver, estimator, controller, path, **options)
        seen.append((driver, log))
        return log

    original = module.run
    monkeypatch.setattr(module, "run", watch)
    return seen


@pytest.mark.parametrize("seed", [0, 1])
def test_the_same_case_gives_the_same_row_bit_by_bit(seed):
    one, other = row_of(seed=seed), run_case(case(seed=seed))
    assert without_latency(one) == without_latency(other)
    assert set(one) > LENGTHS


def test_a_row_is_flat_and_finite():
    row = row_of(seed=0)
    assert checked_values(row) == row
    assert row["completed"] is True
    assert 0.0 < row["latency_median_s"] <= row["latency_p95_s"]
    series = json.loads(row["series"])
    count = len(series["time_s"])
    assert count <= SERIES_SAMPLES_MAX and {len(series[name]) for name in series} == {count}
    assert row_of(seed=1)["series"] is None


def test_other_seeds_are_other_plants_and_noise():
    one, other = (without_latency(row_of(seed=seed)) for seed in (1, 2))
    assert all(one[name] != other[name] for name in LENGTHS)


def test_controllers_meet_the_same_plant_noise_and_trajectory(watched):
    for controller in ("straight_line", "kinematic_solver"):
        run_case(case(controller))
    (one, first), (other, second) = watched
    for name in ("mass", "exit_points", "winch_lag", "axial_stiffness", "drag"):
        assert np.array_equal(getattr(one._plant.robot, name), getattr(other._plant.robot, name))
    assert one._plant.robot.mass != simple_robot().mass
    assert np.array_equal(first.reference, second.reference)
    assert np.array_equal(first.unstrained_length[0], second.unstrained_length[0])
    assert not np.array_equal(first.command[1], second.command[1])
    # the noise of each sample is the same draw, whatever the lengths are
    one_rng, other_rng = (driver._sensors._rng["encoders"][0] for driver in (one, other))
    assert one_rng.bit_generator.state == other_rng.bit_generator.state


def test_another_sensor_changes_neither_plant_nor_encoders():
    """A controller that uses no belief tracks the same, whatever else is measured."""
    rows = [row_of(sensors=sensors) for sensors in ("lengths", "lengths+pose")]
    for name in ("tracking_rmse_norm_m", "tension_max_N", "command_rmse_m"):
        assert rows[0][name] == pytest.approx(rows[1][name], rel=1e-9)  # rounding of the pose


def test_what_the_case_says_cannot_be_overridden():
    settings = FAST | {"driver_settings": {"suite": "lengths+pose"}}
    with pytest.raises(InvalidField, match=r"driver_settings.suite: .*the case itself sets it"):
        run_case(case(settings=settings))


def test_a_robot_file_that_has_changed_is_refused(tmp_path):
    path = tmp_path / "robot.yaml"
    text = robot_text("carosac")
    path.write_text(text)
    digest = robot_digest(str(path))
    path.write_text(text.replace("23.655 kg", "50.0 kg"))
    assert robot_digest(str(path)) != digest
    with pytest.raises(CarosacError, match="not the one the study was made for"):
        run_case(case(robot=str(path), settings=FAST | {"robot_digest": digest}))


def test_a_file_of_a_setting_that_has_changed_is_refused(tmp_path):
    path = tmp_path / "network.npz"
    path.write_bytes(b"one")
    settings = FAST | {"controller_settings": {"policy": str(path), "gain": 1.0}}
    digests = file_digests(settings)
    assert list(digests) == ["controller_settings.policy"]
    assert file_digests({"driver_settings": {"note": 5000 * "long "}}) == {}
    path.write_bytes(b"two")
    assert file_digests(settings) != digests
    with pytest.raises(CarosacError, match="policy: this file is not the one the study was made"):
        run_case(case("td3", settings=settings | {"file_digests": digests}))


def test_estimator_truth_has_no_estimation_error():
    row = row_of(estimator="truth")
    assert row["estimation_rmse_norm_m"] == 0.0
    assert row["tracking_rmse_norm_m"] > 1e-3


def test_truth_knows_the_twist_where_the_driver_does(watched):
    run_case(case(estimator="truth"))
    run_case(case(estimator="truth", settings=FAST | {"driver": "quasi_static"}))
    moving, resting = (driver for driver, _ in watched)
    for driver, has in ((moving, True), (resting, False)):
        driver.connect()
        assert (Truth(driver).reset(driver.measure()).twist is not None) is has


@pytest.mark.parametrize("sensors", ["lengths+imu", "lengths+pose", "lengths+imu+pose"])
def test_all_sensors_meet_the_same_motion(sensors):
    """A controller that uses no belief tracks the same, whatever is measured."""
    one, other = (row_of(sensors=name) for name in ("lengths", sensors))
    assert other["tracking_rmse_norm_m"] == pytest.approx(one["tracking_rmse_norm_m"], rel=1e-4)


@pytest.mark.parametrize(
    ("sensors", "used"),
    [
        ("lengths", (False, False, False)),
        ("lengths+tension", (True, False, False)),
        ("lengths+swivel", (False, True, False)),
        ("lengths+attitude", (False, False, True)),
        ("lengths+imu+inclination", (False, False, True)),
    ],
)
def test_an_estimator_uses_the_sensors_of_the_suite(sensors, used):
    """It has states for what they err by."""
    chosen = case(estimator="dynamic_estimator", sensors=sensors)
    robot = simple_robot(pulley_radius=np.full(4, 0.05))
    settings = estimator_of(chosen, robot, None)._settings
    mounted = settings.attitude_rotation is not None
    assert (settings.load_cells, settings.swivels, mounted) == used


def test_the_wind_of_a_condition_reaches_the_driver_that_has_one(watched):
    for perturbation in ("nominal-1", "none"):
        run_case(case(perturbation=perturbation))
    assert [d._settings.wind_force for d, _ in watched] == [1.0, 0.0]
    assert [d._settings.wind_time for d, _ in watched] == [2.0, 2.0]
    run_case(case(settings=FAST | {"driver": "quasi_static"}))  # has no wind


def test_the_wind_of_a_condition_reaches_the_driver_behind_a_guard():
    windy = case(settings={"driver_settings": {"guarded": {"driver": "simulator"}}})
    given = given_to_driver(windy, find_condition("nominal-1"), 0.02, (0.0, -1.0, 2.0))
    guard = build_part("drivers", "guarded", simple_robot(), windy, "driver_settings", given)
    behind = guard.inner._settings
    assert (behind.wind_force, behind.wind_time, behind.start_position) == (1.0, 2.0, (0, -1, 2))


def test_sway_is_left_at_the_end_where_the_platform_has_inertia():
    sway = {
        name: run_case(case("straight_line", settings=FAST | {"driver": name}))["residual_sway_m"]
        for name in ("simulator", "quasi_static")
    }
    assert sway["simulator"] > 5e-3 > sway["quasi_static"]


def test_truth_needs_a_driver_that_knows_it():
    with pytest.raises(InvalidField, match="estimator: got 'truth'; allowed: a simulated driver"):
        Truth(object())


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"contoller_settings": {}}, r"settings\.contoller_settings: .*'controller_settings'"),
        ({"controller_settings": {"gian": 1.0}},
         r"controller_settings\.gian: got 1.0; allowed: one of \['delay', 'distribution', 'gain'"),
        ({"estimator_settings": {"guess": "x"}}, r"estimator_settings\.guess: got 'x'"),
        ({"driver_settings": {"encoder_bias": 0.0}}, r"driver_settings\.encoder_bias: got 0.0"),
        ({"driver_settings": {"sensors": {"bias": 0.0}}},
         r"driver_settings\.sensors\.bias: got 0.0; allowed: one of \[.*'encoder_bias'"),
        ({"controller_settings": {"gain": -1.0}}, "gain: got -1.0 1/s; allowed: gain >= 0"),
        ({"driver": "quasi"}, r"driver: got 'quasi'; allowed: one of \[.*'quasi_static'"),
    ],
)  # fmt: skip
def test_a_setting_that_nobody_reads_is_named(settings, message):
    with pytest.raises(InvalidField, match=message):
        run_case(case(settings=FAST | settings))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"sensors": "lengths+imu", "settings": FAST | {"driver": "quasi_static"}},
            r"suite: got 'lengths\+imu'; allowed: .*this plant has no inertia",
        ),
        ({"controller": "pid"}, "controller: got 'pid'"),
        ({"estimator": "ukf"}, "estimator: got 'ukf'"),
        ({"trajectory": "square"}, "trajectory: got 'square'"),
        ({"perturbation": "storm"}, "condition: got 'storm'"),
        ({"robot": "carosak"}, "carosak"),
    ],
)
def test_what_is_not_there_is_refused_with_the_reason(changes, message):
    with pytest.raises(InvalidField, match=message):
        run_case(case(**changes))


def test_settings_reach_the_plug_ins(watched):
    settings = FAST | {
        "controller_settings": {"period": 0.04, "gain": 0.5},
        "driver_settings": {"sensors": {"encoder_bias": 0.0, "encoder_delay": 0.0},
                            "limits": {"jerk_max": 300.0}},
        "timeout": 60,
    }  # fmt: skip
    run_case(case(settings=settings))
    ((driver, log),) = watched
    assert np.diff(log.time) == pytest.approx(0.04)
    assert not driver._sensors.encoder_bias.any()
    assert driver._settings.limits.jerk_max == 300.0
    assert driver._settings.limits.jump_max == pytest.approx(0.4)  # 2 periods of the nominal
    assert driver._settings.limits.box is False  # as the driver's own default has it
    assert driver._settings.period == 0.04


def test_a_slower_trajectory_is_tracked_better():
    slow = {"speed_max": 0.5, "acceleration_max": 0.25}
    fast, slow_row = (
        run_case(case(perturbation="none", settings=settings
                      | {"driver_settings": {"sensors": {"encoder_bias": 0.0}}}))
        for settings in (FAST, slow)
    )  # fmt: skip
    assert slow_row["tracking_max_m"] < 0.5 * fast["tracking_max_m"]


def test_on_a_recording_only_commands_and_estimates_are_scored():
    settings = FAST | {"driver": "replay", "driver_settings": {"recording": "synthetic"}}
    row = run_case(case(settings=settings, sensors="lengths+pose"))
    assert all(row[name] is None for name in row if name.startswith("tracking_rmse"))
    assert "tracking_max_m" not in row and "residual_sway_m" not in row
    assert row["command_rmse_m"] > 0.0
    assert row["estimation_rmse_norm_m"] > 0.0


def test_a_recording_is_played_to_its_end(tmp_path):
    path = tmp_path / "short.parquet"
    save_recording(replace(full_recording(), exit_points=None), path)
    settings = FAST | {"driver": "replay", "driver_settings": {"recording": str(path)}}
    row = run_case(case(settings=settings, estimator="straight_line", trajectory="recorded"))
    assert (row["completed"], row["steps"]) == (True, 50)
    assert row["estimation_rmse_norm_m"] is None  # not every sample has a pose


def made_up(count=11, worlds=2):
    """Two worlds: the first 3 mm off along x, the second 4 mm along y; believed 1 mm off in z."""
    time = np.linspace(0.0, 2.0, count)
    reference = np.tile([0.4, -1.8, 3.0], (count, worlds, 1))
    reference[: count // 2, :, 0] = 2.0  # half of the time near the edge of the box
    offset = np.array([[0.003, 0.0, 0.0], [0.0, 0.004, 0.0]])
    position = reference + offset
    lengths = np.full((count, worlds, 4), 9.0)
    return Log(
        time=time, reference=reference, position=position,
        rotation=np.tile(np.eye(3), (count, worlds, 1, 1)), tension=lengths * 10.0,
        belief_position=position + np.array([0.0, 0.0, 0.001]),
        belief_rotation=np.tile(np.eye(3), (count, worlds, 1, 1)),
        unstrained_length=lengths, asked=lengths + 0.002, command=lengths,
        latency=np.linspace(1e-3, 2e-3, count), limited=(), completed=True,
    )  # fmt: skip


def test_scores_of_errors_made_by_hand():
    row = score(made_up(), simple_robot(), 1.0)
    assert row["tracking_rmse_x_m"] == pytest.approx(0.003 / np.sqrt(2))
    assert row["tracking_rmse_y_m"] == pytest.approx(0.004 / np.sqrt(2))
    assert row["tracking_rmse_z_m"] == pytest.approx(0.0)
    assert row["tracking_rmse_norm_m"] == pytest.approx(0.005 / np.sqrt(2))
    assert row["tracking_max_m"] == pytest.approx(0.004)
    assert row["tracking_centre_m"] == pytest.approx(row["tracking_boundary_m"])
    assert row["estimation_rmse_norm_m"] == pytest.approx(0.001)
    assert row["command_rmse_m"] == pytest.approx(0.002)
    assert row["residual_sway_m"] == pytest.approx(0.0)
    assert row["tension_max_N"] == 90.0
    assert row["latency_median_s"] == pytest.approx(1.5e-3)


def test_sway_is_the_swing_about_the_mean_position_of_rest():
    log = made_up(count=201)
    swing = 0.01 * np.sin(2 * np.pi * log.time)[:, None, None] * [0.0, 1.0, 0.0]
    row = score(replace(log, position=log.position + swing), simple_robot(), 1.0)
    assert row["residual_sway_m"] == pytest.approx(0.01 / np.sqrt(2), rel=0.02)


def test_a_run_that_ended_before_the_rest_has_no_sway():
    log = replace(made_up(), completed=False)
    assert score(log, simple_robot(), 5.0)["residual_sway_m"] is None


def test_nothing_is_scored_that_nobody_knows():
    log = replace(made_up(), position=None, rotation=None, tension=None)
    row = score(log, simple_robot(), 1.0)
    assert row["tracking_rmse_norm_m"] is row["estimation_rmse_norm_m"] is None
    assert row["command_rmse_m"] == pytest.approx(0.002)


def test_nominal_2_gives_the_rows_of_nominal_1_on_carosac():
    rows = [run_case(case(perturbation=name)) for name in ("nominal-1", "nominal-2")]
    one, two = (without_latency(row) for row in rows)
    assert one == two


def test_a_condition_file_must_be_the_one_the_study_was_made_for(tmp_path):
    path = tmp_path / "hall.yaml"
    path.write_text("schema: carosac-condition/1\nmass: 3 %\nwind_force: 1 % of weight\n")
    digest = condition_digest(str(path))
    assert condition_of(case(perturbation=str(path), settings={"condition_digest": digest})).mass
    path.write_text("schema: carosac-condition/1\nmass: 4 %\n")
    with pytest.raises(CarosacError, match="not the one the study was made for"):
        run_case(case(perturbation=str(path), settings=FAST | {"condition_digest": digest}))
