"""The program of the PLC: states, requests, watchdog, faults; one call for each PLC cycle."""

from __future__ import annotations

import secrets
from dataclasses import dataclass
from typing import Any

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.loop.drive_state import DriveState, Fault, fault_of
from carosac_toolkit.plc.blocks import BLOCK_LAYOUT, Answer, DriveStatus, Request
from carosac_toolkit.plc.emulator.command_checks import CommandChecks, Counters
from carosac_toolkit.plc.emulator.playback import Playback
from carosac_toolkit.plc.emulator.winches import Winches, WinchLimits
from carosac_toolkit.plc.settings import COMMAND_PERIOD_MAX_S

_DRIVES_ON = (DriveState.ENABLED, DriveState.FOLLOWING, DriveState.STOPPING)
SESSIONS_REMEMBERED_MAX = 32  # by their newest request
FOLLOW_TIME_PERIODS = 2.0  # time constant with which a winch returns to the commanded motion
ENCODER_JUMP_RATIO = 3.0  # over the speed limit; no winch moves that fast


@dataclass(frozen=True, kw_only=True, eq=False)
class Inputs:
    """Signals of the machine in one cycle.

    Attributes:
        length: Positions [unit], shape (n,).
        rate: [unit/s], shape (n,).
        tension: At the platform [N], shape (n,), or None.
    """

    length: Array
    rate: Array
    tension: Array | None = None


@dataclass
class Wires:
    """Inputs wired to the PLC, and injected faults.

    Attributes:
        tripped: Whether the protection of each drive has opened, shape (n,).
        estop: Whether the emergency-stop circuit is open.
        freeze_counter: Whether the heartbeat stands still.
        freeze_data: Whether all data but the heartbeat stand still.
    """

    tripped: Array
    estop: bool = False
    freeze_counter: bool = False
    freeze_data: bool = False


@dataclass
class _Host:
    """Session that the PLC obeys."""

    session: int = 0
    number: int = 0  # public; the session is secret
    sequence: int = 0
    silent: float = 0.0  # [s] without a heartbeat
    starved: float = 0.0  # [s] since its commands ran out
    command: int | None = None
    playback: Playback | None = None
    period: float = 0.0


