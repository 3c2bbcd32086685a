import json
import os
from html import escape
from pathlib import Path

import pytest

from carosac_toolkit.cli.main import main
from carosac_toolkit.pictures import animation
from carosac_toolkit.robot import file as robot_file
from carosac_toolkit.robot.file import robot_text
from carosac_toolkit.studies import read_rows

pytestmark = pytest.mark.usefixtures("quick_pictures")  # tests/pictures draw them

TWO = ["--controllers", "straight_line", "kinematic_solver", "--sensors", "lengths"]
FAST = ["--trajectories", "line", "--speed", "2.5", "--acceleration", "2.5", "--seeds", "1",
        "--estimators", "kinematic_solver"]  # fmt: skip
ALONE = [*FAST, "--workers", "0"]
PACKAGE = "somebodys_controllers"
SOURCE = """
import numpy as np
from carosac_toolkit.physics.cable import straight_line
from carosac_toolkit.loop.values import Command

class Good:
    period, horizon = 0.02, 0.02

    @classmethod
    def build(cls, robot, settings=None, *, seed=0):
        made = cls()
        made.robot = robot
        return made

    def reset(self, belief):
        pass

    def lengths(self, reference):
        return straight_line.inverse_kinematics(self.robot, reference.position[:, 0])

    def command(self, belief, reference):
        return Command(time=belief.time, unstrained_length=self.lengths(reference))

class Raising(Good):
    def lengths(self, reference):
        raise RuntimeError("no luck")

class Nan(Good):
    def lengths(self, reference):
        return np.nan * super().lengths(reference)

class Wrong(Good):
    def lengths(self, reference):
        return super().lengths(reference)[:, :3]

class Nothing(Good):
    def command(self, belief, reference):
        return None

class Unbuildable:
    build = None
"""


@pytest.fixture(autouse=True)
def in_empty_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


@pytest.fixture(scope="module", autouse=True)
def package(tmp_path_factory):
    """Controllers of somebody else, importable from here and from workers."""
    folder = tmp_path_factory.mktemp("installed")
    (folder / f"{PACKAGE}.py").write_text(SOURCE)
    (folder / "broken_at_import.py").write_text("1 / 0\n")
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(folder))
        yield


def names(folder="."):
    return sorted(str(path) for path in Path(folder).rglob("*"))


def test_the_contract_of_the_json_the_table_and_the_files(capsys):
    words = ["--trajectories", "line", "circle", "--speed", "2.5", "--acceleration", "2.5"]
    words += [*TWO, "--estimators", "kinematic_solver", "--seeds", "1", "--workers", "0"]
    words += ["--output", "out", "--json", "x.json"]
    assert main(["compare", *words]) == 0
    data = json.loads(Path("x.json").read_text())
    assert data["cases"] == 4
    assert [line["controller"] for line in data["summary"]] == ["straight_line", "kinematic_solver"]
    for line in data["summary"]:
        assert line["estimator"] == "kinematic_solver" and line["sensors"] == "lengths"
        assert line["robot"] == "carosac" and line["reasons"] == {}
        for key in ("tracking_rmse_m", "estimation_rmse_m"):
            assert set(line[key]) == {"x", "y", "z", "norm"}
            assert all(isinstance(value, float) for value in line[key].values())
        for key in ("tracking_std_m", "tracking_centre_m", "tracking_boundary_m",
                    "residual_sway_m", "latency_p95_s"):  # fmt: skip
            assert isinstance(line[key], float), key
        assert line["failures"] == 0 and line["cases"] == 2
    out = capsys.readouterr().out
    for line in data["summary"]:
        assert f"{line['tracking_rmse_m']['norm'] * 1e3:.1f}" in out
    assert max(map(len, out.splitlines())) <= 80
    assert "tension: of any cable, allowed 5 to 500 N" in " ".join(out.split())
    assert len([line for line in out.splitlines() if line.startswith("----")]) == 1  # one table
    assert 2 <= len(data["headlines"]) <= 3
    assert all(f"* {line}" in " ".join(out.split()) for line in data["headlines"])
    assert len(out.splitlines()) <= 22
    kinds = {path.suffix for path in Path("out").iterdir()}
    assert {".parquet", ".png", ".html", ".json", ".md", ".tex"} <= kinds
    block = data["paired"][0]
    assert block["baseline"] == "straight_line"
    pair = block["compared"][1]["against_baseline"]["tracking"]
    assert pair["cases"] == pair["scored"] == 2 and pair["difference"]["low"] is None
    report = Path("out/report.html").read_text()
    assert "against straight_line" in report and f"{pair['ratio']['value']:.2f}" in report
    assert "--trajectories line circle" in report
    assert all(escape(line, quote=False) in report for line in data["conclusions"])


