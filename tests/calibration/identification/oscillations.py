"""Recordings of platforms that swing from the first sample while the winches are locked."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from carosac_toolkit.physics.rest import statics
from carosac_toolkit.physics.rest.modes import natural_modes
from carosac_toolkit.recordings.poses import PoseSamples
from carosac_toolkit.recordings.recording import Recording
from sim_warp import Simulator

RATE_HZ = 100.0
BEFORE_S = 2.0  # of swinging before the recording begins
POSITION_NOISE_M = 1e-3
ROTATION_NOISE_RAD = 1e-3
LENGTH_NOISE_M = 1e-4


def free_oscillation(robot, seed, *, swing, duration, cables="catenary", position=None):
    """Record a free oscillation of a robot whose slow modes were all kicked.

    Args:
        robot: The robot that swings, n < 6 cables.
        seed: Of kicks and noise.
        swing: Largest tilt from rest [rad].
        duration: [s].
        cables: Model of the cables.
        position: Where it rests before, shape (3,); None: home.

    Returns:
        The recording, and its poses without noise.
    """
    rng = np.random.default_rng([seed, 9])
    place = robot.home_position if position is None else np.asarray(position)
    rest = statics.inverse_kinematics(robot, place[None])
    slow = natural_modes(robot, rest).shape[0, :, : 6 - robot.n]
    kick = slow @ rng.uniform(0.5, 1.0, 6 - robot.n) * rng.choice([-1.0, 1.0])
    for _ in range(2):  # tilt is not quite proportional to the kick
        truth = _swung(robot, rest, 0.1 * kick if _ == 0 else kick, duration, cables)
        tilt = Rotation.from_matrix(rest.rotation[0].T @ truth[1]).magnitude().max()
        kick = kick * swing / tilt * (0.1 if _ == 0 else 1.0)
    position, rotation = _swung(robot, rest, kick, duration, cables)
    time = np.arange(len(position)) / RATE_HZ
    turn = Rotation.from_rotvec(ROTATION_NOISE_RAD * rng.standard_normal(position.shape))
    noise = POSITION_NOISE_M * rng.standard_normal(position.shape)
    lengths = np.tile(rest.unstrained_length, (len(time), 1))
    recording = Recording(
        time=time,
        unstrained_length=lengths + LENGTH_NOISE_M * rng.standard_normal(lengths.shape),
        poses=PoseSamples.from_rotation(time, position + noise, rotation @ turn.as_matrix()),
    )
    return recording, (position, rotation)


def _swung(robot, rest, kick, duration, cables):
    """Return positions (N, 3) and rotations (N, 3, 3) after a kick."""
    simulator = Simulator(robot, cables=cables)
    simulator.reset(unstrained_length=rest.unstrained_length, twist=kick[None])
    simulator.follow(rest.unstrained_length, BEFORE_S)
    positions, rotations = [], []
    for _ in range(round(duration * RATE_HZ)):
        state = simulator.state.numpy()
        positions.append(state.position[0])
        rotations.append(state.rotation[0])
        simulator.follow(rest.unstrained_length, 1.0 / RATE_HZ)
    return np.array(positions), np.array(rotations)
