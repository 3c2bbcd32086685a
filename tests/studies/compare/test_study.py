import json
import shutil
from dataclasses import replace

import numpy as np
import pytest

import carosac_toolkit as ct
from carosac_toolkit.base.errors import CarosacError, InvalidField
from carosac_toolkit.base.extras import MissingExtra
from carosac_toolkit.robot.file import robot_text
from carosac_toolkit.studies import read_rows
from carosac_toolkit.studies.compare import defaults
from carosac_toolkit.studies.compare import study as study_module
from carosac_toolkit.studies.compare.defaults import default_controllers, default_estimation
from carosac_toolkit.studies.compare.findings import conclusions
from carosac_toolkit.studies.compare.tables import failures, header
from carosac_toolkit.studies.compare.terminal_table import terminal_table
from carosac_toolkit.studies.run.row_files import part_files
from learned.bundled_files import find_bundled
from sim_warp.driver import SimDriver
from tests.studies.tables import bad, case, good, study

pytestmark = pytest.mark.usefixtures("quick_pictures")  # tests/pictures draw them

PLAIN = "tests.studies.tables:PlainDriver"
FAST = {
    "controllers": ["straight_line", "kinematic_solver"], "estimators": ["kinematic_solver"],
    "sensors": ["lengths"], "trajectories": ["line"], "speed_max": 2.5, "acceleration_max": 2.5,
}  # fmt: skip


def without_latency(results):
    return [{k: x for k, x in line.items() if "latency" not in k} for line in results.summary]


def test_squared_errors_are_pooled_with_the_number_of_steps():
    rows = [good(case("a", 0), (3.0, 0.0, 4.0), steps=300), good(case("a", 1), (1.0, 2.0, 2.0))]
    line = study(rows).summary[0]
    tracking = line["tracking_rmse_m"]
    assert tracking["x"] == pytest.approx(np.sqrt((3 * 9 + 1) / 4))
    assert tracking["norm"] == pytest.approx(np.sqrt((3 * 25 + 9) / 4))
    assert tracking["norm"] ** 2 == pytest.approx(sum(tracking[a] ** 2 for a in "xyz"))
    assert line["estimation_rmse_m"]["norm"] == pytest.approx(0.5 * tracking["norm"])
    assert line["tracking_std_m"] == pytest.approx(np.std([5.0, 3.0], ddof=1))
    assert line["limited"] == 6 and line["cases"] == 2 and line["failures"] == 0


def test_centre_and_boundary_are_weighted_with_their_own_steps():
    one = good(case("a", 0), (1, 0, 0), tracking_centre_m=2.0, centre_steps=100,
               tracking_boundary_m=None)  # fmt: skip
    two = good(case("a", 1), (1, 0, 0), tracking_centre_m=4.0, centre_steps=50,
               tracking_boundary_m=6.0)  # fmt: skip
    line = study([one, two]).summary[0]
    assert line["tracking_centre_m"] == pytest.approx(np.sqrt((100 * 4 + 50 * 16) / 150))
    assert line["tracking_boundary_m"] == 6.0


def test_latency_is_the_median_of_the_cases():
    rows = [good(case("a", k), (1, 0, 0), latency_p95_s=x) for k, x in enumerate((1.0, 2.0, 9.0))]
    assert study(rows).summary[0]["latency_p95_s"] == 2.0


def test_cases_without_a_score_are_counted_with_their_reasons():
    reasons = ["ValueError: at 1.25 s", "ValueError: at 3e-2 s", "TypeError: no"]
    rows = [good(case("a", 9), (1, 0, 0)), good(case("b", 9), (1, 0, 0))]
    rows += [bad(case("a", k), reason) for k, reason in enumerate(reasons)]
    rows += [bad(case("a", 7), "stopped after 5 s", "timed_out")]
    results = study(rows)
    line = results.summary[0]
    assert (line["cases"], line["failures"]) == (5, 4)
    assert line["reasons"] == {"failed: ValueError: at 1.25 s": 2, "failed: TypeError: no": 1,
                               "timed out: stopped after 5 s": 1}  # fmt: skip
    assert failures(results) == [
        "a: 4 of 5 cases without a score", "  2 failed: ValueError: at 1.25 s",
        "  1 failed: TypeError: no", "  1 timed out: stopped after 5 s",
    ]  # fmt: skip
    assert "4 of 6 cases without a score" in " ".join(conclusions(results))
    assert results.complete