def test_a_robot_in_another_unit_is_asked_for_it_before_its_cases_run(capsys):
    Path("thick.yaml").write_text(robot_text("carosac").replace("diameter: 4 mm", "diameter: 3"))
    words = [*ALONE, "--robots", "thick.yaml", "--controllers", "straight_line"]
    main(["compare", *words, "--sensors", "lengths"])
    out = " ".join(capsys.readouterr().out.split())
    assert out.index("WARNING: carosac: all cables: diameter 3000 mm") < out.index("All rows")


def test_broken_controllers_cost_their_own_cases_and_say_why(capsys):
    reasons = {
        "Raising": "RuntimeError: no luck",
        "Nan": "unstrained_length",
        "Wrong": "controller: got lengths of shape (1, 3); allowed: (1, 4)",
        "Nothing": "controller: got NoneType; allowed: a Command",
    }
    broken = [f"{PACKAGE}:{name}" for name in reasons]
    controllers = ["straight_line", *broken, f"{PACKAGE}:Good"]
    words = ["compare", *ALONE, "--controllers", *controllers, "--output", "o", "--json", "x.json"]
    assert main(words) == 1
    out = " ".join(capsys.readouterr().out.split())
    lines = json.loads(Path("x.json").read_text())["summary"]
    summary = {line["controller"]: line for line in lines}
    assert list(summary) == controllers
    report = Path("o/report.html").read_text()
    for name, reason in reasons.items():
        line = summary[f"{PACKAGE}:{name}"]
        assert line["failures"] == line["cases"] == 1
        assert line["tracking_rmse_m"]["norm"] is None
        assert reason in " ".join(line["reasons"]) and reason in out and reason in report
    for name in ("straight_line", f"{PACKAGE}:Good"):
        assert summary[name]["failures"] == 0 and summary[name]["tracking_rmse_m"]["norm"] > 0.0


@pytest.mark.usefixtures("blank_pictures")
def test_somebody_elses_controller_runs_on_workers_as_in_this_process(capsys):
    words = ["compare", *FAST, "--controllers", f"{PACKAGE}:Good", f"{PACKAGE}:Raising"]
    tables = []
    for workers in ("0", "2"):
        out = ["--workers", workers, "--output", workers, "--json", f"{workers}.json"]
        assert main([*words, *out]) == 1
        summary = json.loads(Path(f"{workers}.json").read_text())["summary"]
        tables.append(
            [{k: x for k, x in row.items() if not k.startswith("latency")} for row in summary]
        )
    assert tables[0] == tables[1]
    assert tables[0][0]["failures"] == 0 and tables[0][1]["failures"] == 1


@pytest.mark.usefixtures("blank_pictures")
def test_a_second_call_goes_on_and_another_study_is_refused(capsys):
    words = ["compare", *ALONE, "--controllers", "straight_line"]
    assert main([*words, "--output", "o"]) == 0
    first = read_rows("o")
    assert main([*words, "--output", "o"]) == 0
    assert read_rows("o") == first
    before = names()
    assert main([*words, "--speed", "2", "--output", "o"]) == 2
    assert "o holds another study" in capsys.readouterr().err
    assert names() == before
    for _ in range(2):
        assert main(words) == 0
    assert main([*words, "--acceleration", "2"]) == 0
    assert sorted(os.listdir("carosac-results")) == ["compare", "compare-2"]


@pytest.mark.usefixtures("blank_pictures")
def test_the_seed_moves_the_draws_and_their_pictures():
    numbers = []
    for seed in ("0", "7"):
        words = ["--controllers", "straight_line", "--seed", seed, "--json", "x.json"]
        assert main(["compare", *ALONE, *words, "--output", seed]) == 0
        summary = json.loads(Path("x.json").read_text())["summary"]
        numbers.append(summary[0]["tracking_rmse_m"]["norm"])
        assert Path(seed, "paths.png").exists()
        assert read_rows(seed)[0]["series"]
    assert numbers[0] != numbers[1]
    assert "--seed 7" in Path("7/report.html").read_text()


