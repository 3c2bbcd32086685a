from dataclasses import dataclass
from types import ModuleType

import pytest

from carosac_toolkit.cli.arguments import parse_options
from carosac_toolkit.cli.main import main
from carosac_toolkit.loop.plugins import load


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["robots", "--seed", "abc"], "--seed: got 'abc'; allowed: a whole number"),
        (["robots", "--seed=1.5"], "--seed: got '1.5'; allowed: a whole number"),
        (["validate", "x", "--stop", "y"], "--stop: got 'y'; allowed: a whole number"),
        (["robots", "--json"], "--json: got nothing; allowed: a value; see 'carosac robots"),
        (["run", "--set", "controller.kinematic_solver.gian=1", "--controller", "kinematic_solver"],
         "--set controller.kinematic_solver.gian: got 1; allowed: one of ['delay', 'distribution', "
         "'gain', 'period']; did you mean 'gain'?"),
        (["check"], "ROBOT: got nothing; allowed: a robot, as ROBOT or --robot ROBOT"),
        (["check", "scampi", "--robot", "carosac"], "--robot: got 'carosac'; allowed: one robot; "
         "the argument is 'scampi'"),
        (["view", "scampi", "--robot", "carosac"], "--robot: got 'carosac'; allowed: one robot"),
        (["view"], "WHAT: got nothing; allowed: a robot, a recording or a study's folder"),
        (["check", "a", "b"], "argument: got 'b'; allowed: nothing more"),
        (["compare", "mine.yaml"], "argument: got 'mine.yaml'; allowed: nothing more; did you mean "
         "'--robot mine.yaml'?"),
        (["compare", "scampi"], "did you mean '--robot scampi'?"),
        (["completion"], "SHELL: got nothing; allowed: one of bash, zsh, fish; see 'carosac "),
        (["robots", "--sead", "1"], "option: got '--sead'; allowed: --help, --json, --seed, "
         "--copy; did you mean '--seed'?"),
        (["check", "x", "--robts", "y"], "option: got '--robts'; allowed: --help, --json, --seed, "
         "--robot, --picture; did you mean '--robot'?"),
        (["workspace", "carosac", "--cells", "9"], "did you mean '--points' or '--slice-points'?"),
        (["robots", "--zzz"], "allowed: --help, --json, --seed"),
        (["workspace", "carosac", "--lower", "1", "2"], "--lower: got '1 2'; allowed: X Y Z"),
        (["view", "scampy"], "or a study's folder; did you mean 'scampi'?"),
        (["run", "--sensors", "lenghts"], "--sensors: got 'lenghts'; allowed: 'lengths', then any"),
        (["run", "--output", "x.csv"], "--output: got 'x.csv'; allowed: a file name ending in"),
        (["run", "--to", "9", "9", "9"], "allowed: (-1.6, -3.8, 1) to (2.4, 0.2, 5) m"),
        (["compare", "--trajectories"], "trajectories: got none; allowed: one or more different"),
        (["compare", "--scheduler", "foo"], "address of a running dask scheduler"),
        (["compare", "--suites", "lengths"], "--suites is now --sensors"),
        (["run", "--suite", "lengths"], "--suite is now --sensors"),
        (["run", "--suite=lengths"], "--suite is now --sensors"),
        (["view", "carosac", "--live", "--suite", "lengths"], "--suite is now --sensors"),
        (["compare", "--suite", "lengths"], "sensors are chosen with --sensors"),
        (["chek"], "command: got 'chek'; allowed: calibrate guide, "),
        (["chek"], "did you mean 'check'?"),
        (["robot:s"], "command: got 'robot:s'"),
    ],
)  # fmt: skip
def test_a_wrong_word_is_one_line_and_status_two(capsys, words, message):
    assert main(words) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("carosac: ") and len(captured.err.splitlines()) == 1
    assert message in captured.err
    assert "module:Class" not in captured.err


@pytest.mark.parametrize("command", ["robots", "check", "validate"])
def test_help_is_in_words(capsys, command):
    with pytest.raises(SystemExit) as stopped:
        main([command, "--help"])
    assert not stopped.value.code
    text = capsys.readouterr().out
    assert "{None}" not in text
    for empty in ("(default: )", "(default: None)", "(default: none)", "(default: False)"):
        assert empty not in text
    assert "(default: 0)" in text
    if command == "validate":
        assert "--robot TEXT" in text and "--stop INT" in text


def test_sentences_of_the_help_are_not_broken_before_dots_and_digits(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "500")
    with pytest.raises(SystemExit):
        main(["view", "--help"])
    text = capsys.readouterr().out
    assert "(bundled name, .parquet, .csv, .mat or .jsonl), or the folder of a study" in text
    assert "by default 1 m/s on the robot carosac, on others by their size." in text


def test_a_robot_is_named_with_or_without_the_option():
    module = load("commands", "check")
    for words in (["scampi"], ["--robot", "scampi"], ["scampi", "--robot", "scampi"]):
        assert parse_options(module, "check", words).robot == "scampi"
    for command in ("run", "plc", "train"):
        module = load("commands", command)
        assert parse_options(module, command, []).robot == "carosac"
        assert parse_options(module, command, ["scampi"]).robot == "scampi"
        assert parse_options(module, command, ["--robot", "scampi"]).robot == "scampi"
    compare = load("commands", "compare")
    assert parse_options(compare, "compare", ["--robot", "scampi"]).robots == ("scampi",)


def test_numbers_are_read(capsys):
    assert main(["robots", "--seed", "7"]) == 0
    assert main(["robots", "--seed=-7"]) == 0


def test_several_numbers_are_no_single_number():
    @dataclass(frozen=True)
    class Options:
        box: tuple[float, float] = (0.0, 1.0)
        maybe: tuple[int, int] | None = None
        counts: tuple[int, ...] = ()

    module = ModuleType("command")
    module.Options = Options
    words = ["--box", "2", "3.5", "--maybe", "1", "2", "--counts", "4", "5", "6"]
    found = parse_options(module, "command", words)
    assert found == Options(box=(2.0, 3.5), maybe=(1, 2), counts=(4, 5, 6))
    assert parse_options(module, "command", []) == Options()