def test_a_group_without_any_score_has_nulls_and_is_not_complete():
    results = study([bad(case("a", 0), "no"), good(case("b", 0), (1, 0, 0))])
    line = results.data()["summary"][0]
    assert line["tracking_rmse_m"] == dict.fromkeys(("x", "y", "z", "norm"))
    assert line["tracking_std_m"] is line["latency_p95_s"] is line["residual_sway_m"] is None
    assert not results.complete
    assert "failed 1 of 1" in terminal_table(results, 80)
    json.dumps(results.data(), allow_nan=False)


def test_a_group_is_a_robot_controller_estimator_sensors_and_perturbation():
    pairs = [("controller", "a"), ("controller", "b"), ("estimator", "e"), ("sensors", "s"),
             ("robot", "scampi"), ("perturbation", "nominal-1")]  # fmt: skip
    rows = [
        good(case(**{"controller": "a"} | {name: x}, seed=seed), (1, 0, 0))
        for name, x in pairs
        for seed in (0, 1)
    ]
    results = study(rows)
    assert [line["cases"] for line in results.summary] == [2] * len(pairs)
    assert len(set(results.labels)) == len(pairs)
    for titles in (terminal_table(results, 120), " ".join(header(results))):
        assert "condition" in titles and "perturbation" not in titles
    for width in (80, 120):
        assert max(map(len, terminal_table(results, width).splitlines())) <= width


def test_long_names_keep_the_table_within_its_width():
    names = [f"a.very.long.package.of.somebody:Controller{k}" for k in range(2)]
    rows = [good(case(name, sensors="lengths+imu+pose"), (1, 0, 0)) for name in names]
    text = terminal_table(study(rows), 80)
    assert max(map(len, text.splitlines())) <= 80
    assert "Controller0 " in text and "Controller1 " in text and "..." not in text


def test_sentences_compare_over_the_cases_that_both_finished():
    rows = [good(case("a", k), (0.010, 0, 0)) for k in range(3)]
    rows += [good(case("b", k), (0.030, 0, 0)) for k in range(2)] + [bad(case("b", 2), "no")]
    rows[0] = good(case("a", 0), (0.040, 0, 0))
    said = conclusions(study(rows))
    ratio = 30.0 / np.sqrt((40**2 + 10**2) / 2)
    assert said[0].startswith(f"The tracking error of b is {ratio:.3g} times that of a: 30.0 mm")
    assert "over the same 2 cases, larger in 1 of them; with 2 seeds this may be" in said[0]


@pytest.mark.parametrize(("seeds", "doubted"), [(5, True), (6, False)])
def test_what_the_seeds_cannot_show_is_said(seeds, doubted):
    """Signs of k seeds that all agree happen by chance with p = 2 / 2^k: 0.06 and 0.03."""
    rows = [good(case("a", k), (0.010, 0, 0)) for k in range(seeds)]
    rows += [good(case("b", k), (0.030, 0, 0)) for k in range(seeds)]
    assert ("may be chance" in conclusions(study(rows))[0]) == doubted


def test_one_case_is_not_spoken_of_as_many():
    rows = [good(case("a", 0), (0.010, 0, 0)), good(case("b", 0), (0.030, 0, 0))]
    said = conclusions(study(rows))
    assert said[0] == (
        "The tracking error of b is 3 times that of a: 30.0 mm against 10.0 mm RMSE in the one "
        "case of both."
    )
    lost = study([bad(case("a", 0), "no")])
    assert any(
        "1 of 1 case without a score: the errors of a row" in text for text in conclusions(lost)
    )


def test_a_ranking_is_turned_round_where_the_shared_cases_say_so():
    rows = [good(case("a", k), (x, 0, 0)) for k, x in enumerate((0.02, 0.001, 0.001))]
    rows += [good(case("b", 0), (0.01, 0, 0))]
    assert "error of a is 2 times that of b" in conclusions(study(rows))[0]


def test_what_is_alike_is_said_to_be_alike():
    rows = [good(case(name, k), (0.01, 0, 0)) for name in "ab" for k in range(2)]
    assert "a and b track alike" in conclusions(study(rows))[0]


def test_robots_are_not_compared_with_each_other():
    rows = [good(case(c, robot=r), (e, 0, 0)) for r in ("carosac", "scampi")
            for c, e in (("a", 0.01), ("b", 0.02))]  # fmt: skip
    said = [line for line in conclusions(study(rows)) if "times" in line]
    assert [line.partition(":")[0] for line in said] == [
        "On carosac, condition none",
        "On scampi, condition none",
    ]


