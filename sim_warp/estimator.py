"""The estimator `simulator`: the motion that the measured lengths cause, by simulation alone."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import CarosacError, InvalidField
from carosac_toolkit.base.numbers import check_not_negative, check_positive
from carosac_toolkit.loop.values import Belief, Command, Measurement
from carosac_toolkit.robot.robot import Robot
from sim_warp.delayed_lengths import DelayedLengths
from sim_warp.options import CableOptions
from sim_warp.simulator import Simulator
from sim_warp.state import SimulatorState

SAME_STEP = 1e-9  # [s] by which the time steps of the worlds of one batch may differ


@dataclass(frozen=True, kw_only=True)
class SimulatorSettings(CableOptions):
    """Settings of `SimulatorEstimator`: those of the cables, and what concerns the clock.

    Without a `time_step` it is that of the cable model.

    Attributes:
        delay: By how much the lengths lead the poses [s]: the belief at a time is the pose that
            belongs to the lengths of that much earlier. 0: they are of the same time. None: what
            the robot says, `Robot.length_delay`.
        gap_max: Time between two measurements [s] beyond which nothing is known of the motion; the
            platform is then hung anew.
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
    """Memory of a belief that is simulated.

    Attributes:
        converged: Whether the last update gave the belief's pose, shape (B,). Where it is False,
            the pose is the last good one, or home if there was none yet.
        updates: Measurements since the last reset, the first one included.
        failures: Measurements among them without a pose, shape (B,).
        restarts: How often a world was hung anew on measured lengths, after a failure or a gap,
            shape (B,).
    """

    converged: NDArray[np.bool_]
    updates: int
    failures: NDArray[np.int64]
    restarts: NDArray[np.int64]


class SimulatorEstimator:
    """Open loop: cables wound as measured move the platform, from rest on the first lengths.

    Lengths go straight from one measurement to the next, past the winches; poses, commands and all
    other sensors are not used. Where a simulation fails, the belief keeps the last good pose,
    ``belief.memory``, a `SimulationRecord`, counts it, and the platform is hung anew.

    The simulation goes on from where it is, not from the belief it is given: each belief can be
    updated once, and `reset` starts anew.
    """

    Settings: ClassVar = SimulatorSettings

    def __init__(self, robot: Robot, settings: SimulatorSettings) -> None:
        self._robot = robot
        self._settings = settings
        known = robot.length_delay or 0.0
        self._delay = known if settings.delay is None else settings.delay
        check_not_negative("delay", self._delay, "s")
        self._simulator: Simulator | None = None
        self._record: SimulationRecord | None = None

    @classmethod
    def build(
        cls, robot: Robot, settings: SimulatorSettings | None = None, *, seed: int = 0
    ) -> SimulatorEstimator:
        """Make one for the nominal robot; it draws no random numbers, so `seed` has no effect."""
        return cls(robot, settings or SimulatorSettings())

    def reset(self, measurement: Measurement) -> Belief:
        """Hang the platforms at rest on the first lengths."""
        lengths = measurement.lengths_of(len(measurement.unstrained_length), self._robot.n)
        size = len(lengths)
        if self._simulator is None or self._simulator.size != size:
            options = self._settings.simulator_options
            self._simulator = Simulator(self._robot, worlds=size, **options)
        self._delayed = DelayedLengths(lengths, self._delay)
        self._time = measurement.time
        self._lost = np.zeros(size, dtype=np.bool_)  # worlds that stand nowhere sensible
        good = self._hang(np.ones(size, dtype=np.bool_), lengths)
        start = Belief(
            time=measurement.time,
            position=np.tile(self._robot.home_position, (size, 1)),
            rotation=np.tile(self._robot.home_rotation, (size, 1, 1)),
            twist=np.zeros((size, 6)),
        )
        none = np.zeros(size, dtype=np.int64)
        record = SimulationRecord(
            converged=good, updates=1, failures=none + ~good, restarts=none
        )  # fmt: skip
        return self._belief(start, measurement, record, self._simulator.state.numpy())

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
        good = ~(lost | state.failed)
        again = np.zeros_like(good)
        if not good.all():
            again = self._hang(~good, pieces[-1][1])
        if step > self._settings.gap_max:
            good, state = again, simulator.state.numpy()
        self._time = measurement.time
        record = replace(
            record,
            converged=good,
            updates=record.updates + 1,
            failures=record.failures + ~good,
            restarts=record.restarts + again,
        )
        return self._belief(belief, measurement, record, state)

    def _last(self, belief: Belief) -> SimulationRecord:
        """Memory of the last belief; refuse any other one."""
        if self._record is None or belief.memory is not self._record:
            mine = "none yet" if self._record is None else f"that at {self._time[0]} s"
            raise CarosacError(
                f"simulator: update() of a belief at {belief.time[0]} s that is not the last one, "
                f"{mine}: the simulation goes on from there alone; call reset() to start anew"
            )
        return self._record

    def _step(self, measurement: Measurement) -> float:
        """Time since the last measurement [s], one for all worlds."""
        step = measurement.time - self._time
        if not (step > 0.0).all():
            late = f"{measurement.time.min()} s after {self._time.max()} s"
            raise InvalidField("measurement.time", late, "later than the last one")
        if np.ptp(step) > SAME_STEP:
            allowed = "the same for all robots"
            raise InvalidField("measurement.time", f"steps of {step} s", allowed)
        return float(step[0])

    def _hang(self, which: NDArray[np.bool_], lengths: Array) -> NDArray[np.bool_]:
        """Hang worlds at rest on lengths (B, n); say where that worked, and remember where not."""
        assert self._simulator is not None
        done = np.zeros_like(which)
        rows = np.flatnonzero(which)
        # One world that cannot hang keeps the others from it, so they are then taken one by one.
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
        """The belief of a state; where it is no good, that of before."""
        good = record.converged
        tension: Array | None = state.tension
        twist = state.twist
        if not good.all():
            old = before.tension
            tension = None if old is None else np.where(good[:, None], state.tension, old)
            assert before.twist is not None
            twist = np.where(good[:, None], state.twist, before.twist)
        self._record = record
        return Belief(
            time=measurement.time,
            position=np.where(good[:, None], state.position, before.position),
            rotation=np.where(good[:, None, None], state.rotation, before.rotation),
            twist=twist,
            tension=tension,
            memory=record,
        )
