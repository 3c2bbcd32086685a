"""Controllers against each other: tracking, sway after a move, limits, time, wrong parameters.

Run by hand: ``python -m benchmarks.controllers [--seeds N] [--steps N] [--parts NAME ...]``; two
processes. Each part is kept as soon as it is done, under ``benchmarks/controllers.parts``, and the
section is written anew from all that is there.
"""

from __future__ import annotations

import argparse
import multiprocessing
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

import carosac_toolkit as ct
from benchmarks.results import table, write_section
from carosac_toolkit import trajectories
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import CarosacError
from carosac_toolkit.loop import plugins
from carosac_toolkit.loop.loop import run
from carosac_toolkit.loop.protocols import FallbackSource
from carosac_toolkit.loop.values import Belief, Command, Measurement
from carosac_toolkit.pictures.style import (
    CONTROLLER_NUMBERS,
    DOUBLE_COLUMN_INCH,
    looks_by_name,
    styled,
)
from carosac_toolkit.robot.condition_file import find_condition
from carosac_toolkit.robot.perturbations import draw_plant
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.safety.settled import settled
from carosac_toolkit.studies.run.run_case import Truth
from carosac_toolkit.trajectories import Trajectory

COMMAND = "python -m benchmarks.controllers"
FIGURE = Path(__file__).parent / "controllers_sweep.png"
CONTROLLERS = {
    "straight_line": "straight_line",
    "kinematic_solver": "kinematic_solver",
    "input_shaping": "baselines.input_shaping:InputShaping",
    "mpc": "baselines.mpc:Mpc",
}
ESTIMATOR = "baselines.dynamic_estimator:DynamicEstimator"
SUITE = "lengths+imu"
ROBOTS = ("carosac", "scampi")
CALM, END = 4.0, 6.0  # [s] after a move: between them its residual sway is measured
LATE, HELD = 2.0, 10.0  # [s] of which sway is looked at, after so much longer a hold
MAIN, OUTER = "fast, centre", "fast, outer 10 %"
MOVES = {  # shares of the half box that hold both ends of a move; speed, acceleration
    MAIN: (0.0, 0.5, 2.0, 3.0),
    OUTER: (0.9, 1.0, 2.0, 3.0),
}
SMOOTH = "minimum snap, 1 m/s"
STILL = "held still"  # where the fast move ends: the sway that the wind makes by itself
WRONG = {
    "as known": {},
    "mass -20 %": {"mass": 0.8},
    "mass +20 %": {"mass": 1.2},
    "EA x 0.5": {"axial_stiffness": 0.5},
    "EA x 2": {"axial_stiffness": 2.0},
    "exits 2 cm": {"exits": 0.02},
}
STEPS = 10_000
FEWER = 10  # by this factor, where no bar is at stake
PARTS = ("time", "endurance", "bar", "moves", "hold", "sweep")
KEPT = Path(__file__).parent / "controllers.parts"
GALE = 0.023  # wind over weight: scampi's 1 N; its cables slacken at 6 N, a sixth of its weight


@dataclass(frozen=True, kw_only=True)
class Task:
    """One run: names, and what is wrong with the plant (None: nominal-1 drawn by the seed).

    A controller that `CONTROLLERS` does not know is named as the registry knows it, or as
    ``module:Class``; one that is a trained policy has its file in `policy`.
    """

    robot: str
    controller: str
    path: str
    seed: int
    estimator: str = ESTIMATOR
    wind: bool = True
    wrong: str | None = None
    policy: str | None = None
    held: float = 0.0  # [s] for which it holds still beyond `END`


def path_of(task: Task, robot: Robot) -> Trajectory:
    """The path of a task; the same for all controllers."""
    rng = np.random.default_rng([task.seed, 7])
    if task.path == SMOOTH:
        return trajectories.build("minimum_snap", robot, task.seed)
    inner, outer, speed, acceleration = MOVES[MAIN if task.path == STILL else task.path]
    middle = 0.5 * (robot.workspace_min + robot.workspace_max)
    half = 0.5 * (robot.workspace_max - robot.workspace_min)
    ends: list[Array] = []
    while len(ends) < 2:
        share = rng.uniform(-outer, outer, 3)
        far = not ends or np.linalg.norm(middle + half * share - ends[0]) > 1.0
        if np.abs(share).max() >= inner and far:
            ends.append(middle + half * share)
    if task.path == STILL:
        ends[0] = ends[1] + np.array([0.0, 0.0, 1e-3])  # a path needs some length
    return trajectories.line(*ends, speed_max=speed, acceleration_max=acceleration)


