"""Vibrations that noise hides: how strong they are, and how far they let a sway drift."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from benchmarks.calibration_oscillations import SURVEYED, draw_plant, robot_with_pulleys
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
from calibration.identification.vibrations import (
    PROBE,
    REFINED,
    VibratingStarts,
    hidden_vibrations,
)
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
    points = start.points(at, PROBE * np.eye(len(start.ways)))
    (errors,), _ = simulator.pose_errors([start.run], [points], STEP_S, refined=REFINED)
    return start.told(errors).level


def drift_of(simulator, plant, run, at):
    """Return what hidden vibrations change of a run, and what averages of its poses miss."""
    robot = simulator._unknowns.robot_at(at[: simulator._count])
    (hidden,) = hidden_vibrations(simulator, [run], [run], [at], robot, STEP_S)
    (errors,), _ = simulator.pose_errors([run], [at[None]], STEP_S, refined=REFINED)
    return hidden, run.seen(errors[0]).ravel()


def test_each_elongation_and_each_rate_lets_the_platform_vibrate(simulator, plant, run, at):
    start = VibratingStarts.of(run, plant, np.random.default_rng(0))
    each = np.eye(len(start.ways))
    points = np.hstack([np.tile(at, (1 + len(each), 1)), PROBE * np.vstack([0.0 * each[:1], each])])
    (errors,), _ = simulator.pose_errors([start.run], [points], STEP_S, refined=REFINED)
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
    assert hidden.spread.shape == (len(drift), 2 * plant.n) and np.isfinite(hidden.spread).all()
    assert not hidden.drift.any()


def test_drifts_are_told_from_the_vibrations_that_poses_show(simulator, plant, run, at):
    """Against sigmas of averages the drift of vibrating platforms is large, and what is left not.

    Nor is it beyond what V says, and V says less than that the drift may be as large as it is.
    """
    shares = []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        other = vibrating(simulator, plant, run, at, 0.2, rng)
        hidden, missed = drift_of(simulator, plant, other, at)
        noise = NOISE * rng.standard_normal((len(other.poses.time), 6))
        variance = np.var(other.seen(noise))
        left = missed + hidden.drift.ravel()
        covariance = variance * np.eye(len(left)) + hidden.spread @ hidden.spread.T
        each = [
            missed @ missed / variance,
            left @ left / variance,
            left @ np.linalg.solve(covariance, left),
            np.trace(covariance) / variance,
        ]
        shares.append(np.array(each) / len(left))
    alone, corrected, beside, claimed = np.mean(shares, axis=0)
    assert alone > 3.0
    assert corrected - 1.0 < 0.2 * (alone - 1.0)
    assert beside == pytest.approx(1.0, abs=0.2)
    assert claimed - 1.0 < 0.3 * (alone - 1.0)
