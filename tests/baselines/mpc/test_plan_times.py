"""Stages and weights of plans for platforms that turn fast on their cables."""

from __future__ import annotations

import pytest

import carosac_toolkit as ct
from baselines import MpcSettings
from baselines.mpc.plan_times import STAGE_ANGLE_MAX_RAD, fastest_motion, settings_for
from carosac_toolkit.base.scaled import resolved
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.robot.similar import similar_robot, similarity


def test_on_carosac_everything_is_as_it_is_stated():
    found, unit = settings_for(ct.load_robot("carosac"), MpcSettings())
    assert (found, unit) == (resolved(MpcSettings(), Scales(ct.load_robot("carosac")).ratios), 1.0)


@pytest.mark.parametrize("name", ["carosac", "stadium", "ipanema1"])
def test_no_stage_is_longer_than_the_model_can_follow_at_any_size(name):
    for factor in (0.1, 1.0, 10.0):
        robot = similar_robot(ct.load_robot(name), factor)
        found, _ = settings_for(robot, MpcSettings(period=0.02 * similarity(factor).time))
        stage = (found.lookahead - found.period) / (found.stages - 1)
        assert stage * fastest_motion(robot) <= STAGE_ANGLE_MAX_RAD * (1.0 + 1e-9)


def test_a_fast_platform_is_corrected_quickly_and_what_is_chosen_stays():
    robot = ct.load_robot("stadium")
    by_size = resolved(MpcSettings(), Scales(robot).ratios)
    found, unit = settings_for(robot, MpcSettings(velocity_weight=1.0, lookahead=9.0))
    assert found.position_weight > 10.0 * by_size.position_weight
    assert unit < Scales(robot).ratios.time
    assert (found.velocity_weight, found.lookahead) == (1.0, 9.0)


def test_the_fastest_motion_is_slower_by_the_root_of_the_size():
    robot = ct.load_robot("carosac")
    slower = similar_robot(robot, 4.0)
    assert fastest_motion(slower) == pytest.approx(0.5 * fastest_motion(robot), rel=1e-6)
