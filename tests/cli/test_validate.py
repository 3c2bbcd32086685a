import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import carosac_toolkit as ct
from carosac_toolkit.cli.main import main
from carosac_toolkit.recordings.bundled import find_recording, list_recordings
from carosac_toolkit.robot.file import robot_text
from tests.validation.models import NAME

pytestmark = pytest.mark.usefixtures("quick_pictures")  # tests/pictures draw them

BUNDLED = "synthetic"


@pytest.fixture(autouse=True)
def in_empty_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


@pytest.fixture(scope="module")
def short(tmp_path_factory):
    """A short piece of the bundled recording, as CSV."""
    path = tmp_path_factory.mktemp("recording") / "short.csv"
    ct.save_recording(ct.load_recording(find_recording(BUNDLED)).slice(0, 200), path)
    return path


def names(folder):
    """Names of all files, without the note by which the command knows its folder again."""
    return sorted(path.name for path in Path(folder).rglob("*") if path.name != ".carosac-results")


def test_the_contract_of_the_json_and_the_files(short, capsys):
    assert main(["validate", str(short), "--json", "x.json", "--output", "out"]) == 0
    data = json.loads(Path("x.json").read_text())
    assert data["samples"] == 200
    assert list(data["models"]) == ["straight_line", "kinematic_solver", "simulator"]
    for model in data["models"].values():
        for key in ("rmse_m", "mae_m", "max_m"):
            assert set(model[key]) == {"x", "y", "z", "norm"}
            assert all(isinstance(value, float) for value in model[key].values())
            for part in ("moving", "resting"):
                assert set(model[part][key]) == {"x", "y", "z", "norm"}
        assert model["orientation_rmse_rad"] > 0.0 and model["length_rmse_m"] > 0.0
        assert model["error"] is None and model["failures"] == 0
    pictures = ("error_violins", "length_errors", "paths", "time_series")
    assert set(names("out")) == {
        "report.html", "report_settings.json", "samples.npz",
        *(f"{name}.{end}" for name in pictures for end in ("png", "svg", "pdf")),
    }  # fmt: skip
    out = capsys.readouterr().out
    for model in data["models"].values():
        assert f"{model['rmse_m']['norm'] * 1e3:.1f}" in out
    assert max(map(len, out.splitlines())) <= 80
    assert all(f"* {line}" in " ".join(out.split()) for line in data["conclusions"])
    assert data["warnings"] == [] and data["robot_source"] == "recording"


def test_the_report_stands_alone_and_says_where_it_comes_from(short):
    assert main(["validate", str(short), "--output", "out", "--seed", "4"]) == 0
    text = Path("out/report.html").read_text()
    assert len(re.findall('src="data:image/png;base64,', text)) == 4
    assert not re.findall(r'src="(?!data:)', text) and "url(" not in text
    links = re.findall(r'href="([^"]*)"', text)
    assert len(links) == 8 and all((Path("out") / link).is_file() for link in links)
    for word in ("SYNTHETIC", "Apache-2.0", "seed", "--seed 4", "--robot carosac", ct.__version__):
        assert word in text
    assert "kinematic_solver" in text and "resting" in text


@pytest.mark.usefixtures("blank_pictures")
def test_a_second_call_replaces_the_report_and_leaves_other_files(short):
    for models in (["straight_line"], ["kinematic_solver"]):
        assert main(["validate", str(short), "--output", "out", "--models", *models]) == 0
        Path("out/mine.txt").write_text("keep")
    assert Path("out/mine.txt").read_text() == "keep"
    assert "straight_line" not in Path("out/report.html").read_text()
    assert not [name for name in names(".") if name.startswith(".")]


