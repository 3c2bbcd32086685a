"""Defaults that grow with a robot: units, ratios, and that none is forgotten."""

from __future__ import annotations

import copy
import pickle
from dataclasses import dataclass, field

import numpy as np
import pytest

from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.base.scaled import Ratios, Scaled, exponents, resolved

RATIOS = Ratios(mass=1000.0, length=10.0, time=2.0)


@dataclass(frozen=True)
class Inner:
    force: float = Scaled(1.0, "N")


@dataclass(frozen=True)
class Settings:
    distance: float = Scaled(0.3, "m")
    share: float = 0.5
    corner: tuple[float, ...] = (Scaled(1.0, "m"), 2.0)
    inner: Inner = field(default_factory=Inner)


@pytest.mark.parametrize(
    ("unit", "expected"),
    [
        ("m", (0, 1, 0)), ("rad/s", (0, 0, -1)), ("m/s^2", (0, 1, -2)), ("N", (1, 1, -2)),
        ("N s/m", (1, 0, -1)), ("1/m^2", (0, -2, 0)), ("s^2/rad^2", (0, 0, 2)),
        ("m/sqrt(s)", (0, 1, -0.5)), ("m/s^2/sqrt(Hz)", (0, 1, -1.5)), ("kg m^2", (1, 2, 0)),
    ],
)  # fmt: skip
def test_exponents_of_units(unit, expected):
    assert exponents(unit) == expected


@pytest.mark.parametrize("unit", ["furlong", "m^x", "m per s", "sqrt(m"])
def test_an_unknown_unit_is_refused(unit):
    with pytest.raises(InvalidField, match="unit"):
        Scaled(1.0, unit)


def test_defaults_are_those_of_the_robot_and_what_was_chosen_stays():
    found = resolved(Settings(), RATIOS)
    assert (found.distance, found.share) == (3.0, 0.5)
    assert found.corner == (10.0, 2.0)
    assert found.inner.force == pytest.approx(1000.0 * 10.0 / 4.0)
    assert resolved(Settings(distance=0.3), RATIOS).distance == 0.3
    assert resolved(found, RATIOS) is found


def test_on_carosac_a_default_is_what_it_says():
    assert resolved(Settings(), Ratios(1.0, 1.0, 1.0)) == Settings()


@pytest.mark.parametrize(
    "calculate",
    [lambda x: x + 1.0, lambda x: 2.0 * x, lambda x: 1.0 / x, lambda x: np.ones(3) * x,
     lambda x: x - np.float64(1.0), lambda x: np.float64(1.0) - x, lambda x: -x, lambda x: x**2,
     lambda x: x // 1.0, lambda x: 3.0 % x, abs, round],
)  # fmt: skip
def test_none_is_calculated_with_before_it_belongs_to_a_robot(calculate):
    with pytest.raises(TypeError, match="on carosac"):
        calculate(Scaled(0.3, "m"))


def test_copies_keep_unit_and_bounds():
    number = Scaled(0.3, "m/s^3", least=0.1, most=0.5)
    for other in (copy.deepcopy(number), pickle.loads(pickle.dumps(number))):
        assert (other, other.unit, other.least, other.most) == (0.3, "m/s^3", 0.1, 0.5)


def test_bounds_hold_at_any_size():
    number = Scaled(0.3, "m", least=0.1, most=0.5)
    assert [number.of(Ratios(1.0, k, 1.0)) for k in (0.1, 1.0, 10.0)] == [0.1, 0.3, 0.5]
