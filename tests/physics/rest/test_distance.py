"""Distances of cables against straight lines by hand."""

from dataclasses import replace

import numpy as np
import pytest

from carosac_toolkit.physics.rest import statics
from carosac_toolkit.physics.rest.distance import cable_distances, separate_pairs
from tests.robots import eight_cable_robot


def test_straight_cables_are_as_far_apart_as_their_lines_and_thinner_by_their_radii():
    robot = eight_cable_robot()
    light = replace(robot, linear_density=1e-9 * robot.linear_density)
    rest = statics.inverse_kinematics(light, [robot.home_position])
    distance, pairs = cable_distances(light, rest)
    anchors = robot.home_position + robot.anchor_points @ robot.home_rotation.T
    steps = np.linspace(0.0, 1.0, 400)[:, None]
    lines = [a + steps * (b - a) for a, b in zip(robot.exit_points, anchors, strict=True)]
    for k, (i, j) in enumerate(pairs):
        gaps = np.linalg.norm(lines[i][:, None] - lines[j][None], axis=2)
        thick = 0.5 * (robot.cable_diameter[i] + robot.cable_diameter[j])
        assert distance[0, k] == pytest.approx(gaps.min() - thick, abs=2e-4)


def test_a_sagging_cable_comes_nearer_to_the_one_below():
    robot = eight_cable_robot(tension_min=np.full(8, 5.0))
    heavy = replace(robot, linear_density=8.0 * robot.linear_density)
    near = [statics.inverse_kinematics(r, [robot.home_position]) for r in (robot, heavy)]
    assert all(rest.converged[0] for rest in near)
    light, hanging = (
        cable_distances(r, rest)[0][0] for r, rest in zip((robot, heavy), near, strict=True)
    )
    assert hanging != pytest.approx(light, abs=1e-4)
    fine = cable_distances(heavy, near[1], pieces=64)[0][0]
    sag = statics.sag(heavy, near[1]).max()
    assert hanging == pytest.approx(fine, abs=2.0 * sag / 8**2)


def test_cables_that_share_an_end_are_no_pair():
    robot = eight_cable_robot()
    joined = replace(robot, anchor_points=np.tile(robot.anchor_points[:4], (2, 1)))
    assert len(separate_pairs(robot)) == 28
    assert {tuple(p) for p in separate_pairs(joined)} == {
        (i, j) for i in range(8) for j in range(i + 1, 8) if j - i != 4
    }