@pytest.mark.usefixtures("blank_pictures")
def test_the_same_call_gives_the_same_numbers(short):
    for name in ("a.json", "b.json"):
        assert main(["validate", str(short), "--json", name]) == 0
    one, other = (json.loads(Path(name).read_text()) for name in ("a.json", "b.json"))
    for model in (*one["models"].values(), *other["models"].values()):
        model.pop("median_update_s")
    assert one == other
    assert [path.name for path in Path("carosac-results/validate").iterdir()] == [
        "short-csv-carosac"
    ]


@pytest.mark.usefixtures("blank_pictures")
def test_reports_of_other_settings_go_to_other_folders(short, capsys):
    Path("sub").mkdir()
    for name in ("short.parquet", "sub/short.csv"):
        ct.save_recording(ct.load_recording(short), name)
    one = ["--models", "straight_line"]
    calls = {
        (str(short),): "short-csv-carosac",
        ("short.parquet",): "short-parquet-carosac",
        ("sub/short.csv",): "short-csv-carosac-2",
        (str(short), "--start", "20"): "short-csv-carosac-20-end",
        (str(short), "--stop", "90"): "short-csv-carosac-0-90",
        (str(short), "--robot", "scampi"): "short-csv-scampi",
        (str(short), "--seed", "1"): "short-csv-carosac-3",
        ("synthetic", "--stop", "90"): "synthetic-carosac-0-90",
    }
    for _ in range(2):
        for words, folder in calls.items():
            main(["validate", *words, *one])
            shown = " ".join(capsys.readouterr().out.split())
            assert f"report: carosac-results/validate/{folder}/report.html" in shown
    kept = [path.name for path in Path("carosac-results/validate").iterdir()]
    assert sorted(kept) == sorted(calls.values())


def test_an_implausible_recording_is_warned_of_first_and_a_negative_answer(short, capsys):
    recording = ct.load_recording(short)
    ct.save_recording(
        replace(recording, unstrained_length=1e3 * recording.unstrained_length), "mm.csv"
    )
    assert main(["validate", "mm.csv", "--models", "straight_line", "--json", "x.json"]) == 1
    out = " ".join(capsys.readouterr().out.split())
    message = "Lengths are 1000 times the distance at the measured poses: are they in mm?"
    assert out.index(f"WARNING: {message}") < out.index("RMSE")
    assert json.loads(Path("x.json").read_text())["warnings"] == [message]
    folder = Path("carosac-results/validate/mm-csv-carosac")
    assert message in (folder / "report.html").read_text()


@pytest.mark.usefixtures("blank_pictures")
def test_a_robot_file_is_looked_for_beside_the_recording_first(short, capsys):
    recording = ct.load_recording(short)
    for folder, mass in (("run", "20 kg"), (".", "30 kg")):
        text = robot_text("carosac").replace("mass: 23.655 kg", f"mass: {mass}")
        Path(folder).mkdir(exist_ok=True)
        Path(folder, "mine.yaml").write_text(text.replace("name: carosac", f"name: m{mass[:2]}"))
    named = replace(recording.metadata, robot="mine.yaml")
    ct.save_recording(replace(recording, metadata=named), "run/a.csv")
    words = ["validate", "run/a.csv", "--models", "straight_line", "--json", "x.json"]
    assert main(words) == 0
    assert json.loads(Path("x.json").read_text())["robot"] == "m20"
    Path("run/mine.yaml").unlink()
    assert main(words) == 0
    assert json.loads(Path("x.json").read_text())["robot"] == "m30"
    Path("mine.yaml").unlink()
    capsys.readouterr()
    assert main(words) == 2
    error = capsys.readouterr().err
    assert "mine.yaml: no such file" in error
    assert "the recording 'run/a.csv' names 'mine.yaml' as its robot" in error


def test_a_guessed_robot_is_said_to_be_one(short, capsys):
    recording = ct.load_recording(short)
    points = ct.load_robot("carosac").exit_points
    nameless = replace(recording.metadata, robot=None)
    ct.save_recording(replace(recording, metadata=nameless, exit_points=points), "a.csv")
    assert main(["validate", "a.csv", "--models", "straight_line", "--json", "x.json"]) == 0
    assert "robot carosac (a guess: the recording names no robot" in capsys.readouterr().out
    assert json.loads(Path("x.json").read_text())["robot_source"] == "exit points"


