"""What a fit sees of many recordings: the slow sway, and derivatives that tell no more."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from scipy.optimize import brentq, minimize

import carosac_toolkit as ct
from benchmarks.calibration_oscillations import (
    SURVEYED,
    draw_plant,
    robot_with_pulleys,
)
from calibration.identification import averages, fit, linearization, procedure, spread
from calibration.identification.averages import AVERAGES_DECREASE, MeanErrors
from calibration.identification.doubts import Judge
from calibration.identification.error_noise import estimate_noise
from calibration.identification.fit import Fitter
from calibration.identification.linearization import (
    Linearization,
    axes_of_robot,
    is_stale,
    scattered_moves,
)
from calibration.identification.measured_poses import MeasuredPoses, poses_of
from calibration.identification.open_loop import (
    OpenLoopRun,
    OpenLoopStart,
    first_equilibrium,
    simulate_runs,
)
from calibration.identification.quadratic import Quadratic
from calibration.identification.runs import (
    FittedRun,
    averaged_rate,
    fastest_sway,
    is_locked,
    leading_time,
    slow_window,
    time_before,
    without_ringing,
)
from calibration.identification.settings import IdentificationSettings
from calibration.identification.spread import symmetric_draws
from calibration.identification.sway import find_sway, swaying_states
from calibration.identification.synthetic_oscillations import (
    OscillationSettings,
    simulate_oscillations,
)
from calibration.identification.unknowns import choose_coordinates
from calibration.identification.vibrations import HiddenVibrations
from carosac_toolkit.base.errors import CarosacError
from carosac_toolkit.base.scaled import resolved
from carosac_toolkit.loop.values import Pose
from carosac_toolkit.physics.fleet import Fleet
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.physics.rest.modes import natural_frequencies
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.recordings.length_path import LengthPath
from carosac_toolkit.recordings.poses import PoseSamples
from carosac_toolkit.recordings.recording import Recording
from carosac_toolkit.robot.parameters import with_values
from sim_warp import Simulator
from tests.robots import eight_cable_robot

RATE = 100.0


@pytest.fixture(scope="module")
def plant():
    return draw_plant(robot_with_pulleys(3), SURVEYED, 1)


@pytest.fixture(scope="module")
def runs(plant):
    short = OscillationSettings(count=10, duration=1.0, time_step=0.01)
    return [prepared(plant, each) for each in simulate_oscillations(plant, 1, short)]


def prepared(robot, recording):
    path, poses = LengthPath(recording), poses_of(recording)
    rest = first_equilibrium(robot, path)
    return FittedRun(
        path=path,
        poses=poses,
        rate=RATE,
        sway=find_sway(robot, rest, poses, moves=True, before=time_before(robot, rest)),
        window=slow_window(robot, rest, poses.time, RATE),
    )


def lasting(run, duration=10.0):
    """A run whose poses last for longer; only their times are right."""
    rows = np.arange(round(duration * RATE))
    poses = run.poses.rows(np.zeros(len(rows), dtype=int))
    return replace(run, poses=replace(poses, time=rows / RATE))


def at_home(robot):
    return statics.inverse_kinematics(robot, robot.home_position[None])


def told_of(run, wave):
    """Squares of a wave (K,) over the variance of noise, of what a fit sees and of poses."""
    noise = np.random.default_rng(0).standard_normal((len(wave), 3000))
    seen = run.seen(np.tile(wave[:, None], (1, 6)))[:, 0]
    return float((seen**2).sum() / run.seen(noise).var()), float((wave**2).sum())


def test_averages_tell_of_a_sway_what_poses_do(runs):
    run = lasting(runs[0])
    time = run.poses.time - run.poses.time[0]
    for periods in (0.0, 0.5, 1.0, 1.5, 2.0):  # in a window
        seen, whole = told_of(run, np.cos(2.0 * np.pi * periods * time / run.window + 0.5))
        assert 0.85 < seen / whole < 1.02, periods  # half a window is lost at both ends


def test_averages_have_noise_of_their_own(runs):
    run = lasting(runs[0])
    noise = np.random.default_rng(1).standard_normal((len(run.poses.time), 4000))
    seen = run.seen(noise)
    covariance = seen @ seen.T / seen.shape[1] / seen.var()
    assert np.abs(covariance - np.eye(len(seen))).max() < 0.1  # chance alone leaves 0.06


def test_averages_leave_nothing_of_vibrations(plant, runs):
    run = lasting(runs[0])
    time = run.poses.time - run.poses.time[0]
    frequency = natural_frequencies(plant, first_equilibrium(plant, run.path))[0]
    for value in frequency[3:]:
        seen, whole = told_of(run, np.sin(2.0 * np.pi * value * time))
        assert seen < 1e-6 * whole


def test_averages_near_a_gap_leave_nothing_of_vibrations_either(plant, runs):
    run = lasting(runs[0])
    time = run.poses.time - run.poses.time[0]
    slowest = natural_frequencies(plant, first_equilibrium(plant, run.path))[0, 3]
    gap = np.abs(time - 5.0) > 0.75 * run.window
    few = replace(run, poses=run.poses.rows(np.flatnonzero(gap)))
    seen, whole = told_of(few, np.sin(2.0 * np.pi * slowest * time[gap]))
    assert seen < 1e-3 * whole


def test_where_sway_and_vibrations_are_not_apart_nothing_is_averaged(plant):
    time = np.arange(0.0, 10.0, 1.0 / RATE)
    assert slow_window(plant, at_home(plant), time, RATE) > 0.0
    some = np.delete(time, np.arange(100, 600))  # poses may be missing for a while
    assert slow_window(plant, at_home(plant), some, RATE) > 0.0
    assert slow_window(plant, at_home(plant), time[::10], RATE) == 0.0  # too few poses in a window
    assert slow_window(plant, at_home(plant), time[:1], RATE) == 0.0
    soft = replace(plant, axial_stiffness=1e-3 * plant.axial_stiffness)
    assert slow_window(soft, at_home(soft), time, RATE) == 0.0
    for robot in (ct.load_robot("cogiro"), eight_cable_robot()):  # no sway at all
        assert slow_window(robot, at_home(robot), time, RATE) == 0.0


def test_nothing_is_averaged_where_averages_would_be_too_rare_to_show_a_sway(plant):
    time = np.arange(0.0, 10.0, 1.0 / RATE)
    sway = fastest_sway(plant, at_home(plant))
    assert slow_window(plant, at_home(plant), time, 2.6 * sway) > 0.0
    assert slow_window(plant, at_home(plant), time, 2.4 * sway) == 0.0


def test_windows_are_of_the_robot_that_is_nearly_found(plant, runs):
    soft = replace(plant, axial_stiffness=plant.axial_stiffness / 3.0)
    mixed = replace(plant, axial_stiffness=plant.axial_stiffness / 1000.0)
    kept = np.arange(0.0, 10.0, 1.0 / RATE)
    part = procedure._Part(name="swing", recording=None, train=(0, 10), test=None)
    path = runs[0].path
    for robot in (plant, soft):
        found = procedure._Averaged.of([part], robot, [kept], [path], RATE)
        slowest = natural_frequencies(robot, first_equilibrium(robot, path))[0, 3]
        assert found.windows == pytest.approx([4.0 / slowest]) and found.mixed == ()
    found = procedure._Averaged.of([part], mixed, [kept], [path], RATE)
    assert found.mixed == ("swing",)
    held_out = replace(part, train=None, test=(0, 10))
    assert procedure._Averaged.of([held_out], mixed, [kept], [path], RATE).mixed == ()


def test_no_motion_tells_the_unit_of_force(plant, runs):
    """Derivatives by the mass are those that follow from all forces and masses by one factor."""
    chosen = resolved(IdentificationSettings(), Scales(plant).ratios)
    unknowns = choose_coordinates(plant, replace(chosen, length_delay=0.0))
    fitter = Fitter(unknowns, runs, chosen)
    at, mass = fitter.space.begin, unknowns.prior.names.index("mass")
    jacobians = fitter.run_errors.jacobians(at, coarse=False)
    step = 2e-3 * np.eye(len(at))[mass]
    sides = [fitter.run_errors.at(at + side * step) for side in (-1.0, 1.0)]
    for jacobian, before, after in zip(jacobians, *sides, strict=True):
        expected = (after - before) / (2.0 * step[mass])
        assert np.linalg.norm(jacobian[:, :, mass] - expected) < 3e-3 * np.linalg.norm(expected)
        along = jacobian[:, :, : len(unknowns.prior.names)] @ unknowns.alike
        assert np.abs(along).max() < 1e-12


def fitter_of(plant, runs):
    settings = resolved(SURVEYED, Scales(plant).ratios)
    return Fitter(choose_coordinates(plant, settings), runs, settings)


@pytest.fixture(scope="module")
def near(plant, runs):
    """A fitter, where it begins, errors, their noise, rough and exact derivatives, information.

    Of dry friction one is a little above its bound.
    """
    fitter = fitter_of(plant, runs)
    at, searched = fitter.space.begin.copy(), fitter.space.searched.copy()
    friction = fitter.space.names.index("exit_friction")
    at[friction] = fitter.space.lower[friction] + 0.002
    searched[fitter.space.mass] = False
    errors = fitter.run_errors.at(at)
    rough, fine = (fitter.run_errors.slopes(at, searched, refined=r) for r in (1, 2))
    exact = [(4.0 * b - a) / 3.0 for a, b in zip(rough, fine, strict=True)]
    noise = replace(estimate_noise(errors), sigma=np.full(6, 1e-3))  # as of measured poses
    information, _ = fitter.cost.normal(errors, exact, noise)
    return fitter, at, errors, noise, rough, exact, information


def test_a_linear_function_over_little_uncertainty_has_the_derivatives(near, monkeypatch):
    monkeypatch.setattr(linearization, "AXIS_MAX", 1e-3)  # so near all is linear
    fitter, at, errors, noise, rough, _, information = near
    hessian = information + fitter.cost.precision
    monkeypatch.setattr(fitter.run_errors, "hidden", None)
    averaged = fitter.averages.mean_errors(at, hessian)
    for mean, error, linear in zip(averaged.errors, errors, averaged.linear, strict=True):
        assert np.abs(mean - error).max() < 0.05 * noise.sigma[0]
        assert np.abs(linear.beyond).max() < 0.05 * noise.sigma[0]
    root = np.linalg.cholesky(np.linalg.inv(hessian))
    own = np.arange(len(at)) != fitter.space.mass
    known, again = (
        root.T[:, own] @ fitter.cost.normal(errors, each, noise)[0][np.ix_(own, own)] @ root[own]
        for each in (rough, averaged.jacobians)
    )
    assert np.abs(again - known).max() < 0.1  # by axes of the covariance


def test_what_slopes_tell_by_chance_is_not_believed(near, monkeypatch):
    monkeypatch.setattr(linearization, "AXIS_MAX", 1e-3)  # so near all is linear
    fitter, at, errors, noise, _, _, information = near
    hessian, simulated = information + fitter.cost.precision, fitter.run_errors.simulated
    rng = np.random.default_rng(6)

    def rugged(points, *, refined=1):
        found, good = simulated(points, refined=refined)
        size = 1e-3 * noise.sigma[0] if len(found[0]) > 1 else 0.0
        return [each + size * rng.standard_normal(each.shape) for each in found], good

    monkeypatch.setattr(fitter.run_errors, "hidden", None)
    monkeypatch.setattr(fitter.cost, "doubts", None)
    told = []
    for simulate in (simulated, rugged):
        monkeypatch.setattr(fitter.run_errors, "simulated", simulate)
        found = fitter.averages.mean_errors(at, hessian)
        told.append(fitter.cost.normal(errors, found.jacobians, noise)[0])
    monkeypatch.setattr(fitter.cost, "linear", found.linear)
    believed = fitter.averages.believed(told[1], errors, found.jacobians, noise)
    axes = axes_of_robot(hessian, fitter.space.searched, fitter.space.count)
    axes = np.delete(axes, fitter.space.mass, axis=1)  # the mass follows
    rows = np.delete(np.arange(len(at)), fitter.space.mass)
    by_chance, left = (
        np.einsum("ai,ij,aj->a", axes, (each - told[0])[np.ix_(rows, rows)], axes).sum()
        for each in (told[1], believed)
    )
    assert by_chance > 0.0 and abs(left) < 0.3 * by_chance


def test_a_robot_that_is_likely_and_does_not_move_is_named(near, monkeypatch):
    fitter, at, *_, information = near
    simulated = fitter.run_errors.simulated

    def failing(points, *, refined=1):
        found, good = simulated(points, refined=refined)
        good[3] = good[3] & (np.arange(len(good[3])) < 5)
        return found, good

    monkeypatch.setattr(fitter.run_errors, "hidden", None)
    monkeypatch.setattr(fitter.run_errors, "simulated", failing)
    with pytest.raises(CarosacError, match="no finite motion of a robot that fits as well"):
        fitter.averages.mean_errors(at, information + fitter.cost.precision)


def test_hidden_vibrations_are_found_anew_where_a_search_has_left(near):
    fitter, _, _, _, _, _, information = near
    hessian = information + fitter.cost.precision
    root = np.linalg.cholesky(np.linalg.inv(hessian))
    step = np.sqrt(fitter.space.count) * root[:, 0] / np.sqrt(root[:, 0] @ hessian @ root[:, 0])
    assert not is_stale(0.9 * step, hessian, fitter.space.count)
    assert is_stale(1.1 * step, hessian, fitter.space.count)
    start = np.where(np.arange(len(step)) < fitter.space.count, 0.0, 1.0)  # of the starts alone
    assert not is_stale(start, hessian, fitter.space.count)


@pytest.mark.parametrize("name", ["inertia.xx", "axial_damping", "start.speed[0]"])
def test_steps_are_judged_by_vanishing_time_steps(near, monkeypatch, name):
    """What time steps make errors wrong by changes along a step; one simulation tells it anyway."""
    fitter, at, _, _, rough, exact, _ = near
    move = np.zeros(len(at))
    move[fitter.space.names.index(name)] = 0.02

    def missed():
        fitter.run_errors.at(at)
        trials, _ = fitter.run_errors.trials(np.array([at + move]))
        exact = fitter.run_errors.at(at + move)
        return sum(((a[0] - b) ** 2).sum() for a, b in zip(trials, exact, strict=True))

    monkeypatch.setattr(fitter.run_errors, "finer", None)
    without = missed()
    finer = [one - other for one, other in zip(exact, rough, strict=True)]
    monkeypatch.setattr(fitter.run_errors, "finer", finer)
    assert missed() < 0.1 * without


def test_hidden_vibrations_correct_errors_and_trials_once(near, monkeypatch):
    fitter, at, *_ = near
    without, (plain, _) = fitter.run_errors.at(at), fitter.run_errors.trials(at[None])
    for size in (1e-3, 2e-3):  # found anew, a drift is another and not added
        hidden = [
            replace(HiddenVibrations.none(each), drift=np.full_like(each, size)) for each in without
        ]
        monkeypatch.setattr(fitter.run_errors, "hidden", hidden)
        found, (trials, _) = fitter.run_errors.at(at), fitter.run_errors.trials(at[None])
        for old, new, tried, trial in zip(without, found, plain, trials, strict=True):
            assert new - old == pytest.approx(size) and trial - tried == pytest.approx(size)


def test_hidden_vibrations_that_fit_worse_are_not_taken(near, monkeypatch):
    fitter, at, errors, *_ = near
    monkeypatch.setattr(fitter.cost, "doubts", None)
    calm, wrong = (
        [replace(HiddenVibrations.none(each), drift=np.full_like(each, size)) for each in errors]
        for size in (0.0, 5e-3)
    )
    sigma = np.ones(fitter.space.count)
    for before, anew, taken in ((calm, wrong, calm), (wrong, calm, calm), (None, wrong, wrong)):
        monkeypatch.setattr(fitter.run_errors, "hidden", before)
        monkeypatch.setattr(
            fitter.run_errors, "hidden_vibrations", lambda at, sigma, anew=anew: anew
        )
        assert fitter.averages._likelier_vibrations(at, sigma) is taken
        assert fitter.run_errors.hidden is before


def test_of_two_guesses_each_start_takes_the_one_that_suits_it(near):
    fitter, at, *_ = near
    own = [rows[fitter.space.count :] for rows in fitter.space.own]
    ends = [at.copy(), at.copy()]
    for k, rows in enumerate(own):
        ends[k % 2][rows] += 0.5  # off by centimetres
    found = fitter.start_search._likeliest(ends)
    for k, rows in enumerate(own):
        assert (found[rows] == ends[1 - k % 2][rows]).all()


def test_moves_of_some_sigmas_lead_to_robots(near):
    """Also next to a bound, where a move ends on it."""
    fitter, at, *_, information = near
    space = fitter.space
    searched = space.searched.copy()
    searched[space.mass] = False
    hessian = 1e-3 * information + fitter.cost.precision  # of few data
    axes = axes_of_robot(hessian, searched, space.count)
    cut = space.names.index("exit_friction")
    on_bound = 0
    for k, rows in enumerate(space.varied(searched)):
        moves = scattered_moves(
            axes,
            hessian,
            np.linalg.inv(hessian),
            space.count,
            rows,
            space.lower - at,
            k,
        )
        assert np.linalg.matrix_rank(moves) == len(rows)
        ends = np.tile(at, (len(moves), 1))
        ends[:, rows] += moves
        assert (ends >= space.lower - 1e-12).all()
        on_bound += np.isclose(ends[:, cut], space.lower[cut], atol=1e-9).sum()
        for end in ends:
            fitter._unknowns.robot_at(end[: space.count])  # refuses what is no robot
    assert on_bound


def test_draws_within_bounds_stay_likely():
    """Two numbers that nearly make up for each other still do where one is cut."""
    turn = np.array([[1.0, -1.0], [1.0, 1.0]]) / np.sqrt(2.0)
    root = turn @ np.diag([0.5, 0.0005])
    draws = symmetric_draws(root, np.array([np.inf, 0.1]))
    assert np.abs(draws[:, 1]).max() <= 0.1 and np.isclose(np.abs(draws[:, 1]), 0.1).any()
    assert draws[: spread.PAIRS] == pytest.approx(-draws[spread.PAIRS :], abs=0.0)
    whitened = np.linalg.solve(root, draws.T)
    assert np.sqrt((whitened**2).sum(axis=0)).max() < 4.0
    free = symmetric_draws(root, np.full(2, np.inf))
    assert np.cov(np.linalg.solve(root, free.T)) == pytest.approx(np.eye(2), abs=0.4)
    assert not symmetric_draws(root, np.array([np.inf, 0.0]))[:, 1].any()


def test_what_linear_functions_leave_out_is_not_told(near, monkeypatch):
    fitter, at, errors, noise, _, exact, _ = near
    inertia = fitter.space.names.index("inertia.xx")

    def doubt(columns):
        monkeypatch.setattr(fitter.cost, "doubts", None)
        monkeypatch.setattr(fitter.run_errors, "hidden", None)
        linear = [
            replace(Linearization.nowhere(error), beyond=each)
            for error, each in zip(errors, columns, strict=True)
        ]
        monkeypatch.setattr(fitter.cost, "linear", linear)
        believed, _ = fitter.cost.normal(errors, exact, noise)
        monkeypatch.setattr(fitter.cost, "doubts", fitter.cost._doubted(errors, exact, noise))
        return believed, *fitter.cost.normal(errors, exact, noise)

    nothing = [np.zeros((each.size, 0)) for each in errors]
    believed, doubted, _ = doubt(nothing)
    assert doubted == pytest.approx(believed, abs=1e-9 * np.abs(believed).max())
    along = exact[2].reshape(errors[2].size, -1)[:, inertia]
    believed, doubted, gradient = doubt(
        [10.0 * along[:, None] if k == 2 else each for k, each in enumerate(nothing)]
    )
    lost = believed - doubted
    assert np.linalg.eigvalsh(lost).min() > -1e-9 * np.abs(believed).max()
    own = fitter.space.own[2]
    assert not np.delete(np.delete(lost, own, 0), own, 1).any()  # starts of others
    assert lost[inertia, inertia] > 1.0  # more than was known before
    gradient = gradient + fitter.cost._known_about(at).gradient
    step = 1e-3 * np.linalg.solve(doubted + fitter.cost.precision, gradient)
    behind, ahead = (
        fitter.cost.total(
            at + side * step,
            [
                error + side * jacobian @ step[rows]
                for error, jacobian, rows in zip(errors, exact, fitter.space.own, strict=True)
            ],
            noise,
        )
        for side in (-1.0, 1.0)
    )
    assert ahead - behind == pytest.approx(4.0 * gradient @ step, rel=0.05)  # it is its slope


def test_a_lost_start_is_found_again(plant, runs):
    fitter = fitter_of(plant, runs)
    at = fitter.start_search._suited(fitter.space.begin)
    errors = fitter.run_errors.at(at)
    noise = estimate_noise(errors)
    lost = at.copy()
    own = fitter.space.start_of(4)
    lost[own] += [0.0, -3.0, 1.0, 2.0, 0.0, 1.0]
    found, found_errors = fitter._found_again(lost, fitter.run_errors.at(lost), noise)
    assert noise.cost(found_errors[4]) < 1.1 * noise.cost(errors[4])
    others = np.setdiff1d(np.arange(len(at)), own)
    assert (found[others] == lost[others]).all()


def test_near_the_robot_a_start_that_is_lost_a_little_is_found_again(plant, runs):
    """A second solution that costs a few times as much would bias the robot."""
    fitter = fitter_of(plant, runs)
    at = fitter.start_search._suited(fitter.space.begin)
    noise = estimate_noise(fitter.run_errors.at(at))
    own = fitter.space.start_of(4)

    def off(share):
        point = at.copy()
        point[own] += share * np.array([0.0, -3.0, 1.0, 2.0, 0.0, 1.0])
        errors = fitter.run_errors.at(point)
        costs = [noise.cost(each) / each.size for each in errors]
        return point, errors, costs[4] / np.median(costs)

    share = np.exp(
        brentq(lambda power: off(np.exp(power))[2] - 4.0, *np.log([1e-3, 1.0]), xtol=0.02)
    )
    lost, errors, ratio = off(share)
    assert 3.0 < ratio < 5.0
    _, found = fitter._found_again(lost, errors, noise)
    assert noise.cost(found[4]) < 0.5 * noise.cost(errors[4])


def test_what_is_held_out_costs_what_its_best_start_does(near):
    fitter, at, errors, noise, _, exact, _ = near
    count, rows = fitter.space.count, fitter.space.start_of(2)
    judge = Judge(noise=noise)
    apart = fitter.cost.run_about(2, at, judge, errors[2], exact[2]).least_beside(count)
    starts = exact[2][:, :, count:]

    def cost(start):
        moved = errors[2] + starts @ (start - at[rows])
        before, after = (
            judge.product(2, errors[2], each.reshape(-1, 1), each.reshape(-1, 1))[0, 0]
            for each in (errors[2], moved)
        )
        return judge.cost(2, errors[2]) + after - before + start @ start

    best = minimize(cost, at[rows], tol=1e-12)
    assert apart.at(np.zeros(count)) == pytest.approx(best.fun, rel=1e-6)


def test_a_recording_of_one_pose_is_held_out_too(plant, runs):
    fitter = fitter_of(plant, runs[:2])
    at = fitter.space.begin
    errors, slopes = fitter.run_errors.at(at), fitter.run_errors.jacobians(at, coarse=True)
    short, judge = (errors[0][:1], errors[1][:4]), Judge(noise=estimate_noise(errors))
    folds = fitter.cost.folds(at, short, (slopes[0][:1], slopes[1][:4]), judge)
    assert len(folds.parts) == 1 + 4


def test_a_run_that_no_time_step_follows_tells_nothing(plant, runs, monkeypatch):
    fitter = fitter_of(plant, runs)
    at, simulated = fitter.space.begin, fitter.run_errors.simulated
    errors = fitter.run_errors.at(at)

    def wild(points, *, refined=1):
        found, good = simulated(points, refined=refined)
        found[2] = found[2] + 0.01 * (-1.0) ** (refined // 2)  # does not fall with the step
        return found, good

    fitter.averages.leave_out_unfollowed(at, errors)
    assert fitter.space.kept == list(range(len(runs)))
    monkeypatch.setattr(fitter.run_errors, "simulated", wild)
    fitter.averages.leave_out_unfollowed(at, errors)
    assert fitter.space.kept == [k for k in range(len(runs)) if k != 2]
    jacobians = fitter.run_errors.jacobians(at, coarse=True)
    assert not jacobians[2].any() and all(jacobians[k].any() for k in fitter.space.kept)


def test_means_over_what_is_uncertain_cost_more_where_motion_bends(near, monkeypatch):
    fitter, at, _, noise, _, _, information = near
    simulated = fitter.run_errors.simulated

    def bent(points, *, refined=1):
        found, good = simulated(points, refined=refined)
        if len(found[2]) > 1:
            found[2] = found[2] + noise.sigma
        return found, good

    monkeypatch.setattr(linearization, "AXIS_MAX", 1e-3)  # so near all else is linear
    monkeypatch.setattr(fitter.run_errors, "hidden", None)
    monkeypatch.setattr(fitter.run_errors, "simulated", bent)
    monkeypatch.setattr(fitter.cost, "noise", lambda errors: noise)
    rises = fitter.averages.mean_errors(at, information + fitter.cost.precision).rises
    bends = np.arange(len(rises)) == 2
    assert (np.abs(rises[~bends]) < 1.0).all()
    assert rises[2] > 5.0


def test_chance_that_a_start_makes_up_for_takes_no_information(near, monkeypatch):
    fitter, _, errors, noise, _, exact, _ = near
    monkeypatch.setattr(fitter.run_errors, "hidden", None)
    monkeypatch.setattr(fitter.cost, "doubts", None)
    searched = fitter.space.searched.copy()
    searched[fitter.space.mass] = False
    linear = [
        replace(
            Linearization.nowhere(error),
            chance=slopes[:, :, fitter.space.count].reshape(-1, 1),
            scatter=np.eye(len(rows)),
        )
        for error, slopes, rows in zip(errors, exact, fitter.space.varied(searched), strict=True)
    ]
    fitter.space.fill_alike(exact)
    information, _ = fitter.cost.normal(errors, exact, noise)
    monkeypatch.setattr(fitter.cost, "linear", linear)
    left = fitter.averages.believed(information, errors, exact, noise)
    monkeypatch.setattr(fitter.cost, "linear", None)
    raw, believed = (fitter.cost.marginal(each) for each in (information, left))
    assert believed == pytest.approx(raw, rel=1e-3, abs=1e-3 * np.abs(raw).max())


def test_windows_without_poses_are_left_out(runs):
    run = lasting(runs[0])
    time = run.poses.time - run.poses.time[0]
    around = np.abs(time - 5.0) < 0.5
    gap = replace(run, poses=run.poses.rows(np.flatnonzero(~around)))
    centers, whole = gap._averages[0] @ time[~around], run._averages[0] @ time
    assert 0 < len(centers) < len(whole)
    assert np.abs(centers[:, None] - whole).min(axis=1).max() < 0.1 * run.window
    assert np.abs(centers - 5.0).min() > 0.5


def test_poses_at_first_lead_the_search_and_do_not_count(runs):
    run = runs[0]
    time = run.poses.time
    late = replace(run, leading=0.3)
    assert late.first(0.15).poses.time[0] == late.first(0.4).poses.time[0] == time[0]
    counted = late.first(1.0)
    assert counted.poses.time[0] == pytest.approx(time[0] + 0.3, abs=1.0 / RATE)
    assert counted.first(1.0).poses.time[0] == counted.poses.time[0]
    span = time[-1] - time[0]
    assert leading_time(0.1 * span, run.poses) == pytest.approx(0.1 * span)
    assert leading_time(span, run.poses) == pytest.approx(0.3 * span)
    rows = np.append(np.arange(len(time) // 4), len(time) - 1)  # a gap takes no poses from the rest
    assert leading_time(span, run.poses.rows(rows)) < 0.1 * span


def test_poses_of_locked_winches_lead_and_of_moving_ones_all_count(plant):
    settings = resolved(IdentificationSettings(), Scales(plant).ratios)
    short = OscillationSettings(count=2, duration=3.0, time_step=0.01)
    still, other = simulate_oscillations(plant, 3, short)
    wound = other.unstrained_length + 0.1 * other.time[:, None]
    recordings = [still, replace(other, unstrained_length=wound)]
    parts = [
        procedure._Part(name=name, recording=each, train=(0, len(each.time)), test=None)
        for name, each in zip(("still", "wound"), recordings, strict=True)
    ]
    paths = [LengthPath(each) for each in recordings]
    rests = [first_equilibrium(plant, path) for path in paths]
    poses = [poses_of(each) for each in recordings]
    windows = [
        slow_window(plant, rest, each.time, RATE) for rest, each in zip(rests, poses, strict=True)
    ]
    prepare = partial(procedure._prepare, parts, plant, poses, settings, paths, plant)
    locked, moving = (run.fitted for run in prepare(windows))
    assert locked.leading > 0.2 and locked.begin < locked.poses.time[0]
    assert moving.leading == 0.0 and moving.begin == moving.path.first
    assert [run.fitted.leading for run in prepare([0.0, 0.0])] == [0.0, 0.0]
    rates = [run.fitted.averaged_rate for run in prepare([0.48, 0.52])]
    assert rates == [averaged_rate([0.48, 0.52])] * 2
    kept_back = replace(parts[1], train=None, test=parts[1].train)
    beside = procedure._prepare(
        [parts[0], kept_back], plant, poses, settings, paths, plant, [0.48, 0.2]
    )
    assert beside[0].fitted.averaged_rate == averaged_rate([0.48])  # what is fitted stays as it is


def test_starts_are_guessed_in_the_frame_of_the_robot_that_is_nearly_found(plant):
    """That sees poses turned by its tilt, by 6 cm at the height of its exit points."""
    tilted = with_values(plant, ["pose_tilt.x", "pose_tilt.y"], np.array([0.02, -0.01]))
    level = with_values(plant, ["pose_tilt.x", "pose_tilt.y"], np.zeros(2))
    settings = resolved(IdentificationSettings(), Scales(plant).ratios)
    short = OscillationSettings(count=2, duration=3.0, time_step=0.01)
    recordings = simulate_oscillations(tilted, 3, short)
    parts = [
        procedure._Part(name="swing", recording=each, train=(0, len(each.time)), test=None)
        for each in recordings
    ]
    paths, poses = (
        [LengthPath(each) for each in recordings],
        [poses_of(each) for each in recordings],
    )
    runs = procedure._prepare(parts, level, poses, settings, paths, tilted, [0.4, 0.4])
    sways = [run.fitted.sway for run in runs]
    starts = [OpenLoopStart(sway=sway, coordinates=sway.guess[None]) for sway in sways]
    for errors in procedure._motions(level, tilted, runs, settings, starts):
        assert np.linalg.norm(errors[0, :3]) < 0.006  # it is 0.03 if poses are not turned
    for errors in procedure._motions(level, level, runs, settings, [run.guess for run in runs]):
        assert np.linalg.norm(errors[0, :3]) > 0.015


def test_many_poses_are_thinned(runs):
    run = replace(runs[0], averaged_rate=averaged_rate([100.0 * runs[0].window]))
    assert len(run.first(1.0).poses.time) < len(runs[0].first(1.0).poses.time)


def test_poses_of_all_runs_count_alike_whatever_their_windows(runs):
    """Rates of 96 and 104 Hz would thin poses of 100 Hz in one run and not in the other."""
    pose = runs[0].poses.rows(np.zeros(2000, dtype=int))
    pose = replace(pose, time=0.01 * np.arange(2000))
    noise = np.random.default_rng(0).standard_normal((2000, 6))
    windows = [0.48, 0.52]
    rate = averaged_rate(windows)
    scatter = []
    for window in windows:
        run = replace(runs[0], poses=pose, window=window, leading=0.0, averaged_rate=rate)
        fitted = run.first(1.0)
        own = noise[np.searchsorted(pose.time, fitted.poses.time)]
        scatter.append(fitted.seen(own).var())
    assert scatter[0] / scatter[1] == pytest.approx(windows[1] / windows[0], rel=0.25)


def test_a_robot_that_cannot_hang_is_failed_and_nothing_else(plant, runs):
    run = runs[0]
    heavy = replace(plant, mass=1e7 * plant.mass)
    job = OpenLoopRun(robots=[plant, heavy], path=run.path, time=run.poses.time)
    motion = simulate_runs([job], time_step=0.01)[0]
    assert motion.failed.tolist() == [False, True]
    errors = run.poses.errors(motion.position[:, 1], motion.rotation[:, 1])
    assert np.isfinite(errors).all()


def test_refined_steps_are_exactly_as_many_times_more(plant, runs):
    """Errors fall with the square of the step, also where intervals of poses jitter."""
    run = runs[0]
    rng = np.random.default_rng(0)
    time = run.poses.time + np.append(0.0, rng.uniform(0.0, 1e-4, len(run.poses.time) - 1))
    start = OpenLoopStart(sway=run.sway, coordinates=run.sway.guess[None])
    job = OpenLoopRun(robots=[plant], path=run.path, time=time, start=start)
    once, twice, often = (
        simulate_runs([job], time_step=1.0 / 140.0, refined=k)[0].position for k in (1, 2, 16)
    )
    ratio = np.linalg.norm(once - often) / np.linalg.norm(twice - often)
    assert 3.5 < ratio < 4.6


def eight_cables_at_rest(noise=0.0):
    """Return coordinates of a robot without a sway, recordings of it at rest, and settings."""
    robot, rng = eight_cable_robot(), np.random.default_rng(0)
    settings = resolved(IdentificationSettings(), Scales(robot).ratios)
    rest, time = at_home(robot), np.arange(0.0, 0.4, 0.02)

    def run():
        position = np.tile(rest.position, (len(time), 1))
        recording = Recording(
            time=time,
            unstrained_length=np.tile(rest.unstrained_length, (len(time), 1)),
            poses=PoseSamples.from_rotation(
                time,
                position + noise * rng.standard_normal(position.shape),
                np.tile(rest.rotation, (len(time), 1, 1)),
            ),
        )
        path, poses = LengthPath(recording), poses_of(recording)
        sway = find_sway(robot, first_equilibrium(robot, path), poses, moves=False)
        return FittedRun(path=path, poses=poses, rate=RATE, sway=sway)

    return choose_coordinates(robot, settings), [run() for _ in range(10)], settings


def test_nothing_to_search_needs_no_derivatives():
    unknowns, runs, settings = eight_cables_at_rest()
    fitter = Fitter(unknowns, runs, settings, robot_at=np.zeros(len(unknowns.prior.names)))
    assert all(len(start) == 0 for start in fitter.starts())


def test_many_runs_without_a_sway_are_searched_to_the_end():
    found = Fitter(*eight_cables_at_rest(noise=1e-3)).run(lambda *_: None)
    assert found.converged and np.abs(found.coordinates).max() < 3.0


def test_poses_begin_where_a_vibration_is_lost_in_noise():
    rng, time = np.random.default_rng(0), np.arange(0.0, 10.0, 0.01)
    sway = 0.1 * np.sin(2.0 * np.pi * 0.6 * time)
    ringing = 5e-3 * np.exp(-time / 1.0) * np.sin(2.0 * np.pi * 6.0 * time)  # 1 mm after 1.6 s

    def begins(motion, noise=1e-3):
        poses = MeasuredPoses(
            time=time,
            position=motion[:, None] + noise * rng.standard_normal((len(time), 3)),
            rotation=np.tile(np.eye(3), (len(time), 1, 1)),
            index=np.arange(len(time)),
        )
        return without_ringing(poses, 0.5, 2.0).time[0]

    assert begins(sway) == 0.0
    assert 0.7 < begins(sway + ringing) < 3.0
    for frequency in (0.6, 2.0):  # a sway that decays is no vibration
        decaying = np.exp(-time / 5.0) * np.sin(2.0 * np.pi * frequency * time)
        assert begins(0.1 * decaying, noise=2e-4) == 0.0
    assert begins(sway + 5e-3 * np.sin(2.0 * np.pi * 6.0 * time)) == 0.0  # always: no less later


def test_few_poses_in_a_window_are_not_taken_for_a_vibration():
    for rate in (20.0, 25.0, 100.0):
        for seed in range(10):
            rng, time = np.random.default_rng(seed), np.arange(0.0, 10.0, 1.0 / rate)
            poses = MeasuredPoses(
                time=time,
                position=1e-3 * rng.standard_normal((len(time), 3)),
                rotation=np.tile(np.eye(3), (len(time), 1, 1)),
                index=np.arange(len(time)),
            )
            assert without_ringing(poses, 0.36, 0.5).time[0] == 0.0


def test_winches_that_move_at_first_are_not_locked(runs):
    path = runs[0].path
    assert is_locked(path, path.first + 0.8)
    time = np.arange(0.0, 2.0, 0.01)
    wound = 5.0 + np.outer(0.1 * time, np.ones(3))
    moving = LengthPath(Recording(time=time, unstrained_length=wound))
    assert not is_locked(moving, 0.8)
    assert is_locked(moving, 0.01)


def test_a_platform_that_starts_before_its_first_pose_hardly_vibrates(plant, runs):
    """Of the swing's own pull nothing is left to shake the cables."""
    shaken = []
    for begin in (None, 0.0):
        power = 0.0
        for run in runs[:3]:
            rest = first_equilibrium(plant, run.path)
            sway, lengths = replace(run.sway, begin=begin), rest.unstrained_length
            position, rotation, twist = swaying_states(
                [sway], Fleet([plant]), Pose(position=rest.position, rotation=rest.rotation),
                lengths, np.zeros_like(lengths), [sway.guess],
            )  # fmt: skip
            simulator = Simulator(plant, worlds=1, cables="catenary", time_step=1e-3)
            simulator.reset(position, rotation, unstrained_length=lengths, twist=twist)
            tension = []
            for _ in range(400):
                simulator.follow(lengths, 2e-3)
                tension.append(simulator.state.numpy().tension[0].copy())
            power += float((np.diff(tension, 2, axis=0) ** 2).sum())  # fast motion most of all
        shaken.append(power)
    assert shaken[1] < 0.2 * shaken[0]