def test_cases_are_all_combinations_with_the_settings_of_their_own_plugins():
    chosen = ct.Study(
        trajectories=["line"], seeds=[4, 2], controller_settings={"kinematic_solver": {"gain": 1.0}}
    )
    cases = chosen.cases()
    assert len(cases) == 10 and {x.seed for x in cases} == {4, 2}
    for x in cases:
        solver = x.controller == "kinematic_solver"
        assert ("controller_settings" in x.settings) == solver
        assert x.settings["example_seed"] == 4
    assert len(ct.Study().cases()) == 50
    quick = ct.Study().quick().cases()
    assert len(quick) == 10 and set(quick) < set(ct.Study().cases())


def test_a_policy_of_a_file_is_part_of_the_identity_of_a_case(tmp_path):
    path = tmp_path / "policy.onnx"
    shutil.copy(find_bundled("carosac-residual", "policies"), path)
    chosen = ct.Study(
        controllers=["td3"], trajectories=["line"], seeds=[1],
        controller_settings={"td3": {"policy": str(path)}},
    )  # fmt: skip
    (before,) = chosen.cases()
    shutil.copy(find_bundled("carosac-settle", "policies"), path)
    (after,) = chosen.cases()
    assert before.identity != after.identity


def test_by_default_five_controllers_track_one_fast_move_behind_the_dynamic_estimator():
    study = ct.Study()
    assert study.controllers == (
        "straight_line", "kinematic_solver", "input_shaping", "mpc", "td3"
    )  # fmt: skip
    assert study.estimators == ("dynamic_estimator",) and study.sensors == ("lengths+imu",)
    assert {case.trajectory for case in study.cases()} == {"fast_move"}
    assert {case.settings["speed_max"] for case in study.cases()} == {2.0}
    elsewhere = ct.Study(driver="quasi_static")
    assert elsewhere.controllers == ("straight_line", "kinematic_solver")
    assert elsewhere.estimators == ("kinematic_solver",) and elsewhere.sensors == ("lengths",)


def test_the_learned_policy_is_left_out_where_none_was_trained_for_the_robot(tmp_path):
    own = tmp_path / "heavier.yaml"
    own.write_text(robot_text("carosac").replace("mass: 23.655", "mass: 24.655"))
    for robot, why in (("cogiro", "a robot with a bundled policy"), (str(own), "mass differ")):
        kept, left_out = default_controllers("simulator", ["carosac", robot])
        assert kept == ("straight_line", "kinematic_solver", "input_shaping", "mpc")
        assert (
            len(left_out) == 1 and left_out[0].startswith("td3 is left out") and why in left_out[0]
        )
        with pytest.warns(UserWarning, match="td3 is left out"):
            assert ct.Study(robots=[robot]).controllers == kept


def test_without_its_extra_the_default_estimator_and_sensors_are_told(monkeypatch):
    error = MissingExtra("estimator 'dynamic_estimator'", [], ["control"], "carosac-toolkit")

    def refuse(kind, name):
        raise error

    monkeypatch.setattr("carosac_toolkit.studies.compare.defaults.plugins.load", refuse)
    usual, (text,) = default_estimation("simulator")
    assert (usual.estimators, usual.sensors) == (("kinematic_solver",), ("lengths",))
    assert text == (
        f"Left out: {error}. Instead the default estimator is kinematic_solver, and the default "
        "sensors are lengths."
    )
    assert text.count("dynamic_estimator") == 1


def test_a_named_controller_that_refuses_all_robots_is_refused_before_any_case():
    line = {"controllers": ["td3"], "seeds": 1}
    with pytest.raises(InvalidField, match="a robot with a bundled policy"):
        ct.Study(robots=["cogiro"], **line).check()
    ct.Study(robots=["cogiro", "carosac"], **line).check()


def test_a_broken_plug_in_is_not_left_out_in_silence(monkeypatch):
    def load(kind, name):
        raise CarosacError(f"{name} is claimed by several installed distributions")

    monkeypatch.setattr(defaults.plugins, "load", load)
    with pytest.raises(CarosacError, match="several installed"):
        default_controllers("simulator", ["carosac"])


