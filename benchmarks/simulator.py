"""Speed and accuracy of the simulator on one core, beside MuJoCo 4 in the same run.

CPU time of this process, medians. ``python -m benchmarks.simulator`` needs the extra `bench`.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import carosac_toolkit as ct
from benchmarks import mujoco_cables
from benchmarks.mujoco_cables import CABLE_DRAG, cpu_time, rms, settle_errors, swing_path
from benchmarks.results import table, write_section
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.pictures.drawing import new_figure, put_legend, set_title
from carosac_toolkit.pictures.saving import save_picture
from carosac_toolkit.pictures.style import (
    DOUBLE_COLUMN_INCH,
    SERIES_COLORS,
    SERIES_MARKERS,
    styled,
)
from carosac_toolkit.robot.robot import Robot
from sim_warp import Simulator

COMMAND = "python -m benchmarks.simulator"
PICTURE = Path(__file__).parent / "simulator.png"
DISTANCE_MIN_MM = 1e-7  # [mm] that is drawn
CONTROL = 0.1  # s, one control step of the throughput
REPEATS = 30


class OurCables:
    """One world with the interface of `mujoco_cables.MujocoCables`."""

    warnings = 0

    def __init__(self, robot: Robot, cables: str, segments: int, step: float, drag: float) -> None:
        """Make it; `reset` before anything else."""
        self.robot = robot
        self.name = f"{cables} N={segments}" if cables in ("particles", "xpbd") else cables
        self._simulator = Simulator(
            robot, cables=cables, segments=segments, time_step=step, cable_drag=drag
        )
        self._length = np.zeros((1, robot.n))

    def reset(self, position: Array, rotation: Array, unstrained_length: Array) -> None:
        """Rest on lengths; the pose follows from them."""
        self._length = unstrained_length[None]
        self._simulator.reset(unstrained_length=self._length)

    def set_lengths(self, unstrained_length: Array) -> None:
        """Where the lengths go in the next step."""
        self._length = unstrained_length[None]

    def kick(self, linear_velocity: Array) -> None:
        """Start over with a velocity."""
        twist = np.concatenate([linear_velocity, np.zeros(3)])[None]
        self._simulator.reset(unstrained_length=self._length, twist=twist)

    def step(self, duration: float) -> None:
        """Simulate."""
        self._simulator.follow(self._length, duration)

    @property
    def position(self) -> Array:
        """Platform origin [m]."""
        return self._simulator.state.position.numpy()[0].copy()

    @property
    def mid_sag(self) -> Array:
        """Distance of the middle of each cable from its chord [m]."""
        shape = self._simulator.cable_points()[0]
        middle = shape[:, shape.shape[1] // 2]
        return mujoco_cables.distance_to_chord(middle, shape[:, 0], shape[:, -1])


OURS = (
    ("particles", 16, 1 / 100), ("particles", 10, 1 / 100), ("particles", 8, 1 / 100),
    ("particles", 16, 1 / 200), ("particles", 16, 1 / 1000), ("catenary", 0, 1 / 100),
    ("straight", 0, 1 / 100), ("xpbd", 16, 1 / 1000),
)  # fmt: skip


def accuracy(robot: Robot) -> list[dict[str, Any]]:
    """Rows as those of `mujoco_cables.measure`, for our models."""
    bare = replace(robot, run_length=np.zeros(robot.n))
    calm = replace(bare, drag=0.0, angular_drag=0.0)
    thick = replace(bare, drag=60.0, angular_drag=10.0)
    points = swing_path(
        mujoco_cables.point_masses(
            calm, 10, mujoco_cables.REFERENCE_STEP, cable_drag=CABLE_DRAG, integrator="RK4"
        )
    )
    rows = []
    for cables, segments, step in OURS:

        def build(
            robot: Robot, drag: float, step: float = step, c: str = cables, n: int = segments
        ) -> Any:
            return OurCables(robot, c, n or 16, step, drag)

        own = swing_path(build(calm, CABLE_DRAG, 2e-4 if cables != "xpbd" else 1e-4))
        path = swing_path(build(calm, CABLE_DRAG))
        rows.append(
            {
                "model": build(bare, CABLE_DRAG).name,
                "step_s": step,
                "cpu_s_per_s": cpu_time(build(bare, CABLE_DRAG)),
                **settle_errors(build(thick, 5.0), bare),
                "swing_rms_mm": rms(path, own),
                "swing_points_mm": rms(path, points),
            }
        )
    return rows


def throughput(robot: Robot) -> list[list[str]]:
    """Ratio to real time along smooth paths, for one world and for many."""
    rows = []
    for cables, segments, step, worlds, bar in (
        ("particles", 16, 1 / 120, 1, "100"), ("particles", 16, 1 / 120, 256, "200"),
        ("particles", 8, 1 / 120, 1, "-"), ("particles", 8, 1 / 120, 256, "450"),
        ("particles", 16, 1 / 240, 256, "-"), ("catenary", 16, 1 / 70, 1, "800"),
        ("catenary", 16, 1 / 70, 1024, "3000"), ("straight", 16, 1 / 120, 1024, "-"),
    ):  # fmt: skip
        call, simulator = smooth_motion(robot, cables, segments, step, worlds)
        times = []
        iterations = []
        for k in range(REPEATS):
            start = time.process_time()
            call(k)
            times.append(time.process_time() - start)
            iterations.append(simulator.state.iterations.numpy().mean())
        cost = float(np.median(times))
        name = f"{cables} N={segments}" if cables == "particles" else cables
        rows.append(
            [f"{name}, 1/{1 / step:.0f} s, {worlds} world{'s' * (worlds > 1)}", bar,
             f"{worlds * CONTROL / cost:.0f}", f"{1e6 * cost / worlds:.1f}",
             f"{np.mean(iterations):.1f}"]
        )  # fmt: skip
    return rows


def smooth_motion(
    robot: Robot, cables: str, segments: int, step: float, worlds: int
) -> tuple[Callable[[int], None], Simulator]:
    """Worlds that follow circles of 0.3 m, each with its own phase; and one control step of it."""
    simulator = Simulator(robot, worlds=worlds, cables=cables, segments=segments, time_step=step)
    phase = 2.0 * np.pi * np.arange(worlds) / worlds
    paths = []
    for k in range(REPEATS + 1):
        angle = phase + 0.8 * CONTROL * k
        out = np.column_stack([np.cos(angle), np.sin(angle), 0.5 * np.sin(angle)])
        paths.append(
            ct.statics.inverse_kinematics(robot, robot.home_position + 0.3 * out).unstrained_length
        )
    simulator.reset(unstrained_length=paths[0])

    def call(k: int) -> None:
        simulator.step(paths[k + 1], CONTROL)

    return call, simulator


@styled
def draw(rows: list[dict[str, Any]]) -> None:
    """Accuracy against speed, both ways of measuring accuracy; each row has a mark of its own."""
    figure = new_figure(DOUBLE_COLUMN_INCH, 4.4)
    panels = figure.subplots(1, 2)
    for panel, key, title in (
        (panels[0], "settle_mm", "at rest, from the exact equilibrium"),
        (panels[1], "swing_points_mm", "in a swing of 12 s, from 10 point masses at 16 µs"),
    ):
        for k, row in enumerate(rows):
            x, y = 1.0 / row["cpu_s_per_s"], max(row[key], DISTANCE_MIN_MM)
            panel.plot(
                x, y, SERIES_MARKERS[k % len(SERIES_MARKERS)], ms=6, alpha=0.8, ls="",
                color=SERIES_COLORS[int(row["model"].startswith("MuJoCo"))],
                mfc="none" if k >= len(SERIES_MARKERS) else None,
                label=f"{row['model']}, {1e3 * row['step_s']:g} ms",
            )  # fmt: skip
        panel.set(
            xscale="log", yscale="log", xlabel="times real time, one world on one core",
            ylabel="distance [mm]",
        )  # fmt: skip
        panel.set_title(title)
        panel.grid(alpha=0.25)
        panel.margins(0.1)
    set_title(figure, "carosac: accuracy and speed of simulators, ours (blue) and MuJoCo")
    put_legend(figure, panels[0])
    save_picture(figure, PICTURE)


def main() -> None:
    """Measure, draw and write."""
    robot = ct.load_robot("carosac")
    speed = table(
        ["model", "bar", "times real time", "us a control step and world", "Newton steps, most"],
        throughput(robot),
    )
    print(speed, flush=True)
    theirs = mujoco_cables.measure(robot)
    for row in theirs:
        row["model"] = f"MuJoCo {row['model']}"
    rows = accuracy(robot) + theirs
    draw(rows)
    head = [k for k in rows[0] if k != "warnings"]
    texts = [[row[k] if isinstance(row[k], str) else f"{row[k]:.3g}" for k in head] for row in rows]
    side = table(head, texts)
    best = next(row for row in theirs if row["model"].startswith("MuJoCo points, 10"))
    ratios = [
        f"{row['model']} at {1e3 * row['step_s']:g} ms: "
        f"{best['cpu_s_per_s'] / row['cpu_s_per_s']:.1f} times"
        for row in rows
        if row["model"].startswith(("particles", "catenary"))
    ]
    body = (
        "Along smooth paths, winches included; control steps of 0.1 s.\n\n"
        f"{speed}\n\nOne world, new lengths every 10 ms, `run_length` 0; the columns are those of "
        "`benchmarks/mujoco_cables.py`; `swing_rms_mm` is from the same model at a tiny step.\n\n"
        f"{side}\n\nSpeed over that of MuJoCo's best model with true sag, {best['model']} at "
        f"{1e3 * best['step_s']:g} ms: {'; '.join(ratios)}.\n\n![accuracy and speed](simulator.png)"
    )
    write_section("simulator", "Simulator: speed, beside MuJoCo 4", COMMAND, body)
    print(body)


if __name__ == "__main__":
    main()
