"""Vibrations that noise hides: how strong they are, and how far they let a sway drift."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from benchmarks.calibration_oscillations import SURVEYED, draw_plant, robot_with_pulleys
from calibration.identification.hidden_vibrations import hidden_vibrations
from calibration.identification.measured_poses import poses_of
from calibration.identification.open_loop import (
    OpenLoopRun,
    OpenLoopStart,
    first_equilibrium,
    simulate_runs,
)
from calibration.identification.run_simulator import RunSimulator
from calibration.identification.runs import FittedRun, slow_window, time_before
from calibration.identification.sway import find_sway
from calibration.identification.synthetic_oscillations import (
    OscillationSettings,
    simulate_oscillations,
)
from calibration.identification.unknowns import choose_coordinates
from calibration.identification.vibration_scan import cable_ways
from calibration.identification.vibration_search import VibrationSearch
from calibration.identification.vibrations import PROBE, REFINED, ToldVibrations, VibratingStarts
from carosac_toolkit.base.scaled import resolved
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.recordings.length_path import LengthPath

STEP_S = 0.005  # of time
NOISE = 5e-4  # of positions [m] and rotations [rad]


@pytest.fixture(scope="module")
def plant():
    return draw_plant(robot_with_pulleys(4), SURVEYED, 4)  # cables that vibrate for long


@pytest.fixture(scope="module")
def run(plant):
    short = OscillationSettings(count=2, duration=5.0, time_step=0.01)
    recording, _ = simulate_oscillations(plant, 1, short)
    path, poses = LengthPath(recording), poses_of(recording)
    rest = first_equilibrium(plant, path)
    before = time_before(plant, rest)
    return FittedRun(
        path=path, poses=poses, rate=10.0, window=slow_window(plant, rest, poses.time, 10.0),
        sway=find_sway(plant, rest, poses, moves=True, before=before),
    )  # fmt: skip


@pytest.fixture(scope="module")
def simulator(plant, run):
    chosen = resolved(SURVEYED, Scales(plant).ratios)
    unknowns = choose_coordinates(plant, replace(chosen, length_delay=0.0))
    count = len(unknowns.prior.names)
    rows = np.arange(count + len(run.sway.guess))
    return RunSimulator(unknowns, [rows], [*unknowns.prior.names, *run.sway.names])


@pytest.fixture(scope="module")
def at(simulator, run):
    """Coordinates of the plant, which the unknowns are about, and of the first guess."""
    return np.concatenate([np.zeros(simulator._count), run.sway.guess])


def vibrating(simulator, plant, run, at, level, rng):
    """Return a run with noisy poses of a platform that vibrates, each coordinate by itself."""
    start = VibratingStarts.of(run, plant, rng)
    elongations = level * rng.standard_normal(len(start.ways))
    coordinates = np.concatenate([at[simulator._count :], elongations])[None]
    robot = simulator._unknowns.robot_at(at[: simulator._count])
    sway = OpenLoopStart(sway=start.run.sway, coordinates=coordinates)
    job = OpenLoopRun(robots=[robot], path=run.path, time=run.poses.time, start=sway)
    (motion,) = simulate_runs([job], time_step=STEP_S, refined=REFINED)
    assert not motion.failed.any()
    seen = motion.seen_by(simulator._unknowns.robot, [robot])
    turn = Rotation.from_rotvec(NOISE * rng.standard_normal((len(run.poses.time), 3)))
    poses = replace(
        run.poses,
        position=seen.position[:, 0] + NOISE * rng.standard_normal((len(run.poses.time), 3)),
        rotation=seen.rotation[:, 0] @ turn.as_matrix(),
    )
    return replace(run, poses=poses)


def level_of(simulator, plant, run, at):
    start = VibratingStarts.of(run, plant, np.random.default_rng(0))
    (errors,), _ = simulator.pose_errors(
        [start.run], [start.points(at, probes(start))], STEP_S, refined=REFINED
    )
    return start.told(np.zeros(len(start.ways)), errors, 1.0).level


def probes(start):
    """Return no vibrations, and then a little of each."""
    return PROBE * np.vstack([np.zeros(len(start.ways)), np.eye(len(start.ways))])


def drift_of(simulator, plant, run, at):
    """Return what hidden vibrations change of a run, and what averages of its poses miss."""
    robot = simulator._unknowns.robot_at(at[: simulator._count])
    cables = np.zeros((0, simulator._count))
    (hidden,) = hidden_vibrations(simulator, [run], [run], [at], robot, cables, STEP_S)
    (errors,), _ = simulator.pose_errors([run], [at[None]], STEP_S, refined=REFINED)
    return hidden, run.seen(errors[0]).ravel()


def test_each_elongation_and_each_rate_lets_the_platform_vibrate(simulator, plant, run, at):
    start = VibratingStarts.of(run, plant, np.random.default_rng(0))
    own = replace(start, ways=np.eye(len(start.ways)))
    (errors,), _ = simulator.pose_errors(
        [own.run], [own.points(at, probes(own))], STEP_S, refined=REFINED
    )
    moved = np.sqrt(((errors[1:] - errors[0]) ** 2).mean(axis=(1, 2)))
    assert moved.min() > 0.3 * moved.max()


@pytest.mark.parametrize("leading", [0.0, 1.0])
def test_poses_together_say_how_strongly_a_platform_vibrates(simulator, plant, run, at, leading):
    """Few poses show it one by one: noise is as large."""
    runs = {
        level: [
            vibrating(simulator, plant, run, at, level, np.random.default_rng(seed))
            for seed in range(6)
        ]
        for level in (0.0, 0.05, 0.15)
    }
    found = {
        level: [level_of(simulator, plant, replace(one, leading=leading), at) for one in each]
        for level, each in runs.items()
    }
    assert np.sqrt(np.mean(np.square(found[0.15]))) == pytest.approx(0.15, rel=0.3)
    assert np.sqrt(np.mean(np.square(found[0.05]))) == pytest.approx(0.05, rel=0.3)
    assert 0.0 < np.median(found[0.0]) < 0.02  # noise may hide as much


@pytest.mark.parametrize("since", [0.0, 1.0])
def test_poses_that_are_missing_tell_nothing_or_less(simulator, plant, run, at, since):
    """Where too few are left, as much is possible as keeps cables taut."""
    noisy = vibrating(simulator, plant, run, at, 0.05, np.random.default_rng(0))
    time = noisy.poses.time - noisy.poses.time[0]
    there = (time >= since) & ((time > 3.0) | (np.arange(len(time)) % 20 == 0))
    few = replace(noisy, poses=noisy.poses.rows(np.flatnonzero((time == 0.0) | there)))
    start = VibratingStarts.of(few, plant, np.random.default_rng(0))
    assert level_of(simulator, plant, few, at) == start.highest < 0.5
    hidden, drift = drift_of(simulator, plant, few, at)
    assert hidden.spread.shape == (len(drift), 4 * plant.n) and np.isfinite(hidden.spread).all()


def shares_of_drift(simulator, plant, run, at, level):
    """Mean squares of what averages miss over those of noise: alone, beside the drift, beside V.

    And what V claims, of the same.
    """
    shares = []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        other = vibrating(simulator, plant, run, at, level, rng)
        hidden, missed = drift_of(simulator, plant, other, at)
        noise = NOISE * rng.standard_normal((len(other.poses.time), 6))
        variance = np.var(other.seen(noise))
        left = missed + hidden.drift.ravel()
        covariance = variance * np.eye(len(left)) + hidden.spread @ hidden.spread.T
        powers = [
            missed @ missed,
            left @ left,
            variance * left @ np.linalg.solve(covariance, left),
            np.trace(covariance),
        ]
        shares.append(np.array(powers) / variance / len(left))
    return np.mean(shares, axis=0)


def test_the_drift_follows_from_vibrations_below_the_noise_of_a_pose(simulator, plant, run, at):
    alone, corrected, beside, claimed = shares_of_drift(simulator, plant, run, at, 0.1)
    assert alone > 1.15
    assert corrected == pytest.approx(1.0, abs=0.05) and beside == pytest.approx(1.0, abs=0.05)
    assert claimed < 1.05


def test_strong_vibrations_are_followed_from_their_beginning(simulator, plant, run, at):
    """Far from linear: dry friction takes a larger share of small amplitudes."""
    alone, corrected, beside, claimed = shares_of_drift(simulator, plant, run, at, 0.2)
    assert alone > 3.0
    assert corrected < 1.25 and beside == pytest.approx(1.0, abs=0.1)
    assert claimed < 1.15


def test_all_runs_together_say_how_stiff_the_cables_are_that_vibrate(simulator, plant, run, at):
    unknowns, count = simulator._unknowns, simulator._count
    sigma = np.full(count, 0.05) / unknowns.scale  # of logarithms
    ways = cable_ways(unknowns, at[:count], sigma)
    assert len(ways) == 2
    rng = np.random.default_rng(0)
    stiffer = np.concatenate([at[:count] + 0.6 * ways[0], at[count:]])  # by 3 %
    noisy = [vibrating(simulator, plant, run, stiffer, 0.1, rng) for _ in range(3)]
    # every run depends on all of the coordinates
    both = RunSimulator(unknowns, 3 * simulator._own, simulator._names)
    starts = [VibratingStarts.of(one, plant, np.random.default_rng(0)) for one in noisy]
    search = VibrationSearch(both, starts, 3 * [at], ways, STEP_S)
    told = search.run()
    assert search._moved[0] == pytest.approx(0.6, abs=0.2)
    assert not any(each.lost for each in search._runs)
    scatter = np.array([each.told.scatter for each in told]) / NOISE
    assert scatter == pytest.approx(np.ones((3, 6)), abs=0.15)


def test_of_vibrations_that_poses_do_not_show_the_level_is_believed(simulator, plant, run, at):
    """Cables that hang loose for long let a search end anywhere; kicks to be seen by eye."""
    alone, corrected, beside, claimed = shares_of_drift(simulator, plant, run, at, 0.3)
    assert alone > 10.0 and corrected < alone
    assert beside < 1.6 and claimed > 10.0


def test_poses_show_vibrations_in_phase_with_them(simulator, plant, run, at):
    noisy = vibrating(simulator, plant, run, at, 0.1, np.random.default_rng(0))
    start = VibratingStarts.of(noisy, plant, np.random.default_rng(0))
    search = VibrationSearch(simulator, [start], [at], np.zeros((0, simulator._count)), STEP_S)
    (end,) = search.run()
    best = end.told.sigma_points()[:1]
    (errors,), _ = search.errors([end.start], [np.vstack([0.0 * best, best])])
    assert end.start.shows(end.told, errors)
    behind = np.stack([errors[0], 2.0 * errors[0] - errors[1]])
    assert not end.start.shows(end.told, behind)


def test_vibrations_that_leave_more_of_poses_than_before_are_lost():
    told = ToldVibrations(
        level=0.1,
        information=np.eye(4),
        pull=np.ones(4),
        scatter=np.ones(6),
        freedoms=100,
        cables=0,
    )
    assert replace(told, scatter=1.2 * np.ones(6)).follows(told)
    assert not replace(told, scatter=np.array([1.0] * 5 + [1.5])).follows(told)
    few = replace(told, freedoms=8)  # chance alone scatters so much
    assert replace(told, scatter=1.5 * np.ones(6)).follows(few)
    blank = replace(told, freedoms=0)
    assert told.follows(blank) and blank.follows(blank) and not blank.follows(told)
    assert not told.forgotten.sigma_points()[0].any()


def test_a_start_without_a_finite_motion_is_not_taken(simulator, plant, run, at, monkeypatch):
    """It is shown at the origin, where it scatters as little as a calm platform does."""
    noisy = vibrating(simulator, plant, run, at, 0.1, np.random.default_rng(0))
    start = VibratingStarts.of(noisy, plant, np.random.default_rng(0))
    search = VibrationSearch(simulator, [start], [at], np.zeros((0, simulator._count)), STEP_S)
    exact = simulator.pose_errors

    def failing(runs, points, time_step, *, refined):
        errors, sound = exact(runs, points, time_step, refined=refined)
        for own, fine in zip(errors, sound, strict=True):
            if len(own) == 5:  # tries of a step
                own[2:4], fine[2:4] = 0.0, False
        return errors, sound

    monkeypatch.setattr(simulator, "pose_errors", failing)
    search._step([start])
    assert search._runs[0].about.any() and search._runs[0].damping == pytest.approx(0.1)


def test_where_poses_tell_nothing_vibrations_are_as_strong_as_the_level():
    blank = ToldVibrations(
        level=0.3,
        information=np.zeros((4, 4)),
        pull=np.zeros(4),
        scatter=np.ones(6),
        freedoms=9,
        cables=0,
    )
    assert blank.sigma_points() == pytest.approx(
        0.3 * np.vstack([np.zeros((1, 4)), np.eye(4), -np.eye(4)])
    )


def test_sigma_points_scatter_as_a_regression_says():
    rng = np.random.default_rng(0)
    slopes, truth = rng.standard_normal((40, 3)), np.array([0.3, -0.2, 0.1])
    information = slopes.T @ slopes
    told = ToldVibrations(
        level=10.0,
        information=information,
        pull=information @ truth,
        scatter=np.ones(6),
        freedoms=9,
        cables=0,
    )
    best, *others = told.sigma_points()
    off = np.array(others) - best
    assert best == pytest.approx(truth, abs=1e-3) and off.sum(axis=0) == pytest.approx(
        0.0, abs=1e-12
    )
    assert off.T @ off / len(off) == pytest.approx(np.linalg.inv(information), rel=0.01)