def plant_of(task: Task, robot: Robot) -> Robot:
    """The robot that is simulated."""
    rng = np.random.default_rng([task.seed, 11])
    if task.wrong is None:
        return draw_plant(robot, find_condition("nominal-1"), rng)
    changes: dict[str, Any] = {}
    for name, amount in WRONG[task.wrong].items():
        if name == "exits":
            off = rng.normal(size=robot.exit_points.shape)
            off *= amount / np.linalg.norm(off, axis=1, keepdims=True)
            changes["exit_points"] = robot.exit_points + off
        else:
            changes[name] = getattr(robot, name) * amount
    return replace(robot, **changes)


def make(task: Task, robot: Robot, path: Trajectory, **options: Any) -> tuple[Any, Any, Any]:
    """Driver, estimator and controller of a task."""
    chosen = plugins.load("controllers", CONTROLLERS.get(task.controller, task.controller))
    given = None if task.policy is None else chosen.Settings(policy=task.policy)
    controller = chosen.build(robot, given)
    kind = plugins.load("drivers", "simulator")
    windy = task.wind and task.wrong is None
    force = find_condition("nominal-1").of(robot).wind_force if windy else 0.0
    start = tuple(float(x) for x in path.sample(np.zeros(1)).position[0])
    settings = replace(
        kind.Settings(), suite=SUITE, period=controller.period, start_position=start,
        **{"wind_force": force} | options,
    )  # fmt: skip
    driver = kind.build(plant_of(task, robot), settled(settings, robot), seed=task.seed)
    if task.estimator == "truth":
        return driver, Truth(driver), controller
    return driver, plugins.load("estimators", task.estimator).build(robot), controller


def score(task: Task) -> dict[str, Any]:
    """Run and score; a run that ended in an error says so."""
    robot = ct.load_robot(task.robot)
    path = path_of(task, robot)
    driver, estimator, controller = make(task, robot, path)
    clock = Clock(controller)
    try:
        log = run(driver, estimator, clock, path, duration=path.duration + END + task.held)
    except CarosacError as failure:
        return {"task": task, "failed": str(failure)[:120]}
    assert log.position is not None and log.tension is not None
    error = np.linalg.norm(log.position - log.reference, axis=2)[:, 0]
    calm = log.position[log.time >= path.duration + CALM, 0]
    late = log.position[log.time >= log.time[-1] - LATE, 0]
    later = log.time > 0.5  # the first command meets the encoder bias
    tension = log.tension[later, 0]
    fallbacks = controller.fallbacks if isinstance(controller, FallbackSource) else {}
    return {
        "task": task,
        "rmse": float(np.sqrt((error**2).mean())),
        "sway": sway_of(calm),
        "late": sway_of(late),
        "rest": float(np.linalg.norm(calm.mean(axis=0) - log.reference[-1, 0])),
        "believed": float(np.sqrt(((log.belief_position - log.position) ** 2).sum(2).mean())),
        "low": float((robot.tension_min - tension).max()),
        "high": float((tension - robot.tension_max).max()),
        "slack": float((tension < robot.tension_min).any(axis=1).mean()),
        "limited": len({k for k, _ in log.limited if log.time[k] > 0.5}),
        "speed": float((np.abs(np.diff(log.command[:, 0], axis=0)) / controller.period
                        / robot.speed_max).max()),
        "fallbacks": sum(fallbacks.values()),
        "cycles": len(log.time),
        "latency": clock.cpu[5:],
    }  # fmt: skip


def sway_of(position: Array) -> float:
    """RMS distance of positions (K, 3) from their mean."""
    return float(np.sqrt(((position - position.mean(axis=0)) ** 2).sum(axis=1).mean()))


def mean(rows: Iterable[dict[str, Any]], name: str) -> float:
    """Root mean square over runs."""
    values = [row[name] for row in rows]
    return float(np.sqrt(np.mean(np.square(values)))) if values else float("nan")


