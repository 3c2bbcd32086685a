"""Recording arranged for a smoother: its key frames and what was measured there.

There is a key frame at each length sample, at each pose where any are used, so that the others
can be scored, and where an inertial measurement begins and ends.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from baselines.dynamic_estimator.measurement_models import ImuMean
from baselines.length_readings import (
    READING_INTERVAL_MIN_S,
    LengthReadings,
    reading_tolerances,
)
from baselines.smoother.settings import SmootherSettings, smoother_settings_for
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.base.scaled import Scaled
from carosac_toolkit.loop.values import Pose, Stamped
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.recordings.columns import POSE_COLUMNS_TEXT
from carosac_toolkit.recordings.encoders import calibrated
from carosac_toolkit.recordings.length_path import LengthPath
from carosac_toolkit.recordings.poses import PoseSamples
from carosac_toolkit.recordings.recording import Recording
from carosac_toolkit.robot.robot import Robot

POSE_GAP_MAX = Scaled(0.5, "s")  # between two poses, to interpolate
IMU_STEP_MAX = Scaled(0.01, "s")  # of the step that ends at an inertial sample
# Inertial samples within it are taken as one, at their mean time.
IMU_GROUP_TIME = Scaled(0.01, "s")
ANGLE_INTERVAL = Scaled(0.02, "s")  # in which one reading of a swivel encoder or an AHRS is used


@dataclass(frozen=True, kw_only=True, eq=False)
class ArrangedRecording:
    """A recording for a smoother.

    Attributes:
        recording: As calibrated.
        settings: What of it is used.
        path: Of the lengths, without outliers.
        delay: By how much readings lead, as far as it is known [s].
        delay_sigma: One sigma of it, 0 where it is known [s].
        time: Of the key frames [s], shape (K,).
        samples: Key frame of each length sample, shape (N,).
        felt: By the IMU, of the key frames that end a step of it.
        poses: Measured, of the key frames where they are used: position (3,) and rotation (3, 3).
        readings: Of swivel angles, AHRS or inclinometer, by the key frame and the channel.
        used: Which poses of the recording are used, shape (M,).
        outliers: Length samples that were not believed.
        pose_gap: Longest time between two poses that are interpolated [s].
    """

    recording: Recording
    settings: SmootherSettings
    path: LengthPath
    delay: float
    delay_sigma: float
    time: Array
    samples: NDArray[np.int64]
    felt: dict[int, ImuMean]
    poses: dict[int, tuple[Array, Array]]
    readings: dict[int, dict[str, Array]]
    used: NDArray[np.bool_]
    outliers: int
    pose_gap: float

    @property
    def seen(self) -> Recording:
        """The recording with no other poses than those that are used."""
        poses = self.recording.poses
        if poses is None or not self.used.any():
            return replace(self.recording, poses=None)
        kept = {
            name: getattr(poses, name)[self.used] for name in ("time", "position", "quaternion")
        }
        return replace(self.recording, poses=PoseSamples(**kept))

    def reading(self, time: float, delay: float) -> Array:
        """Return the length reading that counts at a time after a delay [s], in m, shape (n,)."""
        return self.path.at(np.asarray(time - delay))

    def withheld(self, start: int, stop: int) -> tuple[NDArray[np.int64], Pose] | None:
        """Return key frames of samples start to stop - 1 with poses that were not used.

        With all poses withheld they are interpolated to the length samples; else each counts at
        its own time, as between them there are poses that were used.

        Returns:
            The key frames, shape (S,), and the poses there; None where there are none.
        """
        poses = self.recording.poses
        if poses is None or self.used.all():
            return None
        when = self.recording.time[start:stop]
        if self.used.any():
            inside = (poses.time >= when[0] - READING_INTERVAL_MIN_S) & (
                poses.time <= when[-1] + READING_INTERVAL_MIN_S
            )
            rows = np.flatnonzero(~self.used & inside)
            keys = nearest(self.time, poses.time[rows])
            measured = Pose(
                position=poses.position[rows], rotation=poses.rotation[rows], time=poses.time[rows]
            )
        else:
            between = poses.at(when, gap_max=self.pose_gap)
            keys = self.samples[start:stop][between.valid]
            measured = Pose(
                position=between.pose.position[between.valid],
                rotation=between.pose.rotation[between.valid],
                time=when[between.valid],
            )
        return (keys, measured) if len(keys) else None


def arrange(recording: Recording, robot: Robot, settings: SmootherSettings) -> ArrangedRecording:
    """Put a recording in order.

    Args:
        recording: As it was recorded.
        robot: As calibrated, with as many cables.
        settings: What of it is used.

    Raises:
        InvalidField: Another number of cables, less than two samples, relative lengths, or no
            poses where they are to be used.
    """
    recording.require_cables(robot)
    run = calibrated(recording, robot)
    settings = smoother_settings_for(robot, _heard(run, settings))
    _check(run, settings)
    kept, outliers = _believed(run, robot, settings)
    first, last = float(run.time[0]), float(run.time[-1])
    used = _used(run, settings)
    ratios = Scales(robot).ratios
    groups = _groups(run, settings, first, last, IMU_GROUP_TIME.of(ratios))
    stops = [run.time]
    if run.poses is not None:
        when = run.poses.time if used.any() else run.poses.time[:0]
        stops.append(when[(when >= first) & (when <= last)])
    stops.append(np.array([when for when, _ in groups]))
    known = settings.dynamics.delay
    known = robot.length_delay if known is None else known
    interval = ANGLE_INTERVAL.of(ratios)
    angles = _angles(run, settings, known or 0.0, first, last, interval)
    stops += [channel.time for channel in angles.values()]
    time = _apart(np.sort(np.concatenate(stops)))
    step = IMU_STEP_MAX.of(ratios)
    begins = [when - step for when, _ in groups if when - _previous(time, when) > step]
    time = _apart(np.sort(np.concatenate([time, np.maximum(begins, first)])))
    return ArrangedRecording(
        recording=run,
        settings=settings,
        path=LengthPath(kept),
        delay=known or 0.0,
        delay_sigma=settings.delay if known is None else 0.0,
        time=time,
        samples=nearest(time, run.time),
        felt={int(nearest(time, np.array([t]))[0]): felt for t, felt in groups},
        poses=_poses(run, used, time),
        readings=_readings(angles, time),
        used=used,
        outliers=outliers,
        pose_gap=POSE_GAP_MAX.of(ratios),
    )


def _heard(run: Recording, settings: SmootherSettings) -> SmootherSettings:
    """Return settings whose dynamics know which angles are used.

    An AHRS or inclinometer is one whose mounting is stated.
    """
    turned = settings.angles and (run.attitude is not None or run.inclination is not None)
    dynamics = replace(
        settings.dynamics,
        swivels=settings.angles and run.swivel_angle is not None,
        attitude_rotation=settings.dynamics.attitude_rotation if turned else None,
    )
    return replace(settings, dynamics=dynamics)


def _angles(
    run: Recording, settings: SmootherSettings, delay: float, first: float, last: float,
    interval: float,
) -> dict[str, Stamped]:  # fmt: skip
    """Return swivel angles and the orientation by AHRS or else inclinometer, as far as used.

    Args:
        run: As calibrated.
        settings: Whose dynamics know which are used.
        delay: By which lengths lead, and swivel encoders with them, as they share a clock [s].
        first: Begin of the lengths [s].
        last: End of them [s].
        interval: In which one reading counts [s].
    """
    used, found = settings.dynamics, dict[str, Stamped]()
    channels = {"swivel_angle": run.swivel_angle} if used.swivels else {}
    if used.attitude_rotation is not None:
        ahrs = run.attitude is not None
        channels |= {"attitude": run.attitude} if ahrs else {"inclination": run.inclination}
    for name, channel in channels.items():
        if channel is None:
            continue
        time = channel.time + (delay if name == "swivel_angle" else 0.0)
        bins = np.floor((time - first) / interval)
        rows = (time >= first) & (time <= last) & (np.diff(bins, prepend=-1.0) > 0.0)
        if rows.any():
            found[name] = Stamped(time=time[rows], value=channel.value[rows])
    return found


def _readings(angles: Mapping[str, Stamped], time: Array) -> dict[int, dict[str, Array]]:
    """Return readings by key frame and channel; of several at one key frame the last counts."""
    readings: dict[int, dict[str, Array]] = {}
    for name, channel in angles.items():
        for key, value in zip(nearest(time, channel.time), channel.value, strict=True):
            readings.setdefault(int(key), {})[name] = value
    return readings


def _check(run: Recording, settings: SmootherSettings) -> None:
    """Refuse what cannot be smoothed."""
    if len(run.time) < 2:
        raise InvalidField("recording", f"{len(run.time)} sample", "two length samples or more")
    if run.metadata.length_kind != "unstrained":
        allowed = "'unstrained': relative lengths fix no pose; calibrate the robot first"
        raise InvalidField("length_kind", repr(run.metadata.length_kind), allowed)
    if settings.poses != "withheld" and run.poses is None:
        raise InvalidField("poses", "none in the recording", POSE_COLUMNS_TEXT)


def _believed(run: Recording, robot: Robot, settings: SmootherSettings) -> tuple[Recording, int]:
    """Return the recording without lengths that no winch can wind, and their number.

    What encoders slipped by is taken off.
    """
    tolerances = reading_tolerances(robot, settings.dynamics.encoder_noise)
    readings = LengthReadings.first(float(run.time[0]), run.unstrained_length[0], tolerances)
    keep = np.ones(len(run.time), dtype=np.bool_)
    lengths = run.unstrained_length.copy()
    jump = settings.dynamics.reading_jump
    for k in range(1, len(run.time)):
        time, length = float(run.time[k]), run.unstrained_length[k]
        after = readings.taken(time, length, robot, jump, time)
        keep[k] = after.rejected == readings.rejected
        lengths[k] -= after.slid
        readings = after
    kept = replace(run, time=run.time[keep], unstrained_length=lengths[keep])
    return kept, int((~keep).sum())


def _used(run: Recording, settings: SmootherSettings) -> NDArray[np.bool_]:
    """Return which poses are used."""
    count = 0 if run.poses is None else len(run.poses.time)
    used = np.full(count, settings.poses != "withheld")
    if settings.poses == "half":
        used[1::2] = False
    return used


def _groups(
    run: Recording, settings: SmootherSettings, first: float, last: float, span: float
) -> list[tuple[float, ImuMean]]:
    """Group inertial samples within a time [s], each group with its mean time [s]."""
    if run.imu is None or not settings.imu:
        return []
    inside = (run.imu.time > first + READING_INTERVAL_MIN_S) & (run.imu.time <= last)
    time = run.imu.time[inside]
    values = np.hstack([run.imu.angular_rate[inside], run.imu.specific_force[inside]])
    groups = []
    start = 0
    for k in range(1, len(time) + 1):
        if k == len(time) or time[k] - time[start] > span - READING_INTERVAL_MIN_S:
            felt = ImuMean(values=values[start:k].mean(axis=0), samples=k - start)
            groups.append((float(time[start:k].mean()), felt))
            start = k
    return groups


def _poses(run: Recording, used: NDArray[np.bool_], time: Array) -> dict[int, tuple[Array, Array]]:
    """Return the poses that are used, by key frame."""
    if run.poses is None:
        return {}
    when = run.poses.time
    rows = np.flatnonzero(
        used
        & (when >= time[0] - READING_INTERVAL_MIN_S)
        & (when <= time[-1] + READING_INTERVAL_MIN_S)
    )
    return {
        int(key): (run.poses.position[row], run.poses.rotation[row])
        for key, row in zip(nearest(time, when[rows]), rows, strict=True)
    }


def _apart(time: Array) -> Array:
    """Return sorted times without those that follow another at once."""
    return np.asarray(time[np.concatenate([[True], np.diff(time) > READING_INTERVAL_MIN_S])])


def _previous(time: Array, end: float) -> float:
    """Return the last of sorted times before another."""
    return float(time[max(0, int(np.searchsorted(time, end - READING_INTERVAL_MIN_S)) - 1)])


def nearest(time: Array, when: Array) -> NDArray[np.int64]:
    """Return the index of the sorted time nearest to each."""
    right = np.clip(np.searchsorted(time, when), 1, len(time) - 1)
    left_is_nearer = when - time[right - 1] <= time[right] - when
    return np.where(left_is_nearer, right - 1, right)
