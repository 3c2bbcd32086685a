"""The estimator `ks_ekf`: IMU and cable lengths in an error-state Kalman filter.

References:
    Allak et al., *Kinematics-Inertial Fusion for Localization of a 4-Cable Underactuated Suspended
    Robot Considering Cable Sag*, IROS 2022.
"""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar

import numpy as np

from baselines.center_of_mass import learned_center_of_mass
from baselines.ks_ekf import corrections, initial_state
from baselines.ks_ekf.corrections import MeasurementResidual
from baselines.ks_ekf.error_filter import ErrorFilter, FilterCorrection, added, no_innovations
from baselines.ks_ekf.filter_settings import filter_settings
from baselines.ks_ekf.filter_state import (
    CENTER_ERRORS,
    FIXED_ERROR_COUNT,
    NO_SAMPLES,
    POSITION_ERRORS,
    KsEkfState,
)
from baselines.ks_ekf.inertial import InertialMotion, samples_of, slope
from baselines.ks_ekf.platform_motion import at_rest, carried, origin
from baselines.ks_ekf.record import KsEkfRecord
from baselines.ks_ekf.rest_detection import RecentMeasurements, RestMeans, detect_rest
from baselines.ks_ekf.rest_pose import RestPose, find_rest
from baselines.ks_ekf.settings import KsEkfSettings
from baselines.ks_ekf.timed_lengths import TIME_TOLERANCE_S, TimedLengths, due, reading_of
from baselines.length_readings import LengthReadings, reading_tolerances
from carosac_toolkit.base.errors import CarosacError, InvalidField
from carosac_toolkit.base.extras import require
from carosac_toolkit.loop.values import Belief, Command, Measurement
from carosac_toolkit.robot.robot import Robot

DOUBT_FACTOR = 2.0  # by which standard deviations grow where no lengths fit any more