def test_a_driver_has_the_same_defaults_by_its_name_and_as_its_class():
    assert ct.Study(driver=SimDriver).controllers == ct.Study(driver="simulator").controllers
    assert ct.Study(driver=SimDriver).sensors == ("lengths+imu",)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"seeds": 0}, "seeds: got 0"),
        ({"seeds": True}, "seeds: got True"),
        ({"seeds": "1"}, "seeds: got '1'; allowed: a whole number, 1 or more, or a list of seeds"),
        ({"seeds": [1, 1]}, "seeds: got"),
        ({"seeds": [-1]}, "seed: got -1"),
        ({"controllers": "straight_line"}, "controllers: got 'straight_line'; allowed: a list"),
        ({"controllers": []}, "controllers: got none"),
        ({"controllers": ["straight_lime"]}, "did you mean 'straight_line'"),
        ({"estimators": ["json:dumps"]}, "a class with build"),
        ({"trajectories": ["circel"]}, "did you mean 'circle'"),
        ({"perturbations": ["nominal1"]}, "did you mean 'nominal-1'"),
        ({"sensors": ["lengths+imu"], "driver": "quasi_static"}, "sensors: got 'lengths+imu'"),
        (
            {"driver_settings": {"wind_force": 2.0}},
            "driver_settings.wind_force: got 2.0; allowed: none",
        ),
        ({"sensors": ["lengths+swivel"]}, "robot 'carosac' has no pulleys"),
        ({"driver": PLAIN, "sensors": ["lengths+pose"]}, f"driver {PLAIN} has no choice"),
        ({"driver": PLAIN, "estimators": ["truth"]}, f"driver {PLAIN} knows no truth"),
        ({"speed_max": float("nan")}, "speed_max: got nan m/s"),
        ({"acceleration_max": -1.0}, "acceleration_max: got -1.0 m/s^2"),
        ({"speed_max": "fast"}, "speed_max: got 'fast'"),
        ({"controller_settings": {"kinematic_solver": {"gian": 1.0}}}, "did you mean 'gain'"),
        ({"controller_settings": {"kinematic_solver": {"gain": -1.0}}}, "gain: got -1.0"),
        ({"controller_settings": {"other": {}}}, "controller_settings: got 'other'"),
        (
            {"controllers": ["td3"], "controller_settings": {"td3": {"policy": "carosac-residul"}}},
            "did you mean 'carosac-residual'",
        ),
        (
            {"controllers": ["td3"], "controller_settings": {"td3": {"policy": "none.onnx"}}},
            "none.onnx: no such file",
        ),
        (
            {"controllers": ["tests.studies.tables:ModelController"]},
            "check_settings raised FileNotFoundError",
        ),
        ({"retry": ["broken"]}, "retry: got 'broken'"),
        ({"timeout": 0.0}, "timeout: got 0.0 s"),
        ({"workers": -1}, "workers: got -1"),
        ({"batch": 0}, "batch: got 0; allowed: a whole number from 1"),
    ],
)
def test_a_study_that_cannot_run_writes_nothing(changes, message, tmp_path):
    with pytest.raises(ct.CarosacError) as error:
        ct.Study(**{"output": tmp_path / "out"} | changes).run()
    assert message in str(error.value).replace('"', "'")
    assert list(tmp_path.iterdir()) == []


def test_the_table_is_the_same_for_any_number_of_workers_and_a_second_call_goes_on(tmp_path):
    one = ct.Study(**FAST, seeds=1, workers=0, output=tmp_path / "one")
    two = replace(one, seeds=2, workers=2, output=tmp_path / "two")
    one.run(progress=False)
    before = read_rows(tmp_path / "one")
    alone = replace(one, seeds=2).run(progress=False)
    assert [row["wall_time_s"] for row in alone.rows if row["seed"] == 0] == [
        row["wall_time_s"] for row in before
    ]
    shared = two.run(progress=False)
    assert without_latency(alone) == without_latency(shared)
    assert [line["failures"] for line in alone.summary] == [0, 0]
    straight, solver = (line["tracking_rmse_m"]["norm"] for line in alone.summary)
    assert solver < 0.5 * straight
    files = part_files(tmp_path / "two")
    stamps = [file.stat().st_mtime_ns for file in files]
    assert two.run(progress=False).data() == shared.data()
    assert part_files(tmp_path / "two") == files
    assert [file.stat().st_mtime_ns for file in files] == stamps


