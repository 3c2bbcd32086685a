"""Rest with the largest margin: that it is at rest, that there is no better, any way to it."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

import carosac_toolkit as ct
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.physics.rest import hold, statics, tension_margin
from carosac_toolkit.physics.rest.structure import structure_matrix
from tests.robots import eight_cable_robot, with_pulleys


def positions(robot, count, seed=0):
    rng = np.random.default_rng(seed)
    return rng.uniform(robot.workspace_min, robot.workspace_max, (count, 3))


@pytest.mark.parametrize("name", ["carosac", "scampi", "ipanema1", "cogiro"])
def test_it_is_at_rest_and_no_worse_than_the_least_tensions(name):
    robot = ct.load_robot(name)
    result = hold.hold(robot, positions(robot, 60))
    assert result.solved.all()
    held = np.flatnonzero(result.rest.converged)
    assert len(held) > 50
    # The lengths alone lead back to the pose and the tensions, by another solver.
    there = statics.forward_kinematics(
        robot, result.rest.unstrained_length[held],
        guess=ct.Pose(position=result.rest.position[held], rotation=result.rest.rotation[held]),
    )  # fmt: skip
    assert there.converged.all()
    assert there.position == pytest.approx(result.rest.position[held], abs=1e-7)
    assert there.tension == pytest.approx(result.rest.tension[held], abs=1e-4)
    least = statics.inverse_kinematics(robot, result.rest.position)
    assert (least.converged == result.rest.converged).all()
    margin = np.minimum(least.tension - robot.tension_min, robot.tension_max - least.tension)
    assert (result.margin >= margin.min(axis=1) - 1e-6)[held].all()


def test_free_rotation_against_a_general_optimiser_on_straight_cables():
    robot = ct.load_robot("carosac")
    light = replace(robot, linear_density=1e-9 * robot.linear_density)
    place = np.array([[0.4, -1.8, 2.2], [1.9, -3.0, 3.5], [-1.2, -0.3, 4.6]])
    held = hold.hold(light, place)
    weight = np.array([0.0, 0.0, -robot.weight])

    def balance(x, where):
        turn = Rotation.from_rotvec(x[:3]).as_matrix()
        arm = robot.anchor_points @ turn.T
        unit = robot.exit_points - where - arm
        unit /= np.linalg.norm(unit, axis=1, keepdims=True)
        force = x[3:7, None] * unit * robot.weight
        moment = np.cross(arm, force).sum(axis=0) + np.cross(turn @ robot.center_of_mass, weight)
        return np.concatenate([force.sum(axis=0) + weight, moment]) / robot.weight

    for k, where in enumerate(place):
        best = -np.inf
        for seed in range(4):
            start = np.random.default_rng(seed).uniform(-0.2, 0.2, 3)
            first = np.append(np.append(start, np.full(4, 0.4)), 0.2)
            lower, upper = robot.tension_min / robot.weight, robot.tension_max / robot.weight
            answer = minimize(
                lambda x: -x[7], first, method="SLSQP", options={"ftol": 1e-13, "maxiter": 300},
                constraints=[
                    {"type": "eq", "fun": balance, "args": (where,)},
                    {"type": "ineq", "fun": lambda x, a=lower: x[3:7] - a - x[7]},
                    {"type": "ineq", "fun": lambda x, b=upper: b - x[3:7] - x[7]},
                ],
            )  # fmt: skip
            if answer.success and np.abs(balance(answer.x, where)).max() < 1e-8:
                best = max(best, answer.x[7] * robot.weight)
        assert held.margin[k] == pytest.approx(best, abs=1e-4)


@pytest.mark.parametrize("name", ["carosac", "scampi", "cogiro"])
def test_neighbours_chunks_and_batches_change_nothing(name, monkeypatch):
    robot = ct.load_robot(name)
    beyond = robot.workspace_max + np.array([0.3, 0.5, 1.0])
    line = np.linspace(robot.workspace_min, beyond, 30)
    batch = np.concatenate([line, line[::-1]])
    along = hold.hold(robot, batch, lines=[0, 30])
    alone = hold.hold(robot, batch)
    assert along.margin == pytest.approx(alone.margin, abs=1e-5, nan_ok=True)
    assert (along.rest.stable == alone.rest.stable).all()
    monkeypatch.setattr(hold, "CHUNK_POSES", 7)
    chunked = hold.hold(robot, batch, lines=[0, 30])
    assert np.array_equal(chunked.margin, along.margin, equal_nan=True)
    one = hold.hold(robot, batch[11:12])
    assert one.margin[0] == alone.margin[11]


def test_an_extra_wrench_is_balanced_too():
    robot = ct.load_robot("cogiro")
    light = replace(robot, linear_density=1e-9 * robot.linear_density)
    place, turn = positions(robot, 5, 2), Rotation.from_rotvec(0.05 * np.eye(5, 3)).as_matrix()
    wrench = np.array([30.0, -20.0, 50.0, 4.0, -5.0, 6.0])
    held = hold.hold(light, place, turn, wrench=wrench)
    weight = np.array([0.0, 0.0, -robot.weight])
    moment = np.cross(turn @ robot.center_of_mass, weight)
    load = np.hstack([np.tile(weight, (5, 1)), moment]) + wrench
    pulled = np.einsum("bij,bj->bi", structure_matrix(robot, place, turn), held.rest.tension)
    assert pulled == pytest.approx(-load, abs=1e-5)


def test_beyond_its_limits_a_cable_makes_the_margin_negative_and_nothing_converges():
    robot = ct.load_robot("cogiro")
    heavy = replace(robot, mass=40.0 * robot.mass)
    held = hold.hold(heavy, [robot.home_position])
    assert held.solved[0] and held.margin[0] < 0.0
    assert not held.rest.converged[0] and np.isnan(held.rest.stiffness).all()
    assert held.high[0].sum() > 0.9


def test_a_margin_is_only_said_of_cables_that_can_be_hung():
    """Under its pulley a cable would wrap more than half a turn, which no hanging one does here."""
    robot = with_pulleys(eight_cable_robot())  # of radius 0.06 m: the cable is within 0.12 m
    robot = replace(robot, linear_density=1e-9 * robot.linear_density)
    under = robot.exit_points[0] - robot.anchor_points[0]
    where = under + np.array([[0.02, 0.0, -1.0], [0.05, 0.0, -1.5], [0.125, 0.0, -1.0]])
    held = hold.hold(robot, where)
    weight = [0.0, 0.0, -robot.weight, *np.cross(robot.center_of_mass, [0, 0, -robot.weight])]
    matrix = structure_matrix(robot, where, np.repeat(np.eye(3)[None], 3, axis=0))
    straight = tension_margin.solve(
        matrix, np.repeat([weight], 3, axis=0), robot.tension_min, robot.tension_max
    )
    assert held.solved.tolist() == [False, False, True]
    assert held.margin[2] == pytest.approx(straight.margin[2], abs=1e-4)


def test_bad_input_is_named():
    robot = ct.load_robot("carosac")
    with pytest.raises(InvalidField, match="rotation: got a rotation; allowed: None: 4 cables"):
        hold.hold(robot, [robot.home_position], np.eye(3)[None])
    with pytest.raises(InvalidField, match="wrench"):
        hold.hold(robot, [robot.home_position], wrench=[1.0])
    with pytest.raises(InvalidField, match="lines"):
        hold.hold(robot, [robot.home_position], lines=[1])
