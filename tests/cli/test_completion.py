"""Completion in real shells, and what it is made of held against the options that are parsed."""

import dataclasses
import os
import pty
import select
import shutil
import subprocess
import sys

import pytest
import tyro

import carosac_toolkit as ct
from carosac_toolkit.cli.main import main
from carosac_toolkit.cli.option_source import MANY_WORDS, read_names, read_options, read_stems
from carosac_toolkit.drivers.sensors import SENSOR_SUITES
from carosac_toolkit.loop import plugins
from carosac_toolkit.robot.perturbations import CONDITIONS_BY_NAME
from carosac_toolkit.trajectories import TRAJECTORY_NAMES
from learned import list_policies

EXPECTED = [  # words, and some of what completes the last one
    (["che"], {"check"}),
    (["ca"], {"calibrate"}),
    (["calibrate", ""], {"lengths", "tachymeter"}),
    (["check", "sc"], {"scampi"}),
    (["check", "--ro"], {"--robot"}),
    (["check", "--robot", "ipa"], {"ipanema1"}),
    (["run", "--trajectory", "sp"], {"spiral"}),
    (["compare", "--controllers", "mpc", "kin"], {"kinematic_solver"}),
    (["compare", "--controllers", "mpc", "--estima"], {"--estimators"}),
    (["compare", "--baseline", "kin"], {"kinematic_solver"}),
    (["compare", "--animation", "mpc", "kin"], {"kinematic_solver"}),
    (["compare", "--sensors", "lengths+i"], {"lengths+imu", "lengths+imu+pose"}),
    (["workspace", "--model", "st"], {"straight"}),
    (["calibrate", "lengths", "--repo"], {"--report"}),
    (["validate", "syn"], {"synthetic"}),
    (["completion", ""], {"bash", "zsh", "fish"}),
    (["train", "--preset", ""], {"paper", "carosac", "residual"}),
    (["evaluate", "carosac-"], {"carosac-no-sag", "carosac-residual", "carosac-settle"}),
]
ALL_COMMANDS = sorted(plugins.names("commands"))


@pytest.fixture(scope="module")
def scripts(tmp_path_factory):
    folder = tmp_path_factory.mktemp("completion")
    for shell in ("bash", "zsh", "fish"):
        done = subprocess.run(
            [sys.executable, "-m", "carosac_toolkit.cli.main", "completion", shell],
            capture_output=True, text=True, check=True,
        )  # fmt: skip
        (folder / shell).write_text(done.stdout)
    return folder


def shell(name):
    path = shutil.which(name)
    if path is None:
        pytest.skip(f"no {name} on this machine")
    return path


def complete_in_bash(script, words, folder):
    program = (
        f"source '{script}'; COMP_WORDS=(carosac \"$@\"); COMP_CWORD=$#; "
        "_carosac; printf '%s\\n' \"${COMPREPLY[@]}\""
    )
    done = subprocess.run(
        [shell("bash"), "--norc", "-c", program, "bash", *words],
        capture_output=True, text=True, cwd=folder,
    )  # fmt: skip
    assert done.stderr == ""
    found = done.stdout.splitlines()
    assert len(found) == len(set(found))
    return set(found)


@pytest.mark.parametrize(("words", "wanted"), EXPECTED)
def test_bash_completes(scripts, tmp_path, words, wanted):
    found = complete_in_bash(scripts / "bash", words, tmp_path)
    assert wanted <= found
    assert all(word.startswith(words[-1]) for word in found)


def test_bash_completes_files_of_the_right_kind(scripts, tmp_path):
    for name in ("mine.yaml", "mine.png", "mine.csv"):
        (tmp_path / name).touch()
    (tmp_path / "minerals").mkdir()
    assert complete_in_bash(scripts / "bash", ["check", "mi"], tmp_path) == {
        "mine.yaml", "minerals"
    }  # fmt: skip
    assert "mine.csv" in complete_in_bash(scripts / "bash", ["validate", "mi"], tmp_path)
    assert complete_in_bash(
        scripts / "bash", ["check", "x", "--picture", "mine.p"], tmp_path
    ) == {"mine.png"}  # fmt: skip
    assert complete_in_bash(scripts / "bash", ["workspace", "--robot", "=", "sc"], tmp_path) == {
        "scampi"
    }


def test_bash_takes_names_of_files_as_they_are(scripts, tmp_path):
    """A name that is a pattern of others stands once, and so do the others."""
    for name in ("* folder", "m folder"):
        (tmp_path / name).mkdir()
    for name in ("*.yaml", "m.yaml"):
        (tmp_path / name).touch()
    folders = {"* folder", "m folder"}
    for words, wanted in (
        (["figures", ""], folders),
        (["import", "recording", "x", "--definitions", ""], folders),
        (["check", "x", "--picture", ""], folders | {"*.yaml", "m.yaml"}),
        (["compare", "--conditions", "m"], {"m folder", "m.yaml"}),
    ):
        assert wanted <= complete_in_bash(scripts / "bash", words, tmp_path)


