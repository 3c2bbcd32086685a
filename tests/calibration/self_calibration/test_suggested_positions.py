from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import carosac_toolkit as ct
from calibration.guide.fit import nothing_measured, refit
from calibration.guide.simulated import draw_true_robot, taut_tensions
from calibration.self_calibration.balance import operating_tensions
from calibration.self_calibration.knowledge import spare_lengths
from calibration.self_calibration.safe_tensions import tension_error
from calibration.self_calibration.settings import SelfCalibrationSettings
from calibration.self_calibration.suggested_positions import (
    NoSafePosition,
    Reach,
    safe_positions,
    suggest_positions,
)
from calibration.self_calibration.synthetic import MeasurementNoise, measure_motor_angles
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.physics.cable.straight_line import inverse_kinematics
from carosac_toolkit.physics.rest import statics

ROBOT = ct.load_robot("hangprinter")
HOME = ROBOT.home_position


@pytest.fixture(scope="module")
def known():
    """Knowledge after ten samples near home, whose positions were not known."""
    rng = np.random.default_rng(1)
    true = draw_true_robot(ROBOT, rng)
    place = np.vstack([HOME, HOME + rng.uniform([-0.4, -0.4, 0.0], [0.4, 0.4, 0.5], (9, 3))])
    noise = MeasurementNoise(line=0.5e-3, known=1e-6)
    angles = measure_motor_angles(true, place, np.array([0]), noise, rng)
    return refit(nothing_measured(ROBOT, SelfCalibrationSettings()), angles, place).known


def test_first_position_leaves_less_volume_than_all_other_safe_ones(known):
    best = suggest_positions(known, 1, rng=np.random.default_rng(3)).position[0]
    where, _ = safe_positions(known, np.random.default_rng(3))
    rows = known.problem.exits.ravel()

    def volume(place):
        slope = spare_lengths(known, place[None])[0]
        information = np.linalg.inv(known.covariance) + slope.T @ slope
        after = replace(known, covariance=np.linalg.inv(information))
        values = np.linalg.eigvalsh(after.exit_covariance[np.ix_(rows, rows)])
        return np.log(values[3:]).sum()  # the three least ones are turns about home

    volumes = np.array([volume(place) for place in where])
    assert volume(best) == pytest.approx(volumes.min(), abs=1e-6)
    assert np.ptp(volumes) > 0.5


def test_positions_are_chosen_together_and_the_same_for_a_seed(known):
    first, again = (suggest_positions(known, 6, rng=np.random.default_rng(5)) for _ in range(2))
    assert (first.position == again.position).all()
    assert (np.diff(first.sigma) <= 1e-12).all()
    assert first.sigma[0] == pytest.approx(known.exit_sigma.max())
    assert first.sigma[-1] < 0.95 * first.sigma[0]
    assert len(np.unique(first.position, axis=0)) > 3
    assert first.data()[0]["position_m"] == first.position[0].tolist()


def test_a_turn_of_the_whole_robot_is_no_uncertainty(known):
    rows = known.problem.exits.ravel()
    arm = known.exit_points - HOME
    turn = np.zeros((len(known.shared), 3))
    turn[rows] = np.stack([np.cross(axis, arm).ravel() for axis in np.eye(3)], axis=1)
    turned = replace(known, covariance=known.covariance + 0.04 * turn @ turn.T)
    assert turned.exit_sigma == pytest.approx(known.exit_sigma, rel=1e-6)
    moved = replace(known, covariance=known.covariance + 1e-4 * np.eye(len(known.shared)))
    assert (moved.exit_sigma > known.exit_sigma + 1e-3).all()


def test_robots_that_are_likely_hold_their_cables_taut_at_safe_positions(known):
    """Drawn anew, and judged by other statics."""
    where, margin = safe_positions(known, np.random.default_rng(2))
    rng = np.random.default_rng(77)
    exits, size = known.problem.exits, known.problem.exits.size
    held = []
    for away in rng.multivariate_normal(np.zeros(size), known.exit_covariance, 20, method="eigh"):
        points = known.exit_points + away.reshape(exits.shape)
        tension = taut_tensions(replace(ROBOT, exit_points=points), where)
        held.append(np.isfinite(tension).all(axis=1))
    assert (margin >= 0.0).all()
    assert np.mean(held) > 0.97


def test_tension_error_is_that_of_a_robot_moved_by_lengths_alone(known):
    rng = np.random.default_rng(8)
    rows = known.problem.exits.ravel()
    tight = replace(known, covariance=np.zeros_like(known.covariance))
    tight.covariance[np.ix_(rows, rows)] = 1e-6 * np.eye(len(rows))
    limits = {"tension_min": np.full(4, 40.0), "tension_max": np.full(4, 400.0)}
    model = replace(ROBOT, exit_points=known.exit_points, **limits)
    start, end = HOME + np.array([[0.1, 0.0, 0.4], [0.3, 0.2, 0.6]])
    ahead, here = (inverse_kinematics(model, place[None]) for place in (end, start))

    def moved(robot):
        length = inverse_kinematics(robot, start[None])
        wound = length * (1.0 - taut_tensions(robot, start[None]) / robot.axial_stiffness)
        rest = statics.forward_kinematics(robot, wound)
        return statics.forward_kinematics(robot, wound + ahead - here, guess=rest).tension[0]

    claimed = float(tension_error(tight, start, end[None])[0])
    right = moved(model)
    errors = [
        moved(replace(model, exit_points=model.exit_points + rng.normal(0.0, 1e-3, (4, 3)))) - right
        for _ in range(300)
    ]
    spread = 3.0 * np.std(errors, axis=0).max()
    assert spread == pytest.approx(claimed, rel=0.25)


def test_refusals_give_the_reason(known):
    with pytest.raises(InvalidField, match="count: got 0; allowed: 1 to 40"):
        suggest_positions(known, 0, rng=np.random.default_rng(0))
    unknown = nothing_measured(ROBOT, SelfCalibrationSettings())
    corner = Reach(start=HOME, visited=ROBOT.workspace_max[None], distance=0.1)
    with pytest.raises(NoSafePosition, match=r"can be held taut .* the best lacks"):
        suggest_positions(unknown, 1, rng=np.random.default_rng(0), reach=corner)
    tentative = replace(corner, tentative=True)
    assert suggest_positions(unknown, 1, rng=np.random.default_rng(0), reach=tentative)
    blind = Reach(start=HOME, visited=HOME[None], tension_error_max=1e-3)
    with pytest.raises(NoSafePosition, match=r"tensions would be wrong by .* known to"):
        suggest_positions(known, 1, rng=np.random.default_rng(0), reach=blind)
    weak = replace(ROBOT, tension_max=np.full(4, 5.0))
    with pytest.raises(InvalidField, match=r"tension_limits.max\[0\]: got 5 N; allowed: > 6"):
        operating_tensions(weak)


def test_positions_stay_within_reach(known):
    visited = HOME + np.array([[0.0, 0.0, 0.0], [0.2, 0.0, 0.2]])
    reach = Reach(start=HOME, visited=visited, distance=0.15)
    where, _ = safe_positions(known, np.random.default_rng(4), reach)
    apart = np.linalg.norm(where[:, None] - visited, axis=2).min(axis=1)
    assert apart.max() <= 0.15 + 1e-9
