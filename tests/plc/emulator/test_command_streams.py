"""Random streams of commands: whatever a host sends, the winches keep their limits."""

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from carosac_toolkit.loop.drive_state import DriveState
from carosac_toolkit.plc.blocks import Request
from tests.plc.emulator.test_machine import CYCLE, LIMITS, PERIOD, START, Rig

HOSTILE = (np.nan, np.inf, -np.inf, 0.0, -1.0, 1e-300, 1e-6, 0.005, 0.02, 0.1, 10.0, 1e300)
NEVER = 10**9  # cycles

honest = st.tuples(
    st.sampled_from(["move"]),
    st.lists(st.floats(-1.0, 1.0), min_size=4, max_size=4),  # acceleration over its limit
    st.one_of(st.just(2), st.integers(0, 30)),  # cycles until it arrives: jitter, bursts, pauses
    st.one_of(st.just(1), st.integers(1, 6)),  # periods since the last one that arrives
)
hostile = st.one_of(
    st.tuples(st.sampled_from(["period", "rate", "length"]), st.sampled_from(HOSTILE)),
    st.tuples(st.just("number"), st.integers(0, 2**32 - 1)),
    st.tuples(st.just("step"), st.floats(-2.0, 2.0)),
    st.tuples(st.just("request"), st.sampled_from([Request.STOP, Request.DISABLE, Request.HOLD])),
)
streams = st.tuples(
    st.lists(st.one_of(honest, honest, honest, hostile), min_size=5, max_size=60),
    st.sampled_from(["silence", "heartbeat"]),
    st.floats(-0.5, 2.5),  # speed with which the stream begins [m/s]
)


class Stream(Rig):
    """A host whose commands keep the limits until an event changes one."""

    def begin(self, speed):
        """Speed up in proportion, as far as the sign of `speed` says."""
        self.ask(Request.ENABLE)
        self.speed = np.zeros(4)
        self.send(START)
        share = np.array([1.0, -0.7, 0.3, 0.0])
        for now in np.arange(0.0, abs(speed), 0.045):
            self.speed = np.sign(speed) * now * share
            self.send(self.host["length"] + self.speed * PERIOD)

    def play(self, event):
        kind, value = event[:2]
        if kind == "move":
            self._move(*event[1:])
            return
        if kind == "request":
            self.ask(value)
            return
        changes = {
            "period": {"period": value}, "number": {"command": value},
            "rate": {"rate": np.array([value, 0, 0, 0])},
            "length": {"length": np.array([*START[:3], value])},
            "step": {"length": self.host["length"] + np.array([0, value, 0, 0])},
        }  # fmt: skip
        self.send(self.host["length"], cycles=0)
        self.host = self.host | changes[kind]
        self.cycles(2)

    def _move(self, share, cycles, periods):
        change = np.array(share) * LIMITS.acceleration * PERIOD
        self.speed = np.clip(self.speed + change, -LIMITS.speed, LIMITS.speed)
        length = self.host["length"] + self.speed * PERIOD * periods
        length = np.clip(length, LIMITS.length_min, LIMITS.length_max)
        self.host = self.host | {"command": (self.host["command"] + periods - 1) % 2**32}
        self.send(length, cycles=cycles)


@pytest.mark.parametrize("seed", range(3))
def test_a_stream_with_jitter_within_the_limits_is_followed(seed):
    rng = np.random.default_rng(seed)
    stream = Stream()
    stream.begin(1.0)
    for _ in range(40):
        stream.play(("move", rng.uniform(-0.5, 0.5, 4), int(rng.integers(1, 4)), 1))
    assert stream.machine.state is DriveState.FOLLOWING
    assert np.abs(stream.machine.winches.speed).max() > 0.3


@settings(max_examples=80, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(streams)
def test_no_stream_of_commands_moves_a_winch_beyond_its_limits_or_back_after_a_stop(drawn):
    events, end, speed = drawn
    stream = Stream()
    stream.begin(speed)
    speeds, stopped = [], NEVER
    winches, cycles = stream.machine.winches, stream.cycles

    def watched(count=1, *, beat=True):
        nonlocal stopped
        for _ in range(count):
            cycles(beat=beat)
            speeds.append(winches.speed.copy())
            ramps = stream.machine.state in (DriveState.FAULT, DriveState.STOPPING)
            stopped = min(stopped, len(speeds) - 1) if ramps else NEVER

    stream.cycles = watched
    for event in events:
        stream.play(event)
    stream.host = stream.host | {"follow": 0}
    watched(round(0.08 / CYCLE), beat=end == "heartbeat")  # 3.25 periods, and a late clock
    last = len(speeds) - 1
    watched(200, beat=end == "heartbeat")
    assert winches.at_rest
    assert stream.machine.state is not DriveState.FOLLOWING

    positions = np.array(stream.positions)
    set_speed = np.diff(positions, axis=0) / CYCLE
    assert (np.abs(set_speed) <= LIMITS.speed + 1e-9).all()
    assert (np.abs(np.diff(set_speed, axis=0)) <= LIMITS.acceleration * CYCLE + 1e-9).all()
    assert (positions >= LIMITS.length_min - 1e-4).all()
    assert (positions <= LIMITS.length_max + 1e-4).all()
    assert (winches.speed_peak >= np.abs(set_speed).max(axis=0) - 1e-9).all()
    slowing = np.array(speeds[min(stopped, last) :])
    begun = slowing[0]
    factor = np.abs(slowing).max(axis=1) / max(np.abs(begun).max(), 1e-12)
    assert (slowing * np.sign(begun) >= -1e-9).all()
    assert (np.abs(slowing) <= factor[:, None] * np.abs(begun) + 1e-9).all()
