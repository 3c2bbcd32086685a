"""Acceptance of the study engine: survival, repeatability and overhead; figures to RESULTS.md."""

from __future__ import annotations

import signal
import subprocess
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import Any

from benchmarks.results import table, write_section
from carosac_toolkit.studies import Case, read_rows, run_cases
from carosac_toolkit.studies.run.row_files import part_files, read_part
from tests.studies.functions import some_cases, without_times
from tests.studies.processes import alive, descendants, start, workers_of

COUNT = 1000
DURATION = 0.02  # [s] of a case
WORKERS = 2
WORKER_KILLS = (2, 2, 1)  # in the first, second and third run
STOPS = (300, 650)  # rows on disk after which the driver is killed

SCORE = "tests.studies.functions:score"
BURN = "benchmarks.studies:burn"


def burn(case: Case) -> dict[str, Any]:
    """Use exactly one second of processor time."""
    start = time.thread_time()
    while time.thread_time() - start < 1.0:
        pass
    return {"seed_again": case.seed}


def survival(folder: Path) -> list[list[str]]:
    """Kill drivers and workers, and compare with a run that nobody disturbs."""
    cases = some_cases(COUNT, duration=DURATION)
    left_alive = sum(disturbed(folder / "disturbed", i) for i in range(len(WORKER_KILLS)))
    rows = read_rows(folder / "disturbed")
    on_disk = Counter(
        row["case"] for path in part_files(folder / "disturbed") for row in read_part(path)
    )
    calm = run_cases(cases, SCORE, folder=folder / "calm", workers=WORKERS, progress=False)
    alone = run_cases(cases, SCORE, folder=folder / "alone", workers=0, progress=False)
    same = without_times(rows) == without_times(calm) == without_times(alone)
    kills = f"driver killed {len(STOPS)} times, workers {sum(WORKER_KILLS)} times"
    return [
        [f"{COUNT} cases, {kills}: rows", str(COUNT), str(len(rows))],
        ["of them ok", str(COUNT), str(sum(row["status"] == "ok" for row in rows))],
        ["rows on disk more than once", "0", str(sum(n > 1 for n in on_disk.values()))],
        [
            "same rows as undisturbed on 2 workers and in one process",
            "yes",
            "yes" if same else "NO",
        ],
        ["processes alive 3 s after their driver was killed", "0", str(left_alive)],
    ]


def disturbed(folder: Path, run: int) -> int:
    """Run the study, kill workers, then the driver; return how many processes outlive it."""
    driver = start(folder, f"some_cases({COUNT}, duration={DURATION})", "score")
    stop = STOPS[run] if run < len(STOPS) else COUNT
    begin = STOPS[run - 1] if run else 0
    kills = WORKER_KILLS[run]
    for i in range(kills):
        wait_for(driver, folder, begin + (i + 1) * (stop - begin) // (kills + 1))
        workers_of(driver)[i % WORKERS].send_signal(signal.SIGKILL)
    if run == len(STOPS):
        driver.communicate(timeout=300)
        return 0
    wait_for(driver, folder, stop)
    family = descendants(driver)
    driver.kill()
    driver.communicate()
    time.sleep(3.0)
    return len(alive(family))


def wait_for(driver: subprocess.Popen[str], folder: Path, count: int) -> None:
    """Wait until so many rows are on disk and all workers run."""
    while True:
        if driver.poll() is not None:
            raise RuntimeError(f"the study ended too early: {driver.communicate()}")
        if rows_on_disk(folder) >= count and len(workers_of(driver)) >= WORKERS:
            return
        time.sleep(0.05)


def rows_on_disk(folder: Path) -> int:
    """Number of rows; 0 before the study has begun."""
    return len(read_rows(folder)) if (folder / "study.json").is_file() else 0


def overhead(folder: Path, function: str, count: int, duration: float = 0.0) -> tuple[float, float]:
    """Time of a whole call over the time of its cases: by the book, and as the cases took it."""
    cases = some_cases(count, duration=duration)
    begin = time.perf_counter()
    rows = run_cases(cases, function, folder=folder, workers=WORKERS, progress=False)
    wall = time.perf_counter() - begin
    taken = sum(float(row["wall_time_s"] or 0.0) for row in rows)
    return wall * WORKERS / count - 1.0, wall * WORKERS / taken - 1.0


def overheads(folder: Path) -> list[list[str]]:
    """Overhead of cases that take one second."""
    waiting, _ = overhead(folder / "waiting", SCORE, 120, duration=1.0)
    begin = time.perf_counter()
    run_cases(some_cases(2), SCORE, folder=folder / "few", workers=WORKERS, progress=False)
    fixed = time.perf_counter() - begin
    by_the_book, busy = overhead(folder / "busy", BURN, 60)
    return [
        ["overhead, 120 cases that wait 1 s, whole call", "5 %", f"{waiting:.1%}"],
        ["of this, start and end of the workers", "reported", f"{fixed:.1f} s"],
        ["overhead, 60 cases of 1 s of processor time, over the time they took", "5 %",
         f"{busy:.1%}"],
        ["the same over 1 s a case, with whatever else ran on the machine", "reported",
         f"{by_the_book:.1%}"],
    ]  # fmt: skip


def main() -> None:
    """Measure and write."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        rows = survival(folder) + overheads(folder)
    body = table(["bar", "required", "measured"], rows)
    write_section("bars:studies", "Acceptance of the study engine", "make bars", body)
    print(body)


if __name__ == "__main__":
    main()