@pytest.mark.usefixtures("blank_pictures")
def test_settings_and_variants_of_one_plug_in(capsys):
    names = ["kinematic_solver", "kinematic_solver@slow"]
    chosen = ["--set", "controller.kinematic_solver@slow.delay=0", "--set",
              "driver.sensors.encoder_bias=0.0"]  # fmt: skip
    words = [*ALONE, "--controllers", *names, *chosen, "--output", "o", "--json", "x.json"]
    assert main(["compare", *words]) == 0
    rows = {row["controller"]: json.loads(row["settings"]) for row in read_rows("o")}
    assert rows["kinematic_solver@slow"]["controller_settings"] == {"delay": 0}
    assert "controller_settings" not in rows["kinematic_solver"]
    assert all(x["driver_settings"] == {"sensors": {"encoder_bias": 0.0}} for x in rows.values())
    usual, slow = json.loads(Path("x.json").read_text())["summary"]
    assert slow["tracking_rmse_m"]["norm"] != usual["tracking_rmse_m"]["norm"]
    report = Path("o/report.html").read_text()
    assert "--set controller.kinematic_solver@slow.delay=0" in report


def test_an_option_of_many_values_comes_once(capsys):
    assert main(["compare", *ALONE, "--estimators", "straight_line"]) == 2
    assert "--estimators: got 2 times; allowed: one --estimators with all" in (
        capsys.readouterr().err
    )


def test_estimators_are_compared(capsys):
    words = [*FAST, "straight_line", "--workers", "0", "--controllers", "kinematic_solver",
             "--output", "o", "--json", "x.json"]  # fmt: skip
    assert main(["compare", *words]) == 0
    data = json.loads(Path("x.json").read_text())
    assert data["conclusions"][0].startswith("The estimation error of straight_line is")
    for line in data["summary"]:
        assert 0.0 < line["orientation_rmse_rad"] < 1.0
        assert line["nees_pose"] is line["nis"] is None
    assert "NEES" not in capsys.readouterr().out
    assert Path("o/estimation.png").exists()


def test_the_quick_preset_is_a_part_of_the_whole():
    from carosac_toolkit.cli.compare import Options, _study

    quick, whole = (_study(Options(quick=flag))[0].cases() for flag in (True, False))
    assert len(quick) == 10 and set(quick) < set(whole)
    assert len(_study(Options(quick=True, seeds=3))[0].cases()) == 15


@pytest.mark.usefixtures("blank_pictures")
def test_the_default_study_is_one_table_with_tensions_and_sway_and_an_animation(
    capsys, monkeypatch
):
    monkeypatch.setattr(animation, "FRAMES_PER_SECOND", 1)
    words = ["--seeds", "1", "--workers", "0", "--output", "o", "--animation", "kinematic_solver"]
    assert main(["compare", *words, "mpc", "td3", "--json", "x.json"]) == 0
    out = capsys.readouterr().out
    head = next(line for line in out.splitlines() if line.startswith("controller"))
    assert all(name in head for name in ("track", "sway", "tension", "slack", "limit", "cases"))
    assert len(out.splitlines()) <= 22 and max(map(len, out.splitlines())) <= 80
    assert "report and animation.webp: o/report.html" in out
    data = json.loads(Path("x.json").read_text())
    lines = {line["controller"]: line for line in data["summary"]}
    assert list(lines) == ["straight_line", "kinematic_solver", "input_shaping", "mpc", "td3"]
    errors = {name: line["tracking_rmse_m"]["norm"] for name, line in lines.items()}
    assert errors["mpc"] < 0.05 * errors["kinematic_solver"]
    assert errors["td3"] < 0.15 * errors["kinematic_solver"]
    assert lines["mpc"]["residual_sway_m"] < 0.03 * lines["kinematic_solver"]["residual_sway_m"]
    assert lines["mpc"]["slack_share"] == lines["mpc"]["limited_share"] == 0.0
    assert len(data["headlines"]) == 3
    assert Path("o/animation.webp").stat().st_size < 3e6


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        ([*ALONE, "--controllers", "kinematic_solver", f"{PACKAGE}:Raising", "--animation",
          "kinematic_solver", f"{PACKAGE}:Raising"], f"no run of {PACKAGE}:Raising has poses"),
        (["--driver", "replay", "--controllers", "straight_line", "--seeds", "1", "--workers", "0",
          "--animation", "straight_line"], "no run of straight_line has poses"),
    ],
)  # fmt: skip
@pytest.mark.usefixtures("blank_pictures")
def test_an_animation_that_cannot_be_drawn_costs_nothing_else(words, reason, capsys):
    status = main(["compare", *words, "--output", "o", "--json", "x.json"])
    captured = capsys.readouterr()
    data = json.loads(Path("x.json").read_text())
    assert status == (1 if any(line["failures"] for line in data["summary"]) else 0)
    assert f"animation left out: {reason}" in " ".join(captured.out.split())
    assert captured.err.count("carosac: ") == 0
    assert {"o/report.html", "o/tables.md", "o/tables.tex", "o/statistics.json"} <= set(names("o"))
    assert not Path("o/animation.webp").exists() and "report: o/report.html" in captured.out


