"""The stiffness of cables is found by the frequencies of vibrations, whatever their phases are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from benchmarks.calibration_oscillations import SURVEYED, draw_plant, robot_with_pulleys
from calibration.identification.measured_poses import MeasuredPoses
from calibration.identification.open_loop import first_equilibrium
from calibration.identification.runs import FittedRun
from calibration.identification.sway import FreeSway
from calibration.identification.synthetic_oscillations import (
    OscillationSettings,
    simulate_oscillations,
)
from calibration.identification.vibration_scan import stiffness_factor
from carosac_toolkit.physics.rest.modes import natural_modes
from carosac_toolkit.recordings.length_path import LengthPath

RATE_HZ, DURATION_S, DECAY_S = 100.0, 4.0, 1.5
REACH = 2.0
NOISE = np.repeat([1e-3, 1e-3], 3)  # [m] and [rad]


@pytest.fixture(scope="module")
def plant():
    return draw_plant(robot_with_pulleys(4), SURVEYED, 6)


@pytest.fixture(scope="module")
def paths(plant):
    places = OscillationSettings(count=8, duration=0.1, time_step=0.01)
    return [LengthPath(each) for each in simulate_oscillations(plant, 1, places)]


def swinging(plant, paths, vibration):
    """Runs that sway by centimetres in each slow mode, and vibrate in each fast one [m]."""
    rng = np.random.default_rng(0)
    time = np.arange(0.0, DURATION_S, 1.0 / RATE_HZ)
    none = FreeSway(
        shape=np.zeros((6, 0)), frequency=np.zeros(0), sigma=np.zeros(0),
        stretch_sigma=np.zeros(0), guess=np.zeros(0),
    )  # fmt: skip
    runs = []
    for path in paths:
        rest = first_equilibrium(plant, path)
        modes = natural_modes(plant, rest)
        motion = rng.standard_normal((len(time), 6)) * NOISE
        for mode in range(6):
            shape = modes.shape[0, :, mode]
            slow = mode < 6 - plant.n
            size = (0.03 if slow else vibration) / np.abs(shape[:3]).max()
            wave = np.cos(2.0 * np.pi * modes.frequency[0, mode] * time + rng.uniform(0.0, 6.28))
            wave = wave if slow else wave * np.exp(-time / DECAY_S)
            motion += size * np.outer(wave, shape)
        turned = Rotation.from_rotvec(motion[:, 3:]).as_matrix() @ rest.rotation[0]
        poses = MeasuredPoses(
            index=np.arange(len(time)), time=time, position=rest.position[0] + motion[:, :3],
            rotation=turned,
        )  # fmt: skip
        runs.append(FittedRun(path=path, poses=poses, rate=10.0, sway=none))
    return runs


@pytest.mark.parametrize("softer", [2.5, 0.7])
def test_a_stiffness_is_found_by_vibrations_below_the_noise_of_a_pose(plant, paths, softer):
    robot = replace(plant, axial_stiffness=plant.axial_stiffness / softer)
    runs = swinging(plant, paths, vibration=0.5e-3)
    assert stiffness_factor(robot, runs, REACH) == pytest.approx(softer, rel=0.05)


def test_nothing_is_found_where_no_vibrations_are_seen(plant, paths):
    assert stiffness_factor(plant, swinging(plant, paths, vibration=0.0), REACH) is None


def test_it_is_sought_no_further_than_what_is_known_before_allows(plant, paths):
    robot = replace(plant, axial_stiffness=plant.axial_stiffness / 3.0)
    factor = stiffness_factor(robot, swinging(plant, paths, vibration=2e-3), 0.1)
    assert factor is None or abs(np.log(factor)) < 0.1 + 1e-9


def test_few_poses_tell_nothing(plant, paths):
    runs = swinging(plant, paths, vibration=2e-3)
    some = [replace(run, poses=run.poses.rows(np.arange(0, 400, 20))) for run in runs]
    assert stiffness_factor(plant, some, REACH) is None
