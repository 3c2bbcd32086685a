"""Faults at random times on the emulated PLC: are they named, and how soon are the winches at rest?

    python -m benchmarks.guard_faults --trials 20 [--faults trip jump ...]

Host and PLC are two processes; the PLC counts what it was asked for beyond its limits. A trial is
right where the fault has the name it should have, the winches come to rest, nothing beyond a limit
was commanded, enabling is refused before a reset, and the recording reads back whole.
"""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
import threading
import time
import warnings
from collections import defaultdict
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from baselines.kinematic_solver import KinematicSolver
from baselines.kinematic_solver_controller import KinematicSolverController
from carosac_toolkit import trajectories
from carosac_toolkit.cli.plc import take_priority
from carosac_toolkit.crash_safe import CrashSafeRecorder, CutRecording, read_run
from carosac_toolkit.drivers.drive_state import Fault
from carosac_toolkit.drivers.guarded_ads import GuardedAds, GuardedAdsSettings
from carosac_toolkit.drivers.lifecycle import IllegalTransition
from carosac_toolkit.errors import CarosacError
from carosac_toolkit.live.rehearsal import rehearse
from carosac_toolkit.loop import run
from carosac_toolkit.plc.machine_blocks import Injection
from carosac_toolkit.values import Command
from tests.plc_process import PlcProcess

PERIOD = 0.01
REST = 1e-3  # [m/s] below which a winch counts as at rest
OVER = ("over_length", "over_speed", "over_acceleration", "over_jerk", "not_finite")
WANTED = {
    "trip": (Fault.DRIVE_TRIP,), "jump": (Fault.ENCODER_JUMP, Fault.FOLLOWING_ERROR),
    "freeze_counter": (Fault.STALE_DATA, Fault.LOST_CONNECTION),
    "freeze_data": (Fault.STALE_DATA, Fault.FOLLOWING_ERROR, Fault.LOST_CONNECTION),
    "network": (Fault.LOST_CONNECTION, Fault.HEARTBEAT_LOST, Fault.STALE_DATA),
    "plc_stopped": (Fault.LOST_CONNECTION, Fault.HEARTBEAT_LOST, Fault.STALE_DATA),
    "plc_killed": (Fault.LOST_CONNECTION, Fault.STALE_DATA),
    "heartbeat": (Fault.HEARTBEAT_LOST, Fault.LOST_CONNECTION),
    "raises": (Fault.CONTROLLER,), "hangs": (Fault.CONTROLLER,), "nan": (Fault.COMMAND,),
    "out_of_range": (Fault.COMMAND,), "diverges": (Fault.ESTIMATOR,),
    "ctrl_c": (), "kill_9": (),
}  # fmt: skip


class Controller(KinematicSolverController):
    """Works until it is told to fail."""

    fails = ""

    def command(self, belief, reference):
        """As its base does, or wrong."""
        command = super().command(belief, reference)
        lengths = command.unstrained_length
        if self.fails == "raises":
            raise ZeroDivisionError("a bug")
        if self.fails == "hangs":
            time.sleep(2.0)
        if self.fails == "nan":
            return Command(time=command.time, unstrained_length=lengths * np.nan)
        if self.fails == "out_of_range":
            return Command(time=command.time, unstrained_length=lengths + 2.0)
        return command


class Estimator(KinematicSolver):
    """Works until it runs away."""

    runs_away = 0.0

    def update(self, belief, command, measurement):
        """As its base does, and farther off every time."""
        from dataclasses import replace

        found = super().update(belief, command, measurement)
        if self.runs_away:
            self.runs_away += 0.02
            found = replace(found, position=found.position + np.array([self.runs_away, 0.0, 0.0]))
        return found


class Winches:
    """Watches how fast the PLC turns them, until it is ended."""

    def __init__(self, plc: PlcProcess) -> None:
        self._client, self._over = plc.client(), threading.Event()
        self._seen: list[tuple[float, float]] = []
        self._thread = threading.Thread(target=self._look, daemon=True)
        self._thread.start()

    def _look(self) -> None:
        while not self._over.wait(0.01):
            try:
                speed = 1e-3 * np.abs(self._client.diagnosis()["set_speed"]).max()
            except CarosacError:
                return
            self._seen.append((time.monotonic(), float(speed)))

    def end(self) -> None:
        """Look no more."""
        self._over.set()
        self._thread.join()
        self._client.close()

    def at_rest(self, since: float) -> float | None:
        """Time from `since` until they rested for good [s]; None where they did not."""
        if not self._seen or self._seen[-1][1] > REST:
            return None
        moving = [when for when, speed in self._seen if speed > REST]
        return max(0.0, moving[-1] - since) if moving else 0.0


