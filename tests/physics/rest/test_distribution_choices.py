"""The choices of tensions against scipy, linear programming, other sizes and dense paths."""

import numpy as np
import pytest
from scipy.optimize import linprog, minimize

import carosac_toolkit as ct
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.physics.rest import statics, tension_distribution
from carosac_toolkit.physics.rest.structure import structure_matrix
from carosac_toolkit.physics.rest.tension_problem import DISTRIBUTIONS
from carosac_toolkit.robot.similar import similar_robot

ROBOTS = ("cogiro", "ipanema1")


def path(robot, count, side=0.5):
    """A circle with a change of height inside the workspace box, shape (count, 3)."""
    angle = np.linspace(0.0, 2.0 * np.pi, count)
    wave = np.stack([np.cos(angle), np.sin(angle), 0.5 * np.sin(2.0 * angle)], axis=1)
    middle = 0.5 * (robot.workspace_min + robot.workspace_max)
    return middle + 0.5 * side * (robot.workspace_max - robot.workspace_min) * wave


def problems(robot, count=40):
    """Structure matrices of a path, and the weight with its moment."""
    where = path(robot, count)
    weight = np.array([0.0, 0.0, -robot.weight])
    load = np.concatenate([weight, np.cross(robot.home_rotation @ robot.center_of_mass, weight)])
    return structure_matrix(robot, where), np.tile(load, (count, 1))


def cost(name, lower, upper, load):
    """The cost of tensions as the module states it, written once more."""
    typical = (np.linalg.norm(load) + lower.sum()) / len(lower)
    if name == "least_squares":
        return lambda f: 0.5 * ((f / typical) ** 2).sum()
    if name == "minimum":
        return lambda f: 0.5 * (((f - lower) / typical + 20.0) ** 2).sum()
    if name == "p_norm":
        return lambda f: (0.25 * (f / typical) ** 4 + 0.005 * (f / typical) ** 2).sum()
    middle, half = 0.5 * (lower + upper), 0.5 * (upper - lower)
    return lambda f: -0.5 * np.log(1.0 - ((f - middle) / half) ** 2).sum()


@pytest.mark.parametrize("name", DISTRIBUTIONS)
def test_each_choice_has_the_least_cost_that_scipy_finds(name):
    robot = ct.load_robot("cogiro")
    matrix, wrench = problems(robot, 7)
    lower, upper = robot.tension_min, robot.tension_max
    ours = tension_distribution.solve(matrix, wrench, lower, upper, distribution=name)
    assert ours.feasible.all()
    for k in range(len(matrix)):
        arm = np.linalg.norm(matrix[k, 3:], axis=0).max()
        rows = matrix[k] / np.repeat([1.0, arm], 3)[:, None]
        load = wrench[k] / np.repeat([1.0, arm], 3)
        phi = cost(name, lower, upper, load)
        # Two directions leave the balance as it is; the search is over these alone.
        free = np.linalg.svd(rows)[2][6:].T
        at = ours.tension[k]

        def moved(z, at=at, free=free):
            return at + free @ z

        def room(z, moved=moved):
            return np.concatenate([moved(z) - lower, upper - moved(z)])

        best = minimize(
            lambda z, phi=phi, moved=moved: phi(moved(z)),
            np.full(2, 0.01 * robot.weight),
            constraints={"type": "ineq", "fun": room},
            method="SLSQP",
            options={"ftol": 1e-14, "maxiter": 500},
        )
        assert phi(ours.tension[k]) <= best.fun * (1.0 + 1e-9)
        assert np.abs(best.x).max() < 2e-3 * robot.weight  # where scipy stops


