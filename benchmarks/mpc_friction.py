"""MPC on robots with dry friction that its prediction does not know; the figures go to RESULTS.md.

Run by hand: ``python -m benchmarks.mpc_friction``. The robot `carosac` has dry moments at its exits
and anchors of one sigma of what `carosac validate` takes for possible, and three times that.
Estimators know them. Nothing else is wrong.
"""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

import carosac_toolkit as ct
from benchmarks.results import table, write_section
from carosac_toolkit.physics.device import lever
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.robot.file import robot_text
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.robot.writer import robot_document
from carosac_toolkit.validation.effect_signatures import ANCHOR_MOMENT_SIGMA, EXIT_MOMENT_SIGMA

COMMAND = "python -m benchmarks.mpc_friction"
SIZES = (0.0, 1.0, 3.0)
ESTIMATORS = ("truth", "dynamic_estimator")
SEEDS = 5


def moments(robot: Robot, size: float) -> tuple[float, float]:
    """Return the dry moments at exits and anchors [N m]."""
    share = size * robot.weight / robot.n
    exit_moment = EXIT_MOMENT_SIGMA * share * Scales(robot).length
    return exit_moment, ANCHOR_MOMENT_SIGMA * share * lever(robot)


def write_robot(folder: Path, size: float) -> Path:
    """Write `carosac` with dry moments of a size; return the path."""
    robot = ct.load_robot("carosac")
    at_exits, at_anchors = (np.full(robot.n, moment) for moment in moments(robot, size))
    rubbing = replace(
        robot, name=f"friction-{size:g}", exit_friction=at_exits, anchor_friction=at_anchors
    )
    path = folder / f"friction-{size:g}.yaml"
    path.write_text(robot_document(robot_text("carosac"), rubbing, provenance="assumed"))
    return path


def main() -> None:
    """Run the study and write the section."""
    with tempfile.TemporaryDirectory() as folder:
        paths = [str(write_robot(Path(folder), size)) for size in SIZES]
        study = ct.Study(
            robots=paths, controllers=["mpc"], estimators=list(ESTIMATORS),
            trajectories=["minimum_snap"], perturbations=["none"], seeds=SEEDS,
            output=Path(folder) / "study",
        )  # fmt: skip
        found = study.run(progress=False).rows
    rows = []
    for size, path in zip(SIZES, paths, strict=True):
        errors = [
            [
                r["tracking_rmse_norm_m"]
                for r in found
                if (r["robot"], r["estimator"]) == (path, name)
            ]
            for name in ESTIMATORS
        ]
        numbers = [f"{moment:.2f}" for moment in moments(ct.load_robot("carosac"), size)]
        rows.append([*numbers, *(f"{1e3 * np.mean(each):.1f}" for each in errors)])
    head = ["exits [N m]", "anchors [N m]", "tracking, truth known [mm]", "dynamic_estimator [mm]"]
    body = (
        f"Robot `carosac`, `minimum_snap` at 1 m/s, {SEEDS} paths, IMU; tracking RMSE of MPC.\n\n"
        + table(head, rows)
    )
    write_section("mpc-friction", "MPC and dry friction", COMMAND, body)
    print(body)


if __name__ == "__main__":
    main()
