"""Stiffness and damping of cables are found by vibrations, whatever their phases are."""

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
from calibration.identification.unknowns import choose_coordinates
from calibration.identification.vibration_scan import CABLE_FIELDS, as_vibrating, cable_factors
from carosac_toolkit.base.scaled import resolved
from carosac_toolkit.physics.rest.modes import natural_modes
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.recordings.length_path import LengthPath

RATE_HZ, DURATION_S = 100.0, 4.0
SIGMAS = (0.7, 1.0)  # of logarithms of the stiffness and the damping before
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
    runs, decay = [], float((plant.axial_damping / plant.axial_stiffness).mean())
    for path in paths:
        rest = first_equilibrium(plant, path)
        modes = natural_modes(plant, rest)
        motion = rng.standard_normal((len(time), 6)) * NOISE
        for mode in range(6):
            shape = modes.shape[0, :, mode]
            slow = mode < 6 - plant.n
            size = (0.03 if slow else vibration) / np.abs(shape[:3]).max()
            omega = 2.0 * np.pi * modes.frequency[0, mode]
            wave = np.cos(omega * time + rng.uniform(0.0, 6.28))
            wave = wave if slow else wave * np.exp(-0.5 * omega**2 * decay * time)
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
    found = cable_factors(robot, swinging(plant, paths, vibration=0.5e-3), *SIGMAS)
    assert found.stiffness == pytest.approx(softer, rel=0.05)


@pytest.mark.parametrize("tougher", [3.0, 0.3])
def test_a_damping_is_found_by_how_vibrations_die_out(plant, paths, tougher):
    robot = replace(plant, axial_damping=plant.axial_damping / tougher)
    found = cable_factors(robot, swinging(plant, paths, vibration=2e-3), *SIGMAS)
    assert found.damping == pytest.approx(tougher, rel=0.3)
    assert found.stiffness == pytest.approx(1.0, rel=0.05)


def test_nothing_is_found_where_no_vibrations_are_seen(plant, paths):
    assert cable_factors(plant, swinging(plant, paths, vibration=0.0), *SIGMAS) is None


def test_both_are_sought_no_further_than_what_is_known_before_allows(plant, paths):
    robot = replace(
        plant, axial_stiffness=plant.axial_stiffness / 1.2, axial_damping=plant.axial_damping / 9.0
    )
    found = cable_factors(robot, swinging(plant, paths, vibration=2e-3), 0.03, 0.2)
    assert abs(np.log(found.stiffness)) <= 3.0 * 0.03 + 1e-9
    assert abs(np.log(found.damping)) <= 3.0 * 0.2 + 1e-9
    near = cable_factors(robot, swinging(plant, paths, vibration=2e-3), 1e-3, 1e-2)
    assert abs(np.log(near.stiffness)) < 4e-3 and abs(np.log(near.damping)) < 4e-2
    held = cable_factors(robot, swinging(plant, paths, vibration=2e-3), 0.0, 0.0)
    assert (held.stiffness, held.damping) == (1.0, 1.0)


def test_few_poses_tell_nothing(plant, paths):
    runs = swinging(plant, paths, vibration=2e-3)
    some = [replace(run, poses=run.poses.rows(np.arange(0, 400, 20))) for run in runs]
    assert cable_factors(plant, some, *SIGMAS) is None


def test_only_what_is_known_of_cables_changes(plant, paths):
    """In coordinates of a robot that is softer by a factor the cables get the one that moved."""
    robot = replace(plant, axial_stiffness=plant.axial_stiffness / 1.5)
    unknowns = choose_coordinates(robot, resolved(SURVEYED, Scales(robot).ratios))
    runs = swinging(plant, paths, vibration=2e-3)
    at, sigma = np.zeros(len(unknowns.prior.names)), unknowns.prior.sigma
    found = as_vibrating(unknowns, runs, at, sigma)
    changed = [name for name, value in zip(unknowns.prior.names, found, strict=True) if value]
    assert "axial_stiffness" in changed and set(changed) <= set(CABLE_FIELDS)
    stiffness = unknowns.robot_at(found).axial_stiffness
    assert stiffness == pytest.approx(plant.axial_stiffness, rel=0.05)
    assert as_vibrating(unknowns, [], at, sigma) is None
    held = np.where(np.isin(unknowns.prior.names, CABLE_FIELDS), 0.0, sigma)
    assert as_vibrating(unknowns, runs, at, held) is None
