from math import log, tanh

import numpy as np
import pytest

from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.physics.cable import straight_line
from learned import rewards
from learned.environment import FAILURE_REWARD
from learned.rewards import PAPER_NO_SAG, PAPER_SAG, Reward, RewardSettings
from tests.learned.transitions import STRAIGHT, transition
from tests.robots import simple_robot

SPAN = 4.0 * np.sqrt(3.0)  # of the paper's cube


def terms(names, span=SPAN, settings=None, **changes):
    """The named terms of two steps."""
    return Reward(settings or RewardSettings(terms=names), span).terms(transition(**changes))


def test_a_step_is_worth_a_hundredth_wherever_it_ends():
    np.testing.assert_array_equal(rewards.step_reward(np.array([0.0, 3.0])), 0.01)


def test_the_goal_is_worth_one_inside_its_radius_and_nothing_on_it():
    distance = np.array([0.0, 0.04999, 0.05, 1.0])
    np.testing.assert_array_equal(rewards.goal_reward(distance), [1.0, 1.0, 0.0, 0.0])
    np.testing.assert_array_equal(rewards.goal_reward(distance, 0.01), [1.0, 0.0, 0.0, 0.0])


def test_the_goal_is_as_large_as_is_set():
    settings = RewardSettings(terms=("goal",), goal_radius=0.2)
    step = dict(position=[[0.1, 0.0, 0.0], [0.3, 0.0, 0.0]], target=np.zeros((2, 3)))
    np.testing.assert_array_equal(terms((), settings=settings, **step)["goal"], [1.0, 0.0])
    usual = RewardSettings(terms=("goal",))
    np.testing.assert_array_equal(terms((), settings=usual, **step)["goal"], [0.0, 0.0])


def test_the_distance_term_is_that_of_the_paper():
    found = rewards.distance_reward(np.array([0.0, 0.06, 1.0]))
    expected = [tanh(0.12) + 0.002, 0.002, -tanh(1.88) + 0.002]
    np.testing.assert_allclose(found, expected, rtol=1e-14)
    assert expected[0] == pytest.approx(0.121427, abs=1e-6)  # by hand
    assert expected[2] == pytest.approx(-0.952494, abs=1e-4)


def test_the_sag_term_is_that_of_the_paper():
    found = rewards.sag_reward(np.array([0.0, 0.5, 100.0]))
    expected = [-0.7 * tanh(0.09) - 0.035, -0.7 * tanh(0.34) - 0.035, -0.735]
    np.testing.assert_allclose(found, expected, rtol=1e-14)


def test_the_ratio_term_is_that_of_the_paper():
    found = rewards.action_ratio_reward(np.array([0.0, 1.0, 2.0, 100.0]))
    expected = [0.0, -(tanh(1.0) ** 15) / 10, -(tanh(2.0) ** 15) / 10, -0.1]
    np.testing.assert_allclose(found, expected, rtol=1e-14)
    assert found[1] == pytest.approx(-0.00168, abs=2e-5)


def test_the_deviation_term_is_that_of_the_paper():
    found = rewards.deviation_reward(np.array([0.0, 0.5, -0.5, 100.0]))
    expected = [0.0, -(tanh(0.5) ** 4) / 5, -(tanh(0.5) ** 4) / 5, -0.2]
    np.testing.assert_allclose(found, expected, rtol=1e-14)


def test_distance_is_counted_over_the_largest_one_in_the_workspace():
    found = terms(("distance",), position=[[0.06 * SPAN, 0.0, 0.0], [0.0, 0.0, -SPAN]])
    np.testing.assert_allclose(found["distance"], [0.002, -tanh(1.88) + 0.002], rtol=1e-13)


def test_sag_and_deviation_are_means_of_magnitudes_over_the_cables():
    more = [[0.4, -0.4, 0.0, 0.0], [0.2, 0.2, 0.2, 0.2]]  # both 0.2 m off in the mean
    lengths = STRAIGHT + more
    sag = terms(("sag",), length=lengths)["sag"]
    np.testing.assert_allclose(sag, -0.7 * tanh(0.04 + 0.09) - 0.035, rtol=1e-13)
    deviation = terms(("deviation",), asked=lengths)["deviation"]
    np.testing.assert_allclose(deviation, -(tanh(0.2) ** 4) / 5, rtol=1e-13)


def test_straight_lengths_are_those_of_where_the_platform_is_and_shall_be():
    goal = [[0.5, -1.0, 2.0], [0.1, 0.2, 3.0]]
    at_goal = straight_line.inverse_kinematics(simple_robot(), np.array(goal))
    reached = transition(position=goal, length=at_goal)
    np.testing.assert_array_equal(reached.straight_position, at_goal)
    np.testing.assert_array_equal(reached.straight_target, STRAIGHT)
    taut = -0.7 * tanh(0.09) - 0.035
    np.testing.assert_allclose(terms(("sag",), position=goal, length=at_goal)["sag"], taut)
    asked = terms(("deviation",), target=goal, asked=at_goal)["deviation"]
    np.testing.assert_array_equal(asked, 0.0)


