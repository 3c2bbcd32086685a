"""Simulated moves of a suspended robot with every channel, each by the same clock."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

import carosac_toolkit as ct
from carosac_toolkit.loop.values import Imu, Stamped
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.recordings.poses import PoseSamples
from carosac_toolkit.recordings.recording import Recording
from carosac_toolkit.trajectories.moves import waypoints
from sim_warp.driver import SimDriverSettings, SimPlant

ROBOT = ct.load_robot("carosac")
STEP_S = 0.02
MOUNTING = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])  # of the IMU
SPREAD_M = np.array([0.5, 0.5, 0.3])  # of the waypoints about home


@lru_cache
def moving_run(seed: int = 0) -> Recording:
    """Return moves through drawn points, with noise of lengths 0.3 mm and of poses 1 mm."""
    rng = np.random.default_rng(seed)
    points = ROBOT.home_position + SPREAD_M * rng.uniform(-1.0, 1.0, (8, 3))
    path = waypoints(points, speed_max=0.8, acceleration_max=0.8, rest=1.0)
    time = np.arange(0.0, path.duration, STEP_S)
    rest = statics.inverse_kinematics(ROBOT, path.sample(time).position)
    assert rest.converged.all()
    plant = SimPlant(ROBOT, SimDriverSettings(cables="catenary"), seed=seed)
    plant.reset(points[:1])
    states, forces = [], []
    for command in rest.unstrained_length:
        plant.advance(command[None], STEP_S)
        states.append(plant.truth())
        forces.append(plant.acceleration()[0, :3] + [0.0, 0.0, ROBOT.gravity])
    position, rotation, length, tension, twist = (
        np.concatenate([getattr(state, name) for state in states])
        for name in ("position", "rotation", "unstrained_length", "tension", "twist")
    )
    in_platform = [
        np.einsum("kji,kj->ki", rotation, value) @ MOUNTING.T
        for value in (twist[:, 3:], np.array(forces))
    ]
    return Recording(
        time=time,
        unstrained_length=length + 3e-4 * rng.standard_normal(length.shape),
        tension=Stamped(time=time, value=1.15 * tension + rng.normal(0, 1.0, tension.shape)),
        poses=PoseSamples.from_rotation(
            time, position + 1e-3 * rng.standard_normal(position.shape), rotation
        ),
        imu=Imu(
            time=time,
            angular_rate=in_platform[0] + rng.normal(0, 3.5e-3, position.shape),
            specific_force=in_platform[1] + rng.normal(0.05, 0.017, position.shape),
        ),
    )
