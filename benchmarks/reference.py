"""Compare a run of the reference suite with the committed one, or commit a new one.

``python -m benchmarks.reference FOLDER [--update]``, where FOLDER is what ``carosac compare --suite
reference --output FOLDER`` wrote. Exit status 1: a typical error differs by more than 5 % and 1 mm,
a case failed in one of the two only, or something is missing. Latencies are not compared: they are
those of a machine.
"""

from __future__ import annotations

import argparse
import shutil
import sys
from pathlib import Path

from carosac_toolkit.base.errors import CarosacError
from carosac_toolkit.studies.reference.cases import LATEST_SUITE, ReferenceSuite
from carosac_toolkit.studies.reference.check import (
    DIFFERENCE_MIN_M,
    MACHINE_DIFFERENCE_RATIO,
    agreement,
)
from carosac_toolkit.studies.reference.results import (
    RECORD,
    RESULTS,
    TABLES,
    check_same,
    read_record,
    read_rows,
)

COMMITTED = Path(__file__).parent / "reference"


def check(folder: Path, committed: Path = COMMITTED) -> list[str]:
    """What does not agree with the committed results, as sentences.

    Raises:
        CarosacError: There are no results, or they are of another definition.
    """
    suite = ReferenceSuite.load(LATEST_SUITE)
    check_same(suite, folder)
    check_same(suite, committed)
    found = agreement(read_rows(folder), read_rows(committed))
    print(
        f"{len(found.differences)} typical errors compared; the largest difference is "
        f"{100 * found.largest:.2g} %, allowed are {100 * MACHINE_DIFFERENCE_RATIO:g} % or "
        f"{1e3 * DIFFERENCE_MIN_M:g} mm"
    )
    return [*found.faults, *(f"{', '.join(way)}: missing in {folder}" for way in found.missing)]


def update(folder: Path, committed: Path = COMMITTED) -> None:
    """Take a run of the whole suite for the committed one.

    Raises:
        CarosacError: It is none, or not of the whole suite.
    """
    suite = ReferenceSuite.load(LATEST_SUITE)
    check_same(suite, folder)
    wanted = {
        (task.part, task.robot, c, e)
        for task in suite.tasks()
        for c in task.study.controllers for e in task.study.estimators
    }  # fmt: skip
    there = {
        tuple(str(row[name]) for name in ("part", "robot", "controller", "estimator"))
        for row in read_rows(folder)
    }
    if there != wanted:
        raise CarosacError(f"{folder}: not the whole suite; differing: {sorted(there ^ wanted)}")
    committed.mkdir(exist_ok=True)
    for name in (RESULTS, RECORD, TABLES):
        shutil.copyfile(folder / name, committed / name)


def main() -> int:
    """Check or update."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--update", action="store_true", help="commit these results")
    asked = parser.parse_args()
    try:
        if asked.update:
            update(asked.folder)
            print(f"{COMMITTED}: {read_record(COMMITTED)['suite']}")
            return 0
        faults = check(asked.folder)
    except CarosacError as error:
        print(error, file=sys.stderr)
        return 2
    for line in faults:
        print(f"differs: {line}")
    print("the committed table is reproduced" if not faults else f"{len(faults)} differences")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
