"""A recorded run of a robot: every channel with its own time stamps, absent ones None."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from carosac_toolkit.base.arrays import Array, frozen_array
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.loop.values import Imu, Measurement, Stamped
from carosac_toolkit.recordings.columns import (
    FIXED_COLUMNS,
    POSE_COLUMNS_TEXT,
    channel_columns,
)
from carosac_toolkit.recordings.metadata import RecordingMetadata
from carosac_toolkit.recordings.poses import PoseInterpolation, PoseSamples, check_unit_norm
from carosac_toolkit.robot.robot import Robot

Channel = TypeVar("Channel", Stamped, PoseSamples, Imu)

CABLE_CHANNELS = ("length_rate", "tension", "command", "swivel_angle")  # a column per cable
STAMPED_CHANNELS = (*CABLE_CHANNELS, "attitude", "inclination")
MEASURED_CHANNELS = tuple(name for name in STAMPED_CHANNELS if name != "command")


@dataclass(frozen=True, kw_only=True, eq=False)
class Recording:
    """A recorded run; n cables, all times by one clock.

    Attributes:
        time: Of the cable lengths, strictly increasing [s], shape (N,).
        unstrained_length: Measured by the encoders [m], shape (N, n).
        length_rate: Rate of the unstrained length [m/s], (K, n) with its times, or None.
        tension: Tension at the platform [N], (K, n) with its times, or None.
        command: Commanded unstrained length [m], (K, n) with its times, or None.
        swivel_angle: Angle of each pulley about its swivel axis [rad], (K, n) with its times, or
            None. Sign and zero are those of `carosac_toolkit.physics.cable.swivel`: right-handed
            about `swivel_axis`, 0 towards x of W. Cables without a pulley have any number, say 0.
        attitude: Orientation of an AHRS on the platform: quaternions w x y z from the frame of the
            sensor to a level frame, z up, of any heading, (K, 4) with their times, or None.
        inclination: Roll and pitch of an inclinometer on the platform [rad], (K, 2) with their
            times, or None: R_z(yaw) R_y(pitch) R_x(roll) rotates from the frame of the sensor to a
            level frame, z up.
        poses: Measured by motion capture or the like, (M, ...) with their times, or None.
        imu: Inertial samples with times (K,), without a batch axis, or None.
        exit_points: Exit points measured in the run, medians in W [m], shape (n, 3), or None.
        metadata: Provenance and conventions.
    """

    time: Array
    unstrained_length: Array
    length_rate: Stamped | None = None
    tension: Stamped | None = None
    command: Stamped | None = None
    swivel_angle: Stamped | None = None
    attitude: Stamped | None = None
    inclination: Stamped | None = None
    poses: PoseSamples | None = None
    imu: Imu | None = None
    exit_points: Array | None = None
    metadata: RecordingMetadata = field(default_factory=RecordingMetadata)

    def __post_init__(self) -> None:
        """Freeze the arrays; check shapes, the order of all times and the sign of the lengths."""
        lengths = np.asarray(self.unstrained_length)
        samples = len(np.atleast_1d(self.time))
        if lengths.ndim != 2 or lengths.size == 0:
            raise InvalidField("unstrained_length", f"shape {lengths.shape}", "(N, n), N, n >= 1")
        n = lengths.shape[1]
        for name, shape in (("time", (samples,)), ("unstrained_length", (samples, n))):
            object.__setattr__(self, name, frozen_array(name, getattr(self, name), shape))
        if self.exit_points is not None:
            frozen = frozen_array("exit_points", self.exit_points, (n, 3))
            object.__setattr__(self, "exit_points", frozen)
        for name in STAMPED_CHANNELS:
            self._check_stamped(name)
        if self.attitude is not None:
            check_unit_norm("attitude.value", self.attitude.value)
        for name, time in self.channel_times.items():
            _check_increasing("time" if name == "unstrained_length" else f"{name}.time", time)
        if self.metadata.length_kind == "unstrained" and not (self.unstrained_length > 0).all():
            row, cable = (int(i) for i in np.argwhere(~(self.unstrained_length > 0))[0])
            where, value = f"unstrained_length[{row}, {cable}]", self.unstrained_length[row, cable]
            raise InvalidField(where, f"{value} m", "> 0 m (or length_kind 'relative')")

    @property
    def n(self) -> int:
        """Number of cables."""
        return int(self.unstrained_length.shape[1])

    @property
    def sensors(self) -> tuple[str, ...]:
        """Sensors that it has beside the encoders, by their names in sensor suites."""
        channels = {
            "imu": self.imu, "pose": self.poses, "tension": self.tension,
            "swivel": self.swivel_angle, "attitude": self.attitude,
            "inclination": self.inclination,
        }  # fmt: skip
        return tuple(name for name, channel in channels.items() if channel is not None)

    @property
    def channel_times(self) -> Mapping[str, Array]:
        """Time stamps [s] of each channel that is there, by name; lengths come first."""
        times = {"unstrained_length": self.time}
        for name in (*STAMPED_CHANNELS, "poses", "imu"):
            channel = getattr(self, name)
            if channel is not None:
                times[name] = channel.time
        return times

    @property
    def rates(self) -> Mapping[str, float | None]:
        """Median sample rate of each channel [Hz]; None for a channel of one sample."""
        return {
            name: float(1.0 / np.median(np.diff(time))) if len(time) > 1 else None
            for name, time in self.channel_times.items()
        }

    @property
    def duration(self) -> float:
        """From the first to the last length sample [s]."""
        return float(self.time[-1] - self.time[0])

    def measurement(self, index: int) -> Measurement:
        """Return the measurement of a driver at length sample `index`; poses are withheld.

        The optional channels hold only what is new since the previous length sample: the latest
        of each, and all inertial samples.

        Args:
            index: Of the length sample, 0 <= index < N.

        Returns:
            A batch of one.
        """
        if not 0 <= index < len(self.time):
            raise InvalidField("index", index, f"0 <= index < {len(self.time)}")
        after = -np.inf if index == 0 else float(self.time[index - 1])
        until = float(self.time[index])
        latest: dict[str, Any] = {
            name: _latest(getattr(self, name), after, until) for name in MEASURED_CHANNELS
        }
        return Measurement(
            time=self.time[index : index + 1],
            unstrained_length=self.unstrained_length[index : index + 1],
            imu=_inertial(self.imu, after, until),
            **latest,
        )

    def pose_at(self, time: ArrayLike, *, gap_max: float = 0.5) -> PoseInterpolation:
        """Interpolate measured poses: positions linearly, rotations along the great arc.

        Args:
            time: When [s], shape (B,).
            gap_max: Longest distance of neighbouring stamps to interpolate across [s].

        Returns:
            The poses, and a mask that is False outside the range and inside longer gaps.
        """
        if self.poses is None:
            raise InvalidField("poses", None, POSE_COLUMNS_TEXT)
        return self.poses.at(time, gap_max=gap_max)

    def slice(self, start: int = 0, stop: int | None = None) -> Recording:
        """Cut out length samples start <= i < stop, and all other samples of that time.

        Args:
            start: First length sample.
            stop: One past the last; None: to the end.
        """
        end = len(self.time) if stop is None else stop
        if not 0 <= start < end <= len(self.time):
            raise InvalidField("slice", f"{start}:{stop}", f"0 <= start < stop <= {len(self.time)}")
        first, last = self.time[start], self.time[end - 1]
        stamped: dict[str, Any] = {
            name: _cut(getattr(self, name), first, last) for name in STAMPED_CHANNELS
        }
        return replace(
            self,
            time=self.time[start:end],
            unstrained_length=self.unstrained_length[start:end],
            poses=_cut(self.poses, first, last),
            imu=_cut(self.imu, first, last),
            **stamped,
        )

    def require_cables(self, robot: Robot) -> None:
        """Refuse a robot with another number of cables.

        Raises:
            InvalidField: The numbers differ.
        """
        if robot.n != self.n:
            allowed = f"{robot.n} cables, as robot {robot.name!r} has"
            if robot.n > self.n:
                allowed += f"; is column 'unstrained_length_{self.n + 1:02d}_m' missing?"
            raise InvalidField("unstrained_length", f"{self.n} cables", allowed)

    def _check_stamped(self, name: str) -> None:
        """Refuse a channel with another number of columns."""
        channel: Stamped | None = getattr(self, name)
        per_cable = name in CABLE_CHANNELS
        columns = len(channel_columns(name, self.n))
        if channel is not None and channel.value.shape != (len(channel.time), columns):
            allowed = f"shape (K, {columns}), " + (
                "one column per cable" if per_cable else f"columns {list(FIXED_COLUMNS[name])}"
            )
            raise InvalidField(f"{name}.value", f"shape {channel.value.shape}", allowed)


def _check_increasing(name: str, time: Array) -> None:
    """Refuse an empty channel and times that do not strictly increase."""
    if time.ndim != 1 or len(time) == 0:
        raise InvalidField(name, f"shape {time.shape}", "(K,), K >= 1, or the whole channel None")
    bad = np.diff(time) <= 0
    if bad.any():
        index = int(np.argmax(bad)) + 1
        raise InvalidField(f"{name}[{index}]", f"{time[index]} s", f"> {time[index - 1]} s")


def _latest(channel: Stamped | None, after: float, until: float) -> Stamped | None:
    """Return the last sample with after < time <= until, as a batch of one."""
    if channel is None:
        return None
    index = int(np.searchsorted(channel.time, until, side="right")) - 1
    if index < 0 or channel.time[index] <= after:
        return None
    row = np.s_[index : index + 1]
    return Stamped(time=channel.time[row], value=channel.value[row])


def _inertial(imu: Imu | None, after: float, until: float) -> Imu | None:
    """Return all samples with after < time <= until, with a batch axis of one."""
    if imu is None:
        return None
    new = (imu.time > after) & (imu.time <= until)
    if not new.any():
        return None
    return Imu(
        time=imu.time[None, new],
        angular_rate=imu.angular_rate[None, new],
        specific_force=imu.specific_force[None, new],
    )


def _cut(channel: Channel | None, first: float, last: float) -> Channel | None:
    """Return the samples with first <= time <= last, or None where there are none."""
    if channel is None:
        return None
    keep = (channel.time >= first) & (channel.time <= last)
    samples = {item.name: getattr(channel, item.name)[keep] for item in fields(channel)}
    return replace(channel, **samples) if keep.any() else None
