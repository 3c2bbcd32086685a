"""Seeds that run together against seeds that run alone: processor time and numbers.

``python -m benchmarks.batches``; some minutes.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from benchmarks.results import table, write_section
from carosac_toolkit.studies.run.case import Case
from carosac_toolkit.studies.run.run_case import run_case
from carosac_toolkit.studies.run.run_together import run_together

SIZES = (2, 10)
WAYS = {
    "straight_line": "kinematic_solver", "kinematic_solver": "kinematic_solver",
    "input_shaping": "kinematic_solver", "td3": "truth",
}  # fmt: skip
SCORED = ("tracking_rmse_norm_m", "tracking_max_m", "tension_max_N")


def cases(robot: str, controller: str, count: int) -> list[Case]:
    """A case for each seed."""
    return [
        Case(
            robot=robot, controller=controller, estimator=WAYS[controller], sensors="lengths",
            trajectory="circle", perturbation="nominal-1", seed=seed,
        )
        for seed in range(count)
    ]  # fmt: skip


def timed(work: Callable[[], Any]) -> tuple[float, Any]:
    """Processor time [s] and result."""
    start = time.process_time()
    found = work()
    return time.process_time() - start, found


def compared(robot: str, controller: str) -> list[str]:
    """A row: processor time of a case alone and in batches, and by how much numbers differ."""
    some = cases(robot, controller, max(SIZES))
    run_case(some[0])  # loads kernels
    alone, rows = timed(lambda: [run_case(case) for case in some])
    row = [robot, controller, f"{alone / len(some):.2f}"]
    worst = 0.0
    for size in SIZES:
        parts = [some[k : k + size] for k in range(0, len(some), size)]
        taken, found = timed(lambda parts=parts: [x for part in parts for x in run_together(part)])
        row += [f"{taken / len(some):.2f}", f"{alone / taken:.1f}"]
        for one, other in zip(rows, found, strict=True):
            worst = max(worst, *(abs(one[x] - other[x]) / abs(one[x]) for x in SCORED))
    return [*row, f"{worst:.0e}"]


def main() -> None:
    """Measure, print, and write into RESULTS.md."""
    header = ["robot", "controller", "alone [s]"]
    for size in SIZES:
        header += [f"{size} together [s a case]", "ratio"]
    rows = [compared("carosac", name) for name in WAYS] + [compared("scampi", "kinematic_solver")]
    body = "Processor time of one circle, sensors `lengths`, condition `nominal-1`.\n\n" + table(
        [*header, "largest relative difference of scores"], rows
    )
    print(body)
    write_section("batches", "Seeds that run together", "python -m benchmarks.batches", body)


if __name__ == "__main__":
    main()
