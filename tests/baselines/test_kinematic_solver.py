from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from baselines import kinematic_solver
from baselines.kinematic_solver import KinematicSolver, KinematicSolverSettings
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.loop import plugins
from carosac_toolkit.loop.values import Command, Measurement, Pose
from tests import reference
from tests.robots import simple_robot

POSITION = np.array([0.4, -1.8, 2.2])
SHIFT = np.array([0.2, -0.1, 0.05])


def measured(lengths, time=0.0, pose=None):
    lengths = np.atleast_2d(lengths)
    return Measurement(time=np.full(len(lengths), time), unstrained_length=lengths, pose=pose)


def step(estimator, belief, measurement):
    lengths = measurement.unstrained_length
    return estimator.update(
        belief, Command(time=measurement.time, unstrained_length=lengths), measurement
    )


def lengths_near(robot, position):
    """Straight distances, a few millimetres longer: cables that hang and carry."""
    return np.linalg.norm(robot.exit_points - position - robot.anchor_points, axis=1) + 2e-3


@pytest.fixture
def scripted(monkeypatch):
    """Replaces the solver by one that answers as told, and records the guesses it was given.

    Each answer is a pair of lists over the batch: converged, stable; positions count the calls.
    """

    def play(*answers):
        guesses = []

        def solve(robot, unstrained_length, *, guess=None):
            converged, stable = answers[len(guesses)]
            guesses.append(guess)
            size = len(unstrained_length)
            assert size == len(converged)
            return SimpleNamespace(
                position=np.full((size, 3), float(len(guesses))),
                rotation=np.tile(np.eye(3), (size, 1, 1)),
                tension=np.full((size, 4), 10.0 * len(guesses)),
                residual=np.full(size, 1e-9),
                converged=np.array(converged),
                stable=np.array(stable),
            )

        monkeypatch.setattr(kinematic_solver, "forward_kinematics", solve)
        return guesses

    return play


YES, NO = ([True], [True]), ([False], [False])


@pytest.mark.parametrize("seed", ["belief", "cold", "pose"])
def test_pose_and_tension_agree_with_the_independent_equilibrium(seed):
    robot = simple_robot()
    estimator = KinematicSolver.build(robot, KinematicSolverSettings(seed=seed), seed=0)
    belief = None
    for k, shift in enumerate(np.linspace(0.0, 0.6, 4)):
        position = POSITION + shift * np.array([1.0, -0.5, 0.7])
        lengths = lengths_near(robot, position)
        known = reference.equilibrium(robot, lengths, position, np.eye(3))
        assert known.residual < 1e-13
        near = Pose(position=position[None] + 0.02, rotation=np.eye(3)[None])
        m = measured(lengths, 0.1 * k, near)
        belief = estimator.reset(m) if belief is None else step(estimator, belief, m)
        assert belief.converged.all()
        assert belief.position[0] == pytest.approx(known.position, abs=1e-8)
        assert belief.rotation[0] == pytest.approx(known.rotation, abs=1e-8)
        assert belief.tension[0] == pytest.approx(known.tension, abs=1e-4)
        assert belief.time[0] == pytest.approx(0.1 * k)
    assert belief.memory.updates == 4
    assert belief.memory.failures.tolist() == [0]
    assert belief.memory.unseeded == 0


def test_batch_equals_loop():
    robot = simple_robot()
    lengths = np.array([lengths_near(robot, POSITION + i * SHIFT) for i in range(4)])
    estimator = KinematicSolver.build(robot)
    together = estimator.reset(measured(lengths))
    assert together.converged.all()
    for i, row in enumerate(lengths):
        alone = estimator.reset(measured(row))
        assert alone.position[0] == pytest.approx(together.position[i], abs=1e-12)


def test_standalone_solves_start_at_the_last_solution(scripted):
    guesses = scripted(YES, YES, YES)
    estimator = KinematicSolver.build(simple_robot())
    first = estimator.reset(measured([9.0] * 4))
    second = step(estimator, first, measured([9.0] * 4))
    step(estimator, second, measured([9.0] * 4))
    assert guesses[0] is None
    assert guesses[1] is first.memory.solution
    assert guesses[2] is second.memory.solution


def test_cold_solves_have_no_guess(scripted):
    guesses = scripted(YES, YES)
    estimator = KinematicSolver.build(simple_robot(), KinematicSolverSettings(seed="cold"))
    step(estimator, estimator.reset(measured([9.0] * 4)), measured([9.0] * 4))
    assert guesses == [None, None]


