"""A long run on the emulated PLC: memory of both processes, late cycles, and what was recorded.

``python -m benchmarks.soak [minutes]``; 60 make RESULTS.md. ``carosac run`` follows a target that
moves to and fro for all the time; a proxy between host and PLC sees every command.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from multiprocessing import Process, Value
from pathlib import Path

import numpy as np

import carosac_toolkit as ct
from benchmarks import fault_judge
from benchmarks.fault_wire import Disturbance, Observer, observed
from benchmarks.results import table, write_section
from carosac_toolkit.live.real_time import short_pauses, take_priority
from tests.plc_process import own_address, plc_process, robot_at

MINUTES = 60.0
WARM_MINUTES = 5.0  # after which memory has to stay as it is
TARGET_EVERY_S = 4.0
SAMPLE_EVERY_S = 10.0
STEP_M = 0.25  # of the target to either side of home
SPEED = 0.3  # [m/s]
SILENCE_S = 0.5  # that either side takes for a fault, as for any emulated PLC
MEGABYTE = 2**20


def resident(process: int) -> float:
    """Return the resident memory of a process [MB]."""
    pages = int(Path(f"/proc/{process}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / MEGABYTE


def observe(observer: Observer) -> None:
    """Pass data on and read set points before all else, as a network does."""
    take_priority("observer")
    with short_pauses():
        observer.run()


def drive(host: subprocess.Popen[str], plc: int, seconds: float) -> np.ndarray:
    """Move the target until the time is over or the host ends; return time [s], MB of both."""
    home = ct.load_robot("carosac").home_position
    began = time.monotonic()
    memory, side, next_target, next_sample = [], 1.0, 0.0, 0.0
    assert host.stdin is not None
    while (now := time.monotonic() - began) < seconds - 2.0 and host.poll() is None:
        if now >= next_target:
            x, y, z = home + side * np.array([STEP_M, 0.5 * STEP_M, 0.5 * STEP_M])
            host.stdin.write(f"{x:.4f} {y:.4f} {z:.4f}\n")
            host.stdin.flush()
            side, next_target = -side, next_target + TARGET_EVERY_S
        if now >= next_sample:
            memory.append((now, resident(host.pid), resident(plc)))
            next_sample += SAMPLE_EVERY_S
        time.sleep(0.05)
    return np.array(memory)


def main() -> None:
    """Run, judge and write the section."""
    minutes = float(sys.argv[1]) if len(sys.argv) > 1 else MINUTES
    seconds, silence = 60.0 * minutes, ("--watchdog", str(SILENCE_S))
    with tempfile.TemporaryDirectory() as name, plc_process("--priority", *silence) as plc:
        folder, proxy = Path(name), own_address()
        robot = folder / "robot.yaml"
        text = robot_at("carosac", plc.ip).replace(f", ip: {plc.ip}}}", f", ip: {proxy}}}")
        robot.write_text(text)
        observer = Observer(proxy, plc.ip, folder, Value("i", Disturbance.NONE))
        watching = Process(target=observe, args=(observer,))
        watching.start()
        words = [
            "run", "--driver", "ads", "--robot", robot, "--by-hand", "--enable", "--home-anew",
            "--home-confirmed", "--home", *(str(x) for x in plc.robot.home_position),
            "--speed", SPEED, "--priority", "--duration", seconds,
            "--recording", folder / "run.jsonl", "--json", folder / "run.json",
            *(f"--set=driver.{x}={SILENCE_S}" for x in (
                "stale_time", "hang_time", "inner.lost_after")),
        ]  # fmt: skip
        with (folder / "host.txt").open("w") as log:
            host = subprocess.Popen(
                [sys.executable, "-m", "carosac_toolkit.cli.main", *map(str, words)],
                stdin=subprocess.PIPE, stdout=log, stderr=log, text=True,
            )  # fmt: skip
            memory = drive(host, plc.process.pid, seconds)
            host.wait(60.0)
        watching.terminate()
        watching.join()
        if host.returncode:
            sys.exit(f"soak: the run ended:\n{(folder / 'host.txt').read_text()[-2000:]}")
        text = judged(folder, plc.robot, memory)
    print(text)
    if minutes >= MINUTES:
        write_section("soak", "An hour on the emulated PLC", "python -m benchmarks.soak", text)


def judged(folder: Path, robot: ct.Robot, memory: np.ndarray) -> str:
    """Return the table of a run."""
    assert robot.hardware is not None
    scale = np.array(robot.hardware.sign) * np.array(robot.hardware.scale)
    machine = fault_judge.Machine(scale, robot.speed_max, robot.acceleration_max)
    lengths = fault_judge.commanded(observed(folder / "written.bin", "ST_FromHost")[1], machine)
    missing = fault_judge.unrecorded(lengths, folder / "run.jsonl")
    with (folder / "run.jsonl").open() as file:
        kinds = [json.loads(line).get("row") for line in file]
    data = json.loads((folder / "run.json").read_text())
    warm_from = min(60.0 * WARM_MINUTES, 0.5 * memory[-1, 0])
    warm = memory[memory[:, 0] >= warm_from]
    rows = [
        ["duration", "1 h", f"{memory[-1, 0] / 60.0:.1f} min"],
        ["cycles", "reported", str(data["cycles"])],
        ["commands that passed; unrecorded", "0", f"{len(lengths)}; {missing}"],
        ["measurements recorded", "one a cycle", str(kinds.count("measured"))],
        ["late cycles", "reported", str(data["late_cycles"])],
        *(
            [f"memory of the {who} after {warm_from / 60.0:.1f} minutes; largest change since",
             "1 MB", f"{warm[0, k]:.1f} MB; {np.abs(warm[:, k] - warm[0, k]).max():.2f} MB"]
            for k, who in ((1, "host"), (2, "PLC"))
        ),
        ["distance of a cycle from 10 ms, p50 / p99", "reported",
         f"{1e3 * data['jitter_p50_s']:.2f} / {1e3 * data['jitter_p99_s']:.2f} ms"],
        ["computation of a cycle, p50 / p99", "reported",
         f"{1e3 * data['latency_median_s']:.2f} / {1e3 * data['latency_p99_s']:.2f} ms"],
    ]  # fmt: skip
    return table(["what", "bar", "measured"], rows)


if __name__ == "__main__":
    main()
