"""Range checks of numbers."""

import math

import numpy as np
import pytest

from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.base.numbers import (
    check_fraction,
    check_not_negative,
    check_positive,
    check_whole,
    plain,
)


def test_numbers_in_their_range_pass():
    for value in (1e-9, 1, np.float64(2.0), np.int64(3)):
        check_positive("x", value)
        check_not_negative("x", value)
    check_not_negative("x", 0.0)
    check_fraction("x", 0.5)
    check_whole("x", 3, 3, 3)


@pytest.mark.parametrize("value", [-1.0, 0.0, math.nan, math.inf, 10**400, True, "1", None, [1.0]])
def test_all_else_is_refused_with_field_value_and_what_is_allowed(value):
    with pytest.raises(InvalidField, match=r"x: got .*; allowed: x > 0, finite"):
        check_positive("x", value)
    with pytest.raises(InvalidField, match=r"x: got .*; allowed: 0 < x < 1"):
        check_fraction("x", value)
    if value != 0.0:
        with pytest.raises(InvalidField, match=r"x: got .*; allowed: x >= 0, finite"):
            check_not_negative("x", value)


def test_messages_carry_the_unit():
    with pytest.raises(InvalidField, match=r"time: got -1.0 s; allowed: time > 0, finite"):
        check_positive("time", -1.0, "s")


@pytest.mark.parametrize("value", [1, 5, 2.0, True, "3"])
def test_what_is_no_whole_number_in_the_range_is_refused(value):
    with pytest.raises(InvalidField, match=r"count: got .*; allowed: a whole number from 2 to 4"):
        check_whole("count", value, 2, 4)


@pytest.mark.parametrize(
    ("value", "text"),
    [(15302.4, "15302"), (999.7, "1000"), (-1234.0, "-1234"), (0.012345, "0.0123"), (12.0, "12")],
)
def test_numbers_are_written_without_an_exponent(value, text):
    assert plain(value, 3) == text