def test_a_recording_that_does_not_fit_counts_as_one_with_noise_of_its_own():
    rng = np.random.default_rng(0)
    errors = [1e-3 * rng.standard_normal((100, 6)) for _ in range(12)]
    noise = estimate_noise(errors)
    bad = 50.0 * errors[0]
    again = estimate_noise([bad, *errors[1:]])
    assert (again.sigma < 2.0 * noise.sigma).all()
    assert again.weights(bad).mean() < 0.1 * again.weights(errors[1]).mean()
    assert again.cost(bad) < 10.0 * bad.size < 2500.0 * again.cost(errors[1])
    step = 1e-6 * errors[0]
    slope = (again.cost(bad + step) - again.cost(bad - step)) / 2.0
    assert slope == pytest.approx(2.0 * float((again.weights(bad) * bad * step).sum()), rel=1e-4)


def test_steps_that_jump_by_chance_average_out(near, monkeypatch):
    """The end of a search is nearer to that of all chances than these are."""
    fitter, at, errors, noise, _, exact, _ = near
    rng = np.random.default_rng(3)
    fitter.space.fill_alike(exact)
    still = [HiddenVibrations.none(each) for each in errors]
    monkeypatch.setattr(fitter.cost, "linear", None)
    monkeypatch.setattr(fitter.cost, "doubts", None)
    monkeypatch.setattr(fitter.averages, "_likelier_vibrations", lambda at, sigma: still)
    monkeypatch.setattr(fitter.cost, "noise", lambda errors: noise)
    white, own = [np.zeros_like(each) for each in errors], slice(fitter.space.count)
    information, _ = fitter.cost.normal(white, exact, noise)
    hessian = information + fitter.cost.precision
    left = fitter.cost.marginal(information) + fitter.space.prior[own, own]
    root = np.linalg.cholesky(np.linalg.inv(left))

    def jump(numbers):
        return np.concatenate([0.5 * root @ numbers, np.zeros(len(at) - fitter.space.count)])

    searched = fitter.space.searched.copy()
    searched[fitter.space.mass] = False
    linear = [
        replace(Linearization.nowhere(each), scatter=np.eye(len(rows)))
        for each, rows in zip(errors, fitter.space.varied(searched), strict=True)
    ]

    def mean_errors(point, _):
        away = point - at + jump(rng.standard_normal(fitter.space.count))
        found = [
            each + jacobian @ away[own]
            for each, jacobian, own in zip(white, exact, fitter.space.own, strict=True)
        ]
        return MeanErrors(errors=found, jacobians=exact, linear=linear, rises=np.zeros(len(found)))

    monkeypatch.setattr(fitter.averages, "mean_errors", mean_errors)
    monkeypatch.setattr(fitter.cost, "_known_about", lambda point: Quadratic(
        cost=0.0, gradient=fitter.space.prior @ (point - at), information=fitter.space.prior
    ))  # fmt: skip
    begin = at + jump(np.full(fitter.space.count, 1.6))

    def search():
        found = fitter.averages.search(begin, hessian, 0, lambda *_: None)
        away = (found.at - at)[own]
        return found.settled, away @ left @ away

    fitter.cost.look(at, white, exact, noise)
    step = jump(np.ones(fitter.space.count))
    assert fitter.space.turns_back(step, -step, hessian)
    assert not fitter.space.turns_back(step, 0.1 * step, hessian)
    settled, away = search()
    assert settled and away < 1.5 * AVERAGES_DECREASE * fitter.space.count
    monkeypatch.setattr(fitter.space, "turns_back", lambda *_: False)
    settled, farther = search()
    assert not settled and farther > 2.0 * away


