"""Cases that run together: which do, and what becomes of a batch that fails."""

from __future__ import annotations

import pytest

from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.studies import run_cases
from carosac_toolkit.studies.run.batching import Batching
from tests.studies.functions import some_cases

SCORE = "tests.studies.functions:score"
GROUP = "tests.studies.functions:group"
TOGETHER = "tests.studies.functions:together"


def batching(size: int) -> Batching:
    return Batching(group=GROUP, function=TOGETHER, size=size)


def labels(rows) -> list[str]:
    return [row["label"] for row in rows]


def test_batches_are_of_one_group_and_no_larger_than_asked():
    cases = some_cases(5, controllers=("good", "single"))
    mixed = [case for pair in zip(cases[:5], cases[5:], strict=True) for case in pair]
    parts = batching(2).parts(mixed)
    assert sorted(case.identity for part in parts for case in part) == sorted(
        case.identity for case in cases
    )
    assert [len(part) for part in parts if part[0].controller == "good"] == [2, 2, 1]
    assert all(len(part) == 1 for part in parts if part[0].controller == "single")


@pytest.mark.parametrize("workers", [0, 1])
def test_rows_come_in_the_order_of_the_cases_and_a_batch_that_raises_runs_alone(tmp_path, workers):
    cases = some_cases(3, controllers=("good", "raises", "single"))
    rows = run_cases(
        cases, SCORE, folder=tmp_path / "x", workers=workers, batching=batching(2), progress=False
    )
    assert [row["case"] for row in rows] == [case.identity for case in cases]
    assert {row["status"] for row in rows} == {"ok"}
    assert labels(rows)[:3] == ["one of 2", "one of 2", "seed 2"]  # one left over is alone
    assert labels(rows)[3:] == ["seed 0", "seed 1", "seed 2"] * 2


def test_a_batch_that_kills_its_process_runs_alone(tmp_path):
    cases = some_cases(3, controllers=("dies",))
    rows = run_cases(
        cases, SCORE, folder=tmp_path / "x", workers=1, batching=batching(3), progress=False
    )
    assert labels(rows) == ["seed 0", "seed 1", "seed 2"]


def test_a_batch_of_nothing_is_refused():
    with pytest.raises(InvalidField, match="batch: got 0; allowed: a whole number from 1"):
        batching(0)
