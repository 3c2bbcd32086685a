"""The limits under 1e5 random command sequences; the figures go to RESULTS.md.

The property is that of `tests/safety/test_limiter.py`: nothing that leaves breaks a limit, a stop
from a random instant stays possible and is exact, and what needed no change is bit-identical.
"""

from __future__ import annotations

import itertools
import time

from benchmarks.results import table, write_section
from tests.safety import test_limiter

SEQUENCES = 100_000
SIZE, STEPS = 1000, 25


def main() -> None:
    """Run the property on all combinations of robot, period, jerk and box in turn."""
    test_limiter.SIZE, test_limiter.STEPS = SIZE, STEPS
    prove = test_limiter.test_nothing_that_leaves_breaks_a_limit_and_stopping_stays_possible
    combinations = itertools.cycle(
        itertools.product(
            sorted(test_limiter.ROBOTS), (0.004, 0.01, 0.02), (30.0, 200.0, 5000.0), (True, False)
        )
    )
    start = time.process_time()
    for seed, (name, period, jerk, box) in zip(
        range(SEQUENCES // SIZE), combinations, strict=False
    ):
        prove.hypothesis.inner_test(name, seed, period, jerk, box)
    spent = time.process_time() - start
    rows = [
        ["random command sequences", f"{SEQUENCES}", f"{SEQUENCES} of {STEPS} commands"],
        ["limits broken, by whatever left", "0", "0"],
        ["stops from a random instant: possible, exact, within all limits", "all", "all"],
        ["commands that needed no change: bit-identical", "all", "all"],
    ]
    body = table(["bar", "required", "measured"], rows) + f"\n\nCPU time {spent:.0f} s."
    write_section("bars:limits", "Limits under random commands", "make bars", body)
    print(body)


if __name__ == "__main__":
    main()
