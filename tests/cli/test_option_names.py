"""An error names an option only where the user wrote its value there."""

from __future__ import annotations

import pytest

from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.cli import check, compare, validate
from carosac_toolkit.cli.option_names import name_option


@pytest.mark.parametrize(
    ("field", "value", "words", "name"),
    [
        ("speed_max", "-1.0 m/s", ["--speed", "-1"], "--speed"),
        ("speed_max", "-1.0 m/s", ["--speed=-1"], "--speed"),
        ("speed_max", "3.0 m/s", ["--speed", "1"], "speed_max"),  # of a winch, say
        ("robot", "'labrig'", ["--robots", "mine.yaml"], "robot"),
        ("robot", "'nobody'", ["--robot", "carosac", "nobody"], "--robot"),
        ("estimator", "'dynamic_estimator'", ["--controllers", "mpc"], "estimator"),
        ("controller_settings of a.b:C", "'x'", ["--set", "y=1"], "--set controller.a.b:C"),
        ("driver_settings of simulator.wind", "'x'", ["--set", "y=1"], "--set driver.wind"),
        ("driver_settings", "'x'", ["--seeds", "1"], "driver_settings"),
    ],
)
def test_the_option_takes_the_place_of_its_field(field, value, words, name):
    error = name_option(InvalidField(field, value, f"{field} > 0"), compare.Options(), words)
    assert error.field == name and error.value == value


def test_a_positional_argument_goes_by_the_name_in_the_help():
    options = check.Options(robot_argument="nobody")
    error = name_option(InvalidField("robot", "'nobody'", "one of []"), options, ["nobody"])
    assert error.field == "ROBOT"


def test_a_field_goes_by_the_option_of_another_name_that_sets_it():
    value = "straight_line,kinematic_solver"
    raised = InvalidField("estimator", repr(value), "one of ['straight_line']")
    options = validate.Options(recording="synthetic")
    error = name_option(raised, options, ["synthetic", "--models", value])
    assert error.field == "--models"
    expected = "names with spaces between them: --models straight_line kinematic_solver"
    assert error.allowed == expected