def inject(fault: str, plc: PlcProcess, guard: GuardedAds, controller, estimator, rng) -> None:
    """Make something fail now."""
    if fault in ("raises", "hangs", "nan", "out_of_range"):
        controller.fails = fault
    elif fault == "diverges":
        estimator.runs_away = 0.02
    elif fault == "plc_stopped":
        plc.signal(signal.SIGSTOP)
        threading.Timer(0.5, plc.signal, [signal.SIGCONT]).start()
    elif fault == "plc_killed":
        plc.process.kill()
    elif fault == "heartbeat":
        guard.inner.link._write = lambda: None
    else:
        with plc.client() as client:
            axis = int(rng.integers(1, 5)) if fault in ("trip", "jump") else 0
            sign = rng.choice([-1.0, 1.0])
            value = {"jump": 0.05 * sign, "network": 0.3}.get(fault, 1.0)
            second = 0.2 if fault == "network" else 0.0
            client.inject(Injection[fault.upper()], axis=axis, value=value, second=second)


def inside(fault: str, plc: PlcProcess, rng: np.random.Generator, folder: Path) -> dict:
    """One trial with the host in this process."""
    robot = plc.robot
    points = robot.home_position + np.array([[0, 0, 0], [0.6, 0.5, 0.4], [-0.5, 0.4, 0.8]] * 6)
    path = trajectories.waypoints(points, speed_max=0.8, acceleration_max=1.0, rest=0.0)
    settings = GuardedAdsSettings(
        period=PERIOD, motion=True, overrun_share=1.0, inner={"lost_after": 0.1},
        start_position=tuple(float(x) for x in points[0]),
    )  # fmt: skip
    guard = GuardedAds.build(robot, settings)
    recorder = CrashSafeRecorder(folder / f"{time.monotonic_ns()}.jsonl")
    guard.journal = recorder
    controller = Controller.build(robot, Controller.Settings(period=PERIOD))
    estimator = Estimator.build(robot)
    rehearse(robot, estimator, controller, path, suite="lengths")
    when, began, found = float(rng.uniform(0.8, 4.0)), [0.0], {}
    winches: list[Winches] = [Winches(plc)]

    def watch(step) -> None:
        if not began[0] and float(step.measurement.time[0]) > when:
            with plc.client() as counted:
                before.update({name: counted.diagnosis()[name] for name in OVER})
            began[0] = time.monotonic()
            inject(fault, plc, guard, controller, estimator, rng)

    before: dict = {}
    close, guard.close = guard.close, lambda: None  # ours, after the checks
    with plc.client() as client:
        first = {name: client.diagnosis()[name] for name in OVER}
    try:
        run(guard, estimator, controller, path, watch=watch, keep=1)
    except Exception as error:
        found["error"] = f"{type(error).__name__}: {error}"
    named = guard.fault
    time.sleep(0.8)
    found["told"] = time.monotonic() - began[0]
    try:
        guard.enable()
        found["enabled"] = True
    except (IllegalTransition, CarosacError):
        found["enabled"] = False
    close()
    winches[0].end()
    if plc.process.poll() is None:
        reset(plc)
    recorder.close()
    found |= {
        "fault": None if named is None else named.fault, "text": str(named),
        "rest": winches[0].at_rest(began[0]) if began[0] else None, "rows": whole(recorder.path),
        "began": bool(began[0]),
    }  # fmt: skip
    if plc.process.poll() is None:
        with plc.client() as client:
            after = client.diagnosis()
        found["over"] = {name: after[name] - before.get(name, 0) for name in OVER}
        found["over_at_start"] = {name: before.get(name, 0) - first[name] for name in OVER}
    return found