@pytest.mark.parametrize(("words", "wanted"), EXPECTED)
def test_fish_completes(scripts, tmp_path, words, wanted):
    program = f"source '{scripts / 'fish'}'; complete -C 'carosac {' '.join(words)}'"
    done = subprocess.run(
        [shell("fish"), "--no-config", "-c", program],
        capture_output=True, text=True, cwd=tmp_path,
    )  # fmt: skip
    assert wanted <= {line.partition("\t")[0] for line in done.stdout.splitlines()}
    assert done.stderr == ""


def test_zsh_completes(scripts, tmp_path):
    """A zsh in a terminal of its own: a function notes what a line holds after a tab."""
    lines = [
        "PS1= PROMPT_EOL_MARK=; autoload -Uz compinit; compinit -D -u",
        f"eval \"$(cat '{scripts / 'zsh'}')\"",
        f"carosac() {{ print -r -- $* >> '{tmp_path / 'words'}' }}",
        "carosac che\t",
        "carosac calibrate len\t",
        "carosac check --robot sc\t",
        "carosac compare --controllers mpc kin\t",
        "carosac run --traj\t",
        "carosac compare --baseline kin\t",
        "carosac compare --animation kin\t",
        "exit",
    ]
    master, slave = pty.openpty()
    process = subprocess.Popen(
        [shell("zsh"), "-f", "-i"], stdin=slave, stdout=slave, stderr=slave, cwd=tmp_path,
        start_new_session=True, env=os.environ | {"TERM": "dumb"},
    )  # fmt: skip
    os.close(slave)
    shown = b""
    try:
        for line in lines:
            os.write(master, f"{line}\n".encode())
            while select.select([master], [], [], 0.5)[0]:
                shown += os.read(master, 65536)
        assert process.wait(timeout=30) == 0
    except OSError:  # the terminal is gone as zsh has ended
        process.wait(timeout=30)
    finally:
        process.kill()
        os.close(master)
    assert (tmp_path / "words").read_text().splitlines() == [
        "check", "calibrate lengths", "check --robot scampi",
        "compare --controllers mpc kinematic_solver", "run --trajectory",
        "compare --baseline kinematic_solver", "compare --animation kinematic_solver",
    ], shown.decode()  # fmt: skip


@pytest.mark.parametrize("name", ["bash", "zsh", "fish"])
def test_scripts_are_sound_and_name_every_command(scripts, name):
    checked = subprocess.run([shell(name), "-n", scripts / name], capture_output=True, text=True)
    assert (checked.returncode, checked.stderr) == (0, "")
    text = (scripts / name).read_text()
    assert all(command.rpartition(".")[2] in text for command in ALL_COMMANDS)


@pytest.mark.filterwarnings("ignore:get_parser:DeprecationWarning")
@pytest.mark.parametrize("command", ALL_COMMANDS)
def test_options_read_from_source_are_those_that_are_parsed(command):
    """The parser of the command line takes the same spellings, and as many words of each."""
    module = plugins.load("commands", command)
    parser = tyro.extras.get_parser(module.Options)
    parsed = {}
    for action in parser._actions:
        for flag in action.option_strings:
            parsed[flag] = action.nargs
    found = {}
    for option in read_options(module.__name__):
        for flag in option.flags:
            found[flag] = option.words
    assert set(found) == set(parsed)
    for flag, words in found.items():
        if words == MANY_WORDS:
            assert parsed[flag] in ("*", "+")
        elif words == 0:
            assert parsed[flag] in (0, None)
    fields = [item.name for item in dataclasses.fields(module.Options)]
    assert [option.field for option in read_options(module.__name__)][1:] == fields


def test_names_read_from_source_are_those_there_are():
    assert read_names("carosac_toolkit.drivers.sensors", "SENSOR_SUITES") == SENSOR_SUITES
    paths = read_names("carosac_toolkit.trajectories.catalogue", "_TRAJECTORY_BUILDERS")
    assert paths == TRAJECTORY_NAMES
    conditions = read_names("carosac_toolkit.robot.perturbations", "CONDITIONS_BY_NAME")
    assert conditions == tuple(CONDITIONS_BY_NAME)
    assert read_stems("learned", "policies", ".onnx") == list_policies()
    assert "carosac" in ct.list_robots()


def test_completion_imports_no_command():
    program = (
        "import sys\nfrom carosac_toolkit.cli.main import main\nmain(['completion', 'bash'])\n"
        "print(sorted({'numpy', 'warp', 'pydantic', 'matplotlib'} & set(sys.modules)))\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.stdout.splitlines()[-1] == "[]", done.stderr


def test_an_unknown_shell_is_refused(capsys):
    assert main(["completion", "bsh"]) == 2
    assert "bash, zsh, fish; did you mean 'bash'?" in capsys.readouterr().err
