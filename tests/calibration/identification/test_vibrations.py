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
    points = start.points(at, PROBE)
    (errors,), _ = simulator.pose_errors([start.run], [points], STEP_S, refined=REFINED)
    return start.level(errors)
