from __future__ import annotations

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from carosac_toolkit.studies.run.row_files import read_parts
from carosac_toolkit.studies.run.rows import (
    BadRow,
    checked_values,
    in_common_columns,
    make_row,
    renamed,
)
from tests.studies.functions import one_case


def test_numpy_scalars_become_plain():
    values = checked_values({"a": np.float32(0.5), "b": np.int64(3), "c": np.bool_(True)})
    assert [(type(x), x) for x in values.values()] == [(float, 0.5), (int, 3), (bool, True)]


@pytest.mark.parametrize("value", [float("inf"), np.nan, 10**400, [1.0], np.ones(3), object()])
def test_values_that_are_no_finite_scalars_are_refused(value):
    with pytest.raises(BadRow, match=r"row field 'x': got .* allowed: a finite number"):
        checked_values({"x": value})


@pytest.mark.parametrize(("returned", "match"), [(None, "a dict"), ({3: 1}, "a name"),
                         ({"status": "ok"}, "another name")])  # fmt: skip
def test_what_is_no_row_is_refused(returned, match):
    with pytest.raises(BadRow, match=match):
        checked_values(returned)


def test_rows_share_columns_and_numeric_types():
    case = one_case("mpc")
    rows = in_common_columns(
        [
            make_row(case, "ok", values={"a": 1, "n": 2}, wall_time=0.1),
            make_row(case, "failed", reason="x", wall_time=0.1),
            make_row(case, "ok", values={"a": 0.5, "n": 3}, wall_time=0.1),
        ]
    )
    assert [(type(row["a"]), row["a"]) for row in rows] == [
        (float, 1.0), (type(None), None), (float, 0.5)]  # fmt: skip
    assert [row["n"] for row in rows] == [2, None, 3]
    assert len({tuple(row) for row in rows}) == 1


def test_long_reasons_are_cut():
    row = make_row(one_case("mpc"), "failed", reason="x" * 5000, wall_time=0.0)
    assert len(str(row["reason"])) == 1000


def test_rows_of_an_earlier_version_get_the_names_of_today(tmp_path):
    table = pa.table({"case": ["a"], "status": ["ok"], "suite": ["lengths"]})
    pq.write_table(table, tmp_path / "part-00000000.parquet")
    (row,) = read_parts(tmp_path).values()
    assert row["sensors"] == "lengths" and "suite" not in row
    assert renamed({"sensors": "a", "suite": "a value of a case function"})["suite"]
