"""Recordings of simulated robots with the full measurement model: a truth to identify."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.rotations import from_matrix
from carosac_toolkit.base.scaled import resolved
from carosac_toolkit.drivers.sensors import SensorSettings
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.recordings.metadata import RecordingMetadata
from carosac_toolkit.recordings.poses import PoseSamples
from carosac_toolkit.recordings.recording import Recording
from carosac_toolkit.robot.condition_file import find_condition
from carosac_toolkit.robot.perturbations import DEFAULT_CONDITION, draw_plant
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.trajectories.draws import draw_points
from carosac_toolkit.trajectories.moves import waypoints
from sim_warp.driver import SimDriverSettings, SimPlant

SPEED_MAX_M_S, ACCELERATION_MAX_M_S2 = 0.8, 0.4  # of the moves
REST_TIME_S = 2.5  # between moves, long enough for a swing or two
LENGTH_DELAY_S = 0.02  # by which lengths lead poses
COMMAND_PERIOD_S = 0.01  # [s] of the commands
SETTLING_TIME_S = 20.0  # [s] before the recording begins, at rest but for the wind
WORKSPACE_SHARE = 0.4  # of the way to the edges of the workspace, where platforms tilt far


@dataclass(frozen=True, kw_only=True)
class RunSettings:
    """A run of moves and rests.

    Attributes:
        condition: From which the plant is drawn.
        moves: Number of moves between drawn places in the workspace.
        rate: Of lengths and poses [Hz].
    """

    condition: str = DEFAULT_CONDITION
    moves: int = 14
    rate: float = 100.0


@dataclass(frozen=True, kw_only=True, eq=False)
class SyntheticRun:
    """A recording and the truth behind it.

    Attributes:
        recording: Readings of the sensors.
        plant: The robot that moved; its length sensors are described as they were.
    """

    recording: Recording
    plant: Robot


def simulate_run(robot: Robot, seed: int, settings: RunSettings | None = None) -> SyntheticRun:
    """Draw a plant and a path, and record them.

    Lengths are commanded for the nominal robot at rest on the path, so the plant sways.

    Args:
        robot: The nominal robot, n < 6 cables.
        seed: Of plant, path, wind and noise.
        settings: None takes the defaults.
    """
    chosen = settings or RunSettings()
    rng = np.random.default_rng([seed, 5])
    condition = find_condition(chosen.condition).of(robot)
    plant = draw_plant(robot, condition, rng)
    start, command = _commands(robot, chosen, rng)
    options = SimDriverSettings(
        cables="particles",
        wind_force=condition.wind_force,
        wind_time=condition.wind_time,
    )
    world = SimPlant(plant, options, seed=seed)
    world.reset(start[None])
    world.advance(command[:1], SETTLING_TIME_S)
    stride = round(1.0 / (chosen.rate * COMMAND_PERIOD_S))
    lengths, positions, rotations = [], [], []
    for k, asked in enumerate(command):
        if k > 0:
            world.advance(asked[None], COMMAND_PERIOD_S)
        if k % stride == 0:
            truth = world.truth()
            assert truth.unstrained_length is not None
            lengths.append(truth.unstrained_length[0])
            positions.append(truth.position[0])
            rotations.append(truth.rotation[0])
    time: Array = COMMAND_PERIOD_S * stride * np.arange(len(lengths), dtype=np.float64)
    sensors = resolved(SensorSettings(), Scales(robot).ratios)
    return _record(
        chosen, sensors, plant, rng, time, np.array(lengths), np.array(positions),
        np.array(rotations),
    )  # fmt: skip


def _commands(robot: Robot, settings: RunSettings, rng: np.random.Generator) -> tuple[Array, Array]:
    """Return the start of a path of moves and rests, (3,), and lengths along it, shape (K, n)."""
    middle = 0.5 * (robot.workspace_min + robot.workspace_max)
    points = middle + WORKSPACE_SHARE * (draw_points(robot, rng, count=settings.moves) - middle)
    path = waypoints(
        points, speed_max=SPEED_MAX_M_S, acceleration_max=ACCELERATION_MAX_M_S2,
        rest=REST_TIME_S,
    )  # fmt: skip
    time = np.arange(0.0, path.duration + REST_TIME_S, COMMAND_PERIOD_S)
    rest = statics.inverse_kinematics(robot, path.sample(np.minimum(time, path.duration)).position)
    assert rest.converged.all(), "the workspace of the robot holds the path"
    return points[0], rest.unstrained_length


def _record(
    settings: RunSettings,
    sensors: SensorSettings,
    plant: Robot,
    rng: np.random.Generator,
    time: Array,
    length: Array,
    position: Array,
    rotation: Array,
) -> SyntheticRun:
    """Add the noise of the sensors."""
    from scipy.spatial.transform import Rotation

    offset = sensors.encoder_bias * rng.standard_normal(plant.n)
    reading = length + offset + sensors.encoder_noise * rng.standard_normal(length.shape)
    if sensors.encoder_resolution > 0.0:
        reading = sensors.encoder_resolution * np.round(reading / sensors.encoder_resolution)
    turn = Rotation.from_rotvec(sensors.rotation_noise * rng.standard_normal(position.shape))
    poses = PoseSamples(
        time=time + LENGTH_DELAY_S,
        position=position + sensors.position_noise * rng.standard_normal(position.shape),
        quaternion=from_matrix(rotation @ turn.as_matrix()),
    )
    described = replace(
        plant,
        length_offset=offset,
        length_scale=np.ones(plant.n),
        length_delay=LENGTH_DELAY_S,
    )
    metadata = RecordingMetadata(
        description=f"SYNTHETIC: simulated moves of a plant drawn from {settings.condition}",
        created_by="calibration.identification.synthetic",
    )
    recording = Recording(time=time, unstrained_length=reading, poses=poses, metadata=metadata)
    return SyntheticRun(recording=recording, plant=described)