def test_a_search_ends_where_those_lead_that_are_nearly_linear(near, monkeypatch):
    fitter, at, errors, noise, _, exact, _ = near
    fitter.space.fill_alike(exact)
    still = [HiddenVibrations.none(each) for each in errors]
    rugged, own = 3, slice(fitter.space.count)
    for part, name, value in (
        (fitter.run_errors, "hidden_vibrations", lambda at, sigma: still),
        (fitter.cost, "linear", None), (fitter.cost, "doubts", None),
        (fitter.cost, "noise", lambda errors: noise),
        (fitter.space, "searched", fitter.space.searched.copy()),
        (fitter.space, "followed", fitter.space.followed.copy()),
        (fitter.cost, "_known_about", lambda point: Quadratic(
            cost=0.0, gradient=fitter.space.prior @ (point - at), information=fitter.space.prior
        )),
    ):  # fmt: skip
        monkeypatch.setattr(part, name, value)
    monkeypatch.setattr(averages, "RUNS_APART_MIN", 4)  # so that one of ten may be left out
    searched = fitter.space.searched.copy()
    searched[fitter.space.mass] = False
    rng, varied = np.random.default_rng(6), fitter.space.varied(searched)
    off = 20.0 * rng.standard_normal(fitter.space.count)
    rises, followed = np.where(np.arange(len(errors)) == rugged, 1e3, 0.0), fitter.space.kept

    linear = [
        replace(Linearization.nowhere(error), scatter=np.eye(len(rows)))
        for error, rows in zip(errors, varied, strict=True)
    ]

    def mean_errors(point, _):
        away = [(point - at)[rows] for rows in fitter.space.own]
        away[rugged][own] += off
        found = [slopes @ move for slopes, move in zip(exact, away, strict=True)]
        return MeanErrors(errors=found, jacobians=exact, linear=linear, rises=rises)

    monkeypatch.setattr(fitter.averages, "mean_errors", mean_errors)
    information, _ = fitter.cost.normal([np.zeros_like(each) for each in errors], exact, noise)
    begin, hessian = at.copy(), information + fitter.cost.precision
    begin[own] += 0.5
    found = fitter.averages.search(begin, hessian, 0, lambda *_: None)
    assert found.settled and fitter.space.kept == [k for k in followed if k != rugged]
    assert found.at[own] == pytest.approx(at[own], abs=1e-3)
    fitter.space.followed[rugged], rises[:6] = True, 1e3  # most runs are
    assert fitter.averages.search(begin, hessian, 0, lambda *_: None) is None
    assert fitter.cost.linear is None
    assert fitter.space.kept == followed


