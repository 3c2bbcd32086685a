"""Speed of the statics on one core, beside a plain scipy solver in the same run.

CPU time of this process, medians. The reference solves the same equations (pose and end forces of
all cables, closed-form catenaries in numpy) with `scipy.optimize.root` from the same near guess.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from scipy.optimize import root
from scipy.spatial.transform import Rotation

import carosac_toolkit as ct
from benchmarks.results import table, write_section
from carosac_toolkit.robot.robot import Robot

REPEATS = 300
STEP_SHARE = 5e-4  # of the mean cable length: how far lengths swing from call to call
VERTICAL_SHARE = 1e-9  # of the weight: a smaller horizontal tension is that of a vertical cable


def cpu_time(call: Callable[[], object], repeats: int) -> float:
    """Median CPU time of a call [s]."""
    times = []
    for _ in range(repeats):
        start = time.process_time()
        call()
        times.append(time.process_time() - start)
    return float(np.median(times))


def scipy_solver(robot: Robot, length: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    """Residuals of pose (position, rotation vector) and tension vectors at the exits."""
    n, w, ea = robot.n, robot.weight_per_length, robot.axial_stiffness

    def residual(x: np.ndarray) -> np.ndarray:
        q = x[6:].reshape(n, 3) * robot.weight
        turn = Rotation.from_rotvec(x[3:6]).as_matrix()
        arm = robot.anchor_points @ turn.T
        tension = np.linalg.norm(q, axis=1)
        free = length + robot.run_length * (tension / ea) / (1.0 + tension / ea)
        h = np.maximum(np.hypot(q[:, 0], q[:, 1]), VERTICAL_SHARE * robot.weight)
        low = q[:, 2] - w * free
        stretch = free / ea + (np.arcsinh(q[:, 2] / h) - np.arcsinh(low / h)) / w
        rise = (np.hypot(h, q[:, 2]) - np.hypot(h, low)) / w
        rise += (q[:, 2] - w * free / 2.0) * free / ea
        reach = np.column_stack([q[:, :2] * stretch[:, None], rise])
        closure = x[:3] + arm + reach - robot.exit_points
        force = np.column_stack([q[:, :2], low])
        load = np.array([0.0, 0.0, -robot.weight])
        center = turn @ robot.center_of_mass
        moment = np.cross(arm, force).sum(axis=0) + np.cross(center, load)
        balance = np.concatenate([force.sum(axis=0) + load, moment]) / robot.weight
        return np.concatenate([balance, closure.ravel()])

    return residual


def near_calls(robot: Robot) -> tuple[float, float, float]:
    """FK call to call from a near guess: ours, the reference [s], and how far they differ [m]."""
    start = ct.statics.inverse_kinematics(robot, robot.home_position[None])
    size = float(start.unstrained_length.mean())
    state = {"guess": start, "k": 0}

    def ours() -> None:
        state["k"] += 1
        step = STEP_SHARE * size * np.sin(0.1 * state["k"] + np.arange(robot.n))
        state["guess"] = ct.statics.forward_kinematics(
            robot, start.unstrained_length + step, guess=state["guess"]
        )

    ours()
    mine = cpu_time(ours, REPEATS)
    if robot.pulley_radius.any():  # the reference knows no pulleys
        return mine, np.nan, np.nan
    found = state["guess"]
    x0 = np.concatenate(
        [
            start.position[0],
            Rotation.from_matrix(start.rotation[0]).as_rotvec(),
            (start.exit_tension[0] / robot.weight).ravel(),
        ]
    )
    residual = scipy_solver(robot, found.unstrained_length[0])
    answers = []
    theirs = cpu_time(lambda: answers.append(root(residual, x0, tol=1e-12)), 20)
    if not np.abs(answers[-1].fun).max() < 1e-9:  # also refuses NaN
        raise RuntimeError(f"{robot.name}: the reference does not converge: {answers[-1].message}")
    return mine, theirs, float(np.abs(answers[-1].x[:3] - found.position[0]).max())


def batches(robot: Robot, size: int = 1000) -> tuple[float, float, float]:
    """IK, cold FK and seeded FK, per pose [s]; seeds are rest poses 5 mm away per axis."""
    rng = np.random.default_rng(0)
    where = rng.uniform(robot.workspace_min, robot.workspace_max, (2 * size, 3))
    kept = where[ct.statics.inverse_kinematics(robot, where).converged][:size]
    there = ct.statics.inverse_kinematics(robot, kept)
    length = there.unstrained_length
    moved = ct.statics.inverse_kinematics(robot, kept + 5e-3 * rng.standard_normal(kept.shape))
    return (
        cpu_time(lambda: ct.statics.inverse_kinematics(robot, kept), 11) / size,
        cpu_time(lambda: ct.statics.forward_kinematics(robot, length), 11) / size,
        cpu_time(lambda: ct.statics.forward_kinematics(robot, length, guess=moved), 11) / size,
    )


def main() -> None:
    """Measure all bundled robots and write the table."""
    rows = []
    for name in ct.list_robots():
        robot = ct.load_robot(name)
        mine, theirs, difference = near_calls(robot)
        inverse, cold, seeded = batches(robot)
        rows.append(
            [
                name,
                f"{mine * 1e6:.0f}",
                f"{theirs * 1e6:.0f}",
                f"{theirs / mine:.0f}",
                f"{difference:.0e}",
                f"{seeded * 1e6:.1f}",
                f"{cold * 1e6:.1f}",
                f"{inverse * 1e6:.1f}",
            ]
        )
        print(rows[-1], flush=True)
    header = [
        "robot",
        "FK, call to call [us]",
        "scipy, same start [us]",
        "ratio",
        "they differ by [m]",
        "FK seeded, 1000 [us a pose]",
        "FK cold, 1000 [us a pose]",
        "IK, 1000 [us a pose]",
    ]
    note = (
        "\n\nBars: call to call under 150 us, seeded batch under 30 us a pose, cold under 150 us. "
        "The compiled solver of the SCAMPI authors needs about 700 us (FK) and 2300 us (IK)."
    )
    write_section("speed:statics", "Speed of the statics", "make bench", table(header, rows) + note)


if __name__ == "__main__":
    main()
