"""Train a network that does what MPC would do, in a fraction of its time.

MPC drives simulated plants along random paths and says which tensions it plans; a network learns
that. In three more rounds the network drives and MPC says what it would have done. After an
interruption the same command goes on where it was.

With --family it is one network for all suspended robots of four cables, from robots on a desk to
those over a stadium: every drive is one of another robot.

The network runs on any driver as the controller approximate_mpc: carosac compare --controllers
approximate_mpc --set controller.approximate_mpc.policy=FILE

Exit status 1 means that the network lost most drives of the last round.
"""

from __future__ import annotations

import csv
import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.base.numbers import check_whole
from carosac_toolkit.base.tables import format_table, terminal_width, wrapped
from carosac_toolkit.cli.common import CommandResult, DefaultRobotOptions, OutputFolder
from carosac_toolkit.reports.page import check_folder
from carosac_toolkit.robot.file import load_robot
from learned.approximate_mpc.controller import check_cables
from learned.approximate_mpc.family_robots import FAMILY
from learned.approximate_mpc.family_training import FamilySettings, distill_family
from learned.approximate_mpc.plan_network import check_share
from learned.approximate_mpc.rounds import HELD_OUT_EVERY, TABLE_FILE
from learned.approximate_mpc.training import DistillationSettings, distill
from learned.commands.status_line import StatusLine

RESULTS_FOLDER = Path("carosac-results") / "distill"


@dataclass(frozen=True, kw_only=True)
class Options(DefaultRobotOptions):
    """Options of ``carosac distill``."""

    family: bool = False
    """Train the network of all suspended robots of four cables instead of that of a robot."""
    drives: int | None = None
    """Drives of each of the four rounds: fewer for a first look. By default 25 to 60, a quarter of
    an hour on two cores. With --family 150 to 700, which takes an hour and a quarter."""
    updates: int | None = None
    """Updates of the network after the last round; by default 40000. Earlier rounds take an eighth
    of what is asked for, with --family a fifth."""
    tension_share: float | None = None
    """Share of the way to new tensions that a command goes, by default 1. Where cables are
    stiff and a simulated robot trembles, 0.6 calms it; soft ones may swing up. Always 0.9 with
    --family."""
    workers: int | None = None
    """Processes that drive; by default one per core."""
    output: OutputFolder = None
    """Folder for all results; by default one in carosac-results/distill. An interrupted training
    there goes on; another one is refused."""


def run(options: Options) -> CommandResult:
    """Train, and tell what came of it."""
    for name in ("drives", "updates", "workers"):
        if getattr(options, name) is not None:
            check_whole(f"--{name}", getattr(options, name), 1)
    check_whole("--seed", options.seed, 0)
    return _family(options) if options.family else _robot(options)


def _robot(options: Options) -> CommandResult:
    """Train the network of one robot."""
    robot = load_robot(options.robot)
    settings = DistillationSettings()
    settings = replace(settings, **_asked(options, settings.drives, settings.updates, "drives"))
    check_cables(robot)
    if options.tension_share is not None:
        check_share("--tension-share", options.tension_share)
        settings = replace(settings, tension_share=options.tension_share)
    folder = options.output or RESULTS_FOLDER / f"{robot.name}-seed{options.seed}"
    begun = f"MPC drives {robot.name}, and a network learns from it"
    train = partial(distill, robot, folder, settings=settings)
    path, rows = _trained(options, train, folder, begun, settings.drives)
    _print_rounds(rows, "drives", [
        ("tracking [mm]", "drive_error_m", 1e3, 1), ("off, trained [N]", "trained_error_N", 1.0, 2),
        ("off, held out [N]", "held_out_error_N", 1.0, 2),
    ])  # fmt: skip
    return _told(
        options, robot.name, path, rows, settings.drives, "tracking: median RMS error of the "
        "round's drives; off: what the network's tensions differ by from those of MPC",
        use=f"--robot {options.robot} ",
    )  # fmt: skip


