"""The network `suspended-4` against MPC on robots that it never saw.

Run by hand: ``python -m benchmarks.family [--network FILE] [--robots N]``; two processes. The
bundled robots of the family come first, then drawn ones; each has a plant of nominal-2, sensors of
lengths and IMU, the ``dynamic_estimator``, and two paths in its box: a straight move and a
minimum-snap path, as fast as drives of the training. MPC has the period that the network has, 20 ms
or less. A ratio is that of RMS tracking over both paths. Runs are kept under
``benchmarks/family.parts`` by the content of the network; remove the folder where other code has
changed.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import multiprocessing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

import carosac_toolkit as ct
from benchmarks.results import table, write_section
from carosac_toolkit import trajectories
from carosac_toolkit.base.errors import CarosacError
from carosac_toolkit.base.files import replacing
from carosac_toolkit.loop import plugins
from carosac_toolkit.loop.loop import run
from carosac_toolkit.loop.protocols import FallbackSource
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.robot.condition_file import find_condition
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.safety.settled import settled
from carosac_toolkit.studies.run.divergence import divergence
from carosac_toolkit.trajectories import Trajectory
from learned.approximate_mpc.demonstrations import CALM_TIME, draw_path, draw_resting
from learned.approximate_mpc.family_robots import FAMILY, draw_robot, family_settings
from learned.approximate_mpc.family_training import DRIVES, SIMULATED_TIME, drive_settings
from learned.approximate_mpc.networks import find_network

KEPT = Path(__file__).parent / "family.parts"
TITLE = "One network for a family of robots"
NAMED = ("carosac", "scampi", "stadium", "desktop")
PATHS = ("move", "minimum snap")
CONDITION, SUITE, ESTIMATOR = DRIVES.condition, DRIVES.suite, DRIVES.estimator
SEED = 2032  # of the drawn robots: not one of a training


@dataclass(frozen=True, kw_only=True)
class Drive:
    """One run: number of the robot, path, and file of the network, None for MPC."""

    number: int
    path: str
    network: str | None


def robot_of(number: int) -> Robot:
    """Return a robot by its number, the bundled ones first."""
    if number < len(NAMED):
        return ct.load_robot(NAMED[number])
    return draw_robot(np.random.default_rng([SEED, number]), f"unseen_{number}")


def path_of(drive: Drive, robot: Robot, rng: np.random.Generator) -> Trajectory:
    """Return the path of a drive."""
    settings = drive_settings(robot)
    if drive.path == "minimum snap":
        return trajectories.build(
            "minimum_snap", robot, int(rng.integers(2**31)), speed_max=settings.speed_max,
            acceleration_max=settings.acceleration_max,
        )  # fmt: skip
    return draw_path(robot, settings, rng, snap_share=0.0)


def score(drive: Drive) -> dict[str, Any]:
    """Drive and score."""
    robot = robot_of(drive.number)
    rng = np.random.default_rng([SEED, drive.number, PATHS.index(drive.path)])
    path, scales = path_of(drive, robot, rng), Scales(robot)
    name = "mpc" if drive.network is None else "approximate_mpc"
    chosen = plugins.load("controllers", name)
    given = family_settings(robot)
    if drive.network is not None:
        given = chosen.Settings(policy=drive.network)
    condition, kind = find_condition(CONDITION), plugins.load("drivers", "simulator")
    start = path.sample(np.zeros(1)).position[0]
    try:
        controller = chosen.build(robot, given)
        settings = replace(
            kind.Settings(), suite=SUITE, period=controller.period,
            start_position=tuple(float(x) for x in start),
            wind_force=condition.of(robot).wind_force,
        )  # fmt: skip
        driver = kind.build(
            draw_resting(robot, condition, start, rng), settled(settings, robot),
            seed=drive.number,
        )  # fmt: skip
        estimator = plugins.load("estimators", ESTIMATOR).build(robot)
        longest = SIMULATED_TIME * scales.time
        duration = min(path.duration, longest) + CALM_TIME.of(scales.ratios)
        log = run(driver, estimator, controller, path, duration=duration)
    except CarosacError as failure:
        return {"failed": str(failure)[:160]}
    assert log.position is not None and log.tension is not None
    away = np.linalg.norm(log.position - log.reference, axis=2)
    fallbacks = controller.fallbacks if isinstance(controller, FallbackSource) else {}
    return {
        "error": float(np.sqrt((away**2).mean())) / scales.length,
        "diverged": divergence(log, robot) or "",
        "slack": float((log.tension[:, 0] < robot.tension_min).any(axis=1).mean()),
        "handed_over": sum(fallbacks.values()) / len(log.time),
    }


def kept(drive: Drive) -> dict[str, Any]:
    """Score a drive, unless that was kept."""
    content = "mpc"
    if drive.network is not None:
        content = hashlib.sha256(find_network(drive.network).read_bytes()).hexdigest()[:12]
    path = KEPT / f"{drive.number}-{PATHS.index(drive.path)}-{content}.json"
    if path.is_file():
        return dict(json.loads(path.read_text(encoding="utf-8")))
    found = score(drive)
    KEPT.mkdir(exist_ok=True)
    with replacing(path) as temporary:
        temporary.write_text(json.dumps(found), encoding="utf-8")
    return found


def main() -> None:
    """Measure and write."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--robots", type=int, default=50)
    parser.add_argument(
        "--network", default=FAMILY, help="name, or ONNX file of `carosac distill --family`"
    )
    parser.add_argument("--processes", type=int, default=2)
    asked = parser.parse_args()
    drives = [
        Drive(number=number, path=path, network=network)
        for number in range(asked.robots) for path in PATHS for network in (None, asked.network)
    ]  # fmt: skip
    with multiprocessing.get_context("spawn").Pool(asked.processes) as pool:
        found = pool.map(kept, drives, chunksize=1)
    rows = dict(zip(drives, found, strict=True))
    ratios, diverged, slack, over, lost = {}, [[], []], [], [], [[], []]
    for number in range(asked.robots):
        pair = [
            [rows[Drive(number=number, path=path, network=one)] for path in PATHS]
            for one in (None, asked.network)
        ]
        for k, side in enumerate(pair):
            lost[k] += [number for each in side if "failed" in each]
            diverged[k] += [number for each in side if each.get("diverged")]
        both = [(a, b) for a, b in zip(*pair, strict=True) if "error" in a and "error" in b]
        if not both:
            continue
        mpc, mine = (np.sqrt(np.mean([one[k]["error"] ** 2 for one in both])) for k in (0, 1))
        ratios[number] = mine / mpc, mpc
        slack += [(a["slack"], b["slack"]) for a, b in both]
        over += [b["handed_over"] for _, b in both]
    values = np.array([ratio for ratio, _ in ratios.values()])
    named = [
        [name, f"{ratios[k][0]:.2f}", f"{1e3 * ratios[k][1]:.2f}"]
        for k, name in enumerate(NAMED) if k in ratios
    ]  # fmt: skip
    worst = sorted(ratios, key=lambda k: -ratios[k][0])[:5]
    text = [
        f"{len(NAMED)} bundled robots and {asked.robots - len(NAMED)} drawn ones, none of which "
        f"the network saw, {len(PATHS)} paths each; plants of "
        f"{CONDITION}, `{ESTIMATOR}` on lengths and IMU.",
        "", table(["what", "bar", "measured"], [
            ["tracking over MPC's, median", "1.2", f"{np.median(values):.2f}"],
            ["the same, at 90 %", "1.5", f"{np.quantile(values, 0.9):.2f}"],
            ["the same, largest", "reported", f"{values.max():.2f}"],
            ["drives that diverged, of MPC", "0",
             f"{len(diverged[1])}, {len(diverged[0])} of {asked.robots * len(PATHS)}"],
            ["drives that ended in an error, of MPC", "0",
             f"{len(lost[1])}, {len(lost[0])} of {asked.robots * len(PATHS)}"],
            ["time with a slack cable, of MPC [%]", "reported",
             "{1:.1f}, {0:.1f}".format(*(100.0 * np.mean(slack, axis=0)))],
            ["cycles that were handed over [%]", "reported", f"{100.0 * np.mean(over):.2f}"],
        ]), "",
        table(["robot", "tracking over MPC's", "MPC's, over L [1e-3]"], named), "",
    ]  # fmt: skip
    print("\n".join(text))
    print("largest:", [(k, robot_of(k).name, round(float(ratios[k][0]), 2)) for k in worst])
    print("diverged:", diverged, "in an error:", lost)
    for k in sorted(set(diverged[1] + lost[1])):
        print(k, [rows[Drive(number=k, path=p, network=asked.network)] for p in PATHS])
    if asked.robots >= 50 and asked.network == FAMILY:
        write_section("family", TITLE, "python -m benchmarks.family", "\n".join(text))


if __name__ == "__main__":
    main()
