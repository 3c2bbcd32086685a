"""Each fault at random times while `carosac run` follows a circle on the emulated PLC.

``python -m benchmarks.hardware_faults [times] [fault ...]``; 20 times each makes RESULTS.md.
Host and PLC are processes of their own, and are really killed and frozen. What the winches do is
seen from the PLC's side, through a connection of its own.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable
from ctypes import c_int
from dataclasses import dataclass, field
from multiprocessing import Value
from pathlib import Path
from typing import Any

import numpy as np

import carosac_toolkit as ct
from baselines.kinematic_solver import KinematicSolver
from baselines.kinematic_solver_controller import KinematicSolverController
from benchmarks.results import table, write_section
from carosac_toolkit.base.errors import CarosacError
from carosac_toolkit.cli import run as run_command
from carosac_toolkit.live.real_time import quick_threads, take_priority
from carosac_toolkit.loop.drive_state import Fault
from carosac_toolkit.loop.values import Belief, Command, Measurement, Reference
from carosac_toolkit.plc import blocks
from carosac_toolkit.plc.blocks import Injection
from carosac_toolkit.plc.emulator.client import PlcClient
from carosac_toolkit.plc.emulator.emulator import Emulator
from carosac_toolkit.plc.emulator.settings import EmulatorSettings
from carosac_toolkit.recordings.crash_safe import read_run
from carosac_toolkit.robot.file import parse_robot, robot_text

TIMES = 20
PATIENCE = 12.0  # [s] for anything to happen
MOVING = 0.1  # [m/s] from which on a fault may come
NOTICED = 0.2  # [s] of silence that either side takes for a fault: other programs run here
STATED = 1.0  # [s] from the fault to rest: to notice it, 0.5 s from 2.5 m/s, and the machine
NOT_HELD = ("PLC killed", "Ctrl-C")  # nobody is left who could hold the fault, or there is none
ASKED = "then reset"  # what a start says that a fault of before refuses
OVER = ("over_length", "over_speed", "over_acceleration", "over_jerk", "not_finite", "jumps")
NOTHING, RAISES, HANGS, NAN, FAR, DIVERGES = range(6)
WHAT = Value(c_int, NOTHING)  # what controller and estimator do wrong, from the parent process


class Wrong(KinematicSolverController):
    """The kinematic solver until it is told to fail."""

    def command(self, belief: Belief, reference: Reference) -> Command:
        """Do what the parent process says."""
        asked = super().command(belief, reference)
        if WHAT.value == RAISES:
            raise ZeroDivisionError("a bug")
        if WHAT.value == HANGS:
            time.sleep(30.0)
        lengths = np.array(asked.unstrained_length)
        if WHAT.value == NAN:
            lengths[0, 1] = np.nan
        elif WHAT.value == FAR:
            lengths[0, 1] = 60.0
        return Command(time=asked.time, unstrained_length=lengths)


class Diverging(KinematicSolver):
    """The kinematic solver until it is told to diverge, at 4 m/s."""

    started: float | None = None

    def update(self, belief: Belief, command: Command, measurement: Measurement) -> Belief:
        """Add what grows."""
        found = super().update(belief, command, measurement)
        if WHAT.value != DIVERGES:
            return found
        now = float(measurement.time[0])
        self.started = now if self.started is None else self.started
        away = np.array([[4.0 * (now - self.started), 0.0, 0.0]])
        return Belief(time=found.time, position=found.position + away, rotation=found.rotation)


@dataclass
class Trial:
    """What is running, and what came of it."""

    ip: str
    folder: Path
    plc: int = 0
    host: int = 0
    client: Any = None
    rest: float | None = None
    said: str = "-"
    over: int = 0
    rows: int = 0
    moved: float = 0.0  # [s] from the first motion to the fault
    recorded: float = 0.0  # [s]
    problems: list[str] = field(default_factory=list)


def child(work: Callable[[], int], output: Path) -> int:
    """Run something in a process of its own; its number."""
    sys.stdout.flush()
    number = os.fork()
    if number:
        return number
    status = 1
    try:
        os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
        said = os.open(output, os.O_WRONLY | os.O_CREAT)
        for stream in (1, 2):
            os.dup2(said, stream)
        status = work()
    except BaseException:
        traceback.print_exc()
    finally:
        os._exit(status)


def plc(trial: Trial, check: bool) -> int:
    """The PLC process."""
    take_priority("plc")
    robot = ct.load_robot(trial.folder / "robot.yaml")
    settings = EmulatorSettings(encoder_check=check, shift=0.1, watchdog=NOTICED)
    emulator = Emulator(robot, robot, settings, seed=os.getpid())
    signal.signal(signal.SIGTERM, lambda *_: emulator.stop())
    with quick_threads():
        emulator.run()
    emulator.close()
    return 0


def host(trial: Trial, name: str = "run") -> int:
    """The host process: the command itself."""
    take_priority("host")
    options = run_command.Options(
        robot=str(trial.folder / "robot.yaml"), driver="ads",
        controller="benchmarks.hardware_faults:Wrong",
        estimator="benchmarks.hardware_faults:Diverging", trajectory="circle", enable=True,
        home=tuple(float(x) for x in ct.load_robot("carosac").home_position), home_anew=True,
        settings=(f"driver.stale_time={NOTICED}", f"driver.hang_time={NOTICED}",
                  f"driver.inner.lost_after={NOTICED}"),
        speed=0.8, acceleration=0.8, recording=trial.folder / f"{name}.jsonl",
    )  # fmt: skip
    result = run_command.run(options)
    said = {key: result.data[key] for key in ("fault", "reason")}
    (trial.folder / f"{name}.json").write_text(json.dumps(said))
    return result.status


def prepare(trial: Trial, check: bool) -> None:
    """Start both and wait until the winches move."""
    hardware = f"\nhardware:\n  ads: {{net_id: {trial.ip}.1.1, ip: {trial.ip}}}\n  cables:\n"
    ways = ("{sign: 1, scale: 1 mm, offset: 0.5 m}", "{sign: -1, scale: 1 mm, offset: 25 m}")
    names = ct.load_robot("carosac").cable_names
    cables = "\n".join(f"    {name}: {ways[i % 2]}" for i, name in enumerate(names))
    text = robot_text("carosac") + hardware + cables + "\n"
    parse_robot(text)
    (trial.folder / "robot.yaml").write_text(text)
    WHAT.value = NOTHING
    trial.plc = child(lambda: plc(trial, check), trial.folder / "plc.txt")
    until(lambda: connected(trial), "the PLC did not start")
    trial.host = child(lambda: host(trial), trial.folder / "host.txt")
    until(lambda: speed(trial) > MOVING, "the winches did not move")


def connected(trial: Trial) -> bool:
    """Connect beside the host."""
    try:
        trial.client = PlcClient(4, trial.ip)
    except CarosacError:
        return False
    return True


def speed(trial: Trial) -> float:
    """Largest set velocity now [m/s]."""
    return float(np.abs(trial.client.diagnosis()["set_speed"]).max()) * 1e-3


def until(condition: Callable[[], bool], message: str, patience: float = PATIENCE) -> float:
    """Wait for something; how long it took [s]."""
    began = time.monotonic()
    while not condition():
        if time.monotonic() - began > patience:
            raise TimeoutError(message)
        time.sleep(0.002)
    return time.monotonic() - began


def ended(number: int) -> bool:
    """Whether a process has ended; it is taken away then."""
    try:
        return os.waitpid(number, os.WNOHANG)[0] == number
    except ChildProcessError:
        return True


def state(trial: Trial) -> tuple[int, int]:
    """State and fault of the PLC."""
    from carosac_toolkit.plc.blocks import to_host

    block = to_host(4)
    values = block.unpack(trial.client.read("CaRoSaC.to_host", block.size))
    return values["state"], values["fault"]


def wrong(what: int) -> Callable[[Trial], None]:
    """Have controller or estimator fail."""

    def inject(trial: Trial) -> None:
        WHAT.value = what

    return inject


SLOW = {"network 0.3 s late": 1.0}  # [s] for which it is late; counts in the time to rest
FAULTS: dict[str, tuple[Callable[[Trial], Any], str]] = {
    "PLC killed": (lambda t: os.kill(t.plc, signal.SIGKILL), "lost_connection stale_data"),
    "PLC frozen": (lambda t: os.kill(t.plc, signal.SIGSTOP), "lost_connection stale_data"),
    "host frozen": (lambda t: os.kill(t.host, signal.SIGSTOP), "heartbeat_lost"),
    "host killed -9": (lambda t: os.kill(t.host, signal.SIGKILL), "heartbeat_lost"),
    "Ctrl-C": (lambda t: os.kill(t.host, signal.SIGINT), "none"),
    "encoder jump, seen by the PLC": (
        lambda t: t.client.inject(Injection.JUMP, 1, 0.05), "encoder_jump"),
    "encoder jump, seen by the host": (
        lambda t: t.client.inject(Injection.JUMP, 1, 0.05), "encoder_jump closure"),
    "drive trip": (lambda t: t.client.inject(Injection.TRIP, 2), "drive_trip"),
    "PLC counter frozen": (
        lambda t: t.client.inject(Injection.FREEZE_COUNTER), "stale_data"),
    "PLC data frozen": (lambda t: t.client.inject(Injection.FREEZE_DATA), "stale_data"),
    "network 0.3 s late": (
        lambda t: t.client.write(*late()), "lost_connection stale_data heartbeat_lost"),
    "command NaN": (wrong(NAN), "command controller"),
    "command out of range": (wrong(FAR), "command"),
    "controller raises": (wrong(RAISES), "controller"),
    "controller hangs": (wrong(HANGS), "controller"),
    "estimator diverges": (wrong(DIVERGES), "estimator"),
}  # fmt: skip


def late(number: int = 1001, delay: float = 0.3) -> tuple[str, bytes]:
    """What to write to have every answer come later [s]."""
    values = {"number": number, "kind": int(Injection.NETWORK), "value": delay}
    return blocks.CONTROL, blocks.control().pack(values)


def run_trial(name: str, rng: np.random.Generator, number: int) -> Trial:
    """One fault at one random time."""
    inject, allowed = FAULTS[name]
    ip = f"127.{20 + os.getpid() % 200}.{1 + number // 250}.{1 + number % 250}"
    with tempfile.TemporaryDirectory() as folder:
        trial = Trial(ip=ip, folder=Path(folder))
        try:
            prepare(trial, check="by the host" not in name)
            trial.moved = rng.uniform(0.0, 2.0)
            time.sleep(trial.moved)
            watch(trial, name, inject)
            judge(trial, name, allowed)
            try_again(trial, name)
        except (TimeoutError, CarosacError) as error:
            sys.stdout.flush()
            said = [(trial.folder / f"{who}.txt").read_text()[-600:] for who in ("plc", "host")]
            trial.problems.append(" ".join([str(error), *said]))
        finally:
            for process in (trial.host, trial.plc):
                with contextlib.suppress(ProcessLookupError):
                    os.kill(process, signal.SIGKILL)
                with contextlib.suppress(ChildProcessError):
                    os.waitpid(process, 0)
            if trial.client is not None:
                trial.client.close()
    return trial


def watch(trial: Trial, name: str, inject: Callable[[Trial], Any]) -> None:
    """Inject, and wait for rest as the PLC sees it; for the end of the host where it is gone."""
    began = time.monotonic()
    inject(trial)
    if name == "PLC killed":
        until(lambda: ended(trial.host), "the host did not end")
        trial.rest = time.monotonic() - began
        return
    if name == "PLC frozen":
        until(lambda: ended(trial.host), "the host did not end")
        os.kill(trial.plc, signal.SIGCONT)
        began = time.monotonic()
    if name in SLOW:
        time.sleep(SLOW[name])  # what we see is late as well
        trial.client.write(*late(1002, 0.0))
    until(lambda: speed(trial) == 0.0, "the winches did not come to rest")
    trial.rest = time.monotonic() - began


def judge(trial: Trial, name: str, allowed: str) -> None:
    """What is said of it, and whether any limit was passed."""
    frozen = name in ("host frozen", "host killed -9")
    if frozen:
        time.sleep(0.1)
        trial.said = str(list(Fault)[state(trial)[1]])
    else:
        until(lambda: ended(trial.host), "the host did not end")
    result = trial.folder / "run.json"
    if result.exists():
        trial.said = json.loads(result.read_text())["fault"] or "none"
    if name != "PLC killed":
        found = trial.client.diagnosis()
        counts = {key: int(found[key]) for key in OVER if found[key]}
        trial.over = sum(counts.values())
        if counts:
            shares = {key: found[key] for key in found if key.startswith("worst")}
            trial.problems.append(f"{counts}, {shares}")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # where the process was killed, half a row may be left
        found_time = read_run(trial.folder / "run.jsonl").recording.time
    trial.rows, trial.recorded = len(found_time), float(np.ptp(found_time))
    trial.problems += problems(trial, name, allowed)


def try_again(trial: Trial, name: str) -> None:
    """Start the command once more as it was: a fault that nobody has reset lets nothing move."""
    if name in NOT_HELD:
        return
    with contextlib.suppress(ProcessLookupError):
        os.kill(trial.host, signal.SIGKILL)
    until(lambda: ended(trial.host), "the host did not end")
    WHAT.value = NOTHING
    trial.host = child(lambda: host(trial, "again"), trial.folder / "again.txt")
    fastest = 0.0
    began = time.monotonic()
    while not ended(trial.host) and time.monotonic() - began < PATIENCE:
        fastest = max(fastest, speed(trial))
        time.sleep(0.002)
    said = (trial.folder / "again.txt").read_text()
    if fastest > 0.0:
        trial.problems.append(f"moved again without a reset: {fastest:.2f} m/s")
    elif ASKED not in said:
        trial.problems.append(f"no word of a reset: {said[-300:]}")


def problems(trial: Trial, name: str, allowed: str) -> list[str]:
    """What is not as it must be."""
    rest = trial.rest or 0.0
    checks = {
        f"said {trial.said}, not {allowed}": trial.said not in allowed.split(),
        f"{trial.over} commands over a limit": trial.over > 0,
        f"{rest:.2f} s to rest": rest > STATED + SLOW.get(name, 0.0) and name != "PLC killed",
        f"{trial.recorded:.2f} s recorded of {trial.moved:.2f} s": trial.recorded < trial.moved,
    }
    return [problem for problem, found in checks.items() if found]


def main() -> None:
    """Run all, print and write the table."""
    words = sys.argv[1:]
    times = int(words[0]) if words else TIMES
    chosen = words[1:] or list(FAULTS)
    warm_up()
    rng = np.random.default_rng(0)
    rows, number = [], 0
    for name in chosen:
        trials = []
        for _ in range(times):
            number += 1
            trials.append(run_trial(name, rng, number))
        rest = [t.rest for t in trials if t.rest is not None]
        bad = [problem for t in trials for problem in t.problems]
        said = ", ".join(f"{k} {v}" for k, v in Counter(t.said for t in trials).items())
        worst = f"{np.median(rest):.2f} / {max(rest):.2f}" if rest else "-"
        rows.append([name, worst, said, str(sum(t.over for t in trials)),
                     str(min(t.rows for t in trials)), str(len(bad))])  # fmt: skip
        print(rows[-1], *bad, sep="\n    ", flush=True)
    header = ["fault", "to rest, median / largest [s]", "named", "commands over a limit",
              "fewest rows recorded", "trials with a problem"]  # fmt: skip
    text = table(header, rows)
    print(text)
    if times >= TIMES and len(chosen) == len(FAULTS):
        command = "python -m benchmarks.hardware_faults"
        write_section("hardware_faults", "Faults on the emulated PLC", command, text)


def warm_up() -> None:
    """Load what both processes need before they are forked."""
    from carosac_toolkit import trajectories
    from carosac_toolkit.loop import plugins
    from carosac_toolkit.loop.loop import run as loop

    robot = ct.load_robot("carosac")
    made = Wrong.build(robot, Wrong.Settings(period=0.01), seed=0)
    kind = plugins.load("drivers", "simulator")
    driver = kind.build(robot, kind.Settings(period=0.01, cables="catenary"), seed=0)
    path = trajectories.build("circle", robot, 0)
    loop(driver, Diverging.build(robot, None, seed=0), made, path, duration=0.3)


if __name__ == "__main__":
    from benchmarks import hardware_faults

    hardware_faults.main()  # by its name, as the processes find the plug-ins of this file
