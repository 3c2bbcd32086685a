"""Clocks of the channels of a recording against that of the cable lengths.

Each channel is compared with what the lengths predict of it by the physics of the robot: measured
poses by the straight distances from exit to anchor points, which change as the lengths do; tensions
and inertial samples by what the measured motion takes; swivel angles, and the vertical in the frame
of an AHRS or inclinometer, by the measured poses. Where no poses were measured rest on the lengths
takes their place.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from carosac_toolkit.base.arrays import Array, evenly
from carosac_toolkit.base.errors import CarosacError, InvalidField
from carosac_toolkit.base.rotations import to_matrix, vertical
from carosac_toolkit.physics.cable.straight_line import straight_length
from carosac_toolkit.physics.cable.swivel import straight_swivel_angle
from carosac_toolkit.physics.rest.modes import mass_matrix
from carosac_toolkit.physics.rest.statics import Equilibrium, forward_kinematics
from carosac_toolkit.physics.rest.structure import structure_matrix
from carosac_toolkit.recordings.recording import Recording
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.validation.first_motion import SIX_CABLES
from carosac_toolkit.validation.phases import slope, summed_turns
from carosac_toolkit.validation.time_shift import (
    Signal,
    TimeShift,
    UnknownShift,
    binned,
    find_shift,
)

ANGLE_CHANNELS = ("swivel_angle", "attitude", "inclination")
CHECKED_CHANNELS = ("poses", "length_rate", "tension", "imu")
ALIGNED_CHANNELS = (*CHECKED_CHANNELS, *ANGLE_CHANNELS)
PLAUSIBLE_DELAY_S = 0.1  # [s]: a sensor may be late by as much
OFFSET_SIGMAS_MIN = 5.0  # sigmas from which clocks are apart
MISFIT_RATIO_MIN = 2.0  # of the squared misfits with the stamps as they are and aligned
UNEXPLAINED_SHARE_MAX = {"poses": 0.05}  # of the variance: cables or units are mixed up beyond
UNEXPLAINED_SHARE_OTHER_MAX = 0.4
REST_SAMPLES_MAX = 6000  # of the lengths, for which the pose of rest is solved
IMU_BIN_S = 0.04  # [s] over which inertial samples are averaged


@dataclass(frozen=True, kw_only=True)
class ChannelClock:
    """Clock of one channel against that of the lengths.

    Attributes:
        channel: Its name, as in `Recording`.
        shift: By which its stamps are late, the delay of the lengths that the robot states left
            out; None where it cannot be told.
        reason: Why it cannot be told; empty where it can.
        interval_deviation: Standard deviation of the intervals of its stamps [s].
    """

    channel: str
    shift: TimeShift | None
    reason: str
    interval_deviation: float

    def is_apart(self, delay_max: float = PLAUSIBLE_DELAY_S) -> bool:
        """Return whether the offset is clear, and larger than a delay of a sensor may be [s]."""
        shift = self.shift
        if shift is None or abs(shift.seconds) <= delay_max:
            return False
        left, before = 1.0 - shift.explained, 1.0 - shift.explained_unshifted
        if left > UNEXPLAINED_SHARE_MAX.get(self.channel, UNEXPLAINED_SHARE_OTHER_MAX):
            return False
        return (
            abs(shift.seconds) > OFFSET_SIGMAS_MIN * shift.sigma
            and before > MISFIT_RATIO_MIN * left
        )

    def data(self) -> dict[str, Any]:
        """Return all numbers, ready for JSON; null where they are unknown."""
        shift = self.shift
        return {
            "offset_s": None if shift is None else shift.seconds,
            "sigma_s": None if shift is None else shift.sigma,
            "explained": None if shift is None else shift.explained,
            "jitter_s": None if shift is None else shift.jitter,
            "jitter_sigma_s": None if shift is None else shift.jitter_sigma,
            "interval_deviation_s": self.interval_deviation,
            "reason": self.reason,
        }


def channel_clocks(
    recording: Recording, robot: Robot, channels: Sequence[str] = ALIGNED_CHANNELS
) -> tuple[ChannelClock, ...]:
    """Estimate the clock offset of each channel that a recording has.

    Args:
        recording: As calibrated (`carosac_toolkit.recordings.encoders.calibrated`), n cables.
        robot: With as many cables. Its `length_delay` is no offset of a clock.
        channels: Of `ALIGNED_CHANNELS`; those that the recording lacks are left out, and an
            attitude with the stamps of inertial samples that are among them.
    """
    recording.require_cables(robot)
    times = recording.channel_times
    delay = robot.length_delay or 0.0
    comparisons = _Comparisons(recording, robot)
    clocks = []
    with_imu = "attitude" in _of_one_clock(recording, "imu") and "imu" in channels
    for channel in (name for name in channels if name in times):
        if channel == "attitude" and with_imu:
            continue
        intervals = np.diff(times[channel])
        deviation = float(intervals.std()) if len(intervals) else 0.0
        shift, reason = None, ""
        try:
            found = comparisons.shift(channel)
            late = 0.0 if channel == "length_rate" else delay
            shift = replace(found, seconds=found.seconds - late)
        except UnknownShift as error:
            reason = str(error)
        clocks.append(
            ChannelClock(channel=channel, shift=shift, reason=reason, interval_deviation=deviation)
        )
    return tuple(clocks)


def clock_warnings(
    recording: Recording,
    robot: Robot,
    channels: Sequence[str] = CHECKED_CHANNELS,
    *,
    delay_max: float = PLAUSIBLE_DELAY_S,
) -> Iterator[str]:
    """Name the channels whose clocks are apart from that of the lengths, and the remedy.

    Args:
        recording: As calibrated.
        robot: With as many cables.
        channels: Whose clocks matter.
        delay_max: What a delay of a sensor may be [s].
    """
    for clock in channel_clocks(recording, robot, channels):
        if clock.is_apart(delay_max) and clock.shift is not None:
            side = "ahead of" if clock.shift.seconds > 0.0 else "behind"
            yield (
                f"The clock of channel {clock.channel} is {abs(clock.shift.seconds):.3f} s "
                f"(+-{1e3 * clock.shift.sigma:.2g} ms) {side} that of the lengths: align it by "
                f"'carosac import recording RECORDING --align --align-channels {clock.channel} "
                f"--robot {robot.name} --output ALIGNED.parquet'."
            )


def align_clocks(recording: Recording, clocks: Sequence[ChannelClock]) -> Recording:
    """Shift the stamps of channels to the clock of the lengths; the metadata say by how much.

    An attitude with the stamps of the inertial samples is shifted with them.

    Args:
        recording: As it was recorded.
        clocks: Of its channels.

    Raises:
        CarosacError: The offset of a channel is unknown.
    """
    offsets: dict[tuple[str, ...], tuple[float, str]] = {}
    for clock in clocks:
        if clock.shift is None:
            raise CarosacError(
                f"the clock of channel {clock.channel} cannot be aligned: {clock.reason}"
            )
        names = _of_one_clock(recording, clock.channel)
        offsets[names] = clock.shift.seconds, f"sigma {clock.shift.sigma:.6f} s"
    if not offsets:
        allowed = f"one with a channel of {list(ALIGNED_CHANNELS)}"
        raise InvalidField("recording", "lengths alone", allowed)
    return _without_offsets(recording, offsets)


def remove_offsets(recording: Recording, offsets: Mapping[str, float]) -> Recording:
    """Shift the stamps of channels by offsets that are known; the metadata say by how much.

    Args:
        recording: As it was recorded.
        offsets: By which stamps of channels are late against the clock of the lengths [s].

    Raises:
        InvalidField: A channel that the recording lacks or that has no stamps of its own, or an
            offset that is not finite.
    """
    stamped = [name for name in ALIGNED_CHANNELS if name in recording.channel_times]
    for name, seconds in offsets.items():
        if name not in stamped:
            raise InvalidField("offsets", name, f"of {stamped}")
        if not np.isfinite(seconds):
            raise InvalidField("offsets", f"{name} {seconds} s", "a finite time")
    return _without_offsets(
        recording, {(name,): (seconds, "stated") for name, seconds in offsets.items()}
    )


def _without_offsets(
    recording: Recording, offsets: Mapping[tuple[str, ...], tuple[float, str]]
) -> Recording:
    """Remove offsets [s], each with a remark, from the stamps of the channels of one clock."""
    changes: dict[str, Any] = {}
    notes = []
    for names, (seconds, remark) in offsets.items():
        for name in names:
            channel = getattr(recording, name)
            changes[name] = replace(channel, time=channel.time - seconds)
        notes.append(f"{' and '.join(names)} {seconds:+.6f} s ({remark})")
    before = recording.metadata.clock_offsets
    text = f"{'; '.join(notes)}: removed from the stamps"
    metadata = replace(recording.metadata, clock_offsets=f"{before}; {text}" if before else text)
    return replace(recording, **changes, metadata=metadata)


def not_aligned(recording: Recording, clocks: Sequence[ChannelClock]) -> list[str]:
    """Return the channels beside the lengths whose stamps `align_clocks` leaves as they are."""
    shifted = {name for clock in clocks for name in _of_one_clock(recording, clock.channel)}
    return [name for name in list(recording.channel_times)[1:] if name not in shifted]


def _of_one_clock(recording: Recording, channel: str) -> tuple[str, ...]:
    """Return a channel and what has its stamps for sure: an AHRS measures the attitude too."""
    imu, attitude = recording.imu, recording.attitude
    if channel == "imu" and imu is not None and attitude is not None:
        if np.array_equal(imu.time, attitude.time):
            return channel, "attitude"
    return (channel,)


class _Comparisons:
    """Each channel of one recording against what its lengths predict."""

    def __init__(self, recording: Recording, robot: Robot) -> None:
        """Take a recording as calibrated."""
        self._recording = recording
        self._robot = robot
        self._rest: tuple[Array, Equilibrium] | None = None

    def shift(self, channel: str) -> TimeShift:
        """Return by how much the stamps of a channel are late.

        Raises:
            UnknownShift: It cannot be told.
        """
        if channel == "poses":
            return self._poses
        if channel == "length_rate":
            return find_shift(self._measured(channel), self._length_rates())
        if channel == "tension":
            return find_shift(self._measured(channel), self._tensions(), scaling="each")
        if channel == "swivel_angle":
            return find_shift(*self._swivels())
        if channel in ANGLE_CHANNELS:
            return find_shift(self._verticals(channel), self._vertical(), scaling="mixed")
        imu = self._recording.imu
        assert imu is not None
        samples = Signal(time=imu.time, value=np.hstack([imu.angular_rate, imu.specific_force]))
        return find_shift(binned(samples, IMU_BIN_S), self._inertial(), scaling="mixed")

    def _measured(self, channel: str) -> Signal:
        stamped = getattr(self._recording, channel)
        return Signal(time=stamped.time, value=stamped.value)

    def _lengths(self) -> Signal:
        recording = self._recording
        return Signal(time=recording.time, value=recording.unstrained_length)

    def _length_rates(self) -> Signal:
        """Return rates of the lengths [m/s]."""
        lengths = self._lengths()
        if len(lengths.time) < 2:
            return lengths
        rates = CubicSpline(lengths.time, lengths.value)(lengths.time, 1)
        return Signal(time=lengths.time, value=rates)

    @cached_property
    def _poses_late(self) -> float | None:
        """By which the stamps of the poses are late [s]; None where it cannot be told."""
        if self._recording.poses is None:
            return None
        try:
            return self._poses.seconds
        except UnknownShift:
            return None

    @cached_property
    def _poses(self) -> TimeShift:
        """Compare the distances at the measured poses with the lengths."""
        poses = self._recording.poses
        assert poses is not None
        cables = straight_length(self._robot, poses.position, poses.rotation)
        good = cables.valid.all(axis=1)
        distances = Signal(time=poses.time[good], value=cables.length[good])
        return find_shift(distances, self._lengths())

    def _rests(self) -> tuple[Array, Equilibrium]:
        """Return poses of rest on the lengths, and their times [s]."""
        if self._rest is None:
            recording = self._recording
            if recording.metadata.length_kind != "unstrained":
                raise UnknownShift("lengths that are relative hold no platform at a known pose")
            some = evenly(len(recording.time), REST_SAMPLES_MAX)
            lengths = recording.unstrained_length[some]
            if (lengths <= 0.0).any():
                raise UnknownShift("not all lengths are positive")
            rest = forward_kinematics(self._robot, lengths)
            if not (rest.converged & rest.stable).all():
                raise UnknownShift("the robot cannot hang at rest on all of the lengths")
            self._rest = recording.time[some], rest
        return self._rest

    def _motion(self) -> tuple[Array, Array, Array, Array]:
        """Return times by the clock of the lengths, positions, rotations and twists of P in W.

        As measured, where the clock of the poses is known, and else of the platform at rest.
        """
        poses = self._recording.poses
        if self._poses_late is not None and poses is not None:
            time, position, rotation = poses.time - self._poses_late, poses.position, poses.rotation
        else:
            time, rest = self._rests()
            position, rotation = rest.position, rest.rotation
        if len(time) < 3:
            raise UnknownShift("there are too few poses")
        moved = np.hstack([position, summed_turns(rotation)])
        return time, position, rotation, slope(time, moved)

    def _tensions(self) -> Signal:
        """Return tensions [N] that move the platform as measured, or else hold it at rest."""
        robot = self._robot
        if (
            self._poses_late is None or robot.n > SIX_CABLES
        ):  # tensions that the motion does not fix
            time, rest = self._rests()
            return Signal(time=time, value=rest.tension)
        time, position, rotation, twist = self._motion()
        acceleration = slope(time, twist)
        acceleration[:, 2] += robot.gravity
        wrench = np.einsum("kij,kj->ki", mass_matrix(robot, rotation), acceleration)
        pull = np.linalg.pinv(structure_matrix(robot, position, rotation))
        return Signal(time=time, value=np.einsum("kij,kj->ki", pull, wrench))

    def _swivels(self) -> tuple[Signal, Signal]:
        """Return swivel angles of the pulleys as measured, and as the motion turns them [rad]."""
        robot, measured = self._robot, self._measured("swivel_angle")
        pulleys = robot.pulley_radius > 0.0
        if not pulleys.any():
            raise UnknownShift("the robot has no pulleys")
        time, position, rotation, _ = self._motion()
        expected = straight_swivel_angle(robot, position, rotation)
        said, told = (
            Signal(time=when, value=np.unwrap(value[:, pulleys], axis=0))
            for when, value in ((measured.time, measured.value), (time, expected))
        )
        return said, told

    def _verticals(self, channel: str) -> Signal:
        """Return the vertical in the frame of an AHRS or inclinometer, shape (K, 3)."""
        measured = self._measured(channel)
        if channel == "attitude":
            return Signal(time=measured.time, value=to_matrix(measured.value)[:, 2])
        return Signal(time=measured.time, value=vertical(measured.value))

    def _vertical(self) -> Signal:
        """Return the vertical in P, shape (K, 3)."""
        time, _, rotation, _ = self._motion()
        return Signal(time=time, value=rotation[:, 2])

    def _inertial(self) -> Signal:
        """Return turning rate [rad/s] and specific force [m/s^2] in P, shape (K, 6)."""
        time, _, rotation, twist = self._motion()
        force = slope(time, twist[:, :3])
        force[:, 2] += self._robot.gravity
        in_platform = (np.einsum("kji,kj->ki", rotation, value) for value in (twist[:, 3:], force))
        return Signal(time=time, value=np.hstack(list(in_platform)))