@pytest.mark.usefixtures("blank_pictures")
def test_a_controller_that_is_left_out_is_told(capsys):
    words = ["--robot", "desktop", "--seeds", "1", "--workers", "0", "--json", "x.json"]
    main(["compare", *words])
    assert "td3 is left out. robot: got 'desktop'; allowed: a robot with a bundled policy" in (
        " ".join(capsys.readouterr().out.split())
    )
    assert len(json.loads(Path("x.json").read_text())["summary"]) == 4


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--controllers", "straight_lin"], "did you mean 'straight_line'"),
        (["--controllers", "no.such.module:X"], "cannot import no.such.module"),
        (["--controllers", "broken_at_import:X"], "its import raised ZeroDivisionError"),
        (["--controllers", f"{PACKAGE}:Goood"], "did you mean 'Good'"),
        (["--controllers", f"{PACKAGE}:Unbuildable"], "a class with build("),
        (["--controllers", "straight_line", "straight_line"], "different values"),
        (["--estimators", "kinematic_solvr"], "did you mean 'kinematic_solver'"),
        (["--estimator", "json:loads"], "a class with build("),
        (["--set", "gain=1"], "--set: got 'gain=1'; allowed: controller.NAME.FIELD=VALUE"),
        (["--set", "controller.mpc.gain=1"], "carosac: --set controller.mpc: got 'gain'"),
        (["--set", "controller.slow.gain=1"], "with a NAME of ['straight_line', 'kinematic"),
        (["--set", "controller.kinematic_solver.gian=1"], "did you mean 'gain'"),
        (["--set", "controller.kinematic_solver.gain=-1"], "gain: got -1 1/s"),
        (
            ["--set", "driver.sensors.encoder_bais=0"],
            "--set driver.sensors.encoder_bais: got 0; allowed: one of",
        ),
        (["--set", "driver.suite=lengths"], "--set driver.suite: got 'lengths'; allowed: none"),
        (["--set", "driver.wind=NaN"], "--set: got 'driver.wind=NaN'; allowed: finite numbers"),
        (["--baseline", "nobody"], "--baseline: got 'nobody'; allowed: one of ['straight_line'"),
        (["--against", "."], "--against: got '.'; allowed: nothing without --suite"),
        (["--estimators", "truthh"], "did you mean 'truth'?"),
        (["--sensors", "lenghts"], "--sensors: got 'lenghts'"),
        (["--sensors", "lengths+imu", "--driver", "quasi_static"], "no inertia"),
        (["--trajectories", "spirall"], "did you mean 'spiral'"),
        (["--perturbations", "nominal-3"], "did you mean 'nominal-"),
        (["--conditions", "nominal-3"], "--conditions: got 'nominal-3'"),
        (["--robot", "carosak"], "did you mean 'carosac'"),
        (["--robots", "missing.yaml"], "missing.yaml: no such file"),
        (["--driver", "quasistatic"], "did you mean 'quasi_static'"),
        (["--driver", "simulater"], "did you mean 'simulator'"),
        (["--seeds", "0"], "--seeds: got 0; allowed: 1 or more"),
        (["--seeds", "many"], "a whole number"),
        (["--seed", "-1"], "--seed: got -1"),
        (["--speed", "0"], "carosac: --speed: got 0.0 m/s; allowed: --speed > 0, finite"),
        (["--speed", "nan"], "carosac: --speed: got nan m/s"),
        (["--acceleration", "-2"], "carosac: --acceleration: got -2.0"),
        (["--timeout", "0"], "carosac: --timeout: got 0.0 s"),
        (["--workers", "-2"], "carosac: --workers: got -2"),
        (["--retry", "lost"], "carosac: --retry: got 'lost'"),
        (["--scheduler", "nowhere"], "carosac: --scheduler: got 'nowhere'"),
        (["--scheduler", "tcp://127.0.0.1:1", "--workers", "2"], "no number of workers"),
        (["--output", "a_file"], "--output: got 'a_file'; allowed: a folder"),
        (["--output", "a_file/below"], "a_file is a file"),
        (["--json", "no/such/x.json"], "--json: got"),
        (
            ["--controllers", "straight_line,mpc"],
            "--controllers: got 'straight_line,mpc'; allowed: names with spaces between them: "
            "--controllers straight_line mpc",
        ),
        (["--robot=carosak"], "carosac: --robot: got 'carosak'; allowed: one of"),
        (["--controller", "nobody"], "carosac: --controller: got 'nobody'; allowed: one of"),
        (["--quik"], "did you mean '--quick'"),
        (["--animation", "mcp"], "--animation: got 'mcp'; allowed: of the study"),
    ],
)
def test_bad_input_is_one_message_and_status_two_and_nothing_is_written(words, message, capsys):
    Path("a_file").write_text("hello")
    before = names()
    outputs = [] if "--json" in words else ["--json", "x.json"]
    assert main(["compare", *words, *outputs]) == 2
    captured = capsys.readouterr()
    assert captured.err.startswith("carosac: ") and captured.err.count("carosac: ") == 1
    assert message in captured.err.replace('"', "'")
    assert captured.out == ""
    assert names() == before


