"""The workspace against an independent linear program, and its speed.

Straight cables, random poses in and around the frame (position and orientation): the margin of
each pose beside that of `scipy.optimize.linprog` (HiGHS), which gets a structure matrix made here
from the geometry alone. Then the time for 1e5 poses of `carosac` with sag: rest with a free
orientation, stability, tensions, winch lengths, distance of cables. CPU and wall time, medians.

    python -m benchmarks.workspace            # all: about five minutes
    python -m benchmarks.workspace --poses 300 --repeats 1
"""

from __future__ import annotations

import argparse
import os
import time
from typing import NamedTuple

import numpy as np
from scipy.optimize import linprog
from scipy.spatial.transform import Rotation

import carosac_toolkit as ct
from benchmarks.results import table, write_section
from carosac_toolkit.physics.rest import tension_margin
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.workspace import WorkspaceSettings, box_grid, compute, judge

UNSURE = 1e-6  # [N]: a margin this small may fall on either side


class Agreement(NamedTuple):
    """One robot against the linear program.

    Attributes:
        poses: How many were compared.
        feasible: How many of them the linear program finds feasible.
        unsure: Those with a margin of at most `UNSURE`, which do not count.
        wrong: Other poses where a verdict differs, of `tension_margin.solve` and of `judge`.
        unsolved: Poses without an answer of ours.
        difference: Largest difference of margins over 1 N + |margin|, of the same two.
    """

    poses: int
    feasible: int
    unsure: int
    wrong: tuple[int, int]
    unsolved: tuple[int, int]
    difference: tuple[float, float]


