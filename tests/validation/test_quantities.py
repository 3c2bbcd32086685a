import pytest

from carosac_toolkit.validation.quantities import say_length, unit_for


@pytest.mark.parametrize(
    ("metres", "text"),
    [
        (8001.919, "8001.9 m"),
        (0.0552, "55.2 mm"),
        (-0.02, "-20.0 mm"),
        (2.5e-4, "0.25 mm"),
        (4e-6, "4.0 um"),
        (2.6e-14, "< 0.1 um"),
        (0.0, "0"),
    ],
)
def test_lengths_come_in_the_unit_of_their_size(metres, text):
    assert say_length(metres) == text


def test_units_of_tables_and_pictures():
    assert [unit_for(size)[0] for size in (20.0, 0.1, 1e-5, 1e-9, 0.0)] == [
        "m", "mm", "um", "nm", "mm",
    ]  # fmt: skip
