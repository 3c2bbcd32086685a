import os
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import pytest
import tyro

from carosac_toolkit.base.errors import CarosacError, InvalidField
from carosac_toolkit.base.files import replacing
from carosac_toolkit.cli import robots
from carosac_toolkit.cli.common import CommonOptions, OutputFile, OutputFolder
from carosac_toolkit.cli.main import main
from carosac_toolkit.cli.outputs import check_outputs
from carosac_toolkit.robot.file import robot_text


@dataclass(frozen=True, kw_only=True)
class FutureOptions(CommonOptions):
    """Options of a command that is still to be written."""

    sources: tuple[str, ...] = ()
    case: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="CASE")] = "none"
    big_table: OutputFile = None
    results: OutputFolder = None


@pytest.fixture
def mine(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "h.yaml"
    path.write_text(robot_text("carosac"))
    return path


def refused(capsys, words):
    assert main(words) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert len(captured.err.splitlines()) == 1
    return captured.err


@pytest.mark.parametrize("target", ["h.yaml", "./h.yaml", "soft.json", "hard.json", "d/../h.yaml"])
def test_no_input_is_overwritten(mine, capsys, target):
    os.symlink("h.yaml", "soft.json")
    os.link("h.yaml", "hard.json")
    os.mkdir("d")
    before = mine.read_text()
    error = refused(capsys, ["check", "h.yaml", "--json", target])
    assert error == (
        f"carosac: --json: got '{Path(target)}'; allowed: another path; "
        "ROBOT is read from this one\n"
    )
    assert mine.read_text() == before


def test_a_recording_is_not_overwritten(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("mine.csv").write_text("time_s\n")
    error = refused(capsys, ["validate", "mine.csv", "--json", "mine.csv"])
    assert "RECORDING is read from this one" in error
    Path("r.yaml").write_text("x")
    error = refused(capsys, ["validate", "mine.csv", "--robot", "r.yaml", "--json", "r.yaml"])
    assert "--robot is read from this one" in error
    assert Path("mine.csv").read_text() == "time_s\n"


def test_two_outputs_are_two_files(mine, capsys):
    error = refused(capsys, ["check", "h.yaml", "--picture", "a.png", "--json", "./a.png"])
    assert "--picture: got 'a.png'; allowed: another path; --json is written to this one" in error
    assert sorted(os.listdir()) == ["h.yaml"]


def test_options_of_future_commands_are_checked_too(mine):
    check_outputs(FutureOptions(sources=("h.yaml", "carosac"), big_table=Path("t.csv")))
    with pytest.raises(InvalidField, match=r"--big-table: .*; --sources is read"):
        check_outputs(FutureOptions(sources=("h.yaml",), big_table=Path("h.yaml")))
    with pytest.raises(InvalidField, match=r"--json: .*; CASE is read"):
        check_outputs(FutureOptions(case="h.yaml", json=Path("h.yaml")))
    with pytest.raises(InvalidField, match=r"--results: .*; --json is written"):
        check_outputs(FutureOptions(json=Path("x"), results=Path("x")))
    with pytest.raises(InvalidField, match=r"--results: got 'h\.yaml/x'; .*h\.yaml is a file"):
        check_outputs(FutureOptions(results=Path("h.yaml/x")))


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["robots", "--json", "/proc/x.json"], "allowed: a path in a folder that can be written"),
        (["robots", "--json", "."], "allowed: a file, not a folder"),
        (["robots", "--json", "pipe"], "allowed: a regular file"),
        (["robots", "--json", "a/b/x.json"], "allowed: a file in an existing folder; no a/b/"),
        (["robots", "--json", "n" * 300], "File name too long"),
        (["check", "carosac", "--picture", "/proc/x.png"], "--picture: got"),
        (["validate", "synthetic", "--output", "/proc/foo"], "--output: got '/proc/foo'"),
    ],
)
def test_what_cannot_be_written_is_refused_before_any_work(mine, capsys, words, message):
    os.mkfifo("pipe")  # stands for /dev/null, which root could replace
    assert message in refused(capsys, words)
    assert sorted(os.listdir()) == ["h.yaml", "pipe"]


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_a_read_only_folder_or_file_is_refused(mine, capsys):
    os.mkdir("closed", mode=0o500)
    assert "closed/: Permission denied" in refused(capsys, ["robots", "--json", "closed/x.json"])
    mine.chmod(0o400)
    assert "read-only" in refused(capsys, ["robots", "--json", "h.yaml"])


def test_a_folder_where_no_file_can_be_made_is_refused(mine, capsys, monkeypatch):
    def denied(**_):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("tempfile.mkstemp", denied)
    monkeypatch.setattr(robots, "run", lambda _: pytest.fail("work was done"))
    assert "./: Permission denied" in refused(capsys, ["robots", "--json", "x.json"])


def test_a_disk_that_is_full_is_one_message(mine):
    with pytest.raises(CarosacError, match=r"x\.json: cannot be written: No space"):
        with replacing(mine.parent / "x.json"):
            raise OSError(28, "No space left on device")
    assert os.listdir() == ["h.yaml"]


FOLDER_COMMANDS = [
    ["compare", "--quick", "--output"],
    ["compare", "--suite", "reference", "--output"],
    ["validate", "synthetic", "--output"],
    ["workspace", "carosac", "--output"],
    ["evaluate", "carosac-no-sag", "--output"],
    ["train", "--output"],
    ["figures", "--output"],
    ["identify", "synthetic", "--report"],
    ["smooth", "synthetic", "--report"],
    ["calibrate", "lengths", "synthetic", "--report"],
]


@pytest.mark.parametrize("words", FOLDER_COMMANDS, ids=lambda words: " ".join(words))
def test_a_folder_of_others_is_refused_and_left_as_it_was(mine, capsys, words):
    os.mkdir("theirs")
    for name in ("a.txt", "report.html", "study.json", "positions.csv", "settings.json"):
        Path("theirs", name).write_text("not ours")
    error = refused(capsys, [*words, "theirs"])
    assert (
        f"{words[-1]}: got 'theirs'; allowed: a new or empty folder, or one with results" in error
    )
    assert "holds a.txt, positions.csv, report.html and 2 more" in error
    assert {path.read_text() for path in Path("theirs").iterdir()} == {"not ours"}
    assert sorted(os.listdir()) == ["h.yaml", "theirs"]


def test_a_folder_with_results_of_ours_is_taken_again(mine):
    os.mkdir("out")
    Path("out/.DS_Store").write_text("hidden files are of nobody")
    words = ["workspace", "carosac", "--points", "30", "--slice-points", "9", "--no-pictures"]
    for table in ("csv", "parquet", "csv"):
        assert main([*words, "--table", table, "--output", "out"]) == 0
    Path("out/notes.txt").write_text("mine")
    assert main([*words, "--output", "out"]) == 0
    assert Path("out/notes.txt").read_text() == "mine"


def test_a_reference_suite_that_was_interrupted_is_ours(mine):
    os.makedirs("out/tracking-carosac")
    Path("out/tracking-carosac/study.json").write_text('{"schema": "carosac-study/1"}')
    check_outputs(FutureOptions(results=Path("out")))
