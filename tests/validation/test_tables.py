from dataclasses import replace

import pytest

from carosac_toolkit.base.tables import fit
from carosac_toolkit.validation import validate
from carosac_toolkit.validation.tables import (
    CAUSE_GROUPS,
    CAUSE_HEADER,
    PART_GROUPS,
    PART_HEADER,
    cause_rows,
    part_rows,
    part_units,
)
from tests.validation.models import NAME
from tests.validation.runs import ROBOT, perfect


@pytest.fixture(scope="module")
def result():
    return validate(perfect(), ROBOT, ["straight_line", "kinematic_solver", f"{NAME}:Failing"])


def test_groups_cover_the_columns():
    assert sum(PART_GROUPS) == len(PART_HEADER) and sum(CAUSE_GROUPS) == len(CAUSE_HEADER)


@pytest.mark.parametrize("width", [80, 100, 200])
def test_tables_keep_to_the_width_and_lose_nothing(result, width):
    for header, rows, groups in (
        (PART_HEADER, part_rows(result), PART_GROUPS),
        (CAUSE_HEADER, cause_rows(result), CAUSE_GROUPS),
    ):
        text = fit(header, rows, groups, width)
        assert max(map(len, text.splitlines())) <= width
        for row in rows:
            assert all(cell in text for cell in row[groups[0] :])
        assert ("\n\n" in text) == (width < 200)


def test_tiny_errors_have_a_unit_that_suits_them(result):
    exact = replace(result, models={"ks": result.models["kinematic_solver"]})
    assert " in nm;" in part_units(exact)
    assert not any("e-" in cell for row in part_rows(exact) for cell in row)
    assert " in mm;" in part_units(result)


def test_no_delay_is_negative_zero(result):
    cells = [cell for row in cause_rows(result) for cell in row]
    assert any(cell.startswith("0.0 +-") for cell in cells)
    assert not any(cell.startswith("-0.0 ") or cell.startswith("-0 ") for cell in cells)
