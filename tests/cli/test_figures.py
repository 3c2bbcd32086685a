"""The figures of the paper from folders as the commands write them."""

import json
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.text import Text

from carosac_toolkit.cli.figures import all_figures
from carosac_toolkit.cli.main import main
from carosac_toolkit.pictures.paper import draw_commanded, length_errors
from carosac_toolkit.pictures.validation import VALIDATION_PICTURES
from carosac_toolkit.robot.file import load_robot
from carosac_toolkit.studies.run.folder import opened
from carosac_toolkit.validation import validate
from carosac_toolkit.validation.saved import SAMPLES_FILE, read_samples, samples_bytes
from learned.learning_curve import CURVE_FILE, EPISODES_FILE, Episode, write_curve, write_episodes
from learned.saved_scores import SavedScores
from learned.scores import PolicyScores
from tests.studies.tables import case, good, series, study
from tests.validation.runs import ROBOT, perfect

pytestmark = pytest.mark.usefixtures("quick_pictures")


def study_in(folder, controllers):
    """A study with the course of the first seed, as `carosac compare` keeps it."""
    cases, rows = [], []
    for scale, name in enumerate(controllers, start=1):
        for seed in range(3):
            which = case(name, seed)
            course = json.loads(series(0.01 * scale))
            course["length_error_m"] = [[0.001 * scale] * 4] * len(course["time_s"])
            text = json.dumps(course) if seed == 0 else None
            cases.append(which)
            rows.append(good(which, (0.01 * scale + 0.001 * seed, 0.01, 0.01), series=text))
    with opened(folder, cases, "some:function") as kept:
        kept.append(rows)
    return rows


def evaluation_in(folder, protocol):
    """Scores of an evaluation of three paths, of which one failed."""
    rng = np.random.default_rng(0)
    target = rng.uniform(-1.0, 1.0, size=(3, 25, 3)) + np.array([0.4, -1.8, 3.0])
    failed = np.zeros((3, 25), dtype=bool)
    failed[1, 10] = True
    scores = PolicyScores(
        target=target, position=target + 0.01 * rng.normal(size=target.shape),
        length_error=0.01 * rng.normal(size=(3, 25, 4)), inconsistency=np.zeros((3, 25)),
        length=np.ones((3, 25, 4)), tilt=np.zeros((3, 25)), tension=None, failed=failed,
        counted=np.ones((3, 25), dtype=bool),
    )  # fmt: skip
    folder.mkdir(parents=True)
    saved = SavedScores(
        policy="mine.onnx",
        protocol=protocol,
        robot=load_robot("carosac"),
        scores={"policy": scores},
    )
    saved.write(folder)
    return saved


def training_in(folder):
    """A training of one stage."""
    folder.mkdir(parents=True)
    row = dict.fromkeys(
        ("steps", "updates", "cpu_seconds", "reward", "median_error_m", "median_of_means_m",
         "p95_error_m", "rmse_m", "inconsistency_m", "failed_paths"), 0.1,
    )  # fmt: skip
    write_curve(folder / CURVE_FILE, [row | {"steps": 100.0 * k} for k in (1, 2, 3)])
    write_episodes(folder / EPISODES_FILE, [Episode(20 * k, float(k), 20) for k in range(1, 16)])


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    top = tmp_path_factory.mktemp("results")
    study_in(top / "compare", ["straight_line", "kinematic_solver", "td3"])
    evaluation_in(top / "evaluate" / "no-sag", "no-sag")
    evaluation_in(top / "evaluate" / "settle", "settle")
    for stage in ("no_sag", "sag"):
        training_in(top / "train" / "paper-seed0" / stage)
    result = validate(perfect(0.03), ROBOT, ["straight_line"])
    (top / "validate").mkdir()
    (top / "validate" / SAMPLES_FILE).write_bytes(samples_bytes(result))
    return top


def test_every_figure_of_the_paper_is_drawn_from_one_folder_above_all(folders, tmp_path, capsys):
    out, numbers = tmp_path / "figures", tmp_path / "x.json"
    words = ["figures", str(folders), "--output", str(out), "--formats", "png", "svg"]
    assert main([*words, "--json", str(numbers)]) == 0
    data = json.loads(numbers.read_text())
    assert data["skipped"] == []
    assert "none skipped" in " ".join(capsys.readouterr().out.split())
    names = [one["name"] for one in data["figures"]]
    assert names == sorted(names) and len(names) == len(all_figures()) + 1  # two stages
    assert sorted(path.name for path in out.glob("[!.]*")) == sorted(
        f"{name}.{suffix}" for name in names for suffix in ("png", "svg")
    )
    sources = {one["name"][3:]: Path(one["source"] or ".").name for one in data["figures"]}
    assert sources["error_histograms"] == sources["sample_paths"] == "no-sag"
    assert sources["trajectory_violins"] == "settle" and sources["rmse_gaussians"] == "compare"
    assert sources["simulated_and_real_path"] == "validate"


