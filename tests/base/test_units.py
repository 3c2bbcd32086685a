import math

import pytest

from carosac_toolkit.base.units import InvalidQuantity, is_quantity, parse_quantity


@pytest.mark.parametrize(
    ("written", "unit", "expected"),
    [
        ("10.55 g/m", "kg/m", 0.01055),
        ("130 GPa", "Pa", 130e9),
        ("0.95 MN", "N", 0.95e6),
        ("50mm", "m", 0.05),
        ("-1.5e-3", "m", -1.5e-3),
        ("2e5 N", "N", 2e5),
        (9.81, "m/s^2", 9.81),
        ("90 deg", "rad", math.pi / 2),
        ("90°", "rad", math.pi / 2),
        ("80 N s", "N*s", 80.0),
        ("80 N·s/m", "N*s/m", 80.0),
        ("7 mm²", "m^2", 7e-6),
        ("0.6 kg m^2", "kg*m^2", 0.6),
        ("120 g*cm^2", "kg*m^2", 1.2e-5),
        ("3 kg mm²", "kg*m^2", 3e-6),
        ("5e4 g·mm^2", "kg*m^2", 5e-5),
        ("5 m/s**2", "m/s^2", 5.0),
        ("50 ms", "s", 0.05),
        ("1440 kg / m^3", "kg/m^3", 1440.0),
        ("3", "1", 3.0),
    ],
)
def test_a_number_with_a_unit_becomes_si(written, unit, expected):
    assert parse_quantity(written, unit) == pytest.approx(expected, rel=1e-15)


@pytest.mark.parametrize(
    ("written", "unit", "message"),
    [
        ("60 Gpa", "Pa", r"a stress in Pa .*; did you mean GPa"),
        ("2 kg", "m", r"'2 kg'; allowed: a length in m \(or mm, cm, km\); kg is a mass"),
        ("10 g/n", "kg/m", "did you mean g/m"),
        ("1,5 m/s", "m/s", "a speed in m/s .*; the decimal sign is a point$"),
        ("-1,5", "m", "; the decimal sign is a point$"),
        ("3 furlong", "m", "a length in m"),
        ("top", "m", "got 'top'"),
        (True, "kg", "got True"),
        (None, "kg", "got None"),
        (math.nan, "kg", "finite"),
        ("1e999 kg", "kg", "finite"),
        ("5 m", "1", "a pure number; m is a length"),
        ("1 2 m", "m", "a length in m"),
        ("0x10", "m", "a length in m"),
    ],
)
def test_what_is_no_quantity_of_the_kind_says_what_is_allowed(written, unit, message):
    with pytest.raises(InvalidQuantity, match=message):
        parse_quantity(written, unit)


def test_numbers_and_names_are_told_apart():
    assert all(is_quantity(value) for value in (0, 1.5, "1.5", "2 kg", "-3mm", ".5 m"))
    assert not any(is_quantity(value) for value in (True, None, "rope", "m", "", [1.0]))
