"""Two hundred robots drawn at random, each through check, workspace, statics and all controllers.

    python -m benchmarks.any_robot                  # all, on two processes
    python -m benchmarks.any_robot --robots 20      # a first look; nothing is written

A robot that cannot rest at home is refused with its reason, and goes no further. The others follow
a path in the box that their tensions and winches allow, as fast as these allow it, without
disturbances, with perfect sensors and the true state: what is left are the controllers.
"""

from __future__ import annotations

import argparse
import json
import traceback
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.drawn_robots import drawn_robot
from benchmarks.results import table, write_section
from carosac_toolkit import trajectories
from carosac_toolkit.base.errors import CarosacError
from carosac_toolkit.drivers.sensors import PERFECT_SENSORS
from carosac_toolkit.inspection.report import report_robot
from carosac_toolkit.loop import loop, plugins
from carosac_toolkit.loop.plugin_builder import build_plugin
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.studies.compare.feasibility import slowest_stop
from carosac_toolkit.studies.run.divergence import divergence
from carosac_toolkit.studies.run.run_case import Truth
from carosac_toolkit.studies.run.scores import score
from carosac_toolkit.workspace.grid import search_grid
from carosac_toolkit.workspace.region import compute

ROBOTS = 200
CONTROLLERS = ("straight_line", "kinematic_solver", "input_shaping", "mpc")
PERIOD = 0.03  # of the control, in sqrt(length / g): 0.03 s on `carosac`
SPEED, ACCELERATION = 0.2, 0.3  # of the path before it is slowed, in sqrt(g length) and g
SLOWER = 0.9  # than the fastest feasible one
DURATION = 10.0  # of a run at the most, in sqrt(length / g)
GRID = 5  # positions along the longest side of the box
NO_WORSE = 1.02  # times the error of the kinematic solver, that of MPC
PATH_TRIES = 5


def examined(seed: int) -> dict[str, Any]:
    """Take a robot through everything; return what was found, and any traceback as a fault."""
    row: dict[str, Any] = {"seed": seed}
    try:
        robot = drawn_robot(seed)
        row |= {"cables": robot.n, "size_m": Scales(robot).length, "mass_kg": robot.mass}
        row |= _examined(robot, seed)
    except Exception:
        row |= {"outcome": "traceback", "reason": traceback.format_exc()[-600:]}
    return row


def _examined(robot: Robot, seed: int) -> dict[str, Any]:
    """Check, workspace, statics and runs."""
    report = report_robot(robot)
    region = compute(robot, search_grid(robot, robot.workspace_min, robot.workspace_max, GRID))
    inside = float(np.mean(region.verdicts.inside))
    if report.problems:
        return {"outcome": "refused", "reason": report.problems[0], "inside": inside}
    rest = statics.inverse_kinematics(robot, region.grid.positions)
    found: dict[str, Any] = {"inside": inside, "rest": float(rest.converged.mean())}
    path, reason = _path(robot, seed)
    if path is None:
        return found | {"outcome": "no path", "reason": reason}
    found |= {"speed": path.peak_speed / np.sqrt(robot.gravity * Scales(robot).length)}
    return found | {"outcome": "run", "runs": {x: _run(robot, path, x) for x in CONTROLLERS}}


def _path(robot: Robot, seed: int) -> tuple[trajectories.Trajectory | None, str]:
    """Return a path that is feasible at its speed, or the reason why the last one tried is not."""
    scales, reason = Scales(robot), ""
    speed = SPEED * np.sqrt(robot.gravity * scales.length)
    for attempt in range(PATH_TRIES):
        limits = {"speed_max": speed, "acceleration_max": ACCELERATION * robot.gravity}
        for _ in range(2):
            try:
                path = trajectories.build("minimum_snap", robot, 100 * seed + attempt, **limits)
            except CarosacError as error:
                return None, str(error)
            stop = slowest_stop(robot, path)
            reason = stop.reason
            if stop.scale >= 1.0:
                return path, ""
            by = SLOWER * stop.scale
            if by < 0.05:
                break
            limits = {
                "speed_max": by * path.peak_speed,
                "acceleration_max": by**2 * path.peak_acceleration,
            }
    return None, reason


