"""Damaged files, messages and command lines: what the readers make of them.

Every kind runs in a process of its own with limits of memory and time. A case counts as read,
refused (one error of ours), foreign (any other exception), slow, too large, or a crash.

    python -m benchmarks.fuzz                    # the campaign, about an hour
    python -m benchmarks.fuzz --files 2000       # a first look; nothing is written
"""

from __future__ import annotations

import argparse
import contextlib
import io
import multiprocessing
import os
import resource
import signal
import tempfile
import time
import traceback
import warnings
import zlib
from collections import Counter
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.results import table, write_section
from carosac_toolkit.base.errors import CarosacError
from tests.fuzz.mutators import EXTREMES, mutated

FILES, MESSAGES, COMMANDS = 100_000, 20_000, 5_000
SEED = 3
MEMORY_MAX_BYTES = 2**30  # at the peak of a case, beyond what the process has when it begins
MEMORY_LIMIT_BYTES = 2**32  # at which the system refuses more; readers must not get there
DURATION_MAX_S = 5.0  # of one case
START_TIMEOUT_S, READY = 300.0, "ready"
HANG_S = 30.0  # after which a process that does not answer is killed
OUTCOMES = ("read", "refused", "foreign", "slow", "memory", "crash")
COMMAND_NAMES = ("check", "validate", "compare", "run", "plc", "workspace", "import robot",
                 "import recording", "calibrate tachymeter", "identify", "train", "evaluate",
                 "view", "robots", "smooth", "figures", "nonsense")  # fmt: skip
SHORT_COMMANDS = ("check", "import", "robots", "nonsense", "smooth", "identify", "evaluate")
OPTIONS = (
    "--help", "--robot", "--seed", "--set", "--output", "--controllers", "--seeds", "--out", "--",
    "--period", "--driver", "--steps", "--preset", "--json", "-x", "--workers",
)  # fmt: skip


class _Slow(BaseException):
    """A case took too long; no reader catches it."""