def test_where_averages_lead_nowhere_derivatives_go_on(near, monkeypatch):
    fitter, at, errors, *_ = near
    still = [HiddenVibrations.none(each) for each in errors]
    few = replace(fitter._settings, iterations=2)
    monkeypatch.setattr(fit, "ROUGH_STEPS_MAX", 1)
    for part, name, value in (
        (fitter.cost, "linear", None), (fitter.cost, "doubts", None),
        (fitter.run_errors, "hidden", None), (fitter.run_errors, "finer", None),
        (fitter.run_errors, "hidden_vibrations", lambda at, sigma: still),
        (fitter, "_settings", few), (fitter.averages, "search", lambda *_: None),
    ):  # fmt: skip
        monkeypatch.setattr(part, name, value)
    found = fitter._settle(at, None, lambda *_: None)
    assert found.count == 2 and fitter.cost.linear is None
    noise = fitter.cost.noise(found.errors)
    assert fitter.cost.total(found.at, found.errors, noise) < fitter.cost.total(at, errors, noise)


def test_data_leave_nothing_more_open_than_it_was_before(near):
    fitter, *_ = near
    known = 0.5 * np.linalg.cholesky(np.linalg.inv(fitter.cost.precision))
    kept = fitter._no_worse_known(known)
    assert kept @ kept.T == pytest.approx(known @ known.T, abs=1e-12)
    wide = known.copy()
    wide[3] *= 1e6
    kept = fitter._no_worse_known(wide)
    assert np.diag(kept @ kept.T)[3] == pytest.approx(np.linalg.inv(fitter.cost.precision)[3, 3])
