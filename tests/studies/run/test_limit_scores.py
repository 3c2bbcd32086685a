"""Scores against the limits of a robot, and divergence, on logs made by hand."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from carosac_toolkit.loop.values import LimitHit
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.robot.file import load_robot
from carosac_toolkit.studies.run.divergence import divergence, loose_tension, sway_period
from carosac_toolkit.studies.run.limit_scores import LIMIT_COLUMNS, limit_scores
from carosac_toolkit.studies.run.run_case import robot_digest, robot_of
from tests.studies.run.test_run_case import made_up

ROBOT = load_robot("carosac")


def log(count=301, duration=30.0):
    made = made_up(count=count, worlds=1)
    return replace(made, time=np.linspace(0.0, duration, count))


def with_tension(made, cycles, value, cable=2):
    tension = np.array(made.tension)
    tension[cycles, 0, cable] = value
    return replace(made, tension=tension)


def test_shares_of_slack_overload_and_commands_limited_are_those_made_by_hand():
    made = with_tension(log(), slice(0, 30), 1.0)
    made = with_tension(made, slice(100, 103), 600.0)
    hits = [
        (k, LimitHit(limit="jump", cable=i, asked=1.0, sent=0.3)) for k in range(9) for i in (0, 1)
    ]
    hits.append((3, LimitHit(limit="speed", cable=0, asked=9.0, sent=2.5)))
    row = limit_scores(replace(made, limited=tuple(hits)), ROBOT)
    assert (row["tension_min_N"], row["tension_max_N"]) == (1.0, 600.0)
    assert row["slack_share"] == pytest.approx(30 / 301)
    assert row["slack_until_share"] == pytest.approx(30 / 301)
    assert row["overload_share"] == pytest.approx(3 / 301)
    assert row["limited_share"] == pytest.approx(9 / 301)
    assert json.loads(row["limited_by"]) == {"jump": 9, "speed": 1}
    assert row["outside_share"] == 0.0


def test_the_last_slack_cable_ends_the_slack_part_of_a_run():
    made = with_tension(with_tension(log(), slice(0, 30), 1.0), slice(200, 201), 1.0, cable=0)
    assert limit_scores(made, ROBOT)["slack_until_share"] == pytest.approx(201 / 301)
    assert limit_scores(log(), ROBOT)["slack_until_share"] == 0.0


def test_on_a_recording_nothing_is_scored_that_a_command_could_change():
    row = limit_scores(log(), ROBOT, replayed=True)
    assert all(row[name] is None for name in LIMIT_COLUMNS) and row["limited_share"] == 0.0
    assert divergence(with_tension(log(), slice(None), 0.0), ROBOT, replayed=True) is None


def test_a_calm_run_and_one_that_starts_with_a_slack_cable_do_not_diverge():
    assert divergence(log(), ROBOT) is None
    half = int(0.5 * sway_period(ROBOT) / 0.1)
    assert divergence(with_tension(log(), slice(0, half), 0.0), ROBOT) is None


def test_a_cable_loose_for_over_half_a_sway_is_a_divergence_and_is_named():
    half = int(0.5 * sway_period(ROBOT) / 0.1)
    reason = divergence(with_tension(log(), slice(50, 52 + half), 0.01), ROBOT)
    assert reason.startswith(f"cable {ROBOT.cable_names[2]} hung loose for")
    assert "from 5 s on" in reason


def test_a_cable_at_its_lower_limit_holds_the_platform():
    made = with_tension(log(), slice(None), 0.9 * float(ROBOT.tension_min[2]))
    assert (loose_tension(ROBOT) < 0.5 * ROBOT.tension_min).all()
    assert divergence(made, ROBOT) is None


def test_eight_cables_can_spare_two():
    robot = load_robot("cogiro")
    made = log()
    eight = np.full((len(made.time), 1, 8), 100.0)
    eight[..., :2] = 0.0
    two = replace(made, tension=eight)
    assert divergence(replace(two, **_at(robot, two)), robot) is None
    eight = np.array(eight)
    eight[..., 2] = 0.0
    assert "hung loose" in divergence(replace(two, tension=eight, **_at(robot, two)), robot)


def _at(robot, made):
    place = np.tile(robot.home_position, (len(made.time), 1, 1))
    return {"position": place, "belief_position": place, "reference": place}


def test_leaving_the_box_far_and_losing_the_platform_are_divergences():
    far = np.array(log().position)
    far[200:, 0, 2] = ROBOT.workspace_max[2] + 0.11 * Scales(ROBOT).length
    moved = replace(log(), position=far, belief_position=far)
    assert "left the workspace box by up to 1.01 m" in divergence(moved, ROBOT)
    lost = replace(log(), belief_position=log().position + np.array([0.0, 0.0, 1.2]))
    assert divergence(lost, ROBOT).startswith("the estimator was lost")


def test_the_sway_period_is_computed_once_for_the_robot_of_a_study():
    digest = robot_digest("carosac")
    assert robot_of("carosac", digest) is robot_of("carosac", digest)
    assert 2.0 < sway_period(robot_of("carosac", digest)) < 2.5
