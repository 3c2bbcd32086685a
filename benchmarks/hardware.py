"""The emulated PLC in a process of its own: 100 Hz with estimator and controller, 500 Hz without.

``python -m benchmarks.hardware [seconds]``; 600 s is what RESULTS.md shows.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

import carosac_toolkit as ct
from benchmarks.results import table, write_section
from carosac_toolkit.live.real_time import short_pauses, take_priority
from carosac_toolkit.loop import plugins
from carosac_toolkit.loop.loop import Step, run
from carosac_toolkit.loop.values import State
from carosac_toolkit.plc.driver import PlcDriver, PlcDriverSettings
from carosac_toolkit.plc.emulator.client import PlcClient
from carosac_toolkit.plc.guarded import GuardedAds, GuardedAdsSettings
from carosac_toolkit.safety.guard import GuardedDriver
from carosac_toolkit.trajectories.arcs import circle

SECONDS = 600.0
FAST = 0.002  # [s], 500 Hz
PATIENCE = 0.25  # [s] that host and PLC wait for each other: other programs run here
FAST_SHARE = 0.05  # of the seconds, for 500 Hz
RADIUS, SPEED = 0.5, 0.25  # [m], [m/s] of the circle; slow, as a stop by the watchdog makes it sway
COUNTS = ("over_length", "over_speed", "over_acceleration", "over_jerk", "not_finite", "lost",
          "watchdog", "commands")  # fmt: skip


class Plc:
    """``carosac plc`` for as long as the context lasts."""

    def __init__(self, report: Path) -> None:
        self._report = report

    def __enter__(self) -> Plc:
        self._process = subprocess.Popen(
            [sys.executable, "-m", "carosac_toolkit.cli.main", "plc", "carosac", "--control",
             "--priority", "--shift", "0.1",
             "--watchdog", str(PATIENCE), "--json", str(self._report)],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        )  # fmt: skip
        assert self._process.stdout is not None
        assert "ready" in self._process.stdout.readline()
        return self

    def __exit__(self, *_: object) -> None:
        self._process.communicate(timeout=20.0)


def quantiles(values: list[float] | np.ndarray) -> list[str]:
    """p50, p99, p99.9 and the largest, in ms."""
    found = np.quantile(np.asarray(values), [0.5, 0.99, 0.999, 1.0])
    return [f"{1e3 * x:.2f}" for x in found]


def controlled(seconds: float) -> tuple[dict[str, list[float]], GuardedDriver, float]:
    """A circle at 100 Hz with the kinematic solver; wall times per cycle [s]."""
    robot = ct.load_robot("carosac")
    controller = plugins.load("controllers", "kinematic_solver")
    estimator = plugins.load("estimators", "kinematic_solver")
    made = controller.build(robot, controller.Settings(period=0.01), seed=0)
    center = 0.5 * (robot.workspace_min + robot.workspace_max)
    turns = max(1, round(SPEED * seconds / (2.0 * np.pi * RADIUS)))
    path = circle(center=center, radius=RADIUS, turns=turns, speed_max=SPEED,
                  acceleration_max=SPEED)  # fmt: skip
    x, y, z = (float(v) for v in path.sample(np.zeros(1)).position[0])
    driver = GuardedAds.build(
        robot,
        GuardedAdsSettings(
            motion=True, period=0.01, start_position=(x, y, z), stale_time=PATIENCE,
            hang_time=PATIENCE, overrun_share=1.0, home_anew=True,
            inner={"lost_after": PATIENCE, "start_position": (x, y, z)},
        ),
    )  # fmt: skip
    ticks: dict[str, list[float]] = {"tick": [], "round_trip": [], "error": []}

    def watch(step: Step) -> None:
        exchange = driver.inner.exchange
        ticks["tick"].append(time.monotonic())
        ticks["round_trip"].append(exchange.counters.round_trip)
        if step.truth is not None:
            off = step.truth.position[0] - step.reference.position[0, 0]
            ticks["error"].append(float(np.linalg.norm(off)))

    began = time.monotonic()
    run(driver, estimator.build(robot, None, seed=0), made, path,
        duration=min(seconds, path.duration), watch=watch, keep=1)  # fmt: skip
    return ticks, driver, time.monotonic() - began


def bare(seconds: float) -> tuple[list[float], list[float], PlcDriver]:
    """Read and write at 500 Hz, holding; intervals and round trips [s]."""
    robot = ct.load_robot("carosac")
    driver = PlcDriver(robot, PlcDriverSettings(motion=True, period=FAST, io_period=10 * FAST))
    driver.connect()
    try:
        home = State(time=np.zeros(1), position=robot.home_position[None], rotation=np.eye(3)[None])
        driver.home(home)
        driver.enable()
        exchange = driver.exchange
        assert exchange is not None and exchange.reading is not None
        held = exchange.reading.values["set_length"]
        ticks, trips = [], []
        for _ in range(round(seconds / FAST)):
            began = time.monotonic()
            exchange.send(held, np.zeros(robot.n), FAST)
            exchange.wait_for_data(began, 0.1)
            ticks.append(time.monotonic())
            trips.append(ticks[-1] - began)
            driver.wait(FAST)
    finally:
        driver.close()
    return list(np.diff(ticks)), trips, driver


def main() -> None:
    """Measure and write the table."""
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else SECONDS
    take_priority("host")
    with tempfile.TemporaryDirectory() as folder, short_pauses():
        report = Path(folder) / "plc.json"
        with Plc(report):
            ticks, driver, wall = controlled(seconds)
            with PlcClient(4) as client:
                seen = client.diagnosis()
            intervals, trips, fast = bare(max(2.0, FAST_SHARE * seconds))
        plc = json.loads(report.read_text())
    step = np.diff(ticks["tick"])
    missed = int((np.round(step / 0.01) - 1).clip(0).sum())
    late = int((np.round(np.array(intervals) / FAST) - 1).clip(0).sum())
    rows = [
        ["100 Hz: time between two commands", *quantiles(step)],
        ["100 Hz: distance of that from 10 ms", *quantiles(np.abs(step - 0.01))],
        ["100 Hz: read and write over TCP", *quantiles(ticks["round_trip"])],
        ["500 Hz: time between two commands", *quantiles(intervals)],
        ["500 Hz: command written, answer read", *quantiles(trips)],
    ]
    gap = 1e3 * driver.inner.link_counters.gap_max
    fault = "none" if driver.fault is None else str(driver.fault)
    counts = ", ".join(f"{name.replace('_', ' ')} {seen[name]}" for name in COUNTS)
    error = 1e3 * float(np.sqrt(np.mean(np.square(ticks["error"]))))
    text = "\n".join([
        table(["[ms]", "p50", "p99", "p99.9", "largest"], rows), "",
        f"100 Hz for {wall:.0f} s, {len(ticks['tick'])} commands of the kinematic solver on a "
        f"circle of {RADIUS} m at {SPEED} m/s: {missed} ticks missed, fault: {fault}, largest gap "
        f"of the link {gap:.0f} ms, tracking error {error:.1f} mm RMS. "
        f"500 Hz: {len(trips)} cycles, {late} missed, {fast.overruns} overruns.", "",
        f"PLC ({plc['cycles']} cycles of 5 ms, {plc['overruns']} late, {plc['lost_time']:.2f} s "
        f"lost), after 100 Hz: {counts}; largest share of a limit commanded: speed "
        f"{seen['worst_speed']:.2f}, acceleration {seen['worst_acceleration']:.2f}, jerk "
        f"{seen['worst_jerk']:.2f}.",
    ])  # fmt: skip
    print(text)
    if seconds >= SECONDS:
        command = "python -m benchmarks.hardware"
        write_section("hardware", "Emulated PLC in real time", command, text)


if __name__ == "__main__":
    main()