class KsEkf:
    """Error-state Kalman filter over inertial samples and cable lengths, for one robot."""

    Settings: ClassVar = KsEkfSettings

    def __init__(self, robot: Robot, settings: KsEkfSettings) -> None:
        require("KS+EKF", "filterpy", "pinocchio")
        self._robot = robot
        self._settings = filter_settings(robot, settings)
        self._tolerances = reading_tolerances(robot, self._settings.length_noise)
        self._lead = robot.length_delay or 0.0
        self._kalman = ErrorFilter(FIXED_ERROR_COUNT + robot.n, settings.gate)
        self._motion = InertialMotion(
            robot.gravity, self._settings, FIXED_ERROR_COUNT + robot.n, self._kalman
        )

    @classmethod
    def build(cls, robot: Robot, settings: KsEkfSettings | None = None, *, seed: int = 0) -> KsEkf:
        """Make one for the nominal robot; it draws no random numbers, so `seed` has no effect."""
        return cls(robot, settings or KsEkfSettings())

    def reset(self, measurement: Measurement) -> Belief:
        """Start at rest on the first lengths, which count now even if they lead the platform.

        Raises:
            InvalidField: Another number of cables, or more than one robot.
        """
        self._check(measurement)
        first = reading_of(measurement, self._lead)
        first = replace(first, time=min(first.time, float(measurement.time[0])))
        samples = samples_of(measurement, self._settings)
        nothing = RecentMeasurements(time=np.zeros(0), lengths=np.zeros((0, self._robot.n)))
        state = initial_state.blank(self._robot, self._settings, first.time)
        record = KsEkfRecord(
            state=replace(state, samples=samples),
            reading=first,
            window=nothing.extended([first], samples, self._settings.rest_window),
            encoders=LengthReadings.first(first.time, first.lengths, self._tolerances),
            slid=np.zeros(self._robot.n),
            innovations=no_innovations(),
            updates=1,
        )
        record = self._place(record, first, self._settings.initial_sway)
        if len(samples) and not record.failures:
            record = self._carry(record)
            quiet = RestMeans(rate=samples.rate.mean(axis=0), force=samples.force.mean(axis=0))
            record = self._use_stillness(record, quiet)
        return self._belief(record, measurement)

    def update(self, belief: Belief, command: Command, measurement: Measurement) -> Belief:
        """Go to a measurement; the command is not used.

        Raises:
            CarosacError: The belief is not one of this estimator.
            InvalidField: A measurement that is earlier than the belief, of another number of
                cables, or of more than one robot.
        """
        record = belief.memory
        if not isinstance(record, KsEkfRecord):
            raise CarosacError("ks_ekf: update() of a belief that is not from this estimator")
        self._check(measurement)
        now = float(measurement.time[0])
        if now < belief.time[0]:
            raise InvalidField("measurement.time", f"{now} s", f">= {belief.time[0]} s, the last")
        record, ready = self._received(record, measurement)
        if not self._is_carried(record.state, now):
            record = self._coast(record)
        elif not record.state.inertial:
            record = self._restart(record, record.reading)
        else:
            record = self._filter(record, ready, now)
        return self._belief(record, measurement)

    def _received(
        self, record: KsEkfRecord, measurement: Measurement
    ) -> tuple[KsEkfRecord, list[TimedLengths]]:
        """Note what came; find lengths whose time has come. A gap between samples ends carrying."""
        new, now = reading_of(measurement, self._lead), float(measurement.time[0])
        ready, waiting = due(record.waiting, new, now)
        state, samples = record.state, samples_of(measurement, self._settings)
        late = sum(reading.time < state.time - TIME_TOLERANCE_S for reading in ready)
        known = state.samples.joined(samples)
        gaps = np.flatnonzero(np.diff(known.time) > self._settings.imu_gap)
        if len(gaps):
            known = known.keep(slice(int(gaps[-1]) + 1, None))
            state = initial_state.released(state, self._settings)
        record = replace(record, state=replace(state, samples=known))
        record, good = self._believed(record, ready, now)
        later = [reading for reading in good if reading.time > state.time + TIME_TOLERANCE_S]
        record = replace(
            record,
            reading=max((record.reading, *good), key=lambda reading: reading.time),
            waiting=waiting,
            window=record.window.extended(good, samples, self._settings.rest_window),
            innovations=no_innovations(),
            resting=False,
            updates=record.updates + 1,
            late=record.late + late,
        )
        return record, later

    def _believed(
        self, record: KsEkfRecord, ready: tuple[TimedLengths, ...], now: float
    ) -> tuple[KsEkfRecord, list[TimedLengths]]:
        """Hold back lengths that no winch can have wound; take off what encoders slipped by."""
        good = []
        for reading in ready:
            before, jump = record.encoders, self._settings.reading_jump
            heard = before.taken(reading.time, reading.lengths, self._robot, jump, reading.time)
            record = self._slid(replace(record, encoders=heard), reading.time, now)
            if heard.corrected > before.corrected:  # what was believed came from wrong lengths
                record = replace(record, misfit_since=reading.time - self._settings.misfit_time)
            if heard.outliers is None and np.array_equal(heard.slid, record.slid):
                good.append(replace(reading, lengths=reading.lengths - record.slid))
            else:
                record = replace(record, rejected=record.rejected + 1, misfit_since=None)
        return record, good

    def _slid(self, record: KsEkfRecord, time: float, now: float) -> KsEkfRecord:
        """Believe a slip of encoders: at once, or where inertial samples go on once it lasts."""
        beyond = record.encoders.slid - record.slid
        lasts = time - record.encoders.slid_at >= self._settings.misfit_time
        carried = record.state.inertial and self._is_carried(record.state, now)
        if not beyond.any() or (carried and not lasts):
            return record
        state = record.state.slipped(beyond != 0.0, self._tolerances.slip_deviation)
        return replace(record, state=state, slid=record.encoders.slid)

    def _is_carried(self, state: KsEkfState, now: float) -> bool:
        """Return whether inertial samples reach up to now."""
        samples = state.samples
        return len(samples) > 0 and now - float(samples.time[-1]) <= self._settings.imu_gap

    def _filter(self, record: KsEkfRecord, ready: list[TimedLengths], now: float) -> KsEkfRecord:
        """Go from lengths to lengths, as far as their time has come."""
        if not ready:
            until = max(record.state.time, now - self._settings.lag_max)
            return replace(record, state=self._motion.advance(record.state, until))
        for reading in ready:
            if record.state.inertial:
                record = self._weigh(record, reading)
        return record

    def _weigh(self, record: KsEkfRecord, reading: TimedLengths) -> KsEkfRecord:
        """Go to the time of lengths and weigh them; what rests says so."""
        record = replace(record, state=self._motion.advance(record.state, reading.time))
        quiet = detect_rest(record.window, record.state.rate_bias, self._settings)
        record = replace(record, resting=quiet is not None)
        record = self._use_lengths(record, reading)
        again = reading.time - record.rest_used >= self._settings.rest_use_period
        if quiet is not None and again and record.misfit_since is None:
            record = self._use_stillness(record, quiet)
            record = self._use_equilibrium(record, reading)
        return record

    def _use_lengths(self, record: KsEkfRecord, reading: TimedLengths) -> KsEkfRecord:
        """Weigh lengths, as they are or as a pose of rest; start anew after too many misfits."""
        record, evidence = self._evidence(record, reading)
        if evidence is None:  # without a pose of rest nothing holds the inertial prediction
            return self._misfit(replace(record, failures=record.failures + 1), reading)
        record = replace(record, slack=record.slack + evidence.left_out, tension=evidence.tension)
        if not len(evidence.residual):  # no cable seems taut: no motion lasts long that way
            return self._misfit(record, reading)
        correction = self._correct(record.state, evidence)
        by_cable = self._settings.coupling == "tight"  # a pose is wrong as a whole
        if not correction.accepted and by_cable and len(evidence.residual) > 3:
            fewer = self._correct(record.state, corrections.without_worst(record.state, evidence))
            correction = fewer if fewer.accepted else correction
            record = replace(record, excluded=record.excluded + fewer.accepted)
        record = replace(record, innovations=added(record.innovations, correction))
        if correction.accepted:
            state = record.state.injected(correction.error, correction.covariance)
            return replace(record, state=state, misfit_since=None)
        since = record.misfit_since
        if since is not None and reading.time - since >= self._settings.reject_time:
            correction = self._correct(record.state, evidence, bounded=True)
            state = record.state.injected(correction.error, correction.covariance)
            record = replace(record, state=state)
        return self._misfit(record, reading)

    def _misfit(self, record: KsEkfRecord, reading: TimedLengths) -> KsEkfRecord:
        """Count lengths that do not fit; where none do for long, that raises doubts."""
        since = reading.time if record.misfit_since is None else record.misfit_since
        record = replace(record, rejected=record.rejected + 1, misfit_since=since)
        if reading.time - since < self._settings.misfit_time:
            return record
        return self._doubt(record, reading)

    def _doubt(self, record: KsEkfRecord, reading: TimedLengths) -> KsEkfRecord:
        """Believe less and less of the state, in the end nothing: then start anew."""
        robot, settings = self._robot, self._settings
        state = initial_state.doubted(robot, settings, record.state, DOUBT_FACTOR)
        if np.trace(state.covariance[POSITION_ERRORS, POSITION_ERRORS]) < settings.sway**2:
            return replace(record, state=state, doubts=record.doubts + 1)
        lost = initial_state.forgotten(robot, settings, record.state)
        return self._restart(replace(record, state=lost), reading)

    def _evidence(
        self, record: KsEkfRecord, reading: TimedLengths
    ) -> tuple[KsEkfRecord, MeasurementResidual | None]:
        """Compare the lengths with the state; None where they need a pose of rest but have none."""
        state, settings = record.state, self._settings
        if settings.coupling == "tight":
            turning = slope(record.window.samples, state.time, settings.slope_half_width)
            tight = corrections.of_lengths(
                self._robot, state, reading.lengths, turning, record.swing, settings
            )
            return replace(record, swing=tight.swing or record.swing), tight
        record, rest = self._rest(record, reading)
        if rest is None:
            return record, None
        noise = corrections.sway_noise(rest, settings)
        if record.resting:
            noise = corrections.rest_noise(self._settings)
        return record, corrections.of_rest_pose(state, rest, noise, settings)

    def _use_stillness(self, record: KsEkfRecord, quiet: RestMeans) -> KsEkfRecord:
        """Weigh that nothing moves, by the IMU."""
        gravity = self._robot.gravity
        evidence = corrections.of_stillness(record.state, quiet, gravity, self._settings)
        return self._use_rest(replace(record, rest_used=record.state.time), evidence)

    def _use_equilibrium(self, record: KsEkfRecord, reading: TimedLengths) -> KsEkfRecord:
        """Weigh that the platform is where it rests, unless that was the measurement anyway."""
        if self._settings.coupling == "loose":
            return record
        record, rest = self._rest(record, reading)
        if rest is None:
            return replace(record, failures=record.failures + 1)
        noise = corrections.rest_noise(self._settings)
        evidence = corrections.of_rest_pose(record.state, rest, noise, self._settings)
        return self._use_rest(record, evidence)

    def _use_rest(self, record: KsEkfRecord, evidence: MeasurementResidual) -> KsEkfRecord:
        """Weigh something that holds at rest; where it does not fit, it is held back."""
        correction = self._correct(record.state, evidence)
        if not correction.accepted:
            return replace(record, held=record.held + 1)
        return replace(record, state=record.state.injected(correction.error, correction.covariance))

    def _correct(
        self, state: KsEkfState, evidence: MeasurementResidual, *, bounded: bool = False
    ) -> FilterCorrection:
        """Weigh evidence; beyond the gate not at all, or as far as the gate allows."""
        return self._kalman.correct(
            state.covariance, evidence.residual, evidence.jacobian, evidence.noise, bounded=bounded
        )

    def _coast(self, record: KsEkfRecord) -> KsEkfRecord:
        """Take the pose of rest, with the sway that is possible, without inertial samples."""
        state = replace(initial_state.released(record.state, self._settings), samples=NO_SAMPLES)
        record = replace(record, state=state, coasted=record.coasted + 1)
        return self._place(record, record.reading, self._settings.sway)

    def _restart(self, record: KsEkfRecord, reading: TimedLengths) -> KsEkfRecord:
        """Start anew at the pose of rest, with the sway that there may be."""
        placed = self._place(record, reading, self._settings.sway)
        if placed.failures > record.failures:
            return replace(placed, state=replace(placed.state, samples=record.state.samples))
        return self._carry(replace(placed, restarts=record.restarts + 1, misfit_since=None))

    def _place(self, record: KsEkfRecord, reading: TimedLengths, sway: float) -> KsEkfRecord:
        """Put the state at the pose of rest of the lengths; where there is none, it is lost."""
        record, rest = self._rest(record, reading)
        if rest is None:
            state = initial_state.lost(self._robot, self._settings, record.state, reading.time)
            return replace(record, state=state, failures=record.failures + 1)
        state = initial_state.placed(record.state, rest, reading, sway, self._settings)
        return replace(record, state=state, tension=rest.tension)

    def _carry(self, record: KsEkfRecord) -> KsEkfRecord:
        """Let the inertial samples carry a state that was just placed."""
        return replace(record, state=initial_state.inertial(record.state, self._settings))

    def _rest(
        self, record: KsEkfRecord, reading: TimedLengths
    ) -> tuple[KsEkfRecord, RestPose | None]:
        """Solve for rest on the lengths, less the errors that the state knows."""
        state = record.state
        lengths = reading.lengths - state.length_bias
        step = self._settings.length_step
        rest = find_rest(self._robot, lengths, state.center, state.solution, step)
        solution = None if rest is None else rest.solution
        return replace(record, state=replace(state, solution=solution)), rest

    def _belief(self, record: KsEkfRecord, measurement: Measurement) -> Belief:
        """Return the belief at the time of a measurement; no lengths used are later."""
        now = float(measurement.time[0])
        if record.state.inertial:
            state = self._motion.advance(record.state, now)
            twist, covariance = carried(state, self._settings)
            position = origin(state, self._settings.imu_position)
        else:
            state = record.state
            twist, covariance = at_rest(state)
            position = state.position
        center = learned_center_of_mass(
            self._robot.center_of_mass + state.center,
            state.covariance[CENTER_ERRORS, CENTER_ERRORS],
            self._settings.center_of_mass_prior,
        )  # fmt: skip
        return Belief(
            time=measurement.time,
            position=position[None],
            rotation=state.rotation[None],
            twist=twist[None],
            covariance=covariance[None],
            tension=None if record.tension is None else record.tension[None],
            center_of_mass=None if center is None else center[None],
            innovations=record.innovations,
            memory=record,
        )

    def _check(self, measurement: Measurement) -> None:
        """Refuse another robot, or several."""
        shape = measurement.unstrained_length.shape
        if shape != (1, self._robot.n):
            allowed = f"shape (1, {self._robot.n}): one robot at a time"
            raise InvalidField("unstrained_length", f"shape {shape}", allowed)