def comparison(rows: Sequence[dict[str, Any]], names: Sequence[str]) -> str:
    """Who wins where."""
    lines = []
    keys = dict.fromkeys((r["task"].robot, r["task"].path, r["task"].wind, r["task"].estimator)
                         for r in rows)  # fmt: skip
    for robot, path, wind, estimator in keys:
        group = [
            r for r in rows
            if (t := r["task"]) and (t.robot, t.path, t.wind, t.estimator)
            == (robot, path, wind, estimator)
        ]  # fmt: skip
        best = {}
        for name in names:
            best[name] = [r for r in group if r["task"].controller == name and "rmse" in r]
        track = {name: 1e3 * mean(best[name], "rmse") for name in names}
        sway = {name: 1e3 * mean(best[name], "sway") for name in names}
        ran = [name for name in names if best[name]]
        runs = max(len(found) for found in best.values())
        lines.append((
            robot, path + ("" if wind else ", no wind"), estimator.split(":")[-1], str(runs),
            *(f"{track[n]:.1f} / {sway[n]:.2f}" if best[n] else "-" for n in names),
            min(ran, key=track.__getitem__), min(ran, key=sway.__getitem__),
            f"{1e3 * mean([r for n in names for r in best[n]], 'believed'):.1f}",
        ))  # fmt: skip
    header = ("robot", "path", "estimator", "seeds", *names, "best tracking", "least sway",
              "error of the estimator, all [mm]")  # fmt: skip
    return table(header, lines)


def bars(rows: Sequence[dict[str, Any]]) -> str:
    """The bars of the model predictive controller against the kinematic solver."""
    lines = []
    for robot in ROBOTS:
        for wind, estimator in ((True, ESTIMATOR), (True, "truth"), (False, ESTIMATOR)):
            both = []
            for name in ("mpc", "kinematic_solver"):
                wanted = (robot, name, MAIN, wind, estimator)
                both.append([r for r in rows if "rmse" in r and (
                    r["task"].robot, r["task"].controller, r["task"].path, r["task"].wind,
                    r["task"].estimator) == wanted])  # fmt: skip
            mpc, solver = both
            if not mpc or not solver:
                continue
            ratios = [mean(mpc, key) / mean(solver, key) for key in ("rmse", "sway")]
            lines.append((
                robot, estimator.split(":")[-1], "yes" if wind else "no", str(len(mpc)),
                f"{ratios[0]:.2f}", f"{ratios[1]:.2f}",
                f"{1e3 * mean(mpc, 'rest'):.1f}", f"{1e3 * mean(solver, 'rest'):.1f}",
                f"{max(r['low'] for r in mpc):.1f}", f"{max(r['high'] for r in mpc):.1f}",
                f"{100 * np.mean([r['slack'] for r in mpc]):.2f}",
                f"{100 * max(r['speed'] for r in mpc):.0f}",
                str(sum(r["limited"] for r in mpc)), str(sum(r["fallbacks"] for r in mpc)),
            ))  # fmt: skip
    header = (
        "robot", "estimator", "wind", "seeds", "tracking, share of kinematic_solver (bar 0.5)",
        "sway, share (bar 0.1)", "steady error [mm]", "of kinematic_solver [mm]",
        "worst tension below the minimum [N]", "above the maximum [N]",
        "time with a tension below [%]", "fastest command [% of the limit]",
        "commands the driver limited", "fallbacks",
    )  # fmt: skip
    return table(header, lines)


def degradation(rows: Sequence[dict[str, Any]], names: Sequence[str]) -> str:
    """Outer 10 % against centre, at the same speed."""
    lines = []
    for robot in ROBOTS:
        for name in names:
            found = []
            for path in (MAIN, OUTER):
                found.append([r for r in rows if r["task"].robot == robot and r["task"].wind
                              and r["task"].controller == name and r["task"].path == path
                              and r["task"].estimator == ESTIMATOR])  # fmt: skip
            good = [[r for r in group if "rmse" in r] for group in found]
            centre, outer = (1e3 * mean(group, "rmse") for group in good)
            lines.append((robot, name, f"{centre:.1f}", f"{outer:.1f}", f"{outer / centre:.2f}",
                          f"{1e3 * mean(good[1], 'sway'):.2f}",
                          str(len(found[1]) - len(good[1]))))  # fmt: skip
    header = ("robot", "controller", "centre [mm]", "outer 10 % [mm]", "ratio",
              "sway outside [mm]", "failed runs")  # fmt: skip
    return table(header, lines)