def test_the_ratio_takes_the_norm_over_the_cables_and_floors_the_distance_at_a_centimetre():
    changes = [[0.3, 0.0, 0.0, 0.4], [0.003, 0.0, 0.0, 0.004]]  # norms 0.5 m and 5 mm
    asked = STRAIGHT + np.array(changes)
    before = [[0.25, 0.0, 0.0], [0.001, 0.0, 0.0]]  # the second one within a centimetre
    found = terms(("action_ratio",), asked=asked, position_before=before)["action_ratio"]
    expected = [-(tanh(0.5 / 0.25) ** 15) / 10, -(tanh(0.005 / 0.01) ** 15) / 10]
    np.testing.assert_allclose(found, expected, rtol=1e-9)


def test_the_ratio_looks_at_the_distance_before_the_step_and_at_what_was_asked():
    """Where the step ends, and what the winches wound, is no part of it."""
    asked = STRAIGHT + 0.1
    near = terms(("action_ratio",), asked=asked, position_before=[[0.1, 0, 0]] * 2)
    far = terms(("action_ratio",), asked=asked, position=[[0.1, 0, 0]] * 2, length=asked + 1.0,
                position_before=[[0.1, 0, 0]] * 2)  # fmt: skip
    np.testing.assert_array_equal(near["action_ratio"], far["action_ratio"])


def test_the_sum_of_the_sag_stage_has_the_goal_in_it():
    """The paper's printed sum leaves it out, its text does not."""
    assert set(PAPER_SAG) == {*PAPER_NO_SAG, "sag", "action_ratio", "deviation"}
    at_goal = Reward(RewardSettings(terms=PAPER_SAG), SPAN)(transition())
    expected = 0.01 + 1.0 + tanh(0.12) + 0.002 - 0.7 * tanh(0.09) - 0.035
    np.testing.assert_allclose(at_goal, expected, rtol=1e-13)


def test_the_fit_falls_from_zero_at_the_target_to_minus_one_across_the_workspace():
    misfit = np.concatenate([[0.0], np.geomspace(1e-6, SPAN, 400)])
    found = rewards.misfit_reward(misfit, 0.04, SPAN)
    assert found[0] == 0.0
    assert found[-1] == pytest.approx(-1.0, abs=1e-15)
    assert (np.diff(found) < 0.0).all()


def test_no_misfit_is_worse_than_a_step_without_a_solution():
    far = rewards.misfit_reward(np.array([SPAN, 2.0 * SPAN, 1e9]), 0.04, SPAN)
    np.testing.assert_allclose(far, FAILURE_REWARD, rtol=1e-15)


def test_relative_changes_of_the_misfit_count_alike_far_above_the_scale():
    far = rewards.misfit_reward(np.array([1.0, 2.0, 4.0]), 1e-5, SPAN)
    assert far[0] - far[1] == pytest.approx(far[1] - far[2], rel=1e-4)
    assert far[0] - far[1] == pytest.approx(log(2.0) / log(SPAN / 1e-5), rel=1e-4)


def test_fit_counts_inconsistency_like_distance_times_its_weight():
    lack = [[0.3, 0.0, 0.0, 0.4], [0.0, 0.0, 0.0, 0.0]]
    away = [[0.0, 0.0, 0.0], [0.0, 1.0, 0.0]]
    settings = RewardSettings(terms=("fit",), consistency=2.0)
    found = terms((), settings=settings, inconsistency=lack, position=away)["fit"]
    assert found[0] == pytest.approx(found[1], rel=1e-14)  # 2 * 0.5 m and 1 m
    blind = RewardSettings(terms=("fit",), consistency=0.0)
    assert terms((), settings=blind, inconsistency=lack)["fit"][0] == 0.0


def test_fit_counts_tensions_below_their_limit_and_close_to_it():
    robot = simple_robot()
    share = robot.weight / robot.n
    low, high = robot.tension_min[0], robot.tension_max[0]
    settings = RewardSettings(terms=("fit",), slack=2.0, reserve=0.1)

    def misfit(*tension, **changes):
        row = np.array([*tension, *[(low + high) / 2] * (4 - len(tension))])
        step = transition(tension=[row, row], **changes)
        return rewards.lengths_misfit(step, settings)[0]

    edge = 0.1 * share
    assert misfit(low + edge) == 0.0
    assert misfit(low) == pytest.approx(0.2, rel=1e-12)  # the reserve itself, times 2 m
    assert misfit(low - share) == pytest.approx(2.2, rel=1e-12)
    assert misfit(low - 0.2 * share, low - 0.3 * share) == pytest.approx(1.0, rel=1e-12)
    lack = np.full((2, 4), 0.1)  # 0.2 m in the norm
    assert misfit(low, inconsistency=lack) == pytest.approx(0.2 * 2**0.5, rel=1e-12)
    slack = [[low, low, high / 2, high / 2]] * 2
    found = terms((), settings=settings, tension=slack)["fit"]
    away = terms((), settings=settings, position=[[0.2 * 2**0.5, 0.0, 0.0]] * 2)["fit"]
    np.testing.assert_allclose(found, away, rtol=1e-12)


