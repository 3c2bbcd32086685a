"""Tables of text keep every cell, whatever they are printed to."""

from carosac_toolkit.base.tables import fit, format_table


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