@pytest.mark.parametrize("robot_name", ROBOTS)
def test_minimum_is_nearly_the_linear_program(robot_name):
    robot = ct.load_robot(robot_name)
    matrix, wrench = problems(robot)
    lower, upper = robot.tension_min, robot.tension_max
    ours = tension_distribution.solve(matrix, wrench, lower, upper, distribution="minimum")
    others = tension_distribution.solve(matrix, wrench, lower, upper)
    bounds = list(zip(lower, upper, strict=True))
    assert ours.feasible.any()
    for k in np.flatnonzero(ours.feasible):
        program = linprog(np.ones(8), A_eq=matrix[k], b_eq=-wrench[k], bounds=bounds)
        assert ours.tension[k].sum() <= 1.03 * program.fun  # the price of continuity
        assert ours.tension[k].sum() <= others.tension[k].sum() * (1.0 + 1e-9)


@pytest.mark.parametrize("robot_name", ROBOTS)
def test_each_choice_is_best_at_what_it_is_for(robot_name):
    robot = ct.load_robot(robot_name)
    matrix, wrench = problems(robot)
    lower, upper = robot.tension_min, robot.tension_max
    all_of = {
        name: tension_distribution.solve(matrix, wrench, lower, upper, distribution=name)
        for name in DISTRIBUTIONS
    }
    good = all_of["least_squares"].feasible
    assert good.any()
    least, smooth, inside = (
        all_of[name].tension[good] for name in ("least_squares", "p_norm", "centre")
    )
    norm = [np.linalg.norm(f, ord=4, axis=1) for f in (smooth, least)]
    assert (norm[0] <= norm[1] * (1.0 + 1e-3)).all()
    room = [np.maximum((f - lower) * (upper - f), 1e-300) for f in (inside, least)]
    assert (np.log(room[0]).sum(axis=1) >= np.log(room[1]).sum(axis=1) - 1e-9).all()
    for found in all_of.values():
        assert (found.feasible == good).all()
        assert (found.tension >= lower).all() and (found.tension <= upper).all()
        assert (found.residual[good] < 1e-9 * robot.weight).all()


@pytest.mark.parametrize("name", DISTRIBUTIONS)
@pytest.mark.parametrize("robot_name", ROBOTS)
def test_tensions_change_in_proportion_to_the_step_of_a_path(robot_name, name):
    robot = ct.load_robot(robot_name)

    def largest_change(count):
        matrix, wrench = problems(robot, count)
        found = tension_distribution.solve(
            matrix, wrench, robot.tension_min, robot.tension_max, distribution=name
        )
        assert found.feasible.all()
        return np.abs(np.diff(found.tension, axis=0)).max()

    coarse, fine = largest_change(501), largest_change(5001)
    assert fine < 0.13 * coarse  # a jump would stay as it is
    assert coarse < 20.0 * robot.weight * 2.0 * np.pi / 500


@pytest.mark.parametrize("factor", [0.1, 10.0])
@pytest.mark.parametrize("name", DISTRIBUTIONS)
def test_choices_do_not_depend_on_the_size_of_the_robot(name, factor):
    robot = ct.load_robot("cogiro")
    other = similar_robot(robot, factor)
    here, there = (
        tension_distribution.solve(
            *problems(one), one.tension_min, one.tension_max, distribution=name
        )
        for one in (robot, other)
    )
    assert (here.feasible == there.feasible).all()
    # The cube of 0.1 is not exact in binary; at limits that meet, 1e-9 of the weight is rounding.
    assert there.tension / factor**3 == pytest.approx(here.tension, abs=1e-9 * robot.weight)


@pytest.mark.parametrize("factor", [0.1, 1.0, 10.0])
@pytest.mark.parametrize("name", DISTRIBUTIONS)
def test_the_loop_agrees_with_the_batch_in_any_size(name, factor):
    robot = similar_robot(ct.load_robot("cogiro"), factor)
    matrix, wrench = problems(robot)
    limits = robot.tension_min, robot.tension_max
    together = tension_distribution.solve(matrix, wrench, *limits, distribution=name)
    loop = tension_distribution.TensionDistributor(8, *limits, distribution=name)
    for k in range(len(matrix)):
        alone = loop.solve(matrix[k : k + 1], wrench[k : k + 1])
        assert alone.feasible[0] == together.feasible[k]
        assert alone.tension[0] == pytest.approx(together.tension[k], abs=1e-5 * robot.weight)


