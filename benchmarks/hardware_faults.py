"""Each fault at random times while `carosac run` follows a circle on the emulated PLC.

``python -m benchmarks.hardware_faults [times] [fault ...] [--jobs N]``; 60 times each makes
RESULTS.md. Host and PLC are processes of their own, and are really killed and frozen. Between them
is a proxy (`benchmarks.fault_wire`) that sees every command and can disturb the connection; a
reader of its own sees every set point, and `benchmarks.fault_judge` judges them. Neither the
counters of the PLC nor those of the driver are asked.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import traceback
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
from benchmarks import fault_judge
from benchmarks.fault_wire import Disturbance, Observer, layout, observed
from benchmarks.results import table, write_section
from carosac_toolkit.base.errors import CarosacError
from carosac_toolkit.cli import run as run_command
from carosac_toolkit.live.real_time import short_pauses, take_priority
from carosac_toolkit.loop.drive_state import Fault
from carosac_toolkit.loop.values import Belief, Command, Measurement, Reference
from carosac_toolkit.plc.blocks import Injection
from carosac_toolkit.plc.emulator.client import PlcClient
from carosac_toolkit.plc.emulator.emulator import Emulator
from carosac_toolkit.plc.emulator.settings import EmulatorSettings
from carosac_toolkit.robot.file import parse_robot, robot_text

TIMES = 60
PATIENCE_S = 12.0  # for anything to happen
POLL_S = 0.01  # between two looks at the PLC
MOVING = 0.1  # [m/s] from which on a fault may come
SHIFT_M, NEW_HOME_SHIFT_M = 0.05, 0.3  # of the encoders; beyond 0.1 m the first way is slow
SILENCE_S = 0.2  # that either side takes for a fault: other programs run here
STATED_S = 1.0  # from the fault to rest: to notice it, 0.5 s from 2.5 m/s, and the machine
AFTER_REST_S = 0.5  # for which the winches are watched after a stop
NEW_HOME = "Ctrl-C after a new home"
NOT_HELD = ("PLC killed", "Ctrl-C", NEW_HOME)  # nobody is left to hold a fault, or there is none
ALONE = ("drive trip",)  # one winch is stopped by its brake: no common ramp
ASKED = "then reset"  # what a start says that a fault of before refuses
NOTHING, RAISES, HANGS, NAN, FAR, DIVERGES, EXITS = range(7)
WHAT = Value(c_int, NOTHING)  # what controller and estimator do wrong, from the parent process
DISTURBANCE = Value(c_int, Disturbance.NONE)  # what the proxy does


class Wrong(KinematicSolverController):
    """The kinematic solver until it is told to fail."""

    def command(self, belief: Belief, reference: Reference) -> Command:
        """Do what the parent process says."""
        asked = super().command(belief, reference)
        if WHAT.value == RAISES:
            raise ZeroDivisionError("a bug")
        if WHAT.value == HANGS:
            time.sleep(30.0)
        if WHAT.value == EXITS:
            sys.exit()
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
    """What is running, and what came of it.

    Attributes:
        ip: Address of the proxy; the PLC has the next one.
        folder: Files of all processes.
        wait: From the first motion to the fault [s].
        plc: Process of the PLC; likewise `host` and `observer`.
        client: Connection of the judge to inject faults.
        fault_at: When the fault was injected, by the monotonic clock [s].
        named: Fault that the host or the PLC named.
        reason: What the host said of it.
        stop: How the winches stopped.
        rest: From the fault to rest [s].
        commands: Commands that passed the proxy.
        problems: What is not as it must be.
    """

    ip: str
    folder: Path
    wait: float
    plc: int = 0
    host: int = 0
    observer: int = 0
    client: Any = None
    fault_at: float = np.nan
    named: str = "-"
    reason: str = ""
    stop: fault_judge.Stop | None = None
    rest: float | None = None
    commands: int = 0
    problems: list[str] = field(default_factory=list)

    @property
    def plc_ip(self) -> str:
        """Address of the PLC itself."""
        return self.ip[: self.ip.rindex(".") + 1] + str(int(self.ip.rsplit(".", 1)[1]) + 1)


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


def plc(trial: Trial, name: str) -> int:
    """The PLC process."""
    take_priority("plc")
    robot = ct.load_robot(trial.folder / "plc.yaml")
    settings = EmulatorSettings(
        encoder_check="by the host" not in name, watchdog=SILENCE_S,
        shift=NEW_HOME_SHIFT_M if name == NEW_HOME else SHIFT_M,
    )  # fmt: skip
    emulator = Emulator(robot, robot, settings, seed=os.getpid())
    signal.signal(signal.SIGTERM, lambda *_: emulator.stop())
    with short_pauses():
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
        home_confirmed=True,
        settings=(f"driver.stale_time={SILENCE_S}", f"driver.hang_time={SILENCE_S}",
                  f"driver.inner.lost_after={SILENCE_S}"),
        speed=0.8, acceleration=0.8, output=trial.folder / f"{name}.jsonl",
    )  # fmt: skip
    result = run_command.run(options)
    said = {key: result.data[key] for key in ("fault", "reason")}
    (trial.folder / f"{name}.json").write_text(json.dumps(said))
    return result.status


def robot_file(trial: Trial, name: str, ip: str) -> None:
    """Write the robot file with the PLC at an address; the AMS net id stays that of the PLC."""
    ads = f"\nhardware:\n  ads: {{net_id: {trial.plc_ip}.1.1, ip: {ip}}}\n  cables:\n"
    ways = ("{sign: 1, scale: 1 mm, offset: 0.5 m}", "{sign: -1, scale: 1 mm, offset: 25 m}")
    names = ct.load_robot("carosac").cable_names
    cables = "\n".join(f"    {cable}: {ways[i % 2]}" for i, cable in enumerate(names))
    text = robot_text("carosac") + ads + cables + "\n"
    parse_robot(text)
    (trial.folder / name).write_text(text)


def observe(trial: Trial) -> int:
    """The process of proxy and reader."""
    take_priority("observer")  # the network does not wait for host and PLC
    with short_pauses():
        return Observer(trial.ip, trial.plc_ip, trial.folder, DISTURBANCE).run()


def prepare(trial: Trial, name: str) -> None:
    """Start all processes and wait until the winches move."""
    robot_file(trial, "robot.yaml", trial.ip)
    robot_file(trial, "plc.yaml", trial.plc_ip)
    WHAT.value, DISTURBANCE.value = NOTHING, Disturbance.NONE
    trial.plc = child(lambda: plc(trial, name), trial.folder / "plc.txt")
    until(lambda: connected(trial), "the PLC did not start")
    trial.observer = child(lambda: observe(trial), trial.folder / "observer.txt")
    trial.host = child(lambda: host(trial), trial.folder / "host.txt")
    until(lambda: speed(trial) > MOVING, "the winches did not move")


def connected(trial: Trial) -> bool:
    """Connect beside the host."""
    try:
        trial.client = PlcClient(4, trial.plc_ip)
    except CarosacError:
        return False
    return True


def speed(trial: Trial) -> float:
    """Largest set velocity now [m/s]."""
    return float(np.abs(trial.client.diagnosis()["set_speed"]).max()) * 1e-3


def until(condition: Callable[[], bool], message: str, patience: float = PATIENCE_S) -> float:
    """Wait for something; how long it took [s]."""
    began = time.monotonic()
    while not condition():
        if time.monotonic() - began > patience:
            raise TimeoutError(message)
        time.sleep(POLL_S)
    return time.monotonic() - began


def ended(number: int) -> bool:
    """Whether a process has ended; it is taken away then."""
    try:
        return os.waitpid(number, os.WNOHANG)[0] == number
    except ChildProcessError:
        return True


def state(trial: Trial) -> tuple[int, int]:
    """State and fault of the PLC."""
    kind = layout("ST_ToHost")
    values = np.frombuffer(trial.client.read("CaRoSaC.to_host", kind.itemsize), kind)[0]
    return int(values["state"]), int(values["fault"])


def wrong(what: int) -> Callable[[Trial], None]:
    """Have controller or estimator fail."""

    def inject(trial: Trial) -> None:
        WHAT.value = what

    return inject


def disturb(kind: Disturbance) -> Callable[[Trial], None]:
    """Have the proxy disturb the connection."""

    def inject(trial: Trial) -> None:
        DISTURBANCE.value = kind

    return inject


LOST = "lost_connection stale_data heartbeat_lost"
FAULTS: dict[str, tuple[Callable[[Trial], Any], str]] = {
    "PLC killed": (lambda t: os.kill(t.plc, signal.SIGKILL), "lost_connection stale_data"),
    "PLC frozen": (lambda t: os.kill(t.plc, signal.SIGSTOP), "lost_connection stale_data"),
    "host frozen": (lambda t: os.kill(t.host, signal.SIGSTOP), "heartbeat_lost"),
    "host killed -9": (lambda t: os.kill(t.host, signal.SIGKILL), "heartbeat_lost"),
    "Ctrl-C": (lambda t: os.kill(t.host, signal.SIGINT), "none"),
    NEW_HOME: (lambda t: os.kill(t.host, signal.SIGINT), "none"),
    "encoder jump, seen by the PLC": (
        lambda t: t.client.inject(Injection.JUMP, 1, 0.05), "encoder_jump"),
    "encoder jump, seen by the host": (
        lambda t: t.client.inject(Injection.JUMP, 1, 0.05), "encoder_jump closure"),
    "drive trip": (lambda t: t.client.inject(Injection.TRIP, 2), "drive_trip"),
    "PLC counter frozen": (disturb(Disturbance.COUNTER_FROZEN), "stale_data"),
    "PLC data frozen": (disturb(Disturbance.DATA_FROZEN), "stale_data"),
    "network 0.3 s late": (disturb(Disturbance.LATE), LOST),
    "connection cut for 1 s": (disturb(Disturbance.DROPPED), LOST),
    "answers are nonsense": (disturb(Disturbance.NONSENSE), LOST),
    "answer cut short": (disturb(Disturbance.CUT_SHORT), LOST),
    "answers replayed": (disturb(Disturbance.REPLAYED), LOST),
    "command NaN": (wrong(NAN), "command controller"),
    "command out of range": (wrong(FAR), "command"),
    "controller raises": (wrong(RAISES), "controller"),
    "controller exits": (wrong(EXITS), "controller"),
    "controller hangs": (wrong(HANGS), "controller"),
    "estimator diverges": (wrong(DIVERGES), "estimator"),
}  # fmt: skip


def run_trial(name: str, rng: np.random.Generator, number: int, keep: Path | None) -> Trial:
    """One fault at one random time; all files of it are kept in a folder, if there is one."""
    inject, allowed = FAULTS[name]
    ip = f"127.{20 + os.getpid() % 200}.{1 + number // 100}.{1 + 2 * (number % 100)}"
    with tempfile.TemporaryDirectory() as folder:
        trial = Trial(ip=ip, folder=Path(folder), wait=rng.uniform(0.0, 2.0))
        try:
            prepare(trial, name)
            time.sleep(trial.wait)
            trial.fault_at = time.monotonic()
            inject(trial)
            finish(trial, name)
            try_again(trial, name)
            end(trial.observer, signal.SIGTERM)
            judge(trial, name, allowed)
        except (TimeoutError, CarosacError) as error:
            texts = [(trial.folder / f"{who}.txt").read_text()[-600:] for who in ("plc", "host")]
            trial.problems.append(" ".join([str(error), *texts]))
        finally:
            for process in (trial.host, trial.plc, trial.observer):
                end(process, signal.SIGKILL)
            if trial.client is not None:
                trial.client.close()
        if keep is not None:
            seen = {"fault_at": trial.fault_at, "named": trial.named, "problems": trial.problems}
            (trial.folder / "trial.json").write_text(json.dumps(seen))
            shutil.copytree(folder, keep / f"{name.replace(' ', '-')}-{number}")
    return trial


def end(process: int, how: signal.Signals) -> None:
    """End a process and wait for it."""
    with contextlib.suppress(ProcessLookupError):
        os.kill(process, how)
    with contextlib.suppress(ChildProcessError):
        os.waitpid(process, 0)


def finish(trial: Trial, name: str) -> None:
    """Wait until the host has ended, or the PLC has stopped without it; note what it named."""
    if name in ("host frozen", "host killed -9"):
        until(lambda: speed(trial) == 0.0, "the winches did not come to rest")
        time.sleep(AFTER_REST_S)
        trial.named = str(list(Fault)[state(trial)[1]])
        return
    until(lambda: ended(trial.host), "the host did not end")
    DISTURBANCE.value = Disturbance.NONE
    if name == "PLC frozen":
        os.kill(trial.plc, signal.SIGCONT)
    time.sleep(AFTER_REST_S)
    result = trial.folder / "run.json"
    if result.exists():
        ended_with = json.loads(result.read_text())
        trial.named, trial.reason = ended_with["fault"] or "none", ended_with["reason"] or ""


def judge(trial: Trial, name: str, allowed: str) -> None:
    """Judge what was seen on the wire."""
    robot = ct.load_robot(trial.folder / "robot.yaml")
    assert robot.hardware is not None
    machine = fault_judge.Machine(
        np.array(robot.hardware.sign) * np.array(robot.hardware.scale),
        robot.speed_max, robot.acceleration_max,
    )  # fmt: skip
    at, cycles = observed(trial.folder / "read.bin", "ST_ToHost")
    _, written = observed(trial.folder / "written.bin", "ST_FromHost")
    points = fault_judge.set_points(at, cycles, machine)
    lengths = fault_judge.commanded(written[written["session"] == written["session"][0]], machine)
    missing = fault_judge.unrecorded(lengths, trial.folder / "run.jsonl")
    trial.commands = len(lengths)
    trial.problems += fault_judge.judge_limits(points, machine)
    if missing:
        trial.problems.append(f"{missing} of {len(lengths)} commands unrecorded")
    if trial.named not in allowed.split():
        trial.problems.append(f"named {trial.named}, not {allowed}: {trial.reason}")
    if name == "PLC killed":
        return
    stop = trial.stop = fault_judge.judge_stop(points, trial.fault_at, machine)
    trial.rest = stop.rest_at - trial.fault_at
    late = trial.rest > STATED_S and name != "PLC frozen"  # frozen for as long as the host ran
    checks = {
        f"{trial.rest:.2f} s to rest": late,
        f"turned back at {stop.reversal:.3f} m/s": stop.reversal > fault_judge.REVERSAL_MAX,
        f"{stop.spread:.0%} off the common ramp": name not in ALONE
        and stop.spread > fault_judge.FACTOR_TOLERANCE,
    }
    trial.problems += [problem for problem, found in checks.items() if found]


def try_again(trial: Trial, name: str) -> None:
    """Start the command once more as it was: a fault that nobody has reset lets nothing move."""
    if name in NOT_HELD:
        return
    end(trial.host, signal.SIGKILL)
    WHAT.value = NOTHING
    trial.host = child(lambda: host(trial, "again"), trial.folder / "again.txt")
    fastest = 0.0
    began = time.monotonic()
    while not ended(trial.host) and time.monotonic() - began < PATIENCE_S:
        fastest = max(fastest, speed(trial))
        time.sleep(POLL_S)
    message = (trial.folder / "again.txt").read_text()
    if fastest > 0.0:
        trial.problems.append(f"moved again without a reset: {fastest:.2f} m/s")
    elif ASKED not in message:
        trial.problems.append(f"no word of a reset: {message[-300:]}")


def table_row(name: str, trials: list[Trial]) -> list[str]:
    """Return the row of a fault."""
    stops = [t.stop for t in trials if t.stop is not None]
    rest = [t.rest for t in trials if t.rest is not None]
    right = sum(t.named in FAULTS[name][1].split() for t in trials)
    named = ", ".join(f"{k} {v}" for k, v in Counter(t.named for t in trials).items())
    return [
        name,
        str(len(trials)),
        f"{np.median(rest):.2f} / {max(rest):.2f}" if rest else "-",
        f"{max(s.reversal for s in stops):.4f}" if stops else "-",
        f"{max(s.spread for s in stops):.1%}" if stops and name not in ALONE else "-",
        named,
        f"{right / len(trials):.0%}",
        str(sum(bool(t.problems) for t in trials)),
    ]


HEADER = [
    "fault", "trials", "to rest, median / largest [s]", "largest reversal [m/s]",
    "largest distance from the common ramp", "named", "rightly", "trials with a problem",
]  # fmt: skip


def measure(names: list[str], times: int, seed: int, keep: Path | None) -> list[list[str]]:
    """Run each of these faults, and print what was wrong; return rows of the table."""
    warm_up()
    rng = np.random.default_rng(seed)
    rows, number = [], 0
    for name in names:
        trials = []
        for _ in range(times):
            number += 1
            trials.append(run_trial(name, rng, number, keep))
        rows.append(table_row(name, trials))
        problems = [problem for t in trials for problem in t.problems]
        print(rows[-1], *problems, sep="\n    ", file=sys.stderr, flush=True)
    return rows


def main() -> None:
    """Run all, print and write the table."""
    parser = argparse.ArgumentParser(description="Faults on the emulated PLC.")
    parser.add_argument("times", nargs="?", type=int, default=TIMES)
    parser.add_argument("faults", nargs="*", default=list(FAULTS))
    parser.add_argument("--jobs", type=int, default=1, help="trials at the same time")
    parser.add_argument("--rows", type=Path, help="where one job keeps its rows")
    parser.add_argument("--merge", type=Path, nargs="+", help="make the table of such files")
    parser.add_argument("--keep", type=Path, help="folder in which all files of trials are kept")
    options = parser.parse_args()
    if unknown := set(options.faults) - set(FAULTS):
        parser.error(f"faults: got {sorted(unknown)}; allowed: {list(FAULTS)}")
    if options.rows is not None:
        seed = list(FAULTS).index(options.faults[0])
        rows = measure(options.faults, options.times, seed, options.keep)
        options.rows.write_text(json.dumps(rows))
        return
    if options.merge:
        publish(options.merge, list(FAULTS), " ".join(["--merge", *map(str, options.merge)]))
        return
    with tempfile.TemporaryDirectory() as folder:
        jobs = []
        for k in range(options.jobs):
            command = [sys.executable, "-m", "benchmarks.hardware_faults", str(options.times)]
            file = Path(folder) / f"{k}.json"
            command += [*options.faults[k :: options.jobs], "--rows", str(file)]
            command += ["--keep", str(options.keep)] if options.keep is not None else []
            jobs.append((subprocess.Popen(command), file))
        if any(job.wait() for job, _ in jobs):
            sys.exit("hardware_faults: a job failed")
        whole = options.times >= TIMES and len(options.faults) == len(FAULTS)
        command = f"--jobs {options.jobs}" if whole else None
        publish([file for _, file in jobs], options.faults, command)


def publish(files: list[Path], faults: list[str], options: str | None) -> None:
    """Print the table of what jobs found; write it where they ran by these `options`."""
    rows = {row[0]: row for file in files for row in json.loads(file.read_text())}
    text = table(HEADER, [rows[name] for name in faults])
    print(text)
    if options is not None:
        command = f"python -m benchmarks.hardware_faults {options}"
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
