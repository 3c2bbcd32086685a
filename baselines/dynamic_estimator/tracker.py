"""One robot's filter in time: what it has read, where it stands, and what is still to come.

The filter itself stands at the last time for which lengths are known. From there the estimate is
predicted to now; what an IMU said later than that waits until the lengths have come.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from baselines.dynamic_estimator.filter import DynamicFilter, InnovationTally
from baselines.dynamic_estimator.filter_state import DynamicFilterState
from baselines.dynamic_estimator.measurement_models import ImuMean
from baselines.dynamic_estimator.model import DynamicModel, NoMotion
from baselines.dynamic_estimator.reading_models import READING_MODELS
from baselines.dynamic_estimator.rest_start import RestStart
from baselines.dynamic_estimator.settings import DynamicEstimatorSettings
from baselines.length_readings import (
    READING_INTERVAL_MIN_S,
    LengthReadings,
    reading_tolerances,
)
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.scaled import Scaled
from carosac_toolkit.loop.values import Belief, Measurement, Stamped
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.recordings.recording import CABLE_CHANNELS
from carosac_toolkit.robot.robot import Robot

STRAIGHT_TIME_STEPS = 2.0  # over which lengths may be taken as straight
IMU_GROUP_TIME_STEPS = 0.6  # IMU samples so close together are taken as one
WAITING_SAMPLES_MAX = 400  # of the IMU: a few seconds of them
# Without a length reading, after which lengths are held and doubted.
STALE_TIME = Scaled(0.2, "s")
POSE_DELAY_MAX = Scaled(0.1, "s")  # behind the lengths: older poses are not used
# At which a platform may move where it is hung anew: it need not rest.
RESTART_SPEED = Scaled(0.5, "m/s")


class TimedPose(NamedTuple):
    """A measured pose.

    Attributes:
        time: [s].
        position: Platform origin in W [m], shape (3,).
        rotation: From P to W, shape (3, 3).
        used: Whether the filter knows it.
    """

    time: float
    position: Array
    rotation: Array
    used: bool = False


class TimedReading(NamedTuple):
    """A reading of load cells, swivel encoders, an AHRS or an inclinometer.

    Attributes:
        channel: One of `READING_MODELS`.
        time: [s].
        value: As `Measurement` has it, without its batch.
        used: Whether the filter knows it.
    """

    channel: str
    time: float
    value: Array
    used: bool = False


@dataclass(frozen=True, kw_only=True, eq=False)
class Track:
    """Memory of the tracker of one robot.

    Attributes:
        state: The filter where it stands; None where the platform could not be hung yet.
        now: The estimate at the time of the measurement, or None.
        readings: Of the lengths.
        waiting: IMU samples that are later than the filter: time [s], angular rate [rad/s] and
            specific force [m/s^2], shape (K, 7).
        poses: Measured poses that are later than the filter, the last one in any case.
        signals: Readings of the other sensors that are later than the filter, the last one of each
            sensor in any case.
        tally: What measurements said against the filter since the last belief.
        restarts: How often the platform was hung anew.
        stale: How often lengths were held for want of readings, and doubted the more, the faster
            winches are.
    """

    state: DynamicFilterState | None
    now: DynamicFilterState | None
    readings: LengthReadings
    waiting: Array
    poses: tuple[TimedPose, ...]
    tally: InnovationTally
    restarts: int
    stale: int = 0
    signals: tuple[TimedReading, ...] = ()


class Tracker:
    """Moves tracks on."""

    def __init__(self, robot: Robot, settings: DynamicEstimatorSettings) -> None:
        """Take the robot."""
        self._robot = robot
        self._settings = settings
        self._model = DynamicModel(robot, settings)
        self._filter = DynamicFilter(self._model, settings)
        self._rest = RestStart(robot, settings, self._model.errors)
        self._short = STRAIGHT_TIME_STEPS * settings.time_step
        self._tolerances = reading_tolerances(robot, settings.encoder_noise)
        ratios = Scales(robot).ratios
        self._stale_time, self._late_max = STALE_TIME.of(ratios), POSE_DELAY_MAX.of(ratios)
        self._restart_speed = RESTART_SPEED.of(ratios)
        self._delay = (robot.length_delay or 0.0) if settings.delay is None else settings.delay

    def start(
        self, measurement: Measurement, row: int, speed: float | None = None,
        slid: Array | None = None,
    ) -> Track:  # fmt: skip
        """Hang the platform on the first lengths, where it may move at a speed [m/s].

        Encoders that have slipped before, by (n,) [m], say so much too much.
        """
        now = float(measurement.time[row])
        length = measurement.unstrained_length[row]
        readings = LengthReadings.first(
            self._counts(measurement, row), length, self._tolerances, slid
        )
        state = self._rest.state(now, length - readings.slid, speed)
        if state is not None:
            state = state.slipped(readings.slid, self._tolerances.slip_deviation)
        heard: tuple[TimedReading, ...] = ()
        stamped = measurement.attitude  # once there is an AHRS, no inclinometer counts
        if stamped is not None:
            heard = (TimedReading("attitude", float(stamped.time[row]), stamped.value[row], True),)
        return Track(
            state=state, now=state, readings=readings, waiting=np.empty((0, 7)),
            poses=(), signals=heard, tally=InnovationTally(), restarts=0,
        )  # fmt: skip

    def moving(self, track: Track, measurement: Measurement, row: int, first: Belief) -> Track:
        """Let the platform of a new track move through a measured pose with a twist."""
        if track.state is None:
            return track
        assert first.twist is not None
        state = self._rest.moving(
            track.state, measurement.unstrained_length[row], first.position[row],
            first.rotation[row], first.twist[row],
        )  # fmt: skip
        return replace(track, state=state, now=state)

    def advance(self, track: Track, measurement: Measurement, row: int) -> Track:
        """Move the filter as far as lengths are known, and the estimate to now."""
        now = float(measurement.time[row])
        when = self._counts(measurement, row)
        length = measurement.unstrained_length[row]
        gap = when - track.readings.time[-1]
        if track.state is None or gap > self._settings.gap_max:
            return self._hung_anew(track, measurement, row)
        state = track.state
        readings = track.readings.taken(
            when, length, self._robot, self._settings.reading_jump, min(state.time, now)
        )
        track = replace(track, readings=readings, tally=InnovationTally(),
                        waiting=_waiting(track.waiting, measurement, row),
                        poses=_known_poses(track.poses, measurement, row),
                        signals=self._known_signals(track, measurement, row))  # fmt: skip
        if readings.slipped is not None:
            track = replace(
                track, readings=replace(readings, slipped=None),
                state=state.slipped(readings.slipped, self._tolerances.slip_deviation),
            )  # fmt: skip
        if now - readings.time[-1] > self._stale_time:
            track = self._held(track, now)
        try:
            return self._moved(track, measurement, row)
        except (NoMotion, np.linalg.LinAlgError):
            return self._hung_anew(track, measurement, row)

    def _counts(self, measurement: Measurement, row: int) -> float:
        """Return the time at which the newest length reading counts [s]."""
        stamped = measurement.length_rate
        when = measurement.time[row] if stamped is None else stamped.time[row]
        return float(when) + self._delay

    def _hung_anew(self, track: Track, measurement: Measurement, row: int) -> Track:
        """Start again at rest; what was counted goes on, and encoders have slipped as before."""
        before = track.readings
        fresh = self.start(measurement, row, self._restart_speed, before.slid)
        readings = replace(fresh.readings, rejected=before.rejected, slips=before.slips)
        return replace(
            fresh, readings=readings, stale=track.stale,
            restarts=track.restarts + int(fresh.state is not None),
        )  # fmt: skip

    def _held(self, track: Track, now: float) -> Track:
        """Hold the lengths that no longer arrive; the winches may have wound on."""
        assert track.state is not None
        doubt = self._robot.speed_max * (now - track.readings.time[-1])
        return replace(
            track, state=track.state.loosened(doubt), readings=track.readings.held(now),
            stale=track.stale + 1,
        )  # fmt: skip

    def _moved(self, track: Track, measurement: Measurement, row: int) -> Track:
        """Move the filter to the last known lengths, then the estimate to now."""
        now = float(measurement.time[row])
        track = self._fused(track, min(now, float(track.readings.time[-1])), measurement, row)
        state = track.state
        assert state is not None
        if now - state.time > READING_INTERVAL_MIN_S:
            state = self._predicted(state, track.readings, now)
        return replace(track, now=state)

    def _predicted(
        self, state: DynamicFilterState, readings: LengthReadings, now: float
    ) -> DynamicFilterState:
        """Predict the estimate, covariance included, beyond the last known lengths."""
        for end in readings.knots(state.time, now, self._short):
            start = state.time
            state, _ = self._filter.step(state, readings.at(start), readings.at(end), end - start)
            state = replace(state, time=end)
        return state

    def _fused(self, track: Track, known: float, measurement: Measurement, row: int) -> Track:
        """Take the filter through all measurements up to a time."""
        state, tally = track.state, track.tally
        assert state is not None
        groups, waiting = _grouped(
            track.waiting, known, IMU_GROUP_TIME_STEPS * self._settings.time_step
        )
        told: list[TimedPose | TimedReading] = [*track.signals, *track.poses]
        due = [t for t in told if not t.used and t.time <= known + READING_INTERVAL_MIN_S]
        stops, stop_of = _merged([*groups, *(each.time for each in due)])
        groups = {stop_of[time]: group for time, group in groups.items()}
        if not stops or known - stops[-1] > self._short:
            stops.append(known)
        for stop in stops:
            state, added = self._to(state, track.readings, stop, groups.get(stop))
            tally = tally + added
            for each in due:
                if stop_of[each.time] == stop:
                    state, added = self._told(state, each)
                    tally = tally + added
        until = known + READING_INTERVAL_MIN_S
        poses = tuple(p._replace(used=p.used or p.time <= until) for p in track.poses)
        signals = tuple(s._replace(used=s.used or s.time <= until) for s in track.signals)
        return replace(
            track, state=state, waiting=waiting, tally=tally, poses=poses, signals=signals
        )

    def _told(
        self, state: DynamicFilterState, each: TimedPose | TimedReading
    ) -> tuple[DynamicFilterState, InnovationTally]:
        """Correct by a pose or a reading, unless it is too late to say anything."""
        late = max(0.0, state.time - each.time)
        late = late if late > READING_INTERVAL_MIN_S else 0.0
        if late > self._late_max:
            return state, InnovationTally(disturbed=1)
        if isinstance(each, TimedPose):
            return self._filter.pose(state, each.position, each.rotation, late)
        return self._filter.reading(state, each.channel, each.value, late)

    def _known_signals(
        self, track: Track, measurement: Measurement, row: int
    ) -> tuple[TimedReading, ...]:
        """Return the readings of other sensors that are to be used, with the new ones.

        The last one of each is kept, so that it is not used again. Load cells and swivel encoders
        share the clock of the lengths, sensors on the platform that of the IMU.
        """
        found: list[TimedReading] = []
        for channel in self._channels(track, measurement):
            known = [each for each in track.signals if each.channel == channel]
            kept = [each for each in known[:-1] if not each.used] + known[-1:]
            stamped: Stamped | None = getattr(measurement, channel)
            if stamped is not None:
                delay = self._delay if channel in CABLE_CHANNELS else 0.0
                when = float(stamped.time[row]) + delay
                if not kept or when > kept[-1].time + READING_INTERVAL_MIN_S:
                    kept.append(TimedReading(channel, when, stamped.value[row]))
            found += kept
        return tuple(found)

    def _channels(self, track: Track, measurement: Measurement) -> list[str]:
        """Return the channels of other sensors that are used; of AHRS and inclinometer one.

        Where there has been an AHRS, the inclinometer has no part, whichever reads more often.
        """
        s = self._settings
        ahrs = measurement.attitude is not None or any(
            each.channel == "attitude" for each in track.signals
        )
        mounted = s.attitude_rotation is not None
        used = {
            "tension": s.load_cells, "swivel_angle": s.swivels, "attitude": mounted,
            "inclination": mounted and not ahrs,
        }  # fmt: skip
        return [channel for channel in READING_MODELS if used[channel]]

    def _to(
        self, state: DynamicFilterState, readings: LengthReadings, stop: float, group: Array | None
    ) -> tuple[DynamicFilterState, InnovationTally]:
        """Take the filter to a time, with the IMU samples (K, 7) there."""
        tally = InnovationTally()
        if stop - state.time < READING_INTERVAL_MIN_S:
            return state, tally
        for end in readings.knots(state.time, stop, self._short):
            start = state.time
            felt = None
            if group is not None and end == stop:
                felt = ImuMean(values=group[:, 1:].mean(axis=0), samples=len(group))
            state, added = self._filter.step(
                state, readings.at(start), readings.at(end), end - start, felt,
                inertial=group is not None,
            )  # fmt: skip
            state, tally = replace(state, time=end), tally + added
        return state, tally


def _merged(times: Sequence[float]) -> tuple[list[float], dict[float, float]]:
    """Return times in order without those that follow another at once, and which each one is."""
    stops: list[float] = []
    stop_of: dict[float, float] = {}
    for time in sorted(times):
        if not stops or time - stops[-1] > READING_INTERVAL_MIN_S:
            stops.append(time)
        stop_of[time] = stops[-1]
    return stops, stop_of


def _waiting(waiting: Array, measurement: Measurement, row: int) -> Array:
    """Return the waiting IMU samples with the new ones."""
    imu = measurement.imu
    if imu is None:
        return waiting
    new = np.column_stack([imu.time[row], imu.angular_rate[row], imu.specific_force[row]])
    return np.vstack([waiting, new])[-WAITING_SAMPLES_MAX:]


def _grouped(samples: Array, known: float, alike: float) -> tuple[dict[float, Array], Array]:
    """Group IMU samples up to a time; each group counts at its mean time.

    Returns:
        The groups, and the samples that are later.
    """
    ready = samples[samples[:, 0] <= known + READING_INTERVAL_MIN_S]
    groups: dict[float, Array] = {}
    first = 0
    for k in range(1, len(ready) + 1):
        if k == len(ready) or ready[k, 0] - ready[first, 0] > alike:
            group = ready[first:k]
            groups[float(group[:, 0].mean())] = group
            first = k
    return groups, samples[len(ready) :]


def _known_poses(
    poses: tuple[TimedPose, ...], measurement: Measurement, row: int
) -> tuple[TimedPose, ...]:
    """Return the waiting poses with the new one, if there is one."""
    kept = tuple(pose for pose in poses[:-1] if not pose.used) + poses[-1:]
    pose = measurement.pose
    if pose is None:
        return kept
    when = float(measurement.time[row] if pose.time is None else pose.time[row])
    if kept and when <= kept[-1].time + READING_INTERVAL_MIN_S:
        return kept
    return (*kept, TimedPose(when, pose.position[row], pose.rotation[row]))