def test_fit_without_forces_or_without_a_price_of_slack_knows_no_tensions():
    slack = np.zeros((2, 4))
    priced = RewardSettings(terms=("fit",), slack=2.0)
    assert (rewards.lengths_misfit(transition(), priced) == 0.0).all()
    free = RewardSettings(terms=("fit",))
    assert (rewards.lengths_misfit(transition(tension=slack), free) == 0.0).all()


def test_tracking_counts_velocity_over_a_time_like_distance():
    settings = RewardSettings(terms=("tracking",), velocity=0.1, tracking_scale=0.2)
    velocity, away = [[3.0, 4.0, 0.0], [0.0, 0.0, 0.0]], [[0.0, 0.0, 0.0], [0.5, 0.0, 0.0]]
    found = terms((), settings=settings, velocity=velocity, position=away)["tracking"]
    assert found[0] == pytest.approx(found[1], rel=1e-14)  # 5 m/s over 0.1 s, and 0.5 m
    expected = -log(1 + (0.5 / 0.2) ** 2) / log(1 + (SPAN / 0.2) ** 2)
    assert found[0] == pytest.approx(expected, rel=1e-14)


def test_tracking_is_flat_at_the_target_a_square_near_it_and_minus_one_across_the_workspace():
    misfit = np.concatenate([[0.0], np.geomspace(1e-4, SPAN, 200)])
    found = rewards.tracking_reward(misfit, 0.1, SPAN)
    assert found[0] == 0.0
    assert found[-1] == pytest.approx(-1.0, abs=1e-15)
    assert (np.diff(found) < 0.0).all()
    near = rewards.tracking_reward(np.array([1e-4, 2e-4]), 0.1, SPAN)
    assert near[1] == pytest.approx(4.0 * near[0], rel=1e-4)
    far = rewards.tracking_reward(np.array([1.0, 2.0, 4.0]), 1e-5, SPAN)
    assert far[0] - far[1] == pytest.approx(far[1] - far[2], rel=1e-4)


def test_effort_costs_its_square():
    settings = RewardSettings(terms=("effort",), effort=0.02)
    np.testing.assert_allclose(
        terms((), settings=settings, effort=[0.5, 1.0])["effort"], [-0.005, -0.02]
    )


def test_jerk_costs_its_square():
    settings = RewardSettings(terms=("jerk",), jerk=3.0)
    np.testing.assert_allclose(
        terms((), settings=settings, jerk=[0.1, 0.2])["jerk"], [-0.03, -0.12], rtol=1e-12
    )


def test_a_reward_is_the_sum_of_its_terms():
    step = transition(position=[[0.3, 0.1, 0.0], [0.0, 0.01, 0.02]], asked=STRAIGHT + 0.2)
    reward = Reward(RewardSettings(terms=PAPER_SAG), SPAN)
    parts = reward.terms(step)
    assert tuple(parts) == PAPER_SAG
    np.testing.assert_allclose(reward(step), sum(parts.values()), rtol=1e-14)


@pytest.mark.parametrize(
    "changes, message",
    [
        ({"terms": ("step", "gaol")}, r"terms\[1\]: got 'gaol'; allowed: one of \["),
        ({"goal_radius": 0.0}, "goal_radius: got 0.0; allowed: goal_radius > 0"),
        ({"fit_scale": float("nan")}, "fit_scale: got nan"),
        ({"tracking_scale": 0.0}, "tracking_scale: got 0.0; allowed: tracking_scale > 0"),
        ({"effort": -1.0}, "effort: got -1.0; allowed: effort >= 0"),
        ({"jerk": -1.0}, "jerk: got -1.0; allowed: jerk >= 0"),
        ({"slack": -1.0}, "slack: got -1.0; allowed: slack >= 0"),
        ({"reserve": float("nan")}, "reserve: got nan"),
        ({"reserve": 0.1}, "reserve: got 0.1; allowed: 0 where `slack` is 0"),
    ],
)
def test_settings_without_sense_are_refused(changes, message):
    with pytest.raises(InvalidField, match=message):
        RewardSettings(**changes)
