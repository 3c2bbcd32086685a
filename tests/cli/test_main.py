import json
import os
import subprocess
import sys
import time

import pytest

from carosac_toolkit import __version__
from carosac_toolkit.cli.main import main
from carosac_toolkit.robot.file import load_robot, robot_text

HEAVY = {"warp", "matplotlib", "pyarrow", "scipy", "pydantic", "numpy", "tyro", "yaml"}


def run_python(program):
    return subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)


def test_help_lists_the_commands_and_imports_nothing_heavy():
    program = (
        "import sys\n"
        "from carosac_toolkit.cli.main import main\n"
        "assert main(['--help']) == 0\n"
        f"print('heavy:', sorted({HEAVY!r} & set(sys.modules)))\n"
    )
    done = run_python(program)
    assert done.returncode == 0, done.stderr
    assert "heavy: []" in done.stdout
    lines = [line.split() for line in done.stdout.splitlines()]
    assert ["check", "Check", "a"] in [line[:3] for line in lines]
    assert ["robots", "List", "the"] in [line[:3] for line in lines]
    assert ["calibrate", "tachymeter", "Measure"] in [line[:3] for line in lines]
    assert ["identify", "Fit", "the"] in [line[:3] for line in lines]


def test_help_takes_under_half_a_second_of_processor_time():
    before = os.times()
    for _ in range(2):
        subprocess.run(
            [sys.executable, "-m", "carosac_toolkit.cli.main", "--help"],
            capture_output=True, check=True,
        )  # fmt: skip
    after = os.times()
    spent = (after.children_user - before.children_user) + (
        after.children_system - before.children_system
    )
    assert spent / 2 < 0.5


def test_version_is_printed(capsys):
    assert main(["--version"]) == 0
    assert capsys.readouterr().out.strip() == f"carosac {__version__}"


def test_no_command_shows_the_help_and_is_bad_input(capsys):
    assert main([]) == 2
    assert "usage: carosac COMMAND" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["chek"], "did you mean 'check'"),
        (["check", "carosacc"], "did you mean 'carosac'"),
        (["check", "missing.yaml"], "no such file"),
        (["check", "1" * 5000 + ".yaml"], "File name too long"),
        (["robots", "--json", "/no/such/folder/x.json"], "--json: got"),
        (["check", "carosac", "--picture", "/no/such/folder/x.png"], "--picture: got"),
        (["check", "carosac", "--picture", "x.gif"], "ending in .png"),
        (["calibrate", "lenths"], "'calibrate': got 'lenths'; allowed: guide, lengths, "),
        (["calibrate", "lenths"], "did you mean 'lengths'"),
        (["calibrate", "--json", "x.json"], "command after 'calibrate': got '--json'"),
        (["calibrat", "lengths"], "did you mean 'calibrate lengths'"),
        (["identfy"], "did you mean 'identify'"),
        (["check."], "command: got 'check.'; allowed: "),
        (["nothing."], "command: got 'nothing.'; allowed: "),
    ],
)
def test_bad_input_is_one_message_and_status_two(capsys, words, message):
    assert main(words) == 2
    captured = capsys.readouterr()
    assert captured.err.startswith("carosac: ")
    assert message in captured.err
    assert captured.out == ""


@pytest.mark.parametrize(("words", "status"), [([], 2), (["--help"], 0), (["-h"], 0)])
def test_a_group_of_commands_lists_its_own(capsys, words, status):
    assert main(["calibrate", *words]) == status
    out = capsys.readouterr().out
    assert out.startswith("usage: carosac calibrate COMMAND")
    assert "  calibrate lengths     " in out and "  calibrate tachymeter  " in out
    assert "  check" not in out


@pytest.mark.parametrize(
    "command",
    [
        "calibrate lengths", "calibrate tachymeter", "check", "compare", "identify", "robots",
        "validate",
    ],
)  # fmt: skip
def test_every_command_has_help_and_the_common_options(capsys, command):
    with pytest.raises(SystemExit) as stopped:
        main([*command.split(), "--help"])
    assert not stopped.value.code
    text = capsys.readouterr().out
    assert "--json FILE" in text and "--seed INT" in text
    assert f"usage: carosac {command} " in text


def test_bad_robot_file_leaves_no_output(tmp_path, capsys):
    (tmp_path / "bad.yaml").write_text("schema: carosac-robot/1\n")
    words = ["check", str(tmp_path / "bad.yaml"), "--json", str(tmp_path / "out.json")]
    assert main([*words, "--picture", str(tmp_path / "out.png")]) == 2
    assert "platform: missing" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["bad.yaml"]


def test_output_into_a_closed_pipe_is_quiet():
    done = subprocess.run(
        f"'{sys.executable}' -m carosac_toolkit.cli.main robots | true",
        shell=True, capture_output=True, text=True,
    )  # fmt: skip
    assert done.stderr == ""


def test_json_holds_the_numbers_that_are_printed(tmp_path, capsys):
    start = time.time()
    assert main(["robots", "--json", str(tmp_path / "robots.json")]) == 0
    data = json.loads((tmp_path / "robots.json").read_text())
    assert [robot["name"] for robot in data["robots"]] == [
        "carosac",
        "cogiro",
        "desktop",
        "hangprinter",
        "ipanema1",
        "scampi",
        "stadium",
        "warehouse",
    ]
    assert data["robots"][0]["mass_kg"] == 23.655
    out = capsys.readouterr().out
    assert all(robot["name"] in out for robot in data["robots"])
    assert (tmp_path / "robots.json").stat().st_mtime >= start - 1.0
    assert [path.name for path in tmp_path.iterdir()] == ["robots.json"]


def test_a_bundled_robot_is_copied_to_a_new_file_that_loads(tmp_path, capsys):
    path = tmp_path / "mine.yaml"
    assert main(["robots", "--copy", "desktop", str(path)]) == 0
    assert f"carosac check {path}" in capsys.readouterr().out
    assert path.read_text() == robot_text("desktop")
    assert load_robot(path).mass == load_robot("desktop").mass
    path.write_text("mine")
    assert main(["robots", "--copy", "scampi", str(path)]) == 2
    assert "a new file; this one exists" in capsys.readouterr().err
    assert path.read_text() == "mine"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["desktob", "x.yaml"], "'desktob'; allowed: a bundled robot, of carosac"),
        (["desktop"], "--copy: got 'desktop'; allowed: two words: NAME FILE"),
        (["desktop", "x.txt"], "allowed: a file name ending in .yaml or .yml"),
        (["desktop", "no/x.yaml"], "allowed: a file in an existing folder; no no/"),
    ],
)
def test_a_copy_that_cannot_be_made_is_one_message(words, message, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["robots", "--copy", *words]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert message in line and list(tmp_path.iterdir()) == []
