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
    REFINED,
    VibratingStarts,
    hidden_vibrations,
    vibration_level,
)
from carosac_toolkit.base.scaled import resolved
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.recordings.length_path import LengthPath

STEP_S = 0.005  # of time
LEVEL, NOISE = 0.15, 5e-4  # NOISE in m and rad


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
        path=path, poses=poses, rate=10.0, window=slow_window(plant, rest, poses.time),
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
    """Return a run with noisy poses of a platform that vibrates at a level."""
    start = VibratingStarts.of(run, plant, rng)
    sway = OpenLoopStart(
        sway=start.run.sway, coordinates=start.points(at[simulator._count :], level)[1:2]
    )
    robot = simulator._unknowns.robot_at(at[: simulator._count])
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
        [start.run], [start.points(at, 0.03)], STEP_S, refined=REFINED
    )
    return vibration_level(run, errors)


@pytest.mark.parametrize("leading", [0.0, 1.0])
def test_poses_together_say_how_strongly_a_platform_vibrates(simulator, plant, run, at, leading):
    """Few poses show it one by one: noise is as large."""
    found = {
        level: [
            level_of(
                simulator, plant,
                replace(
                    vibrating(simulator, plant, run, at, level, np.random.default_rng(seed)),
                    leading=leading,
                ), at,
            )
            for seed in range(4)
        ]
        for level in (0.0, LEVEL)
    }  # fmt: skip
    assert 0.7 * LEVEL < np.mean(found[LEVEL]) < 1.3 * LEVEL
    assert 0.0 < np.max(found[0.0]) < 0.5 * np.min(found[LEVEL])  # noise may hide as much


def test_a_sway_drifts_within_what_hidden_vibrations_may_change(simulator, plant, run, at):
    """Against sigmas of averages the drift of vibrating platforms is large, and beside V not."""
    robot = simulator._unknowns.robot_at(at[: simulator._count])
    shares = []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        other = vibrating(simulator, plant, run, at, 1.5 * LEVEL, rng)
        (hidden,) = hidden_vibrations(simulator, [other], [other], [at], robot, STEP_S)
        (errors,), _ = simulator.pose_errors([other], [at[None]], STEP_S, refined=REFINED)
        drift = other.seen(errors[0]).ravel()
        variance = np.var(other.seen(NOISE * rng.standard_normal(errors[0].shape)))
        covariance = variance * np.eye(len(drift)) + hidden @ hidden.T
        each = [float(drift @ drift) / variance, float(drift @ np.linalg.solve(covariance, drift))]
        shares.append(np.array(each) / len(drift))
    alone, beside = np.mean(shares, axis=0)
    assert alone > 3.0
    assert beside - 1.0 < 0.2 * (alone - 1.0)
