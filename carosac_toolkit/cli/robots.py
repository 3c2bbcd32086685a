"""List the robots that come with the toolkit, or copy the file of one to edit it.

List them: carosac robots

Copy one: carosac robots --copy carosac my-robot.yaml
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from carosac_toolkit.base.errors import InvalidField, did_you_mean
from carosac_toolkit.base.files import check_writable, replacing
from carosac_toolkit.base.tables import format_table
from carosac_toolkit.cli.common import CommandResult, CommonOptions
from carosac_toolkit.robot.bundled_names import list_robots
from carosac_toolkit.robot.file import load_robot, robot_text

FILE_SUFFIXES = (".yaml", ".yml")  # by which a path is known from the name of a bundled robot


@dataclass(frozen=True, kw_only=True)
class Options(CommonOptions):
    """Options of ``carosac robots``."""

    copy: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME FILE")] = ()
    """Write the file of this bundled robot to a new FILE.yaml, as a start for one of your own."""


def run(options: Options) -> CommandResult:
    """Print the table of bundled robots, or copy one."""
    if options.copy:
        return _copy(options.copy)
    robots = [load_robot(name) for name in list_robots()]
    rows = [(robot.name, robot.n, robot.mass, robot.description) for robot in robots]
    print(format_table(("name", "cables", "mass [kg]", "description"), rows))
    print(
        "\nAny other robot: `carosac robots --copy NAME FILE.yaml` copies one of these to edit; "
        "`carosac check FILE.yaml` tells what is wrong."
    )
    data = [
        {
            "name": robot.name,
            "cables": robot.n,
            "mass_kg": robot.mass,
            "description": robot.description,
            "licence": robot.licence,
        }
        for robot in robots
    ]
    return CommandResult({"robots": data})


def _copy(words: Sequence[str]) -> CommandResult:
    """Write the file of a bundled robot, NAME, to a new file, FILE."""
    if len(words) != 2:
        raise InvalidField("--copy", repr(" ".join(words)), "two words: NAME FILE")
    name, path = words
    names = list_robots()
    if name not in names:
        allowed = f"a bundled robot, of {', '.join(names)}{did_you_mean(name, list(names))}"
        raise InvalidField("--copy", repr(name), allowed)
    if os.path.lexists(path):
        raise InvalidField("--copy", repr(path), "a new file; this one exists and stays as it is")
    check_writable("--copy", Path(path), FILE_SUFFIXES)
    with replacing(Path(path)) as temporary:
        temporary.write_text(robot_text(name), encoding="utf-8")
    print(f"{path}: a copy of {name}. Enter the name and the numbers of your robot, then:")
    print(f"  carosac check {path}")
    return CommandResult({"copied": name, "file": path})
