"""Tables of text keep every cell, whatever they are printed to."""

import pytest

from carosac_toolkit.base.tables import fit, format_table, wrapped


def test_columns_of_numbers_are_aligned_to_the_right():
    table = format_table(("name", "mass [kg]"), [("a", 1.5), ("long", 123.456)])
    assert table.splitlines() == [
        "name  mass [kg]",
        "----  ---------",
        "a           1.5",
        "long     123.46",
    ]
    assert format_table(("name", "x"), []) == "name  x\n----  -"


def test_a_wide_table_breaks_into_blocks_that_begin_with_the_names():
    header = ("model", "x [mm]", "y [mm]", "norm [mm]")
    text = fit(header, [("a", "1.0", "22.0", "3.0")], (1, 2, 1), 24)
    assert text.splitlines() == [
        "model  x [mm]  y [mm]",
        "-----  ------  ------",
        "a         1.0    22.0",
        "",
        "model  norm [mm]",
        "-----  ---------",
        "a            3.0",
    ]


@pytest.mark.parametrize("quantity", ["<1 %", "2.5 m/s^2", "0.357 s", "833 N", "12 Hz", "3 mm"])
def test_a_line_never_ends_between_a_number_and_its_unit(quantity):
    text = f"a cable was slack for {quantity} under mpc, and once more for {quantity}."
    for width in range(len(quantity) + 1, 60):
        lines = wrapped(text, width).splitlines()
        assert " ".join(lines) == text
        assert sum(line.count(quantity) for line in lines) == 2


def test_a_line_may_end_between_a_number_and_a_word():
    assert wrapped("there are 12 seeds", 12) == "there are 12\nseeds"
