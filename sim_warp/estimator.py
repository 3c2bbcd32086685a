"""The estimator `simulator`: open-loop simulation of the motion that measured lengths cause."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import CarosacError, InvalidField
from carosac_toolkit.base.numbers import check_not_negative, check_positive
from carosac_toolkit.loop.values import Belief, Command, Measurement
from carosac_toolkit.physics.cable.straight_line import straight_length
from carosac_toolkit.physics.motion.length_curve import LENGTH_SEGMENT_MAX
from carosac_toolkit.physics.rest.held_lengths import poses_on_lengths
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.robot.robot import Robot
from sim_warp.delayed_lengths import DelayedLengths
from sim_warp.options import CableOptions
from sim_warp.simulator import Simulator
from sim_warp.state import SimulatorState

STEP_DIFFERENCE_MAX_S = 1e-9  # between robots of a batch


@dataclass(frozen=True, kw_only=True)
class SimulatorSettings(CableOptions):
    """Settings of `SimulatorEstimator`: those of the cables, and two times.

    A `time_step` of None takes that of the cable model.

    Attributes:
        delay: Delay of poses behind lengths [s]: a belief is the pose that belongs to the lengths
            of that much earlier. None takes `Robot.length_delay`.
        gap_max: Longest time between two measurements to simulate through [s]; after a longer one
            the platform starts again at rest.
    """

    delay: float | None = None
    gap_max: float = 60.0

    def __post_init__(self) -> None:
        """Refuse what cannot be simulated."""
        super().__post_init__()
        if self.delay is not None:
            check_not_negative("delay", self.delay, "s")
        check_positive("gap_max", self.gap_max, "s")


@dataclass(frozen=True, kw_only=True, eq=False)
class SimulationRecord:
    """Memory of a simulated belief.

    Attributes:
        converged: True where the last update gave the belief's pose, shape (B,); elsewhere the pose
            is the last valid one, or home if there was none yet.
        updates: Number of measurements since the last reset, the first one included.
        failures: Number of measurements among them without a pose, shape (B,).
        restarts: Number of restarts at rest on measured lengths, after a failure or a gap,
            shape (B,).
    """

    converged: NDArray[np.bool_]
    updates: int
    failures: NDArray[np.int64]
    restarts: NDArray[np.int64]


class SimulatorEstimator:
    """Open-loop estimator: cables wound as measured move the platform, from rest or `reset_moving`.

    Between measurements lengths go smoothly, without winches (`DelayedLengths`); poses, commands
    and all other sensors are not used. Where a simulation fails, the belief keeps the last valid
    pose, ``belief.memory``, a `SimulationRecord`, counts it, and the platform starts again at rest
    on the measured lengths.

    The simulation continues from its own state, not from the belief passed to `update`: each belief
    can be updated once, and `reset` starts again.
    """

    Settings: ClassVar = SimulatorSettings

    def __init__(self, robot: Robot, settings: SimulatorSettings) -> None:
        self._robot = robot
        self._settings = settings
        self._delay = (robot.length_delay or 0.0) if settings.delay is None else settings.delay
        check_not_negative("delay", self._delay, "s")
        self._simulator: Simulator | None = None
        self._record: SimulationRecord | None = None

    @classmethod
    def build(
        cls, robot: Robot, settings: SimulatorSettings | None = None, *, seed: int = 0
    ) -> SimulatorEstimator:
        """Build one for the nominal robot; it draws no random numbers, so `seed` has no effect."""
        return cls(robot, settings or SimulatorSettings())

    def reset(self, measurement: Measurement) -> Belief:
        """Start at rest on the first lengths."""
        lengths = measurement.lengths_of(len(measurement.unstrained_length), self._robot.n)
        size = len(lengths)
        if self._simulator is None or self._simulator.size != size:
            options = self._settings.simulator_options
            self._simulator = Simulator(self._robot, worlds=size, **options)
        segment = LENGTH_SEGMENT_MAX.of(Scales(self._robot).ratios)
        self._delayed = DelayedLengths(lengths, self._delay, segment)
        self._time = measurement.time
        self._lost = np.zeros(size, dtype=np.bool_)  # worlds without a valid state
        valid = self._start_at_rest(np.ones(size, dtype=np.bool_), lengths)
        start = Belief(
            time=measurement.time,
            position=np.tile(self._robot.home_position, (size, 1)),
            rotation=np.tile(self._robot.home_rotation, (size, 1, 1)),
            twist=np.zeros((size, 6)),
        )
        none = np.zeros(size, dtype=np.int64)
        record = SimulationRecord(
            converged=valid, updates=1, failures=none + ~valid, restarts=none
        )  # fmt: skip
        return self._belief(start, measurement, record, self._simulator.state.numpy())

    def reset_moving(self, measurement: Measurement, first: Belief) -> Belief:
        """Start on the first lengths from a pose and a twist.

        The pose is moved to where straight cables are as long as at the equilibrium of the lengths:
        a measured one that is off by millimetres would stretch them. A world that cannot rest on
        its lengths starts as `reset` says.

        Args:
            measurement: The first one.
            first: Pose and twist at its time, one for each robot.
        """
        belief = self.reset(measurement)
        record, simulator = self._last(belief), self._simulator
        assert simulator is not None and first.twist is not None
        rows = np.flatnonzero(record.converged)
        straight = straight_length(self._robot, belief.position, belief.rotation).length
        if not len(rows):
            return belief
        position, rotation = poses_on_lengths(
            self._robot, first.position[rows], first.rotation[rows], straight[rows]
        )
        lengths = measurement.unstrained_length[rows]
        simulator.reset(
            position, rotation, unstrained_length=lengths, twist=first.twist[rows], worlds=rows
        )
        return self._belief(belief, measurement, record, simulator.state.numpy())

    def update(self, belief: Belief, command: Command, measurement: Measurement) -> Belief:
        """Simulate to the time of a measurement; the command is not used.

        Raises:
            CarosacError: The belief is not the last one of this estimator.
            InvalidField: Another number of robots or cables than at the reset, or a measurement
                that is not later than the last one by the same time for all robots.
        """
        record, simulator = self._last(belief), self._simulator
        assert simulator is not None
        lengths = measurement.lengths_of(simulator.size, self._robot.n)
        step = self._step(measurement)
        pieces = self._delayed.advance(step, lengths)
        lost = self._lost
        if step > self._settings.gap_max:
            lost = np.ones_like(lost)
        else:
            for duration, reached in pieces:
                simulator.follow(reached, duration)
        state = simulator.state.numpy()
        valid = ~(lost | state.failed)
        restarted = np.zeros_like(valid)
        if not valid.all():
            restarted = self._start_at_rest(~valid, pieces[-1][1])
        if step > self._settings.gap_max:
            valid, state = restarted, simulator.state.numpy()
        self._time = measurement.time
        record = replace(
            record,
            converged=valid,
            updates=record.updates + 1,
            failures=record.failures + ~valid,
            restarts=record.restarts + restarted,
        )
        return self._belief(belief, measurement, record, state)

    def _last(self, belief: Belief) -> SimulationRecord:
        """Return the memory of the last belief; refuse any other belief."""
        if self._record is None or belief.memory is not self._record:
            last = "none yet" if self._record is None else f"that at {self._time[0]} s"
            raise CarosacError(
                f"simulator: update() of a belief at {belief.time[0]} s that is not the last one, "
                f"{last}: only that one can be updated; call reset() to start again"
            )
        return self._record

    def _step(self, measurement: Measurement) -> float:
        """Return the time since the last measurement [s], one for all worlds."""
        step = measurement.time - self._time
        if not (step > 0.0).all():
            late = f"{measurement.time.min()} s after {self._time.max()} s"
            raise InvalidField("measurement.time", late, "later than the last one")
        if np.ptp(step) > STEP_DIFFERENCE_MAX_S:
            raise InvalidField("measurement.time", f"steps of {step} s", "the same for all robots")
        return float(step[0])

    def _start_at_rest(self, which: NDArray[np.bool_], lengths: Array) -> NDArray[np.bool_]:
        """Start worlds at rest on lengths (B, n) [m]; return a mask of those that succeeded."""
        assert self._simulator is not None
        done = np.zeros_like(which)
        rows = np.flatnonzero(which)
        # A reset fails for all worlds if it fails for one: then they are reset one by one.
        for group in (rows, *(rows[k : k + 1] for k in range(len(rows)))):
            if done[rows].all():
                break
            try:
                self._simulator.reset(unstrained_length=lengths[group], worlds=group)
            except InvalidField:
                continue
            done[group] = True
        self._lost = (self._lost | which) & ~done
        return done

    def _belief(
        self,
        before: Belief,
        measurement: Measurement,
        record: SimulationRecord,
        state: SimulatorState,
    ) -> Belief:
        """Return the belief of a state; where that is invalid, the one before."""
        valid = record.converged
        tension: Array | None = state.tension
        twist = state.twist
        if not valid.all():
            old = before.tension
            tension = None if old is None else np.where(valid[:, None], state.tension, old)
            assert before.twist is not None
            twist = np.where(valid[:, None], state.twist, before.twist)
        self._record = record
        return Belief(
            time=measurement.time,
            position=np.where(valid[:, None], state.position, before.position),
            rotation=np.where(valid[:, None, None], state.rotation, before.rotation),
            twist=twist,
            tension=tension,
            converged=valid,
            memory=record,
        )
