"""Recordings made up for tests, and their comparison bit by bit."""

from __future__ import annotations

from typing import Any

import numpy as np

from carosac_toolkit.loop.values import Imu, Stamped
from carosac_toolkit.recordings.metadata import RecordingMetadata
from carosac_toolkit.recordings.poses import PoseSamples
from carosac_toolkit.recordings.recording import STAMPED_CHANNELS, Recording


def full_recording(n: int = 4, seed: int = 0, **changes: Any) -> Recording:
    """Every channel, each at its own times: some shared, most not."""
    rng = np.random.default_rng(seed)

    def times(count: int) -> Any:
        return np.cumsum(rng.uniform(0.01, 0.1, count)) / 3

    def stamped(count: int, value: float) -> Stamped:
        return Stamped(time=times(count), value=rng.normal(value, 1.0, (count, n)))

    time = times(50)
    quaternion = rng.normal(size=(30, 4))
    quaternion /= np.linalg.norm(quaternion, axis=1, keepdims=True)
    channels: dict[str, Any] = {
        "time": time,
        "unstrained_length": rng.uniform(5.0, 15.0, (50, n)),
        "length_rate": stamped(17, 0.0),
        "tension": Stamped(time=time[::3], value=rng.uniform(5, 200, (17, n))),
        "command": stamped(23, 9.0),
        "poses": PoseSamples(
            time=time[10:40] + 1 / 3, position=rng.normal(size=(30, 3)), quaternion=quaternion
        ),
        "imu": Imu(
            time=times(80),
            angular_rate=rng.normal(size=(80, 3)),
            specific_force=rng.normal(size=(80, 3)),
        ),
        "exit_points": rng.normal(size=(n, 3)),
        "metadata": RecordingMetadata(
            robot="carosac", description='quotes ", commas, # and\nlines: äöü', licence="none"
        ),
    }
    attitude = rng.normal(size=(21, 4))
    attitude /= np.linalg.norm(attitude, axis=1, keepdims=True)
    channels["swivel_angle"] = stamped(13, 0.0)
    channels["attitude"] = Stamped(time=times(21), value=attitude)
    channels["inclination"] = Stamped(time=times(40), value=rng.normal(0.0, 0.1, (40, 2)))
    return Recording(**(channels | changes))


def assert_same(one: Recording, other: Recording) -> None:
    """Every number the same bit by bit, every absent channel absent in both."""
    np.testing.assert_array_equal(one.time, other.time)
    np.testing.assert_array_equal(one.unstrained_length, other.unstrained_length)
    assert (one.exit_points is None) == (other.exit_points is None)
    if one.exit_points is not None:
        np.testing.assert_array_equal(one.exit_points, other.exit_points)
    fields = {name: ("time", "value") for name in STAMPED_CHANNELS}
    fields["poses"] = ("time", "position", "quaternion", "rotation")
    fields["imu"] = ("time", "angular_rate", "specific_force")
    for channel, parts in fields.items():
        mine, theirs = getattr(one, channel), getattr(other, channel)
        assert (mine is None) == (theirs is None), channel
        for part in parts if mine is not None else ():
            np.testing.assert_array_equal(getattr(mine, part), getattr(theirs, part))
    assert one.metadata == other.metadata