@pytest.mark.parametrize("name", DISTRIBUTIONS)
def test_an_infeasible_wrench_is_reported_and_the_loop_recovers(name):
    robot = ct.load_robot("cogiro")
    matrix, wrench = problems(robot, 1)
    limits = robot.tension_min, robot.tension_max
    upwards = -wrench
    assert not tension_distribution.solve(matrix, upwards, *limits, distribution=name).feasible[0]
    loop = tension_distribution.TensionDistributor(8, *limits, distribution=name)
    before = loop.solve(matrix, wrench)
    refused = loop.solve(matrix, upwards)
    after = loop.solve(matrix, wrench)
    assert not refused.feasible[0] and refused.residual[0] > 0.1 * robot.weight
    assert before.feasible[0] and after.feasible[0]
    assert after.tension == pytest.approx(before.tension, abs=1e-5 * robot.weight)


@pytest.mark.parametrize("name", DISTRIBUTIONS)
def test_equal_limits_and_lost_rank_leave_no_wrong_answer(name):
    """Cables whose limits meet have that tension; two cables on one line still balance."""
    matrix = np.zeros((1, 6, 4))
    matrix[0, 2] = 1.0  # all straight up through the origin: rank 1
    wrench = np.array([[0.0, 0.0, -40.0, 0.0, 0.0, 0.0]])
    lower, upper = np.array([5.0, 7.0, 1.0, 1.0]), np.array([5.0, 30.0, 30.0, 30.0])
    found = tension_distribution.solve(matrix, wrench, lower, upper, distribution=name)
    assert found.feasible[0] and found.residual[0] < 1e-9
    assert found.tension[0, 0] == 5.0
    assert found.tension.sum() == pytest.approx(40.0, abs=1e-9)
    assert found.tension[0, 2] == pytest.approx(found.tension[0, 3], abs=1e-9)


@pytest.mark.parametrize("name", DISTRIBUTIONS)
def test_inverse_kinematics_rests_with_the_tensions_of_its_choice(name):
    """With sag the balance moves by the cables' weight; lengths alone give the same rest."""
    robot = ct.load_robot("cogiro")
    where = path(robot, 6)
    rest = statics.inverse_kinematics(robot, where, distribution=name)
    assert rest.converged.all()
    assert not rest.slack.any() and (rest.tension <= robot.tension_max).all()
    again = statics.forward_kinematics(robot, rest.unstrained_length, guess=rest)
    assert again.position == pytest.approx(where, abs=1e-9)
    usual = statics.inverse_kinematics(robot, where)
    straight = [
        tension_distribution.solve(
            *problems(robot, 6), robot.tension_min, robot.tension_max, distribution=choice
        ).tension
        for choice in (name, "least_squares")
    ]
    expected = straight[0] - straight[1]
    assert rest.tension - usual.tension == pytest.approx(expected, abs=0.02 * robot.tension_max[0])


def test_bad_choices_are_refused():
    robot = ct.load_robot("cogiro")
    matrix, wrench = problems(robot, 1)
    with pytest.raises(InvalidField, match=r"distribution: got 'least'; allowed: one of"):
        tension_distribution.solve(matrix, wrench, 1.0, 2.0, distribution="least")
    with pytest.raises(InvalidField, match=r"reference: got 5.0; allowed: 0: 'centre' has its own"):
        tension_distribution.solve(matrix, wrench, 1.0, 2.0, distribution="centre", reference=5.0)
    hall = ct.load_robot("carosac")
    with pytest.raises(InvalidField, match=r"distribution: got 'centre'.*of 4 cables"):
        statics.inverse_kinematics(hall, hall.home_position[None], distribution="centre")