def random_poses(robot: Robot, count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Positions in the frame and its surroundings, turned by up to 30 degrees at random."""
    rng = np.random.default_rng(seed)
    lower = np.minimum(robot.exit_points.min(axis=0), robot.workspace_min)
    upper = np.maximum(robot.exit_points.max(axis=0), robot.workspace_max)
    position = rng.uniform(lower, upper + 0.05 * (upper - lower), (count, 3))
    turn = Rotation.from_rotvec(rng.uniform(-0.3, 0.3, (count, 3))).as_matrix()
    return position, turn @ robot.home_rotation


def linear_program(robot: Robot, position: np.ndarray, rotation: np.ndarray) -> float:
    """Largest margin of straight cables without pulleys at one pose [N], by HiGHS."""
    arm = robot.anchor_points @ rotation.T
    cable = robot.exit_points - position - arm
    unit = cable / np.linalg.norm(cable, axis=1, keepdims=True)
    matrix = np.vstack([unit.T, np.cross(arm, unit).T])
    weight = np.array([0.0, 0.0, -robot.mass * robot.gravity])
    load = np.concatenate([weight, np.cross(rotation @ robot.center_of_mass, weight)])
    eye, ones = np.eye(robot.n), np.ones((robot.n, 1))
    answer = linprog(
        np.append(np.zeros(robot.n), -1.0),
        A_ub=np.block([[-eye, ones], [eye, ones]]),
        b_ub=np.concatenate([-robot.tension_min, robot.tension_max]),
        A_eq=np.hstack([matrix, np.zeros((6, 1))]),
        b_eq=-load,
        bounds=[(None, None)] * (robot.n + 1),
        method="highs",
    )
    if answer.status != 0:
        raise RuntimeError(f"HiGHS: {answer.message}")
    return float(answer.x[-1])


def compare(robot: Robot, count: int, seed: int = 0) -> Agreement:
    """Margins of random poses, ours and those of the linear program."""
    position, rotation = random_poses(robot, count, seed)
    theirs = np.array(
        [linear_program(robot, p, r) for p, r in zip(position, rotation, strict=True)]
    )
    matrix = ct.structure_matrix(robot, position, rotation)
    weight = np.array([0.0, 0.0, -robot.weight])
    moment = np.cross(rotation @ robot.center_of_mass, weight)
    load = np.hstack([np.broadcast_to(weight, moment.shape), moment])
    program = tension_margin.solve(matrix, load, robot.tension_min, robot.tension_max)
    straight = WorkspaceSettings(sag=False, clearance=None)
    verdicts = judge(robot, position, rotation, settings=straight)
    sure = np.abs(theirs) > UNSURE
    ours = (program.margin, verdicts.margin)
    solved = (program.solved, ~np.isnan(verdicts.margin))
    wrong, unsolved, difference = [], [], []
    for margin, done in zip(ours, solved, strict=True):
        wrong.append(int((sure & ((margin >= 0.0) != (theirs >= 0.0))).sum()))
        unsolved.append(int((~done).sum()))
        difference.append(float(np.nanmax(np.abs(margin - theirs) / (1.0 + np.abs(theirs)))))
    return Agreement(
        poses=count,
        feasible=int((theirs >= 0.0).sum()),
        unsure=int((~sure).sum()),
        wrong=(wrong[0], wrong[1]),
        unsolved=(unsolved[0], unsolved[1]),
        difference=(difference[0], difference[1]),
    )


def speed(name: str, count: int, repeats: int) -> tuple[float, float, float, int, int]:
    """Wall and CPU time of a workspace [s], share inside, positions and those not converged."""
    robot = ct.load_robot(name)
    grid = box_grid(robot.workspace_min, robot.workspace_max, count)
    compute(robot, box_grid(robot.workspace_min, robot.workspace_max, 100))
    wall, cpu = [], []
    for _ in range(repeats):
        start, started = time.perf_counter(), time.process_time()
        region = compute(robot, grid)
        wall.append(time.perf_counter() - start)
        cpu.append(time.process_time() - started)
    positions = len(region.verdicts.margin)
    return float(np.median(wall)), float(np.median(cpu)), region.share, positions, region.unknown


def agreement_table(count: int) -> str:
    """Both robots against the linear program."""
    rows = []
    for name in ("ipanema1", "cogiro"):
        found = compare(ct.load_robot(name), count)
        rows += [
            [
                name, who, f"{found.poses}", f"{found.feasible}", f"{found.unsure}",
                f"{found.wrong[k]}", f"{found.unsolved[k]}", f"{found.difference[k]:.0e}",
            ]
            for k, who in enumerate(("tension_margin.solve", "workspace.judge, straight"))
        ]  # fmt: skip
        print(*rows[-2:], sep="\n", flush=True)
    header = [
        "robot", "ours", "poses", "feasible", f"margin under {UNSURE:g} N", "wrong verdicts",
        "not solved", "largest difference / (1 N + margin)",
    ]  # fmt: skip
    return table(header, rows)


def speed_table(count: int, repeats: int) -> str:
    """Time of the workspaces with sag."""
    rows = []
    for name in ("carosac", "scampi", "ipanema1", "cogiro"):
        wall, cpu, share, positions, unknown = speed(name, count, repeats)
        rows.append(
            [
                name, f"{positions}", f"{wall:.1f}", f"{cpu:.1f}", f"{cpu / positions * 1e6:.0f}",
                f"{share:.1%}", f"{unknown}",
            ]
        )  # fmt: skip
        print(rows[-1], flush=True)
    header = [
        "robot", "positions", "wall [s]", "CPU [s]", "CPU [us a pose]", "inside", "not converged",
    ]  # fmt: skip
    return table(header, rows)


def main() -> None:
    """Compare, time and write the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--poses", type=int, default=10_000)
    parser.add_argument("--positions", type=int, default=104_000)
    parser.add_argument("--repeats", type=int, default=5)
    chosen = parser.parse_args()
    agreement = agreement_table(chosen.poses)
    times = speed_table(chosen.positions, chosen.repeats)
    load = os.getloadavg()[0]
    body = (
        "Straight cables against `scipy.optimize.linprog` (HiGHS), random poses in and around the "
        f"frame, turned by up to 30 degrees.\n\n{agreement}\n\nBar: no wrong verdict where the "
        f"margin is over {UNSURE:g} N.\n\n"
        "With sag, in the box of the robot file: rest (orientation free with four cables), "
        f"stability, tensions, winch lengths, distance of cables. One process, median of "
        f"{chosen.repeats}, load average {load:.1f} at the end.\n\n{times}\n\n"
        "Bar: 1e5 poses of `carosac` in under 10 s."
    )
    write_section("workspace", "Workspace", "python -m benchmarks.workspace", body)


if __name__ == "__main__":
    main()