def reset(plc: PlcProcess) -> None:
    """Take the cause away and reset the latched fault, as an operator does."""
    with plc.client() as client:
        client.inject(Injection.CLEAR)
    time.sleep(0.5)  # the PLC lets go of the host that is gone
    guard = GuardedAds.build(plc.robot, GuardedAdsSettings(motion=True, enable_at_once=False))
    guard.connect()
    try:
        for _ in range(5):  # a fault of the PLC is seen within a few cycles
            guard.measure()
            guard.wait(PERIOD)
        if guard.fault is not None:
            guard.reset_fault()
    finally:
        guard.close()


def outside(fault: str, plc: PlcProcess, rng: np.random.Generator, folder: Path) -> dict:
    """One trial with ``carosac run`` in a process of its own, which is really killed."""
    path = folder / f"{time.monotonic_ns()}.jsonl"
    words = [sys.executable, "-m", "carosac_toolkit.cli.main", "run", "--robot", str(plc.file),
             "--driver", "ads", "--enable", "--priority", "--speed", "0.8", "--acceleration", "1",
             "--recording", str(path), "--set", "driver.inner.lost_after=0.1"]  # fmt: skip
    with plc.client() as client:
        before = {name: client.diagnosis()[name] for name in OVER}
    winches = Winches(plc)
    host = subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    while not (path.exists() and '"following"' in path.read_text()) and host.poll() is None:
        time.sleep(0.02)
    time.sleep(float(rng.uniform(1.5, 5.0)))
    began = time.monotonic()
    host.send_signal(signal.SIGINT if fault == "ctrl_c" else signal.SIGKILL)
    status = host.wait(30.0)
    time.sleep(0.8)
    winches.end()
    with plc.client() as client:
        after = client.diagnosis()
    reset(plc)
    good = status == (130 if fault == "ctrl_c" else -signal.SIGKILL)
    return {
        "fault": None, "text": f"status {status}", "rest": winches.at_rest(began),
        "rows": whole(path), "enabled": False, "began": good,
        "over": {name: after[name] - before[name] for name in OVER},
    }  # fmt: skip


def whole(path: Path) -> int:
    """Measurements in a recording; 0 where it does not read back."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", CutRecording)
        return len(read_run(path).recording.time)


def main() -> int:
    """Run all trials and print a line for each kind."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--trials", type=int, default=20)
    parser.add_argument("--faults", nargs="*", default=list(WANTED))
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    rng = np.random.default_rng(options.seed)
    sys.setswitchinterval(1e-3)
    priority = os.sched_getscheduler(0) if hasattr(os, "sched_getscheduler") else 0
    take_priority()
    bad = 0
    with TemporaryDirectory() as folder:
        plc = PlcProcess()
        for fault in options.faults:
            rows = defaultdict(list)
            for _ in range(options.trials):
                if plc.process.poll() is not None:
                    plc.kill()
                    plc = PlcProcess()
                trial = outside if fault in ("ctrl_c", "kill_9") else inside
                found = trial(fault, plc, rng, Path(folder))
                right = (
                    found["began"] and not found["enabled"] and found["rows"] > 0
                    and (found["rest"] is not None or fault == "plc_killed")
                    and not any(found.get("over", {}).values())
                    and (not WANTED[fault] or found["fault"] in WANTED[fault])
                )  # fmt: skip
                rows["right"].append(right)
                rows["rest"].append(found["rest"])
                rows["start"].append(any(found.get("over_at_start", {}).values()))
                rows["fault"].append(str(found["fault"]))
                if not right:
                    print(f"  {fault}: {found}", flush=True)
            rest = [x for x in rows["rest"] if x is not None]
            names = {name: rows["fault"].count(name) for name in sorted(set(rows["fault"]))}
            times = f"median {np.median(rest):.3f} s, most {max(rest):.3f} s" if rest else "unknown"
            print(f"{fault:<15} right {sum(rows['right'])} of {options.trials}; at rest after "
                  f"{times}; named {names}; over a limit before it: "
                  f"{sum(rows['start'])}", flush=True)  # fmt: skip
            bad += options.trials - sum(rows["right"])
        plc.kill()
    if priority == 0 and hasattr(os, "sched_setscheduler"):
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main())
