"""The table of axial stiffnesses in docs/robot-yaml.md follows from its own formula."""

from pathlib import Path

import pytest

from carosac_toolkit.robot.file import load_robot

PAGE = Path(__file__).resolve().parents[2] / "docs" / "robot-yaml.md"
LINEAR_DENSITY = 0.010  # [kg/m], of the rope in the table


def rows():
    text = PAGE.read_text(encoding="utf-8")
    table = text.partition("| material | density")[2].partition("\n\n")[0]
    return [line.strip("| ").split(" | ") for line in table.splitlines()[2:]]


@pytest.mark.parametrize(("name", "density", "modulus", "factor", "stiffness"), rows())
def test_stiffness_is_modulus_times_area_times_factor(name, density, modulus, factor, stiffness):
    area = LINEAR_DENSITY / (1e3 * float(density))  # [m^2]
    for c, shown in zip(factor.split(" to "), stiffness.split(" to "), strict=True):
        assert float(shown) == pytest.approx(
            1e-3 * float(c) * 1e9 * float(modulus) * area, rel=0.06
        )


def test_the_steel_rope_of_a_bundled_robot_is_as_stiff_as_the_table_says():
    robot = load_robot("cogiro")
    (steel,) = [row for row in rows() if row[0] == "steel"]
    ratio = robot.axial_stiffness / (robot.linear_density / LINEAR_DENSITY)
    assert ratio == pytest.approx(1e3 * float(steel[4]), rel=0.1)
