"""Words that a shell can complete: commands, their options, and the values of these."""

from __future__ import annotations

from functools import cache
from importlib.metadata import EntryPoint
from typing import NamedTuple

from carosac_toolkit.cli.option_source import (
    Option,
    read_names,
    read_options,
    read_stems,
    read_summary,
)
from carosac_toolkit.loop import plugins
from carosac_toolkit.recordings.bundled import list_recordings
from carosac_toolkit.robot.bundled_names import list_robots

ANY_FILE, FOLDER = "*", "/"  # instead of suffixes
ROBOT_SUFFIXES = ("yaml", "yml")
RECORDING_SUFFIXES = ("parquet", "csv", "mat", "jsonl")


class Values(NamedTuple):
    """Values that an option can take.

    Attributes:
        names: Texts.
        files: Suffixes of files without a dot, or `ANY_FILE`, or `FOLDER`; none: no files.
    """

    names: tuple[str, ...] = ()
    files: tuple[str, ...] = ()


class Described(NamedTuple):
    """Command with its options.

    Attributes:
        name: Name as users write it; one or two words.
        summary: First line of its description.
        options: Options and positional arguments, in order.
    """

    name: str
    summary: str
    options: list[Option]


def described_commands() -> list[Described]:
    """Return all installed commands, sorted; a command of a package without source has no options.

    Reads sources; imports no command.
    """
    entries = sorted(plugins.entry_points_of("carosac.commands"), key=lambda entry: entry.name)
    return [_described(entry) for entry in entries]


def values_of(option: Option) -> Values:
    """Return what an option can take, by its choices, its field or its metavar."""
    if option.choices:
        return Values(option.choices)
    by_field = _values_by_field()
    if option.field in by_field:
        return by_field[option.field]
    if option.metavar.startswith(("DIR", "FOLDER")):
        return Values(files=(FOLDER,))
    if option.metavar.startswith(("FILE", "BAG")):
        return Values(files=(ANY_FILE,))
    return Values()


def _described(entry: EntryPoint) -> Described:
    summary = read_summary(entry.module) or f"not installed: {entry.value}"
    return Described(entry.name.replace(".", " "), summary, read_options(entry.module))


@cache
def _values_by_field() -> dict[str, Values]:
    """Return the values of options that mean the same in every command, by their fields."""
    robots = Values(list_robots(), ROBOT_SUFFIXES)
    recordings = Values(list_recordings(), RECORDING_SUFFIXES)
    controllers = Values(tuple(plugins.names("controllers")))
    estimators = Values((*plugins.names("estimators"), "truth"))
    drivers = Values(tuple(plugins.names("drivers")))
    sensors = Values(read_names("carosac_toolkit.drivers.sensors", "SENSOR_SUITES"))
    paths = read_names("carosac_toolkit.trajectories.catalogue", "_TRAJECTORY_BUILDERS")
    conditions = read_names("carosac_toolkit.robot.perturbations", "CONDITIONS_BY_NAME")
    return {
        "robot": robots, "robots": robots, "robot_argument": robots,
        "copy": robots,
        "recording": recordings,
        "what": Values((*list_robots(), *list_recordings()), (ANY_FILE,)),
        "controller": controllers, "controllers": controllers,
        "baseline": controllers, "animation": controllers,
        "estimator": estimators, "estimators": estimators,
        "models": Values(tuple(plugins.names("estimators"))),
        "driver": drivers, "plant": drivers,
        "sensors": sensors,
        "trajectory": Values(paths), "trajectories": Values(paths, RECORDING_SUFFIXES),
        "condition": Values(conditions), "conditions": Values(conditions, ROBOT_SUFFIXES),
        "suite": Values(("reference",)),
        "against": Values(files=(FOLDER,)),
        "policy": Values(read_stems("learned", "policies", ".onnx"), ("onnx",)),
        "targets": Values(files=(ANY_FILE,)), "complete": Values(files=ROBOT_SUFFIXES),
        "definitions": Values(files=(FOLDER,)),
    }  # fmt: skip