def main() -> None:
    """Run the campaign; write its counts if it was whole."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--files", type=int, default=FILES)
    parser.add_argument("--only", default="", help="kinds whose name has this in it")
    parser.add_argument("--seed", type=int, default=SEED, help="of the damage; another tests more")
    asked = parser.parse_args()
    share = asked.files / FILES
    began = time.monotonic()
    counts: dict[str, Counter[str]] = {}
    for name, total in _kinds(asked.files, int(MESSAGES * share), int(COMMANDS * share)).items():
        if asked.only in name:
            counts[name] = _campaign(name, total, asked.seed)
            print(name, total, dict(counts[name]), flush=True)
    if not asked.only and share >= 0.5:
        _write(counts, time.monotonic() - began, asked)


def _kinds(files: int, messages: int, commands: int) -> dict[str, int]:
    """Return how many cases of each kind there are."""
    from tests.fuzz.targets import targets

    weight = sum(target.weight for target in targets())
    kinds = {target.name: round(files * target.weight / weight) for target in targets()}
    wires = ("AMS requests", "FROM_HOST", "CONTROL", "TO_HOST", "IMU datagrams")
    return kinds | {name: messages // len(wires) for name in wires} | {"command lines": commands}


def _campaign(name: str, total: int, seed: int) -> Counter[str]:
    """Run all cases of a kind; begin a new process behind a case that ends one."""
    counts: Counter[str] = Counter()
    context = multiprocessing.get_context("spawn")
    case = 0
    while case < total:
        here, there = context.Pipe()
        worker = context.Process(target=_work, args=(name, case, total, seed, there), daemon=False)
        worker.start()
        there.close()
        if not here.poll(START_TIMEOUT_S) or here.recv() != READY:
            raise SystemExit(f"{name}: the process does not start")
        with contextlib.suppress(EOFError):
            while here.poll(HANG_S):
                case, outcome, text = here.recv()
                counts[outcome] += 1
                if text:
                    print(f"{name} {case}: {outcome}: {text}", flush=True)
                case += 1
        worker.join(1.0)
        status = worker.exitcode  # None: it hangs
        worker.kill()
        worker.join()
        if case < total:
            counts["crash"] += 1
            print(f"{name} {case}: crash, exit status {status}", flush=True)
            case += 1
    return counts


def _work(name: str, first: int, total: int, seed: int, pipe: Connection) -> None:
    """Run the cases of a kind from one on, and tell the outcome of each."""
    take, source = _taker(name)
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    limit = pages * resource.getpagesize() + MEMORY_LIMIT_BYTES
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    signal.signal(signal.SIGALRM, _stop)
    warnings.simplefilter("ignore")
    pipe.send(READY)
    for case in range(first, total):
        made = source(case, np.random.default_rng([zlib.crc32(name.encode()), seed, case]))
        pipe.send((case, *_outcome(take, made)))


def _outcome(take: Callable[[Any], object], made: Any) -> tuple[str, str]:
    """Return the outcome of a case, and the last lines of a traceback.

    Readers may turn a `MemoryError` into a refusal, so memory is measured, that of children too.
    """
    before, _ = _memory(peak=False)
    Path("/proc/self/clear_refs").write_text("5")  # the peak is that of now
    outcome = _ending(take, made)
    peak, of_child = _memory(peak=True)
    taken = max(peak - before, of_child)
    if taken > MEMORY_MAX_BYTES and outcome[0] in ("read", "refused"):
        return "memory", f"{outcome[0]}, {taken / 2**20:.0f} MiB"
    return outcome


def _memory(*, peak: bool) -> tuple[int, int]:
    """Return the memory of this process, now or at its peak, and of its largest child [bytes]."""
    name = "VmHWM:" if peak else "VmRSS:"
    lines = Path("/proc/self/status").read_text().splitlines()
    own = next(int(line.split()[1]) for line in lines if line.startswith(name))
    return 1024 * own, 1024 * resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss


def _ending(take: Callable[[Any], object], made: Any) -> tuple[str, str]:
    """Return how a case ends, and the last lines of a traceback."""
    signal.setitimer(signal.ITIMER_REAL, DURATION_MAX_S)
    try:
        take(made)
    except CarosacError:
        return "refused", ""
    except _Slow:
        return "slow", _last_lines()
    except MemoryError:
        return "memory", _last_lines()
    except (Exception, SystemExit):
        return "foreign", _last_lines()
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
    return "read", ""


def _stop(number: int, frame: object) -> None:
    raise _Slow


def _last_lines() -> str:
    lines = traceback.format_exc().strip().splitlines()
    where = [line.strip() for line in lines if line.startswith("  File")][-2:]
    return " | ".join([*where, lines[-1][:200]])


def _taker(name: str) -> tuple[Callable[[Any], object], Callable[[int, Any], Any]]:
    """Return what takes the cases of a kind, and what makes one."""
    from tests.fuzz.targets import place, targets

    if name == "command lines":
        os.chdir(tempfile.mkdtemp(prefix="fuzz-"))
        for command in COMMAND_NAMES:  # what they import is not a case's time
            with contextlib.suppress(CarosacError):
                _command_line([*command.split(), "--help"])
        return _command_line, _drawn_command
    target = next((target for target in targets() if target.name == name), None)
    if target is not None:
        seeds, folder = target.seeds(), Path(tempfile.mkdtemp(prefix="fuzz-"))
        return (
            lambda content: target.read(place(target, folder, content)),
            lambda case, rng: mutated(seeds[case % len(seeds)], rng, target.mutators),
        )
    from tests.fuzz.messages import EmulatedWires

    wire = next(wire for wire in EmulatedWires().wires() if wire.name == name)
    return wire.take, lambda case, rng: mutated(
        wire.seeds[case % len(wire.seeds)], rng, wire.mutators
    )


def _drawn_command(case: int, rng: np.random.Generator) -> list[str]:
    """Draw a command line; one that could begin hours of work has an unknown option too."""
    words = [*COMMAND_NAMES[rng.integers(len(COMMAND_NAMES))].split()]
    junk = [x.decode(errors="replace") for x in EXTREMES if b"\0" not in x]
    for _ in range(rng.integers(1, 6)):
        choice = [OPTIONS, junk, ("carosac", "nothere.yaml", "/", "", "\u202e", "a=b", "ü")]
        words.append(str(rng.choice(choice[rng.integers(3)])))
    return words if words[0] in SHORT_COMMANDS else [*words, "--no-such-option", "1"]


def _command_line(words: list[str]) -> None:
    """Run `carosac` in this process, as the console script does."""
    from carosac_toolkit.cli.main import main as carosac

    printed = io.StringIO()
    with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(printed):
        try:
            status: Any = carosac(words)
        except SystemExit as ended:
            status = ended.code
    if status not in (0, 1, None, 2):
        raise RuntimeError(f"status {status} of {words}")
    if "Traceback" in printed.getvalue():
        raise RuntimeError(f"a traceback of {words}")
    if status == 2:
        raise CarosacError("refused")


def _write(counts: dict[str, Counter[str]], duration: float, asked: argparse.Namespace) -> None:
    """Write the counts into RESULTS.md."""
    rows = [
        [name, *(str(value[key]) if key else str(sum(value.values())) for key in ("", *OUTCOMES))]
        for name, value in counts.items()
    ]
    total = Counter[str]()
    for value in counts.values():
        total.update(value)
    rows.append(["all", str(sum(total.values())), *(str(total[key]) for key in OUTCOMES)])
    body = (
        "Damaged inputs by kind: read all the same, refused by one error of the toolkit, foreign "
        f"exceptions, slower than {DURATION_MAX_S:g} s, more than "
        f"{MEMORY_MAX_BYTES // 2**20} MiB, ended the process. "
        f"{duration / 60:.0f} minutes in one process.\n\n"
        + table(["input", "cases", *OUTCOMES], rows)
    )
    command = f"python -m benchmarks.fuzz --files {asked.files} --seed {asked.seed}"
    write_section("fuzz", "Damaged inputs", command, body)


if __name__ == "__main__":
    main()
