"""Recordings of free oscillations of a simulated robot: winches locked, swinging from the start."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.scaled import Scaled, resolved
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.physics.rest.modes import natural_modes
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.recordings.encoders import readings
from carosac_toolkit.recordings.metadata import RecordingMetadata
from carosac_toolkit.recordings.poses import PoseSamples
from carosac_toolkit.recordings.recording import Recording
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.trajectories.draws import draw_points
from carosac_toolkit.validation.phases import anchors_at
from sim_warp import Simulator
from sim_warp.simulator import Cables

KICK_SHARE_MIN = 0.3  # of the swing: least amplitude of a mode


@dataclass(frozen=True, kw_only=True)
class OscillationSettings:
    """Free oscillations from several places.

    Attributes:
        count: Number of recordings.
        duration: Of each [s].
        rate: Of lengths and poses [Hz].
        swing: Largest amplitude of a mode, of the anchor point that moves most [m].
        before: Time of swinging before a recording begins [s].
        workspace: Share of the workspace in which they rest [1].
        position_noise: Standard deviation per axis [m].
        rotation_noise: The same about each axis [rad].
        length_noise: Of readings [m].
        cables: Model of the cables.
        time_step: Of the simulator, at most [s].
    """

    count: int = 40
    duration: float = 10.0
    rate: float = 100.0
    swing: float = Scaled(0.1, "m")
    before: float = Scaled(0.5, "s")
    workspace: float = 0.5
    position_noise: float = Scaled(1e-3, "m")
    rotation_noise: float = 1e-3
    length_noise: float = Scaled(1e-4, "m")
    cables: Cables = "catenary"
    time_step: float = Scaled(1.0 / 2000.0, "s")


def simulate_oscillations(
    plant: Robot, seed: int, settings: OscillationSettings | None = None
) -> list[Recording]:
    """Kick the slow modes of a robot in several places and record it with locked winches.

    Args:
        plant: The robot that swings, n < 6 cables; what it says of its sensors is how they read.
        seed: Of places, kicks and noise.
        settings: None takes the defaults.
    """
    chosen = resolved(settings or OscillationSettings(), Scales(plant).ratios)
    rng = np.random.default_rng([seed, 7])
    middle = 0.5 * (plant.workspace_min + plant.workspace_max)
    places = draw_points(plant, rng, count=chosen.count)
    rest = statics.inverse_kinematics(plant, middle + chosen.workspace * (places - middle))
    assert rest.converged.all(), "the platform can rest in the middle of its workspace"
    kicks = _kicks(plant, rest, chosen.swing, rng)
    simulator = Simulator(
        plant, worlds=chosen.count, cables=chosen.cables, time_step=chosen.time_step
    )
    simulator.reset(unstrained_length=rest.unstrained_length, twist=kicks)
    simulator.follow(rest.unstrained_length, chosen.before)
    positions, rotations = [], []
    for _ in range(round(chosen.duration * chosen.rate)):
        state = simulator.state.numpy()
        assert not state.failed.any(), "a swing of moderate size keeps cables taut"
        positions.append(state.position.copy())
        rotations.append(state.rotation.copy())
        simulator.follow(rest.unstrained_length, 1.0 / chosen.rate)
    position, rotation = np.array(positions), np.array(rotations)  # (N, B, 3) and (N, B, 3, 3)
    return [
        _recording(plant, chosen, rest.unstrained_length[b], position[:, b], rotation[:, b], rng)
        for b in range(chosen.count)
    ]


def _kicks(
    plant: Robot, rest: statics.Equilibrium, swing: float, rng: np.random.Generator
) -> Array:
    """Draw the twists (B, 6) with which platforms leave their equilibria."""
    modes = natural_modes(plant, rest)
    count = 6 - plant.n
    kicks = np.zeros((len(rest.position), 6))
    for b, kick in enumerate(kicks):
        arms = anchors_at(plant, np.zeros((1, 3)), rest.rotation[b : b + 1])[0]
        for j in range(count):
            shape = modes.shape[b, :, j]
            fastest = np.linalg.norm(shape[:3] + np.cross(shape[3:], arms), axis=1).max()
            amplitude = swing * rng.uniform(KICK_SHARE_MIN, 1.0) * rng.choice([-1.0, 1.0])
            kick += shape * amplitude * 2.0 * np.pi * abs(modes.frequency[b, j]) / fastest
    return kicks


def _recording(
    plant: Robot,
    settings: OscillationSettings,
    length: Array,
    position: Array,
    rotation: Array,
    rng: np.random.Generator,
) -> Recording:
    """Return what the sensors read of one motion."""
    count = len(position)
    time = np.arange(count) / settings.rate
    turn = Rotation.from_rotvec(settings.rotation_noise * rng.standard_normal((count, 3)))
    noise = settings.position_noise * rng.standard_normal((count, 3))
    frame = np.eye(3) if plant.pose_rotation is None else plant.pose_rotation  # of the poses to W
    lengths = readings(plant, np.tile(length, (count, 1)))
    return Recording(
        time=time,
        unstrained_length=lengths + settings.length_noise * rng.standard_normal(lengths.shape),
        poses=PoseSamples.from_rotation(
            time, position @ frame + noise, frame.T @ rotation @ turn.as_matrix()
        ),
        metadata=RecordingMetadata(
            description="SYNTHETIC: free oscillation with locked winches",
            created_by="calibration.identification.synthetic_oscillations",
        ),
    )
