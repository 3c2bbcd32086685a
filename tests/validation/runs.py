"""Recordings without any error, made with the toolkit's own statics."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np

from carosac_toolkit.physics.rest import statics
from carosac_toolkit.recordings.metadata import RecordingMetadata
from carosac_toolkit.recordings.poses import PoseSamples
from carosac_toolkit.recordings.recording import Recording
from carosac_toolkit.trajectories import waypoints
from tests.robots import simple_robot

POINTS = [[0.4, -1.8, 2.2], [1.2, -2.8, 3.2], [-0.4, -1.0, 2.8], [0.4, -1.8, 2.2]]
ROBOT = simple_robot()
STEP = 0.05  # [s]


@lru_cache
def perfect(delay: float = 0.0) -> Recording:
    """Lengths at rest on catenaries, poses late by `delay` [s]."""
    path = waypoints(POINTS, speed_max=1.0, acceleration_max=1.0, rest=2.0)
    time = np.arange(0.0, path.duration + 4.0, STEP)
    lengths = statics.inverse_kinematics(ROBOT, path.sample(time - 2.0).position)
    poses = statics.inverse_kinematics(ROBOT, path.sample(time - 2.0 - delay).position)
    assert lengths.converged.all() and poses.converged.all()
    return Recording(
        time=time,
        unstrained_length=lengths.unstrained_length,
        poses=PoseSamples.from_rotation(time, poses.position, poses.rotation),
        metadata=RecordingMetadata(description="made with statics"),
    )


def shifted(recording: Recording, offset) -> Recording:
    """The same with measured positions shifted by `offset` [m], shape (3,) or (M, 3)."""
    poses = recording.poses
    return replace(recording, poses=replace(poses, position=poses.position + np.asarray(offset)))