def solve_times() -> str:
    """Time of `command` on one core, compiled and interpreted."""
    from baselines.mpc import Mpc, MpcSettings

    lines = []
    for robot_name in ROBOTS:
        robot = ct.load_robot(robot_name)
        for compiled in ("auto", "never"):
            controller = Mpc.build(robot, MpcSettings(compiled=compiled))
            task = Task(robot=robot_name, controller="mpc", path=MAIN, seed=0, estimator="truth")
            path = path_of(task, robot)
            driver, estimator, _ = make(task, robot, path)
            clock = Clock(controller)
            run(driver, estimator, clock, path, duration=path.duration + 3.0)
            cpu, wall = (1e3 * np.array(values[5:]) for values in (clock.cpu, clock.wall))
            lines.append((
                robot_name, "compiled" if controller.record.compiled else "interpreted",
                str(len(cpu)), f"{np.median(cpu):.2f}", f"{np.quantile(cpu, 0.95):.2f}",
                f"{np.median(wall):.2f}", f"{np.quantile(wall, 0.95):.2f}",
            ))  # fmt: skip
    header = ("robot", "stage function", "commands", "CPU time, median [ms]",
              "CPU 95 % [ms] (bar 10, 20)", "wall, median [ms]", "wall 95 % [ms]")  # fmt: skip
    return table(header, lines)


class Clock:
    """A controller whose commands are timed."""

    def __init__(self, controller: Any) -> None:
        self._controller = controller
        self.period, self.horizon = controller.period, controller.horizon
        self.cpu: list[float] = []
        self.wall: list[float] = []

    def reset(self, belief: Belief) -> None:
        """Pass on."""
        self._controller.reset(belief)

    def command(self, belief: Belief, reference: Any) -> Command:
        """Pass on and time."""
        cpu, wall = time.process_time(), time.perf_counter()
        command: Command = self._controller.command(belief, reference)
        self.cpu.append(time.process_time() - cpu)
        self.wall.append(time.perf_counter() - wall)
        return command


class Faulty(Truth):
    """The truth with noise, without any twist for a second in ten, and with outliers."""

    def __init__(self, source: object, seed: int) -> None:
        super().__init__(source)
        self._rng = np.random.default_rng(seed)
        self._count = 0

    def update(self, belief: Belief, command: Command, measurement: Measurement) -> Belief:
        """The state now, or nearly so."""
        self._count += 1
        now = self.reset(measurement)
        assert now.twist is not None
        shift = 2e-3 * self._rng.normal(size=(1, 3))
        if self._count % 397 < 4:
            shift = shift + self._rng.uniform(-3.0, 3.0, size=(1, 3))
        twist = now.twist + 0.01 * self._rng.normal(size=(1, 6))
        return replace(
            now, position=now.position + shift, twist=None if self._count % 500 < 50 else twist
        )


def endurance(name: str, steps: int = STEPS) -> tuple[str, ...]:
    """Many steps to random targets in strong wind, with beliefs that fail."""
    robot = ct.load_robot(name)
    task = Task(robot=name, controller="mpc", path=MAIN, seed=1, estimator="truth")
    rng = np.random.default_rng(5)
    points = trajectories.draws.draw_points(robot, rng, count=120)
    path = trajectories.waypoints(points, speed_max=2.0, acceleration_max=3.0, rest=0.5)
    driver, _, controller = make(
        task, robot, path, wind_force=GALE * robot.weight, cables="catenary"
    )
    try:
        log = run(driver, Faulty(driver, 3), controller, path, duration=steps * controller.period)
        done, outcome = len(log.time), "none"
        assert log.position is not None
        error = np.linalg.norm(log.position - log.reference, axis=2)[:, 0]
        typical, worst = f"{1e3 * np.median(error):.1f}", f"{1e3 * error.max():.0f}"
    except CarosacError as error_:
        done, outcome, typical, worst = controller.record.commands, str(error_), "-", "-"
    record = controller.record
    return (name, str(done), outcome, str(dict(record.failures)), str(dict(record.fallbacks)),
            str(record.softened), str(record.held), typical, worst)  # fmt: skip


