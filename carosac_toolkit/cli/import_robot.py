"""Make a robot file from one of CASPR (XML), WireX (.wcrfx) or cdpyr (JSON, YAML).

Says what it takes, what it drops, and which fields a robot file needs that the other one does not
hold. None of these is guessed: give them with --complete or --set. Without --output it only looks.

carosac import robot X_bodies.xml X_cables.xml --form missing.yaml

carosac import robot X_bodies.xml X_cables.xml --complete missing.yaml --output x.yaml

Exit status 1: fields are missing, and no robot file was asked for.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from carosac_toolkit.base.errors import CarosacError, MissingFile
from carosac_toolkit.base.files import check_writable, replacing
from carosac_toolkit.base.tables import format_table, terminal_width, wrapped
from carosac_toolkit.base.yaml import format_path
from carosac_toolkit.cli.common import CommandResult, CommonOptions, OutputFile
from carosac_toolkit.interchange.completion import (
    Completed,
    complete,
    form,
    missing_lines,
    robot_and_text,
)
from carosac_toolkit.interchange.robots import read_robot
from carosac_toolkit.interchange.source_file import SourceFile
from carosac_toolkit.robot.robot import Robot


@dataclass(frozen=True, kw_only=True)
class Options(CommonOptions):
    """Options of ``carosac import robot``."""

    files: Annotated[tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="FILE ...")]
    """The robot: X_bodies.xml and X_cables.xml of CASPR (one finds the other), a .wcrfx of WireX,
    or a .json, .yaml of cdpyr."""
    output: OutputFile = None
    """Write the robot file here (.yaml)."""
    complete: str | None = None
    """YAML in the layout of a robot file with the missing fields; units are allowed. Its values
    replace those of the imported file."""
    settings: Annotated[
        tuple[str, ...], tyro.conf.arg(name="set", metavar="PATH=VALUE"), tyro.conf.UseAppendAction
    ] = ()
    """A single missing field, as in `--set gravity=9.81`; may be given several times."""
    form: OutputFile = None
    """Write a form for --complete here, with the missing fields and their allowed values."""
    cable_set: str | None = None
    """CASPR: name of the cable set; by default the file's default."""
    pulleys: bool = True
    """Import pulleys as pulleys; otherwise as eyelets at the cables' entry points."""
    inertia_about: Annotated[str | None, tyro.conf.arg(metavar="POINT")] = None
    """cdpyr: `origin` or `center_of_mass`, the point of the platform to which its inertia
    refers."""


def run(options: Options) -> CommandResult:
    """Import one robot."""
    check_writable("--output", options.output, (".yaml", ".yml"))
    check_writable("--form", options.form, (".yaml", ".yml"))
    if not options.files:
        raise MissingFile("FILE", "name the file of a robot; see 'carosac import robot --help'")
    draft = read_robot(
        [Path(file) for file in options.files],
        cable_set=options.cable_set,
        pulleys=options.pulleys,
        inertia_about=options.inertia_about,
    )
    fragment = SourceFile(Path(options.complete)).text() if options.complete else ""
    completed = complete(
        draft, fragment=fragment, name=options.complete or "", pairs=options.settings
    )
    _say(completed)
    if completed.missing:
        return _incomplete(completed, options)
    robot, text = robot_and_text(completed)
    lengths = _straight_lengths(robot)
    print("\nstraight lengths at home, to compare with the other program [m]:")
    print(wrapped("  ".join(f"{length:.6f}" for length in lengths), terminal_width(), "  "))
    if options.output is not None:
        with replacing(options.output) as temporary:
            temporary.write_text(text, encoding="utf-8")
        print(f"\nrobot file: {options.output}; next: carosac check {options.output}")
    return CommandResult(_data(completed, lengths))


def _incomplete(completed: Completed, options: Options) -> CommandResult:
    """Say what is missing; refuse to write a robot file without it."""
    if options.form is not None:
        with replacing(options.form) as temporary:
            temporary.write_text(form(completed), encoding="utf-8")
        print(f"\nform: {options.form}; fill it in and give it with --complete")
    if options.output is not None:
        lines = [
            f"{options.output} is not written: {len(completed.missing)} fields are missing",
            "give them with --complete FILE (--form FILE writes one to fill in) or --set",
            *missing_lines(completed),
        ]
        raise CarosacError("\n  ".join(lines))
    print(f"\nmissing ({len(completed.missing)}), to be given with --complete FILE or --set:")
    for line in missing_lines(completed):
        print(f"  {line}")
    return CommandResult(_data(completed, None), status=1)


def _say(completed: Completed) -> None:
    """Print what was taken, replaced and dropped, and any warnings."""
    draft = completed.draft
    print(f"{draft.source}: {len(draft.data['chains'])} cables\n")
    ours = f"{draft.source}: "
    rows = [(path, source.removeprefix(ours)) for path, source in draft.provenance.items()]
    print(format_table(("field", "from"), rows))
    for path in completed.replaced:
        print(f"{path}: yours instead of the file's")
    print("\ndropped:")
    for what in draft.dropped:
        print(wrapped(what, terminal_width(), "  "))
    for warning in draft.warnings:
        print(wrapped(warning, terminal_width(), "warning: "))


def _straight_lengths(robot: Robot) -> list[float]:
    """Return the lengths of straight cables at home, with the arcs on pulleys [m]."""
    from carosac_toolkit.physics.cable import straight_line

    cables = straight_line.inverse_kinematics(robot, robot.home_position[None])
    return [float(length) for length in cables[0]]


def _data(completed: Completed, lengths: list[float] | None) -> dict[str, object]:
    """Return the numbers that ``--json`` writes."""
    draft = completed.draft
    return {
        "source": draft.source,
        "cables": len(draft.data["chains"]),
        "provenance": draft.provenance,
        "dropped": draft.dropped,
        "warnings": draft.warnings,
        "replaced": list(completed.replaced),
        "missing": {format_path(path): allowed for path, allowed in completed.missing},
        "straight_lengths_m": lengths,
    }