def test_the_style_of_papers_has_serif_letters_in_all_formats(folders, tmp_path, monkeypatch):
    families = set()

    def keep(figure, target, **_):
        families.update(text.get_fontfamily()[0] for text in figure.findobj(Text))
        target.write(b"x")

    monkeypatch.setattr(Figure, "savefig", keep)
    out = tmp_path / "f"
    words = ["figures", str(folders / "compare"), "--output", str(out), "--style", "paper"]
    assert main(words) == 0
    assert families == {"STIXGeneral"}
    assert {path.suffix for path in out.glob("[!.]*")} == {".png", ".svg", ".pdf"}


def test_without_a_folder_the_figures_that_need_one_are_named(tmp_path, capsys):
    assert main(["figures", "--style", "paper", "--output", str(tmp_path / "f")]) == 0
    out = " ".join(capsys.readouterr().out.split())
    assert (
        "1 figure in" in out and "No folder with results was given: carosac figures FOLDER" in out
    )
    assert "carosac compare for commanded_length_error, rmse_gaussians, error_over_time" in out


def test_one_line_names_the_commands_that_make_what_is_missing(tmp_path, capsys):
    study_in(tmp_path / "a", ["straight_line"])
    numbers = tmp_path / "x.json"
    words = ["figures", str(tmp_path / "a"), "--output", str(tmp_path / "f")]
    assert main([*words, "--json", str(numbers)]) == 0
    out = " ".join(capsys.readouterr().out.split())
    assert "2 figures in" in out and out.count("skipped") == 1
    assert "9 skipped, whose data comes from carosac compare, evaluate, train, validate" in out
    data = json.loads(numbers.read_text())
    commands = {one["name"]: one["command"] for one in data["skipped"]}
    assert commands["error_histograms"].startswith("carosac evaluate POLICY")
    assert "--controllers kinematic_solver td3" in commands["rmse_gaussians"]
    assert commands["simulated_and_real_path"].startswith("carosac validate RECORDING")
    assert commands["reward"].startswith("carosac train")


def test_the_terms_of_the_reward_are_drawn_beside_trainings_or_alone(folders, tmp_path):
    def drawn(*sources):
        numbers = tmp_path / "x.json"
        words = ["figures", *map(str, sources), "--output", str(tmp_path / "f")]
        main([*words, "--formats", "png", "--json", str(numbers)])
        return {one["name"][3:] for one in json.loads(numbers.read_text())["figures"]}

    assert "reward_terms" not in drawn(folders / "compare")
    assert "reward_terms" in drawn(folders / "train")
    assert drawn() == {"reward_terms"}


def test_the_length_error_has_the_names_of_the_cables(tmp_path):
    results = study(study_in(tmp_path / "a", ["straight_line"]))
    axes = draw_commanded(results).axes[0]
    names = [label.get_text() for label in axes.get_xticklabels()]
    assert names == list(load_robot("carosac").cable_names)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["nowhere"], "FOLDER: got 'nowhere'; allowed: a folder that is there"),
        (["empty"], "FOLDER: got 'empty'; allowed: a folder that carosac compare"),
        (["--formats", "gif"], "--formats: got 'gif'; allowed: some of ['png', 'svg', 'pdf']"),
    ],
)
def test_bad_input_is_one_message_and_writes_nothing(words, message, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("empty").mkdir()
    assert main(["figures", *words, "--output", "f"]) == 2
    assert message in capsys.readouterr().err and not Path("f").exists()


def test_a_validation_is_drawn_from_its_file_as_it_was(tmp_path):
    result = validate(perfect(0.03), ROBOT, ["straight_line"])
    (tmp_path / SAMPLES_FILE).write_bytes(samples_bytes(result))
    back = read_samples(tmp_path)
    assert back.robot.name == result.robot.name and back.rests == result.rests
    rmse = [one.models["straight_line"].scores.rmse for one in (result, back)]
    assert rmse[0] == pytest.approx(rmse[1])
    for name in ("paths", "error_violins", "length_errors"):
        first, second = VALIDATION_PICTURES[name](result), VALIDATION_PICTURES[name](back)
        for a, b in zip(first.axes, second.axes, strict=True):
            assert a.get_xlim() == pytest.approx(b.get_xlim())
            for mine, theirs in zip(a.lines, b.lines, strict=True):
                assert mine.get_xdata() == pytest.approx(theirs.get_xdata(), nan_ok=True)


def test_scores_survive_their_file(tmp_path):
    saved = evaluation_in(tmp_path / "e", "settle")
    back = SavedScores.read(tmp_path / "e")
    assert (back.policy, back.protocol) == ("mine.onnx", "settle")
    assert back.scores["policy"].tension is None
    assert (back.scores["policy"].error == saved.scores["policy"].error).all()
    assert back.robot.exit_points == pytest.approx(saved.robot.exit_points)


def test_lengths_of_the_winches_are_those_that_the_study_kept(tmp_path):
    rows = study_in(tmp_path / "a", ["straight_line", "kinematic_solver"])
    errors = {group.label: values for group, values in length_errors(study(rows))}
    assert errors["straight_line"] == pytest.approx(1e-3) and errors["straight_line"].shape[1] == 4
    assert errors["kinematic_solver"] == pytest.approx(2e-3)