@styled
def draw_sweep(rows: Sequence[dict[str, Any]], names: Sequence[str]) -> None:
    """Tracking error and sway under wrong parameters."""
    from carosac_toolkit.pictures.drawing import new_figure, put_legend, set_log, set_title
    from carosac_toolkit.pictures.saving import save_picture

    figure = new_figure(DOUBLE_COLUMN_INCH, 4.6)
    grid = figure.subplots(2, len(ROBOTS), sharex=True)
    width = 0.8 / len(names)
    looks = looks_by_name(names, CONTROLLER_NUMBERS)
    for column, robot in enumerate(ROBOTS):
        for line, (key, label) in enumerate(
            (("rmse", "tracking error, RMS [mm]"), ("sway", "residual sway, RMS [mm]"))
        ):
            axes = grid[line][column]
            for k, name in enumerate(names):
                values = [
                    1e3 * mean([r for r in rows if "rmse" in r and r["task"].robot == robot
                                and r["task"].controller == name
                                and r["task"].wrong == wrong], key)
                    for wrong in WRONG
                ]  # fmt: skip
                place = np.arange(len(WRONG)) + (k - 0.5 * (len(names) - 1)) * width
                look = looks[k]
                axes.bar(
                    place, values, width, color=look.color, hatch=look.hatch, edgecolor="white",
                    lw=0.0, label=name,
                )  # fmt: skip
            set_log(axes, "y")
            axes.set(ylabel=label, axisbelow=True)
            axes.grid(axis="y", alpha=0.25)
            axes.set_xticks(np.arange(len(WRONG)), list(WRONG), rotation=30, ha="right")
            if line == 0:
                axes.set_title(robot)
    set_title(
        figure, f"{', '.join(ROBOTS)}: fast moves of a plant that differs from the robot file"
    )
    put_legend(figure, grid[0][0])
    save_picture(figure, FIGURE)