@pytest.fixture
def compiled(monkeypatch):
    """Packages of each compilation that a study asks for; none happens."""
    calls = []
    monkeypatch.setattr(study_module, "compile_kernels", lambda packages: calls.append(packages))
    return calls


def test_kernels_are_compiled_only_if_cases_are_left(tmp_path, compiled):
    alone = ct.Study(**FAST | {"driver": PLAIN}, seeds=1, workers=0, output=tmp_path / "study")
    results = alone.run(progress=False)
    assert [row["status"] for row in results.rows] == ["failed"] * 2
    finished = replace(alone, workers=2)
    for unchanged in (alone, finished, replace(finished, retry=["timed_out"])):
        unchanged.prepare()
        assert compiled == []
    more, other = replace(finished, seeds=2), replace(finished, output=tmp_path / "other")
    for count, extended in enumerate((more, other, replace(finished, retry=["failed"])), 1):
        extended.prepare()
        assert len(compiled) == count


@pytest.mark.parametrize(
    ("changes", "packages"),
    [
        ({"driver": "quasi_static"}, {"baselines", "carosac_toolkit"}),
        ({"driver": "simulator", "controllers": ["mpc"]}, {"baselines", "sim_warp"}),
        ({"driver": "quasi_static", "estimators": ["simulator"]}, {"carosac_toolkit", "sim_warp"}),
        ({"driver": "quasi_static", "estimators": ["truth"]}, {"carosac_toolkit"}),
        ({"driver": PLAIN}, {"baselines", "tests"}),
        ({"driver": "guarded"}, {"baselines", "carosac_toolkit", "sim_warp"}),
        (
            {"driver": "guarded", "driver_settings": {"driver": "quasi_static"}},
            {"baselines", "carosac_toolkit"},
        ),
    ],
)
def test_kernels_are_those_of_the_driver_and_the_estimators(tmp_path, compiled, changes, packages):
    ct.Study(**FAST | changes, seeds=1, output=tmp_path / "study").prepare()
    assert compiled == [packages]


def test_without_a_folder_another_study_gets_a_folder_of_its_own(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    first = ct.Study(**FAST | {"controllers": ["straight_line"]}, seeds=1, workers=0)
    assert [first.run(progress=False).folder.name for _ in range(2)] == ["compare"] * 2
    other = replace(first, speed_max=2.0)
    assert other.folder().name == "compare-2"
    assert replace(first, seeds=3).folder().name == "compare"


def test_on_a_recording_a_known_path_becomes_the_recorded_one_and_others_are_refused():
    study = ct.Study(driver="replay", trajectories=["circle"], perturbations=["none"], seeds=1)
    assert study.trajectories == ("recorded",)
    for wrong in (["circel"], []):
        with pytest.raises(InvalidField, match="trajector"):
            replace(study, trajectories=wrong).check()


def test_on_a_recording_nothing_is_tracked(tmp_path):
    results = ct.Study(
        driver="replay", controllers=["straight_line"], seeds=1, workers=0,
        perturbations=["none"], output=tmp_path / "out",
    ).run(progress=False)  # fmt: skip
    line = results.summary[0]
    assert line["failures"] == 0 and line["tracking_rmse_m"]["norm"] is None
    assert line["estimation_rmse_m"]["norm"] > 0.0 and line["command_rmse_m"] > 0.0
    assert "-" in terminal_table(results, 80) and conclusions(results) == []


def test_a_changed_condition_file_makes_another_study(tmp_path):
    path = tmp_path / "hall.yaml"
    path.write_text("schema: carosac-condition/1\nmass: 3 %\n")
    study = ct.Study(perturbations=[str(path)], seeds=1)
    before = [case.identity for case in study.cases()]
    path.write_text("schema: carosac-condition/1\nmass: 4 %\n")
    assert not set(before) & {case.identity for case in study.cases()}


def test_paths_are_as_fast_as_the_robot_is_large():
    line = {"trajectories": ["line"], "robots": ["carosac", "ipanema1"], "seeds": 1}
    cases = ct.Study(**line).cases()
    speed = {case.robot: case.settings["speed_max"] for case in cases}
    assert speed["carosac"] == 1.0
    assert speed["ipanema1"] == pytest.approx(np.sqrt(2.6148 / 9.1418), rel=1e-4)
    asked = ct.Study(**line, speed_max=0.7).cases()
    assert {case.settings["speed_max"] for case in asked} == {0.7}
