from __future__ import annotations

import pytest

from carosac_toolkit.drivers.sensors import SensorSettings
from carosac_toolkit.robot.file import load_robot
from carosac_toolkit.robot.similar import similar_robot, similarity
from carosac_toolkit.safety.guard import GuardSettings
from carosac_toolkit.safety.limiter import LimitSettings
from carosac_toolkit.safety.settled import settled

DISTANCES = (
    "first_max", "range_margin", "jump_max", "following_max", "first_way", "closure_max",
    "belief_max", "workspace_margin", "home_change_max",
)  # fmt: skip


def test_on_carosac_all_numbers_are_those_that_are_stated():
    stated, known = GuardSettings(), settled(GuardSettings(), load_robot("carosac"))
    for name in (*DISTANCES, "first_speed", "slack_time", "direction_max"):
        assert getattr(known, name) == getattr(stated, name), name
    assert known.limits.jump_max == pytest.approx(0.3)
    assert known.step(load_robot("carosac")) == pytest.approx(0.35)


@pytest.mark.parametrize("factor", [0.1, 10.0])
def test_distances_follow_the_robot_within_bounds_and_what_is_given_stays(factor):
    robot, ratios = similar_robot(load_robot("carosac"), factor), similarity(factor)
    known = settled(GuardSettings(belief_max=0.4), robot)
    assert known.belief_max == 0.4
    for name in set(DISTANCES) - {"belief_max"}:
        stated = getattr(GuardSettings(), name)
        wanted = min(max(float(stated) * factor, stated.least), stated.most)
        assert getattr(known, name) == pytest.approx(wanted), name
    assert known.slack_time == pytest.approx(0.5 * ratios.time)
    assert known.direction_max == 0.004  # of the encoders


def test_a_fault_of_an_encoder_or_a_home_may_not_be_larger_on_a_large_robot():
    large = settled(GuardSettings(), load_robot("stadium"))
    for name in ("first_max", "range_margin", "jump_max", "following_max", "workspace_margin",
                 "home_change_max"):  # fmt: skip
        assert getattr(large, name) == float(getattr(GuardSettings(), name)), name


def test_errors_of_encoders_do_not_stop_a_small_robot():
    robot = load_robot("desktop")
    small = settled(GuardSettings(), robot)
    bias = settled(SensorSettings(), robot).encoder_bias
    assert small.home_change_max > 4.0 * bias
    assert min(small.jump_max, small.following_max, small.closure_max) > small.direction_max


def test_the_limits_of_a_slowed_run_may_be_as_tight_as_its_winches():
    limits = LimitSettings(jump_max=0.1, box=False)
    known = settled(GuardSettings(limits=limits, speed_max=0.3), load_robot("carosac"))
    assert known.limits.jump_max == 0.1


def test_a_large_robot_is_not_faster_near_people():
    base = load_robot("carosac")
    assert settled(GuardSettings(), similar_robot(base, 10.0)).first_speed == 0.075
    assert settled(GuardSettings(), similar_robot(base, 0.1)).first_speed == pytest.approx(
        0.075 * 0.1**0.5
    )
    assert settled(GuardSettings(first_speed=0.2), base).first_speed == 0.2
