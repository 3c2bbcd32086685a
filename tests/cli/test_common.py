"""What commands share."""

from carosac_toolkit.cli.common import format_table


def test_columns_of_numbers_are_aligned_to_the_right():
    table = format_table(("name", "mass [kg]"), [("a", 1.5), ("long", 123.456)])
    assert table.splitlines() == [
        "name  mass [kg]",
        "----  ---------",
        "a           1.5",
        "long     123.46",
    ]
    assert format_table(("name", "x"), []) == "name  x\n----  -"