def _family(options: Options) -> CommandResult:
    """Train the network of a family of robots."""
    for name, value, usual in (
        ("robot", options.robot, DefaultRobotOptions().robot),
        ("--tension-share", options.tension_share, None),
    ):
        if value != usual:
            raise InvalidField(name, value, "none with --family")
    settings = FamilySettings()
    settings = replace(settings, **_asked(options, settings.robots, settings.updates, "robots"))
    folder = options.output or RESULTS_FOLDER / f"{FAMILY}-seed{options.seed}"
    begun = f"MPC drives robots of {FAMILY}, each another one, and a network learns from it"
    train = partial(distill_family, folder, settings=settings)
    path, rows = _trained(options, train, folder, begun, settings.robots)
    _print_rounds(rows, "robots", [
        ("tracking [%]", "drive_error", 100.0, 2), ("off, trained", "trained_error", 1.0, 3),
        ("off, held out", "held_out_error", 1.0, 3),
    ])  # fmt: skip
    return _told(
        options, FAMILY, path, rows, settings.robots, "tracking: median RMS error of the round's "
        "simulated drives, over the length of a cable; off: what the network's tensions differ by "
        "from those of MPC, over the weight per cable",
        use="",
    )  # fmt: skip


def _asked(
    options: Options, drives: tuple[int, ...], updates: tuple[int, ...], name: str
) -> dict[str, Any]:
    """Return how many drives, under their name, and updates were asked for."""
    asked: dict[str, Any] = {}
    if options.drives is not None:
        asked[name] = (options.drives,) * len(drives)
    if options.updates is not None:
        asked["updates"] = tuple(max(1, options.updates * each // updates[-1]) for each in updates)
    return asked


def _trained(
    options: Options, train: Callable[..., Path], folder: Path, begun: str, drives: tuple[int, ...]
) -> tuple[Path, list[dict[str, float]]]:
    """Train; return the network and the table of rounds."""
    check_folder("--output", folder)
    line = (
        f"approximate_mpc: {begun}; seed {options.seed}, {len(drives)} rounds, {sum(drives)} "
        f"drives in all, to {folder}"
    )
    print(wrapped(line, terminal_width()), flush=True)
    status = StatusLine()
    try:
        path = train(
            seed=options.seed, workers=options.workers or os.cpu_count() or 1,
            report=lambda what, done, of: status.tell(f"{what} {done} of {of}"),
        )  # fmt: skip
    except KeyboardInterrupt:
        print("stopped; the same command goes on from there", flush=True)
        raise
    finally:
        status.clear()
    with (folder / TABLE_FILE).open(encoding="utf-8", newline="") as file:
        return path, [{k: float(v) for k, v in row.items()} for row in csv.DictReader(file)]


def _print_rounds(
    rows: list[dict[str, float]], drives: str, errors: list[tuple[str, str, float, int]]
) -> None:
    """Print the table of rounds: counts, and errors by header, name, unit and digits."""
    counts = ["round", drives, "samples", "lost"]
    cells = [
        [
            *(f"{row[name]:.0f}" for name in counts),
            *(_number(unit * row[name], digits) for _, name, unit, digits in errors),
        ]
        for row in rows
    ]
    print(format_table([*counts, *(header for header, *_ in errors)], cells))


def _told(
    options: Options, name: str, path: Path, rows: list[dict[str, float]],
    drives: tuple[int, ...], meaning: str, *, use: str,
) -> CommandResult:  # fmt: skip
    """Print what the table means and how to use the network; return the result."""
    print(f"network: {path}")
    lost = rows[-1]["lost"] > 0.5 * drives[-1]
    held = sum(drives) >= HELD_OUT_EVERY
    lines = [
        meaning + ("" if held else "; too few drives to hold one out"),
        *(
            ["the network lost most drives of the last round: train it longer, on more drives"]
            if lost
            else []
        ),
        f"to use it: carosac compare {use}--controllers mpc approximate_mpc "
        f"--set controller.approximate_mpc.policy={path}",
    ]
    print("\n".join(wrapped(line, terminal_width()) for line in lines))
    told = [{k: None if np.isnan(v) else v for k, v in row.items()} for row in rows]
    data = {"robot": name, "folder": path.parent, "network": path, "rounds": told}
    return CommandResult(data, status=1 if lost else 0)


def _number(value: float, digits: int) -> str:
    return "-" if np.isnan(value) else f"{value:.{digits}f}"
