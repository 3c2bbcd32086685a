"""What the sensors of a recording read at each rest."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.rotations import to_matrix
from carosac_toolkit.loop.values import Stamped
from carosac_toolkit.recordings.poses import PoseSamples
from carosac_toolkit.recordings.recording import Recording
from carosac_toolkit.validation.phases import REST_DURATION_MIN_S, find_phases

RESTS_ALONE_MIN = 4  # of which a recording consists
DRIFT_MAX_M = 2e-3  # [m] from half to half of a rest: a noise of readings, no motion

Mean = Callable[[Array], Array]


@dataclass(frozen=True, kw_only=True, eq=False)
class RestReadings:
    """Means over K rests of n cables; a sensor that is not there is None.

    Attributes:
        time: Middle of each rest [s], shape (K,).
        length: Readings of length [m], shape (K, n).
        tension: Readings of load cells at the platform [N], shape (K, n).
        attitude: Rotation from the AHRS to its level frame, shape (K, 3, 3).
        inclination: Roll and pitch of an inclinometer [rad], shape (K, 2).
        swivel_angle: Of pulleys about their axes [rad], shape (K, n).
        position: Measured, of the platform origin [m], shape (K, 3).
        rotation: Measured, from P, shape (K, 3, 3).
        single: True if each sample counts as a rest, as samples are far apart.
        skipped: Rests in which a sensor has no sample, by that sensor.
    """

    time: Array
    length: Array
    tension: Array | None = None
    attitude: Array | None = None
    inclination: Array | None = None
    swivel_angle: Array | None = None
    position: Array | None = None
    rotation: Array | None = None
    single: bool = False
    skipped: dict[str, int]

    def rows(self, which: NDArray[np.int64]) -> RestReadings:
        """Return some of the rests."""
        channels = {
            name: value[which]
            for name in (
                "time",
                "length",
                "tension",
                "attitude",
                "inclination",
                "swivel_angle",
                "position",
                "rotation",
            )
            if (value := getattr(self, name)) is not None
        }
        return replace(self, **channels)


def rest_readings(recording: Recording, *, poses: bool = False) -> RestReadings:
    """Return the readings at the rests of a recording.

    Where samples of length are at least `REST_DURATION_MIN_S` apart, as in a table with one row for
    each pose, every sample is a rest. Else the rests are those of `find_phases`.

    Args:
        recording: With lengths; every other sensor counts if it has samples in the rests.
        poses: True to count measured poses among the sensors.

    Returns:
        K rests, 0 or more.
    """
    time, length = recording.time, recording.unstrained_length
    single = len(time) == 1 or bool(np.median(np.diff(time)) >= REST_DURATION_MIN_S)
    if single:
        rows = [(k, k + 1) for k in range(len(time))]
        around = 0.5 * REST_DURATION_MIN_S
    else:
        rows, around = list(find_phases(time, length).rests), 0.0
    spans = np.array([(time[a] - around, time[b - 1] + around) for a, b in rows]).reshape(-1, 2)
    means: dict[str, tuple[Stamped | None, Mean]] = {
        "tension": (recording.tension, _mean),
        "attitude": (recording.attitude, _mean_rotation),
        "inclination": (recording.inclination, mean_angle),
        "swivel_angle": (recording.swivel_angle, mean_angle),
    }
    if poses and recording.poses is not None:
        measured = recording.poses
        means["position"] = Stamped(time=measured.time, value=measured.position), _mean
        turned = Stamped(time=measured.time, value=measured.quaternion)
        means["rotation"] = turned, _mean_rotation
    kept, skipped = np.ones(len(rows), dtype=np.bool_), dict[str, int]()
    for name, (channel, _) in means.items():
        if channel is not None:
            there = np.array([len(_within(channel, span)) > 0 for span in spans], dtype=np.bool_)
            skipped[name] = int((kept & ~there).sum())
            kept &= there
    used = [span for span, keep in zip(spans, kept, strict=True) if keep]
    values = {
        name: None if channel is None else np.array([mean(_within(channel, span)) for span in used])
        for name, (channel, mean) in means.items()
    }
    lengths = [length[a:b].mean(axis=0) for (a, b), keep in zip(rows, kept, strict=True) if keep]
    return RestReadings(
        time=np.mean(used, axis=1) if used else np.zeros(0),
        length=np.array(lengths).reshape(-1, recording.n),
        single=single,
        skipped={name: count for name, count in skipped.items() if count},
        **values,
    )


def rests_alone(recording: Recording) -> tuple[Recording, NDArray[np.int64]] | None:
    """Return a recording of means over its rests, and the samples in the middle of these.

    Noise that lasts as long as a rest does not average out, however many samples are taken of it,
    and while nothing moves, no sample tells of delays. None where a length moves from sample to
    sample, or where samples are so far apart that each is a rest.

    Args:
        recording: As it was recorded; without measured poses there is none either.
    """
    time, length = recording.time, recording.unstrained_length
    if len(time) < 2 or np.median(np.diff(time)) >= REST_DURATION_MIN_S:
        return None
    breaks = np.flatnonzero(np.diff(time) >= REST_DURATION_MIN_S) + 1
    parts = np.split(np.arange(len(time)), breaks)
    if len(parts) < RESTS_ALONE_MIN or not all(_rests(time[k], length[k]) for k in parts):
        return None
    readings = rest_readings(recording, poses=True)
    if readings.position is None or readings.rotation is None or not len(readings.time):
        return None
    poses = PoseSamples.from_rotation(readings.time, readings.position, readings.rotation)
    alone = Recording(
        time=readings.time, unstrained_length=readings.length, poses=poses,
        metadata=recording.metadata,
    )  # fmt: skip
    return alone, np.minimum(np.searchsorted(time, readings.time), len(time) - 1)


def _rests(time: Array, length: Array) -> bool:
    """Return whether no length moves from first to last sample, shapes (K,) and (K, n)."""
    halves = np.array_split(length, 2)
    drift = np.abs(halves[1].mean(axis=0) - halves[0].mean(axis=0)).max() if len(time) > 1 else 0.0
    return bool(find_phases(time, length).resting.all() and drift <= DRIFT_MAX_M)


def _within(channel: Stamped, span: Array) -> Array:
    """Return the values of a channel in a span of time [s]."""
    return np.asarray(channel.value[(channel.time >= span[0]) & (channel.time <= span[1])])


def _mean(value: Array) -> Array:
    return np.asarray(value.mean(axis=0))


def mean_angle(value: Array) -> Array:
    """Return the mean of angles [rad], whatever turns they are counted in."""
    return np.asarray(np.arctan2(np.sin(value).mean(axis=0), np.cos(value).mean(axis=0)))


def _mean_rotation(quaternion: Array) -> Array:
    return np.asarray(Rotation.from_matrix(to_matrix(quaternion)).mean().as_matrix())