def test_seeded_solves_start_at_the_measured_pose_and_count_where_it_lacks(scripted):
    guesses = scripted(YES, YES, YES)
    pose = Pose(position=POSITION[None], rotation=np.eye(3)[None])
    estimator = KinematicSolver.build(simple_robot(), KinematicSolverSettings(seed="pose"))
    belief = estimator.reset(measured([9.0] * 4, pose=pose))
    belief = step(estimator, belief, measured([9.0] * 4, pose=pose))
    last = belief.memory.solution
    belief = step(estimator, belief, measured([9.0] * 4))
    assert guesses[0] is pose
    assert guesses[1] is pose
    assert guesses[2] is last
    assert belief.memory.unseeded == 1


def test_a_failed_solve_is_done_again_without_a_guess_and_counted(scripted):
    guesses = scripted(YES, NO, YES)
    estimator = KinematicSolver.build(simple_robot())
    belief = step(estimator, estimator.reset(measured([9.0] * 4)), measured([9.0] * 4))
    assert guesses[2] is None
    assert belief.position[0].tolist() == [3.0, 3.0, 3.0]
    assert belief.memory.restarts.tolist() == [1]
    assert belief.memory.failures.tolist() == [0]
    assert belief.converged.tolist() == [True]


def test_only_the_failed_rows_are_solved_again(scripted):
    guesses = scripted(
        ([True, True, True], [True, True, True]),
        ([True, False, True], [True, False, True]),
        YES,
        ([True, True, True], [True, True, True]),
    )
    estimator = KinematicSolver.build(simple_robot())
    m = measured(np.full((3, 4), 9.0))
    belief = step(estimator, estimator.reset(m), m)
    assert belief.position[:, 0].tolist() == [2.0, 3.0, 2.0]
    assert belief.tension[:, 0].tolist() == [20.0, 30.0, 20.0]
    assert belief.memory.restarts.tolist() == [0, 1, 0]
    step(estimator, belief, m)
    assert (guesses[3].position == belief.position).all()  # poses alone: forces are of two solves


@pytest.mark.parametrize("bad", [NO, ([True], [False])], ids=["diverged", "unstable"])
def test_without_a_solution_the_last_good_pose_stays_and_says_so(scripted, bad):
    scripted(YES, bad, YES)
    settings = KinematicSolverSettings(restart=False)
    estimator = KinematicSolver.build(simple_robot(), settings)
    start = estimator.reset(measured([9.0] * 4))
    belief = step(estimator, start, measured([9.0] * 4, 0.1))
    assert belief.time[0] == pytest.approx(0.1)
    assert (belief.position == start.position).all()
    assert (belief.tension == start.tension).all()
    assert belief.converged.tolist() == [False]
    assert belief.memory.failures.tolist() == [1]
    belief = step(estimator, belief, measured([9.0] * 4, 0.2))
    assert belief.converged.tolist() == [True]
    assert belief.memory.failures.tolist() == [1]
    assert belief.memory.updates == 3


def test_a_first_failure_leaves_home_without_tensions_and_says_so(scripted):
    scripted(NO)
    robot = simple_robot()
    belief = KinematicSolver.build(robot).reset(measured([9.0] * 4))
    assert (belief.position[0] == robot.home_position).all()
    assert belief.tension is None
    assert belief.converged.tolist() == [False]
    assert belief.memory.failures.tolist() == [1]


def test_lengths_that_no_cable_survives_show_in_the_tensions():
    robot = simple_robot()
    belief = KinematicSolver.build(robot).reset(measured([4.0] * 4))  # corners are 13 m apart
    if belief.converged.all():  # elastic cables always have an equilibrium: here at 2e5 N
        assert (belief.tension > 100.0 * robot.tension_max).all()
    else:
        assert belief.memory.failures.tolist() == [1]


def test_it_is_found_by_name():
    assert plugins.load("estimators", "kinematic_solver") is KinematicSolver


def test_settings_and_missing_poses_are_refused():
    with pytest.raises(InvalidField, match="seed: got 'warm'; allowed: one of"):
        KinematicSolverSettings(seed="warm")  # type: ignore[arg-type]
    estimator = KinematicSolver.build(simple_robot(), KinematicSolverSettings(seed="pose"))
    with pytest.raises(InvalidField, match=r"measurement\.pose: got None"):
        estimator.reset(measured([9.0] * 4))
