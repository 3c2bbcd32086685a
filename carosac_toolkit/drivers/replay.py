"""A recording as a driver: it returns the recorded measurements and commands."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from carosac_toolkit.base.errors import CarosacError, InvalidField
from carosac_toolkit.drivers.sensors import check_suite
from carosac_toolkit.loop.values import Command, Measurement, State
from carosac_toolkit.recordings.bundled import find_recording
from carosac_toolkit.recordings.encoders import calibrated
from carosac_toolkit.recordings.files import load_recording
from carosac_toolkit.recordings.recording import Recording
from carosac_toolkit.robot.robot import Robot


@dataclass(frozen=True, kw_only=True)
class ReplaySettings:
    """Settings of `ReplayDriver`.

    Attributes:
        recording: A file, or the name of a bundled recording.
        suite: What of the recording `Measurement` carries; all but IMU and poses always, and a
            suite that names it needs it. None: all it has but poses.
    """

    recording: str = "synthetic"
    suite: str | None = None

    def __post_init__(self) -> None:
        """Refuse an unknown suite."""
        if self.suite is not None:
            check_suite(self.suite, inertial=True)


class ReplayDriver:
    """Driver that replays a recording; a command changes nothing and the recorded one is returned.

    Poses of the recording are its truth. Readings are converted by what the robot file says of
    its sensors (`carosac_toolkit.recordings.encoders`).
    """

    Settings: ClassVar = ReplaySettings
    replays: ClassVar = True

    def __init__(self, robot: Robot, recording: Recording, settings: ReplaySettings) -> None:
        recording.require_cables(robot)
        suite = settings.suite
        for sensor in [] if suite is None else suite.split("+")[1:]:
            if sensor not in recording.sensors:
                allowed = f"one without {sensor}: the recording has none"
                raise InvalidField("suite", repr(suite), allowed)
        self._recording = calibrated(recording, robot)
        self._suite = "lengths+imu" if suite is None else suite
        self._index: int | None = None

    @classmethod
    def build(
        cls, robot: Robot, settings: ReplaySettings | None = None, *, seed: int = 0
    ) -> ReplayDriver:
        """Load the recording; nothing here is random, so `seed` has no effect."""
        chosen = settings or ReplaySettings()
        return cls(robot, load_recording(find_recording(chosen.recording)), chosen)

    @property
    def recording(self) -> Recording:
        """Recording that is played."""
        return self._recording

    def connect(self) -> None:
        """Go to the first sample."""
        self._index = 0

    def measure(self) -> Measurement:
        """Return the sample of this cycle."""
        index = self._here()
        measurement = self._recording.measurement(index)
        if "imu" not in self._suite:
            measurement = replace(measurement, imu=None)
        if "pose" not in self._suite:
            return measurement
        sample = self._recording.pose_at(self._recording.time[index : index + 1])
        return replace(measurement, pose=sample.pose if sample.valid[0] else None)

    def command(self, command: Command) -> Command:
        """Return the command that was recorded for this cycle, or the lengths if none was."""
        index = self._here()
        shape = (1, self._recording.n)
        if command.unstrained_length.shape != shape:
            got = f"shape {command.unstrained_length.shape}"
            raise InvalidField("unstrained_length", got, f"shape {shape}")
        time = self._recording.time[index : index + 1]
        recorded = self._recording.unstrained_length[index]
        channel = self._recording.command
        if channel is not None:
            newest = int(np.searchsorted(channel.time, time[0] + 1e-9, side="right")) - 1
            recorded = channel.value[max(newest, 0)]
        return Command(time=time, unstrained_length=recorded[None])

    def wait(self, duration: float) -> bool:
        """Go to the next sample, however long that took; False after the last one."""
        index = self._here() + 1
        if index >= len(self._recording.time):
            return False
        self._index = index
        return True

    def stop(self, reason: str) -> None:
        """Do nothing: a recording cannot be stopped."""

    def close(self) -> None:
        """Release the recording."""
        self._index = None

    def truth(self) -> State | None:
        """Return the recorded pose of this sample, or None if it has none."""
        index = self._here()
        time = self._recording.time[index : index + 1]
        if self._recording.poses is None:
            return None
        sample = self._recording.pose_at(time)
        if not sample.valid[0]:
            return None
        return State(time=time, position=sample.pose.position, rotation=sample.pose.rotation)

    def _here(self) -> int:
        """Return the index of the sample."""
        if self._index is None:
            raise CarosacError("replay: not connected; call connect() first")
        return self._index