PATH_ROWS = "0,0.4,-1.8,2.2\n1,0.6,-1.8,2.2\n2,0.4,-1.8,2.2\n"
PATH_HEADER = "time_s,position_x_m,position_y_m,position_z_m\n"


def test_a_path_of_the_user_is_run_and_its_study_viewed_from_anywhere(
    tmp_path, monkeypatch, capsys
):
    Path("paths").mkdir()
    Path("paths/mine.csv").write_text(PATH_HEADER + PATH_ROWS)
    words = ["compare", "--trajectories", "paths/mine.csv", "--seeds", "2", "--workers", "0"]
    words += ["--controllers", "kinematic_solver", "--driver", "quasi_static", "--output", "out"]
    assert main(words) == 0
    out = capsys.readouterr().out
    assert "paths/mine.csv as fast as the file says, 2 seeds, in all 2 cases" in " ".join(
        out.split()
    )
    (copy,) = Path("out/trajectories").iterdir()
    assert copy.name.startswith("mine-") and copy.read_text() == PATH_HEADER + PATH_ROWS
    assert f"trajectories/{copy.name}" in Path("out/report.html").read_text()
    rows = read_rows("out")
    assert {row["trajectory"] for row in rows} == {"paths/mine.csv"}
    assert not {"speed_max", "acceleration_max"} & set(json.loads(rows[0]["settings"]))
    Path("elsewhere").mkdir()
    Path("paths/mine.csv").unlink()
    monkeypatch.chdir("elsewhere")
    assert main(["view", "../out", "--html", "run.html"]) == 0

    monkeypatch.chdir("..")
    Path("paths/mine.csv").write_text(PATH_HEADER + PATH_ROWS.replace("0.6", "0.7"))
    assert main(words) == 2  # another path under the same name is another study
    assert "holds another study" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (
            ["high.csv"],
            "high.csv: line 3, column 'position_z_m': got 6 m; allowed: 1 m to 5 m, the",
        ),
        (["none.csv"], "none.csv: no such file; a trajectory is a .csv, or a recording"),
        (["high.csv", "--speed", "2"], "--speed: got 2.0 m/s; allowed: none: all trajectories"),
        (["circel"], "or ./FOLDER with one; did you mean 'circle'?"),
    ],
)
def test_bad_paths_are_refused_before_any_work(words, message, capsys):
    Path("high.csv").write_text(f"{PATH_HEADER}0,0.4,-1.8,2.2\n2,0.4,-1.8,6\n")
    assert main(["compare", "--output", "out", "--trajectories", *words]) == 2
    assert message in capsys.readouterr().err
    assert names() == ["high.csv"]


