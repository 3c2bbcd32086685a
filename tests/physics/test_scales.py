"""Sizes of robots, and the same robot in another size."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import carosac_toolkit as ct
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.physics.rest.modes import natural_modes
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.robot.model_error import ModelError
from carosac_toolkit.robot.similar import similar_robot, similarity, unscaled_fields

ROBOTS = ("carosac", "scampi", "cogiro")


def test_defaults_are_stated_on_carosac():
    assert Scales(ct.load_robot("carosac")).ratios == pytest.approx((1.0, 1.0, 1.0), abs=1e-12)


@pytest.mark.parametrize("name", ROBOTS)
@pytest.mark.parametrize("factor", [0.1, 10.0])
def test_sizes_of_a_similar_robot_are_similar(name, factor):
    robot = ct.load_robot(name)
    old, new, by = Scales(robot), Scales(similar_robot(robot, factor)), similarity(factor)
    for size, unit in (
        ("length", "m"), ("time", "s"), ("tension", "N"), ("workspace", "m"),
    ):  # fmt: skip
        assert getattr(new, size) == pytest.approx(getattr(old, size) * by.of_unit(unit)), size
    assert new.reach(0.01 * by.time) == pytest.approx(old.reach(0.01) * factor)
    assert new.ratios == pytest.approx(np.array(old.ratios) * by)


@pytest.mark.parametrize("name", ROBOTS)
@pytest.mark.parametrize("factor", [0.1, 10.0])
def test_rest_and_modes_of_a_similar_robot_are_similar(name, factor):
    robot = ct.load_robot(name)
    other, by = similar_robot(robot, factor), similarity(factor)
    rest, there = (statics.inverse_kinematics(r, r.home_position[None]) for r in (robot, other))
    assert there.converged.all()
    np.testing.assert_allclose(there.unstrained_length, factor * rest.unstrained_length, rtol=1e-9)
    np.testing.assert_allclose(there.tension, by.of_unit("N") * rest.tension, rtol=1e-7)
    np.testing.assert_allclose(
        natural_modes(other, there).frequency, natural_modes(robot, rest).frequency / by.time,
        rtol=1e-6,
    )  # fmt: skip


def test_what_a_model_misses_scales():
    error = ModelError(
        mass=0.02, length=1e-3, force=0.1, acceleration=2e-3, position=3e-3, rotation=4e-3
    )
    robot = replace(ct.load_robot("carosac"), model_error=error)
    there, by = similar_robot(robot, 4.0).model_error, similarity(4.0)
    assert (there.length, there.position, there.rotation) == pytest.approx((4e-3, 12e-3, 4e-3))
    assert there.force == pytest.approx(0.1 * by.of_unit("N"))
    assert there.acceleration == pytest.approx(2e-3 * by.of_unit("m/s/sqrt(s)"))


def test_every_field_with_a_unit_scales():
    assert unscaled_fields() == {
        "name", "cable_names", "swivel_axis", "gravity", "home_rotation", "description", "licence",
        "angular_drag_axes", "capstan_friction", "provenance", "drum_gear", "drum_advantage",
        "length_scale", "pose_rotation", "hardware", "calibrated", "calibration_covariance",
        "model_error",
    }  # fmt: skip
