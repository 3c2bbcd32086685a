"""Train a network that does what MPC would do, in a fraction of its time.

MPC drives simulated plants along random paths and says which tensions it plans; a network learns
that. In three more rounds the network drives and MPC says what it would have done. After an
interruption the same command goes on where it was.

The network runs on any driver as the controller approximate_mpc: carosac compare --controllers
approximate_mpc --set controller.approximate_mpc.policy=FILE

Exit status 1 means that the network lost most drives of the last round.
"""

from __future__ import annotations

import csv
import os
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from carosac_toolkit.base.numbers import check_whole
from carosac_toolkit.base.tables import format_table, terminal_width, wrapped
from carosac_toolkit.cli.common import CommandResult, DefaultRobotOptions, OutputFolder
from carosac_toolkit.reports.page import check_folder
from carosac_toolkit.robot.file import load_robot
from learned.approximate_mpc.controller import check_cables
from learned.approximate_mpc.plan_network import check_share
from learned.approximate_mpc.rounds import HELD_OUT_EVERY, TABLE_FILE
from learned.approximate_mpc.training import DistillationSettings, distill
from learned.commands.status_line import StatusLine

RESULTS_FOLDER = Path("carosac-results") / "distill"


@dataclass(frozen=True, kw_only=True)
class Options(DefaultRobotOptions):
    """Options of ``carosac distill``."""

    drives: int | None = None
    """Drives of each of the four rounds: fewer for a first look. By default 80 to 120, about half
    an hour on two cores."""
    updates: int | None = None
    """Updates of the network after the last round; by default 40000. Earlier rounds take a fifth
    of them."""
    tension_share: float | None = None
    """Share of the way to new tensions that a command goes, by default 1. Where cables are
    stiff and a simulated robot trembles, 0.6 calms it; soft ones may swing up."""
    workers: int | None = None
    """Processes that drive; by default one per core."""
    output: OutputFolder = None
    """Folder for all results; by default one in carosac-results/distill. An interrupted training
    there goes on; another one is refused."""


def run(options: Options) -> CommandResult:
    """Train, and tell what came of it."""
    robot = load_robot(options.robot)
    settings = DistillationSettings()
    for name in ("drives", "updates", "workers"):
        if getattr(options, name) is not None:
            check_whole(f"--{name}", getattr(options, name), 1)
    check_whole("--seed", options.seed, 0)
    rounds = len(settings.drives)
    if options.drives is not None:
        settings = replace(settings, drives=(options.drives,) * rounds)
    if options.updates is not None:
        early = max(1, options.updates // 5)
        settings = replace(settings, updates=(early,) * (rounds - 1) + (options.updates,))
    check_cables(robot)
    if options.tension_share is not None:
        check_share("--tension-share", options.tension_share)
        settings = replace(settings, tension_share=options.tension_share)
    folder = options.output or RESULTS_FOLDER / f"{robot.name}-seed{options.seed}"
    check_folder("--output", folder)
    line = (
        f"approximate_mpc: MPC drives {robot.name}, and a network learns from it; seed "
        f"{options.seed}, {rounds} rounds, {sum(settings.drives)} drives in all, to {folder}"
    )
    print(wrapped(line, terminal_width()), flush=True)
    status = StatusLine()
    try:
        path = distill(
            robot, folder, seed=options.seed, settings=settings,
            workers=options.workers or os.cpu_count() or 1,
            report=lambda what, done, of: status.tell(f"{what} {done} of {of}"),
        )  # fmt: skip
    except KeyboardInterrupt:
        print("stopped; the same command goes on from there", flush=True)
        raise
    finally:
        status.clear()
    with (folder / TABLE_FILE).open(encoding="utf-8", newline="") as file:
        rows = [{k: float(v) for k, v in row.items()} for row in csv.DictReader(file)]
    header = ["round", "drives", "samples", "lost", "tracking [mm]", "off, trained [N]",
              "off, held out [N]"]  # fmt: skip
    cells = [
        [
            *(f"{row[name]:.0f}" for name in ("round", "drives", "samples", "lost")),
            _number(1e3 * row["drive_error_m"], 1),
            _number(row["trained_error_N"], 2),
            _number(row["held_out_error_N"], 2),
        ]
        for row in rows
    ]
    print(format_table(header, cells))
    print(f"network: {path}")
    lost = rows[-1]["lost"] > 0.5 * settings.drives[-1]
    held = sum(settings.drives) >= HELD_OUT_EVERY
    lines = [
        "tracking: median RMS error of the round's drives; off: what the network's tensions differ "
        "by from those of MPC" + ("" if held else "; too few drives to hold one out"),
        *(
            ["the network lost most drives of the last round: train it longer, on more drives"]
            if lost
            else []
        ),
        f"to use it: carosac compare --robot {options.robot} --controllers mpc approximate_mpc "
        f"--set controller.approximate_mpc.policy={path}",
    ]
    print("\n".join(wrapped(line, terminal_width()) for line in lines))
    told = [{k: None if np.isnan(v) else v for k, v in row.items()} for row in rows]
    data = {"robot": robot.name, "folder": folder, "network": path, "rounds": told}
    return CommandResult(data, status=1 if lost else 0)


def _number(value: float, digits: int) -> str:
    return "-" if np.isnan(value) else f"{value:.{digits}f}"