def test_one_sample_is_scored_and_said_to_be_too_few(short, capsys):
    ct.save_recording(ct.load_recording(short).slice(0, 1), "one.csv")
    assert main(["validate", "one.csv"]) == 0
    assert "Only 1 sample scored: too few" in " ".join(capsys.readouterr().out.split())


def test_a_failing_model_costs_its_own_row_and_is_a_negative_answer(short, capsys):
    words = ["validate", str(short), "--models", f"{NAME}:Raising", "kinematic_solver"]
    assert main([*words, "--json", "x.json"]) == 1
    captured = capsys.readouterr()
    assert f"{NAME}:Raising failed: RuntimeError: no luck" in captured.err
    data = json.loads(Path("x.json").read_text())["models"]
    assert data[f"{NAME}:Raising"]["rmse_m"]["norm"] is None
    assert data["kinematic_solver"]["rmse_m"]["norm"] > 0.0


def test_without_any_model_left_the_report_still_says_why(short):
    assert main(["validate", str(short), "--models", f"{NAME}:Raising", "--output", "out"]) == 1
    assert names("out") == ["report.html", "report_settings.json"]
    assert "RuntimeError: no luck" in Path("out/report.html").read_text()


def make_files(short):
    """Faulty inputs, by name."""
    lines = short.read_text().splitlines()
    row = next(i for i, line in enumerate(lines) if line[0].isdigit()) + 7
    cells = lines[row].split(",")
    cells[2] = "nan"
    Path("nan.csv").write_text("\n".join([*lines[:row], ",".join(cells), *lines[row + 1 :]]) + "\n")
    Path("cut.csv").write_text("\n".join(lines[:-3]) + "\n")
    Path("notes.txt").write_text("hello")
    Path("a_file").write_text("hello")
    Path("folder.csv").mkdir()
    Path("bad.yaml").write_text(robot_text("carosac").replace("mass: 23.655 kg", "mass: -1 kg"))
    header = ",".join(line for line in lines if line.startswith("time_s"))
    columns = [c for c in header.split(",") if not c.startswith(("position", "quaternion"))]
    picks = [header.split(",").index(c) for c in columns]
    body = [[line.split(",")[i] for i in picks] for line in lines[-20:]]
    Path("blind.csv").write_text("\n".join([",".join(columns), *map(",".join, body)]) + "\n")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["missing.csv"], "missing.csv: no such file"),
        (["synthetik"], "did you mean 'synthetic'"),
        (["nothing"], "RECORDING: got 'nothing'; allowed: one of ['synthetic']"),
        (["notes.txt"], "suffix"),
        (["folder.csv"], "this is a folder"),
        (["nan.csv"], "nan; allowed: a finite number"),
        (["cut.csv"], "the file is truncated"),
        (["blind.csv"], "--robot: got nothing; allowed: the recording names no robot"),
        (["blind.csv", "--robot", "carosac"], "poses: got None"),
        (["SHORT", "--robot", "carosacc"], "did you mean 'carosac'"),
        (["SHORT", "--robot", "missing.yaml"], "missing.yaml: no such file"),
        (["SHORT", "--robot", "bad.yaml"], "bad.yaml: 1 fault"),
        (["SHORT", "--robot", "ipanema1"], "a recording of another robot than 'ipanema1'"),
        (["SHORT", "--start", "50", "--stop", "50"], "stop: got 50"),
        (["SHORT", "--start", "60", "--stop", "50"], "stop: got 50"),
        (["SHORT", "--start", "200"], "start: got 200; allowed: 0 <= start < 200"),
        (["SHORT", "--start", "-1"], "start: got -1"),
        (["SHORT", "--stop", "201"], "stop: got 201"),
        (["SHORT", "--models", "kinematic_solvr"], "did you mean 'kinematic_solver'"),
        (["SHORT", "--models", "no.such.module:X"], "cannot import no.such.module"),
        (["SHORT", "--models", f"{NAME}:Unbuildable"], "something with build("),
        (["SHORT", "--models", "straight_line", "straight_line"], "each once"),
        (["SHORT", "--output", "a_file"], "--output: got 'a_file'; allowed: a folder"),
        (["SHORT", "--output", "a_file/below"], "a_file is a file"),
        (["SHORT", "--json", "no/such/x.json"], "--json: got"),
    ],
)
def test_bad_input_is_one_message_and_status_two_and_nothing_is_written(
    words, message, short, capsys
):
    make_files(short)
    before = names(".")
    words = [str(short) if word == "SHORT" else word for word in words]
    outputs = [] if "--json" in words else ["--json", "x.json"]
    assert main(["validate", *words, *outputs]) == 2
    captured = capsys.readouterr()
    assert captured.err.startswith("carosac: ") and captured.err.count("carosac: ") == 1
    assert message in captured.err
    assert captured.out == ""
    assert names(".") == before