def tasks_of(names: Sequence[str], seeds: int) -> tuple[list[Task], list[Task]]:
    """The comparison and the sweep."""
    few = max(1, seeds // FEWER)
    main = []
    for robot in ROBOTS:
        for path in (*MOVES, SMOOTH):
            for name in names:
                count = seeds if path == MAIN and name != "straight_line" else few
                main += [Task(robot=robot, controller=name, path=path, seed=s)
                         for s in range(count)]  # fmt: skip
        main += [Task(robot=robot, controller="kinematic_solver", path=STILL, seed=s)
                 for s in range(max(1, seeds // 2))]  # fmt: skip
        for name in ("kinematic_solver", "mpc"):
            for more in ({"estimator": "truth"}, {"wind": False}):
                main += [Task(robot=robot, controller=name, path=MAIN, seed=s, **more)
                         for s in range(few)]  # fmt: skip
    sweep = [
        Task(robot=robot, controller=name, path=MAIN, seed=s, wrong=wrong)
        for robot in ROBOTS for wrong in WRONG for name in names for s in range(max(1, few // 2))
    ]  # fmt: skip
    return main, sweep


def all_of(pool: Any, tasks: Sequence[Task]) -> list[dict[str, Any]]:
    """Scores of all tasks, in their order; says how far it is."""
    rows = []
    for row in pool.imap(score, tasks):
        rows.append(row)
        if len(rows) % 20 == 0:
            print(f"{len(rows)} of {len(tasks)} runs", flush=True)
    return rows


def available() -> list[str]:
    """Controllers that are there; says which are not."""
    found = []
    for name, where in CONTROLLERS.items():
        try:
            plugins.load("controllers", where)
            found.append(name)
        except CarosacError as error:
            print(f"skipped: {name}: {error}", flush=True)
    return found


def bar_part(pool: Any, seeds: int) -> str:
    """The fast moves alone, of the two controllers that the bars are about."""
    names = ("kinematic_solver", "mpc")
    tasks = [Task(robot=robot, controller=name, path=MAIN, seed=seed)
             for robot in ROBOTS for name in names for seed in range(seeds)]  # fmt: skip
    rows = all_of(pool, tasks)
    return f"The fast moves alone:\n\n{comparison(rows, names)}\n\n{bars(rows)}{ended(rows)}"


def moves_part(pool: Any, names: Sequence[str], seeds: int) -> str:
    """The comparison, the bars and the outer part of the box."""
    rows = all_of(pool, tasks_of(names, seeds)[0])
    return (
        "Entries of the first table are tracking RMSE / residual sway from 4 to 6 s after the move,"
        " in mm, root mean squares over the seeds; the wind blows on through the rest. `mpc` sees "
        "the belief and corrects the believed position: it cannot be better than its estimator.\n\n"
        + "\n\n".join((comparison(rows, names), bars(rows), degradation(rows, names)))
        + ended(rows)
    )


def sweep_part(pool: Any, names: Sequence[str], seeds: int) -> str:
    """Wrong parameters."""
    rows = all_of(pool, tasks_of(names, seeds)[1])
    draw_sweep(rows, names)
    return "![Tracking error and sway with wrong parameters](controllers_sweep.png)" + ended(rows)


def hold_part(pool: Any, seeds: int) -> str:
    """Holding still for long near a face of the box, where a cable hardly pulls."""
    names = ("kinematic_solver", "input_shaping", "mpc")
    tasks = [
        Task(robot=robot, controller=name, path=OUTER, seed=seed, held=HELD)
        for robot in ROBOTS for name in names for seed in range(seeds)
    ]  # fmt: skip
    rows = all_of(pool, tasks)
    lines = []
    for robot in ROBOTS:
        for name in names:
            late = [
                1e3 * r["late"] for r in rows
                if "late" in r and (r["task"].robot, r["task"].controller) == (robot, name)
            ]  # fmt: skip
            lines.append((robot, name, str(len(late)), f"{np.median(late):.1f}",
                          f"{np.quantile(late, 0.9):.1f}", f"{max(late):.1f}"))  # fmt: skip
    header = ("robot", "controller", "seeds", "median [mm]", "90 % [mm]", "worst [mm]")
    return (
        f"Holding still in the wind near a face of the box, {END + HELD:g} s after a fast move; "
        f"sway in the last {LATE:g} s:\n\n{table(header, lines)}{ended(rows)}"
    )


def endurance_part(pool: Any, steps: int) -> str:
    """Many commands to random targets."""
    header = ("robot", "commands", "unhandled", "failures", "fallbacks", "plans over a soft limit",
              "commands held to limits", "median error [mm]", "worst [mm]")  # fmt: skip
    lasted = pool.map(partial(endurance, steps=steps), ROBOTS, chunksize=1)
    return (
        f"Random targets at 2 m/s and 3 m/s^2, wind of {100 * GALE:.1f} % of the weight, noisy "
        "beliefs without twist for a tenth of the time, and 3 m off for 4 of 397 commands:\n\n"
        + table(header, lasted)
    )


def ended(rows: Sequence[dict[str, Any]]) -> str:
    """How many runs ended in an error, and how the first of them did."""
    failed = [r for r in rows if "failed" in r]
    return f"\n\nRuns that ended in an error: {len(failed)}" + "".join(
        f"; {r['task'].controller}, {r['task'].path}: {r['failed']}" for r in failed[:5]
    )


def write_parts() -> None:
    """The section, from the parts that are kept."""
    kept = [(KEPT / f"{part}.md").read_text() for part in PARTS if (KEPT / f"{part}.md").exists()]
    head = f"Driver `simulator`, cables `particles`, condition `nominal-1`, suite `{SUITE}`."
    write_section("controllers", "Controllers", COMMAND, "\n\n".join([head, *kept]))


def main() -> None:
    """Measure and write the section, part by part."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--steps", type=int, default=STEPS, help="of the run to random targets")
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=PARTS)
    asked = parser.parse_args()
    names = available()
    KEPT.mkdir(exist_ok=True)
    with multiprocessing.get_context("spawn").Pool(2) as pool:
        parts: dict[str, Callable[[], str]] = {
            "time": solve_times,
            "endurance": partial(endurance_part, pool, asked.steps),
            "bar": partial(bar_part, pool, asked.seeds),
            "moves": partial(moves_part, pool, names, asked.seeds),
            "hold": partial(hold_part, pool, asked.seeds),
            "sweep": partial(sweep_part, pool, names, asked.seeds),
        }
        for part in asked.parts:
            print(f"part: {part}", flush=True)
            text = parts[part]()
            (KEPT / f"{part}.md").write_text(f"{text}\n\nSeeds: {asked.seeds}.")
            write_parts()
            print(text, flush=True)


if __name__ == "__main__":
    main()