def write_path(file, rows):
    """Write a path; rows of time [s] and of metres from a place in the box of `carosac`."""
    lines = [f"{t},{x},{y - 0.8},{z + 2.5}" for t, x, y, z in rows]
    file.write_text("\n".join(["time_s,position_x_m,position_y_m,position_z_m", *lines]) + "\n")
    return str(file)


def test_a_robot_goes_by_the_name_in_its_file(capsys):
    text = (Path(robot_file.__file__).parent / "bundled" / "desktop.yaml").read_text()
    slow = text.replace("speed_max: 1.5 m/s", "speed_max: 0.2 m/s")
    Path("mine.yaml").write_text(slow.replace("name: desktop", "name: labrig"))
    words = ["compare", "--robots", "mine.yaml", "desktop", *TWO, "--driver", "quasi_static"]
    words += ["--trajectories", "line", "--estimators", "kinematic_solver", "--seeds", "1"]
    assert main([*words, "--workers", "0", "--output", "o"]) != 2
    out = " ".join(capsys.readouterr().out.split())
    assert "labrig, desktop on driver quasi_static" in out
    assert "WARNING: line is not feasible on labrig: " in out
    report = Path("o/report.html").read_text()
    before_settings = report.partition("<h2>Settings</h2>")[0]
    assert "labrig, condition" in before_settings and "mine.yaml" not in before_settings
    assert "mine.yaml" not in out.replace("carosac workspace mine.yaml", "")


@pytest.mark.parametrize("driver", ["simulator", "quasi_static"])
def test_a_robot_that_cannot_rest_is_refused_before_the_run(capsys, driver):
    text = (Path(robot_file.__file__).parent / "bundled" / "desktop.yaml").read_text()
    limits = "tension_limits: {min: 0.05 N, max: 10 N}"
    assert limits in text
    weak = text.replace(limits, "tension_limits: {min: 0.05 N, max: 0.3 N}")
    Path("mine.yaml").write_text(weak.replace("name: desktop", "name: labrig"))
    words = ["compare", "--robot", "mine.yaml", "--driver", driver, *ALONE]
    assert main([*words, "--controllers", "straight_line"]) == 2
    error = capsys.readouterr().err
    assert "robot: got 'labrig'; allowed: a robot that can rest at home, (0, 0, 0.25) m" in error
    assert "no tensions within the limits found; carosac check mine.yaml says more" in error
    assert not Path("carosac-results").exists()


def test_a_path_that_bends_away_from_its_rows_is_told_before_the_run(tmp_path, capsys):
    path = write_path(tmp_path / "turned.csv", [(0, 0.5, 0, 0), (4, 0, 0.5, 0), (8, -0.5, 0, 0)])
    words = ["compare", *TWO, "--estimators", "kinematic_solver", "--seeds", "1", "--workers", "0"]
    assert main([*words, "--trajectories", path, "--output", str(tmp_path / "o")]) == 0
    text = " ".join(capsys.readouterr().out.split())
    assert "NOTE: turned.csv: between lines " in text and "m from the straight line" in text


def test_a_trajectory_that_looks_like_a_file_is_missed_as_a_file(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_path(Path("path.csv"), [(0, 0, 0, 0), (4, 0.5, 0, 0)])
    Path("path.txt").write_text("x")
    for name, message in (
        ("path.cvs", "path.cvs: no such file; a trajectory is a file with suffix .parquet"),
        ("./pth.csv", "pth.csv: no such file; a trajectory is a .csv, or a recording or"),
        ("path.txt", "path.txt: 1 fault suffix: got '.txt'; allowed: .parquet, .csv"),
    ):
        assert main(["compare", *TWO, "--trajectories", name]) == 2
        text = " ".join(capsys.readouterr().err.split())
        assert message in text
        assert name == "path.txt" or "did you mean 'path.csv'?" in text
