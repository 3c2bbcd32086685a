"""Time of one call of the limiter on one core: undisturbed, and where a limit is in the way."""

from __future__ import annotations

import time
from collections.abc import Iterable

import numpy as np

import carosac_toolkit as ct
from benchmarks.results import table, write_section
from carosac_toolkit.loop.values import Command
from carosac_toolkit.physics.cable.straight_line import inverse_kinematics
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.safety.limiter import Limiter

STEPS = 1500


def figure_eight(robot: Robot, period: float) -> np.ndarray:
    """Lengths (T, 1, n) along a smooth closed path through most of the workspace box."""
    t = np.arange(STEPS) * period
    swell = np.clip(t / 2.0, 0.0, 1.0)
    swell = swell**3 * (10 - 15 * swell + 6 * swell**2)
    center = 0.5 * (robot.workspace_min + robot.workspace_max)
    half = 0.3 * (robot.workspace_max - robot.workspace_min)
    w = 1.0 / half.max()  # about 1 m/s
    wave = np.column_stack([np.sin(w * t), np.sin(2 * w * t) / 2.0, np.sin(w * t) / 2.0])
    return inverse_kinematics(robot, center + swell[:, None] * half * wave)[:, None]


def times(robot: Robot, period: float, lengths: Iterable[np.ndarray]) -> tuple[np.ndarray, int]:
    """CPU time of each call [s], and how many calls were limited."""
    rows = list(lengths)
    limiter = Limiter(robot, period=period)
    limiter.reset(rows[0])
    spent, limited = [], 0
    for k, length in enumerate(rows):
        command = Command(time=np.array([k * period]), unstrained_length=length)
        start = time.process_time()
        limited += bool(limiter.apply(command, length).limited)
        spent.append(time.process_time() - start)
    return np.array(spent[5:]), limited


def main() -> None:
    """Measure all bundled robots and write the table."""
    rows = []
    for name in ct.list_robots():
        robot = ct.load_robot(name)
        for period in (0.01, 0.001):
            smooth = figure_eight(robot, period)
            rng = np.random.default_rng(0)
            rough = smooth + 0.1 * np.repeat(rng.standard_normal(smooth[::50].shape), 50, axis=0)
            rough[0] = smooth[0]
            cells = [name, f"{period * 1e3:.0f}"]
            for lengths in (smooth, rough):
                spent, limited = times(robot, period, lengths)
                cells += [
                    f"{100 * limited / STEPS:.0f}",
                    f"{np.median(spent) * 1e6:.0f}",
                    f"{np.percentile(spent, 99) * 1e6:.0f}",
                ]
            rows.append(cells)
            print(rows[-1], flush=True)
    header = ["robot", "period [ms]"]
    for case in ("smooth", "jumps"):
        header += [f"{case}: limited [%]", "median [us]", "99 % [us]"]
    note = (
        "\n\nBar: under 100 us where nothing is limited. Smooth: a figure of eight at about 1 m/s; "
        "jumps: the same with jumps of 0.1 m (1 sigma) in every cable, each held for 50 periods."
    )
    write_section(
        "speed:limits", "Speed of the limiter", "python -m benchmarks.limits",
        table(header, rows) + note,
    )  # fmt: skip


if __name__ == "__main__":
    main()