@pytest.mark.usefixtures("blank_pictures")
def test_the_robot_of_the_real_recording_is_known_by_its_exit_points(real_data, capsys):
    for suffix in ("csv", "mat"):
        path = real_data / f"scampi_run_part.{suffix}"
        assert main(["validate", str(path), "--json", "x.json", "--start", "500"]) == 0
        data = json.loads(Path("x.json").read_text())
        assert data["robot_source"] == "exit points"
        assert data["robot"] == "scampi" and data["samples"] == 100


def test_bundled_recordings_are_small_labelled_and_found_by_name():
    assert list_recordings() == (BUNDLED,)
    path = find_recording(BUNDLED)
    assert path.stat().st_size < 300_000
    recording = ct.load_recording(path)
    assert recording.metadata.robot == "carosac"
    assert recording.metadata.description.startswith("SYNTHETIC")


def test_the_bundled_recording_is_what_its_script_makes():
    from benchmarks.make_synthetic_recording import Settings, make_recording

    kept, made = ct.load_recording(find_recording(BUNDLED)), make_recording(Settings())
    assert made.metadata.description == kept.metadata.description
    np.testing.assert_array_equal(made.time, kept.time)
    np.testing.assert_allclose(made.unstrained_length, kept.unstrained_length, atol=6e-5)
    np.testing.assert_allclose(made.poses.position, kept.poses.position, atol=3e-5)


def test_the_bundled_recording_shows_delay_and_sway():
    assert main(["validate", "synthetic", "--json", "x.json"]) == 0
    data = json.loads(Path("x.json").read_text())["models"]
    solver = data["kinematic_solver"]
    assert solver["rmse_m"]["norm"] < 0.5 * data["straight_line"]["rmse_m"]["norm"]
    assert solver["sway"]["clear"] and solver["sway"]["axis"] == "x"
    assert solver["delay_s"]["y"] == pytest.approx(0.030, abs=3e-3)
    assert solver["delay_s"]["z"] == pytest.approx(0.030, abs=3e-3)


def test_a_folder_in_the_way_of_the_report_is_named_and_nothing_is_written(tmp_path, capsys):
    (tmp_path / "out" / "report.html").mkdir(parents=True)
    (tmp_path / "out" / ".carosac-results").write_text("validate")
    words = ["synthetic", "--stop", "90", "--models", "straight_line"]
    status = main(["validate", *words, "--output", str(tmp_path / "out")])
    assert status == 2
    assert "no folder named report.html in it" in capsys.readouterr().err
    found = sorted(p.name for p in (tmp_path / "out").iterdir())
    assert found == [".carosac-results", "report.html"]