class Machine:
    """Program of a PLC that moves n winches for one host.

    Attributes:
        state: Present state.
        fault: Latched fault.
        fault_axis: Cable of the fault from 1, or 0.
        winches: Set point generators.
        boot: Number drawn at each start of the program, by which a host notices the start.
        counters: Counts of what came from hosts, and of positions beyond the ends.
        wires: Inputs and injected faults.
        reference: Shift of the set positions that makes them agree with the encoders [unit],
            shape (n,); the machine follows ``winches.position - reference``.
    """

    def __init__(
        self, limits: WinchLimits, *, cycle: float, watchdog: float, identity: int,
        period_max: float = COMMAND_PERIOD_MAX_S, encoder_check: bool = True,
    ) -> None:  # fmt: skip
        """Start with the drives off, obeying nobody.

        Args:
            limits: Limits of the winches.
            cycle: Period of the PLC [s].
            watchdog: Silence of the host after which the winches ramp to rest [s].
            identity: Hash of the robot; a host that has another one is not enabled.
            period_max: Longest period of the commands [s]; the shortest is `cycle`.
            encoder_check: Whether a position that jumps is a fault.
        """
        n = len(limits.speed)
        self.state, self.fault, self.fault_axis = DriveState.CONNECTED, Fault.NONE, 0
        self.winches = Winches(limits, cycle)
        self.boot = secrets.randbelow(2**32 - 1) + 1
        self.counters = Counters()
        self.wires = Wires(np.zeros(n, dtype=bool))
        self.reference = np.zeros(n)
        self._ticks = 0
        self._checks = CommandChecks(limits, self.counters, period_min=cycle, period_max=period_max)
        self._limits, self._cycle, self._watchdog = limits, cycle, watchdog
        self._encoder_check, self._identity = encoder_check, identity
        self._host = _Host()
        self._foreign = (0, 0)
        self._answer = (0, Answer.NONE)
        self._numbers: dict[int, int] = {}  # newest request of each session
        self._disable = False
        self._beats = 0
        self._length: Array | None = None
        self._frozen: dict[str, Any] | None = None

    @property
    def time(self) -> float:
        """Clock of the PLC [s]: its cycles."""
        return self._ticks * self._cycle

    @property
    def owner(self) -> int:
        """Public number of the host that the PLC obeys; 0: nobody."""
        return self._host.number

    def cycle(self, host: dict[str, Any] | None, inputs: Inputs) -> None:
        """Run one cycle: listen, check, move the set points.

        Args:
            host: Members of `blocks.from_host` by name, or None if the block is not valid.
            inputs: Signals of the machine.
        """
        self._ticks += 1
        self._inputs = inputs
        self._beats += not self.wires.freeze_counter
        if host is not None:
            self._listen(host)
        self._watch()
        self._protect(inputs)
        self._move()
        self.counters.beyond_ends += self.winches.beyond_ends
        self._length = inputs.length

    def output(self, inputs: Inputs) -> dict[str, Any]:
        """Return the members of `blocks.to_host` by name."""
        heartbeat = {"sequence": self._beats, "sequence_end": self._beats}
        if self.wires.freeze_data and self._frozen is not None:
            return self._frozen | heartbeat
        tension = inputs.tension
        values = heartbeat | {
            "layout": BLOCK_LAYOUT, "cables": len(inputs.length), "echo": self._host.sequence,
            "owner": self.owner, "state": self.state.number, "fault": self.fault.number,
            "fault_axis": self.fault_axis, "answered": self._answer[0], "answer": self._answer[1],
            "command_echo": self._host.command or 0, "has_tension": tension is not None,
            "time": self.time, "length": inputs.length, "rate": inputs.rate,
            "tension": 0.0 if tension is None else tension, "drive_status": self._drives(),
            "set_length": self.winches.position, "boot": self.boot,
        }  # fmt: skip
        self._frozen = values
        return values

    def place(self, length: Array) -> None:
        """Give the positions where the winches stand new numbers; nothing moves."""
        self.reference = self.reference + (length - self.winches.position)
        self.winches.place(length)
        self._length = None

    def stop(self, fault: Fault, axis: int = 0) -> None:
        """Latch a fault unless one is latched already, and ramp to rest."""
        if self.fault is Fault.NONE:
            self.fault, self.fault_axis = fault, axis
        if self.state is not DriveState.ESTOP:
            self.state = DriveState.FAULT
        self._host.playback = None

    def held_up(self, duration: float) -> None:
        """Take note that this program could not run for a time [s], and not watch the host."""
        if duration >= self._watchdog:
            self._lose_host()

    def _listen(self, host: dict[str, Any]) -> None:
        """Take over new data of a host, if it is the one that counts."""
        if host["sequence"] != host["sequence_end"]:
            self.counters.torn += 1
            return
        session = host["session"]
        if session == 0 or host["host_number"] == 0:
            return
        mine = session == self._host.session
        if mine and host["sequence"] != self._host.sequence:
            self._host.sequence, self._host.silent = host["sequence"], 0.0
        if not mine and self._host.session and (session, host["sequence"]) != self._foreign:
            self._foreign = (session, host["sequence"])
            self.counters.foreign += 1
        if host["request"] and host["request_number"] != self._numbers.get(session, 0):
            self._numbers.pop(session, None)
            self._numbers[session] = host["request_number"]
            if len(self._numbers) > SESSIONS_REMEMBERED_MAX:
                del self._numbers[next(iter(self._numbers))]
            self._answer = (host["request_number"], self._request(host, mine))
        if session == self._host.session:
            self._command(host)

    def _request(self, host: dict[str, Any], mine: bool) -> Answer:
        """Carry out one request."""
        request = host["request"]
        if self._host.session and not mine:
            return Answer.NOT_OWNER
        if request == Request.ENABLE:
            return self._enable(host)
        if request == Request.RESET:
            return self._reset()
        if request in (Request.STOP, Request.DISABLE, Request.HOLD):
            if not mine and request != Request.HOLD:
                return Answer.NOT_OWNER
            if request == Request.HOLD:
                held = fault_of(host["fault"])
                self.stop(Fault.UNKNOWN if held is Fault.NONE else held)
            self._disable = self._disable or request != Request.STOP
            if self.state in (DriveState.ENABLED, DriveState.FOLLOWING):
                self.state = DriveState.STOPPING
            elif request != Request.STOP and self.winches.at_rest:
                self._release()
            self._host.playback = None
            return Answer.DONE
        return Answer.UNKNOWN

    def _enable(self, host: dict[str, Any]) -> Answer:
        if host["machine"] != self._identity:
            return Answer.ANOTHER_ROBOT
        if self.state not in (DriveState.CONNECTED, DriveState.ENABLED):
            return Answer.WRONG_STATE
        self._host = _Host(
            host["session"], host["host_number"], host["sequence"], command=host["command"]
        )
        self.place(self._inputs.length)
        self._checks.reset(self.winches.position, host["command"], self.time)
        self._disable = False
        self.state = DriveState.ENABLED
        return Answer.DONE

    def _reset(self) -> Answer:
        if self.state is DriveState.CONNECTED:
            return Answer.DONE
        if self.state not in (DriveState.FAULT, DriveState.ESTOP) or not self.winches.at_rest:
            return Answer.WRONG_STATE
        if self.wires.tripped.any() or self.wires.estop:
            return Answer.CAUSE_REMAINS
        self.state, self.fault, self.fault_axis = DriveState.CONNECTED, Fault.NONE, 0
        self._release()
        return Answer.DONE

    def _command(self, host: dict[str, Any]) -> None:
        """Take over a new command."""
        own = self._host
        if not host["follow"] or host["command"] == own.command:
            return
        own.command = host["command"]
        if self.state not in (DriveState.ENABLED, DriveState.FOLLOWING):
            self.counters.ignored += 1
            return
        playback = own.playback
        standing = playback is None or (playback.ended and self.winches.at_rest)
        fault = self._checks.check(host, self.winches.position, now=self.time, standing=standing)
        if fault is not Fault.NONE:
            self.stop(fault)
            return
        if own.playback is None:
            own.playback = Playback(self.winches.position)
        own.playback.add(host["length"], self._checks.gap, host["period"])
        own.period = host["period"]
        self.state = DriveState.FOLLOWING

    def _watch(self) -> None:
        """Ramp to rest if the host or its commands are silent; then obey nobody."""
        own = self._host
        if not own.session:
            return
        own.silent += self._cycle
        starves = own.playback is not None and own.playback.ended
        own.starved = own.starved + self._cycle if starves else 0.0
        if max(own.silent, own.starved) < self._watchdog:
            return
        if self.state not in _DRIVES_ON and self.winches.at_rest:
            self._release()
        self._lose_host()

    def _lose_host(self) -> None:
        """Latch that the host is not there, if it could move winches."""
        if self.state in _DRIVES_ON:
            self.counters.watchdog += 1
            self.stop(Fault.HEARTBEAT_LOST)

    def _release(self) -> None:
        """Obey nobody."""
        self._host = _Host()

    def _protect(self, inputs: Inputs) -> None:
        """Latch faults of the machine itself."""
        if self.wires.estop and self.state is not DriveState.ESTOP:
            self.state = DriveState.ESTOP
            self._host.playback = None
        tripped = np.flatnonzero(self.wires.tripped)
        if len(tripped):
            self.stop(Fault.DRIVE_TRIP, int(tripped[0]) + 1)
        if self._length is not None and self._encoder_check:
            jumped = (
                np.abs(inputs.length - self._length)
                > ENCODER_JUMP_RATIO * self._limits.speed * self._cycle
            )
            if jumped.any():
                self.stop(Fault.ENCODER_JUMP, int(np.argmax(jumped)) + 1)
        if self.state in _DRIVES_ON:
            behind = np.abs(inputs.length - self.winches.position) > self._limits.following
            if behind.any():
                self.stop(Fault.FOLLOWING_ERROR, int(np.argmax(behind)) + 1)

    def _move(self) -> None:
        """Advance the set points."""
        own = self._host
        if own.playback is not None and not own.playback.ended:
            goal, rate = own.playback.advance(self._cycle)
            self.winches.follow(goal, rate, FOLLOW_TIME_PERIODS * own.period)
            return
        braked = np.ones_like(self.wires.tripped) if self.state is DriveState.ESTOP else (
            self.wires.tripped
        )  # fmt: skip
        self.winches.ramp(braked)
        if self.state in (DriveState.STOPPING, DriveState.FAULT) and self.winches.at_rest:
            if self.state is DriveState.STOPPING:
                self.state = DriveState.CONNECTED if self._disable else DriveState.ENABLED
            if self._disable:
                self._release()
            self._disable = False

    def _drives(self) -> Array:
        """Return the status of each drive, as `DriveStatus`."""
        on = self.state in _DRIVES_ON or (
            self.state is DriveState.FAULT and not self.winches.at_rest
        )
        moving = np.where(self.winches.speed != 0.0, DriveStatus.MOVING, DriveStatus.HOLDING)
        status = np.where(on, moving, DriveStatus.OFF)
        return np.where(self.wires.tripped, DriveStatus.TRIPPED, status).astype(np.uint64)