def _run(robot: Robot, path: trajectories.Trajectory, name: str) -> dict[str, Any]:
    """Follow the path with a controller; return its scores, or the reason why there are none."""
    scales = Scales(robot)
    period = PERIOD * scales.time
    start = tuple(path.sample(np.zeros(1)).position[0])
    try:
        controller = build_plugin(
            plugins.load("controllers", name), robot, where="controller",
            offered={"period": period},
        )  # fmt: skip
        driver = build_plugin(
            plugins.load("drivers", "simulator"), robot, where="driver", seed=1,
            asked={"period": period, "start_position": start, "sensors": PERFECT_SENSORS},
        )  # fmt: skip
        duration = min(path.duration + 2.0 * scales.time, DURATION * scales.time)
        log = loop.run(driver, Truth(driver), controller, path, duration=duration)
    except CarosacError as error:
        return {"status": "refused", "reason": str(error)}
    scores = score(log, robot, path.duration)
    reason = divergence(log, robot)
    return {
        "status": "diverged" if reason else "finished", "reason": reason,
        "error": scores["tracking_rmse_norm_m"] / scales.length,
        "tension_min": scores["tension_min_N"] / scales.tension,
        "limited": scores["limited"] / scores["steps"],
    }  # fmt: skip


def main() -> None:
    """Examine all robots and write the section."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--robots", type=int, default=ROBOTS)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--json", type=Path)
    asked = parser.parse_args()
    rows = []
    with ProcessPoolExecutor(asked.jobs, mp_context=get_context("spawn")) as pool:
        for row in pool.map(examined, range(asked.robots)):
            rows.append(row)
            print(json.dumps(row), flush=True)
    if asked.json:
        asked.json.write_text(json.dumps(rows))
    text = told(rows)
    print(text)
    if asked.robots >= ROBOTS:
        write_section("any-robot", "Two hundred robots", "python -m benchmarks.any_robot", text)


def _ratio(mpc: dict[str, Any], other: dict[str, Any]) -> float:
    """Return the error of MPC over another; a run that is no score is worse than any, or alike."""
    finished = [one["status"] == "finished" for one in (mpc, other)]
    if all(finished):
        return float(mpc["error"] / other["error"])
    return 0.0 if finished[0] else np.inf if finished[1] else 1.0


def told(rows: Sequence[dict[str, Any]]) -> str:
    """Return the tables: outcomes, scores by controller, and MPC over the kinematic solver."""
    outcomes = Counter(row["outcome"] for row in rows)
    runs = [row["runs"] for row in rows if row["outcome"] == "run"]
    lines = []
    for name in CONTROLLERS:
        each = [run[name] for run in runs]
        status = Counter(one["status"] for one in each)
        unexplained = sum(one["status"] != "finished" and not one["reason"] for one in each)
        errors = [100.0 * one["error"] for one in each if one["status"] == "finished"]
        spread = np.quantile(errors, (0.05, 0.5, 0.95)) if errors else [np.nan] * 3
        shown = [str(status[key]) for key in ("finished", "diverged", "refused")]
        lines.append([name, *shown, str(unexplained), *(f"{x:.3g} %" for x in spread)])
    pairs = [_ratio(run["mpc"], run["kinematic_solver"]) for run in runs]
    no_worse = sum(ratio <= NO_WORSE for ratio in pairs)
    quantiles = np.quantile(pairs, (0.05, 0.25, 0.5, 0.75, 0.95)) if pairs else []
    words = ", ".join(f"{count} {name}" for name, count in outcomes.most_common())
    return "\n\n".join([
        f"Outcomes of {len(rows)} robots: {words}. Errors are root mean squares over the mean "
        "length of a cable, of runs that were finished.",
        table(["controller", "finished", "diverged", "refused", "without a reason", "5 %",
               "median", "95 %"], lines),
        f"MPC tracks no worse than {NO_WORSE:g} times the kinematic solver in {no_worse} of "
        f"{len(pairs)} ({100.0 * no_worse / max(1, len(pairs)):.0f} %; bar 95 %). Ratios at 5, 25, "
        f"50, 75 and 95 %: {', '.join(f'{x:.3g}' for x in quantiles)}.",
    ])  # fmt: skip


if __name__ == "__main__":
    main()
