"""Judges a fault from what was seen on the wire: how the winches came to rest, and what was kept.

Everything here works on the set points that the PLC showed and the commands that passed, never on a
counter of the PLC or of the driver. Lengths are in metres, pay-out positive, offsets left out.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import CarosacError

SPEED_TOLERANCE = 1.001  # share of a limit
ACCELERATION_TOLERANCE = 1.01
REVERSAL_MAX = 0.01  # [m/s] against the motion at the start of a stop
FACTOR_TOLERANCE = 0.02  # share of the largest speed by which winches leave the common ramp
REST_SPEED = 1e-4  # [m/s]
REST_DRIFT = 1e-4  # [m] that a set position moves after rest
STOP_ACCELERATION_SHARE = 0.4  # of the limit; paths here ask for 0.8 of 5 m/s^2
HIGH_SPEED_SHARE = 0.7  # of the largest speed after the fault; no winch turns back that fast
RECORDED_TOLERANCE = 1e-6  # [m]
FIRST_ROWS = 20  # among which the first command that passed is; a stall may skip some
TRIPPED = 3  # the brake of the drive stops it
DRIVES_ON = (1, 2, TRIPPED)  # drive holding, drive moving


@dataclass(frozen=True)
class Machine:
    """What a judge has to know of the robot.

    Attributes:
        scale: Metres of unstrained length per unit of the PLC, with sign, shape (4,).
        speed_max: [m/s], shape (4,).
        acceleration_max: [m/s^2], shape (4,).
    """

    scale: Array
    speed_max: Array
    acceleration_max: Array


@dataclass(frozen=True)
class SetPoints:
    """Set points of the PLC while no drive was off, once a cycle.

    Attributes:
        at: Time at which they were read, by the monotonic clock [s], shape (K,).
        time: By the clock of the PLC [s], shape (K,).
        length: [m], shape (K, 4).
        tripped: Whether the brake of a winch stops it, shape (K, 4).
    """

    at: Array
    time: Array
    length: Array
    tripped: Array

    @property
    def speed(self) -> Array:
        """Rate of the set points [m/s], shape (K - 1, 4), between one cycle seen and the next."""
        return np.diff(self.length, axis=0) / np.diff(self.time)[:, None]


def set_points(at: Array, cycles: Array, machine: Machine) -> SetPoints:
    """Return the set points of all cycles in which no drive was off.

    Args:
        at: When each was read [s], shape (K,).
        cycles: Structures of the PLC, shape (K,).
        machine: Scales.
    """
    on = np.isin(cycles["drive_status"], DRIVES_ON).all(axis=1)
    new = np.concatenate([[True], np.diff(cycles["time"]) > 0.0])
    at, cycles = at[on & new], cycles[on & new]
    length = cycles["set_length"] * machine.scale
    return SetPoints(at, cycles["time"], length, cycles["drive_status"] == TRIPPED)


def stop_range(points: SetPoints, fault_at: float, machine: Machine) -> tuple[int, int]:
    """Return the first and last interval of the stop; it ends with the data if there is no rest.

    After the fault, winches may brake and go on, as where the host was late. The stop is the last
    time that they begin to brake from high speed, harder than on any path here.
    """
    speed = points.speed
    fastest = np.abs(speed).max(axis=1)
    moving = np.flatnonzero(fastest > REST_SPEED)
    last = int(moving[-1]) if len(moving) else 0
    change = np.diff(speed, axis=0)
    hard = np.abs(change) / np.diff(points.time)[1:, None] > (
        STOP_ACCELERATION_SHARE * machine.acceleration_max
    )
    braking = hard.any(axis=1) & ((change * speed[:-1]).sum(axis=1) < 0.0)
    onsets = np.flatnonzero(braking & ~np.append(False, braking[:-1]) & (points.at[2:] > fault_at))
    after = np.flatnonzero(points.at[1:] > fault_at)
    if not len(after) or after[0] > last:
        raise CarosacError("judge: the winches had stopped before the fault")
    if not len(onsets) or onsets[0] > last:
        return int(after[0]), last  # so slow that they are at rest within a cycle or two
    high = fastest[onsets] >= HIGH_SPEED_SHARE * fastest[onsets[0] :].max()
    return int(onsets[high][-1]), last


def judge_limits(points: SetPoints, machine: Machine) -> list[str]:
    """Return each limit of a winch that its set points broke; a brake has no such limit."""
    speed, duration = points.speed, np.diff(points.time)
    next_to = duration < 1.5 * np.median(duration)  # no cycle was missed between them
    pair = next_to[1:] & next_to[:-1]
    middle = 0.5 * (duration[1:] + duration[:-1])[:, None]
    acceleration = np.abs(np.diff(speed, axis=0) / middle)
    acceleration = np.where(points.tripped[2:], 0.0, acceleration)[pair]
    shares = {
        "speed": (np.abs(speed) / machine.speed_max, SPEED_TOLERANCE),
        "acceleration": (acceleration / machine.acceleration_max, ACCELERATION_TOLERANCE),
    }
    return [
        f"{name} at {share.max():.2f} of its limit"
        for name, (share, allowed) in shares.items()
        if share.size and share.max() > allowed
    ]


@dataclass(frozen=True)
class Stop:
    """How the winches came to rest.

    Attributes:
        duration: From the first loss of speed to rest, by the clock of the PLC [s].
        rest_at: When they were seen at rest, by the monotonic clock [s].
        reversal: Largest speed against the motion at its start [m/s].
        spread: Largest distance of a winch from the common ramp, as a share of the largest speed.
        speed: Largest speed of a winch at its start [m/s].
    """

    duration: float
    rest_at: float
    reversal: float
    spread: float
    speed: float


def judge_stop(points: SetPoints, fault_at: float, machine: Machine) -> Stop:
    """Return how the winches stopped after a fault at this time of the monotonic clock [s]."""
    if len(points.at) < 2:
        raise CarosacError("judge: no set point was seen while the drives were on")
    first, last = stop_range(points, fault_at, machine)
    speed = points.speed[first : last + 1]
    start = speed[0]
    against = np.where(np.abs(start) > REST_SPEED, -np.sign(start) * speed, np.abs(speed))
    factor = speed @ start / max(float(start @ start), 1e-12)
    largest = float(np.abs(start).max())
    spread = np.abs(speed - factor[:, None] * start).max() / max(largest, 1e-6)
    return Stop(
        duration=float(points.time[last + 1] - points.time[first]),
        rest_at=float(points.at[min(last + 1, len(points.at) - 1)]),
        reversal=float(against.max(initial=0.0)),
        spread=float(spread),
        speed=largest,
    )


def commanded(commands: Array, machine: Machine) -> Array:
    """Return each commanded length that passed, once [m], shape (K, 4)."""
    followed = commands[commands["follow"] == 1]
    _, first = np.unique(followed["command"], return_index=True)
    return np.asarray(followed["length"][np.sort(first)] * machine.scale)


def unrecorded(lengths: Array, file: Path) -> int:
    """Return how many commanded lengths [m] are in no row of a recording.

    The recording has the offsets of homing in its lengths, the wire has not: they are the
    difference of the first command that passed and one of the first that were recorded.
    """
    rows = []
    for line in file.read_text().splitlines():
        try:
            row = json.loads(line)
        except json.JSONDecodeError:
            continue  # cut off by a kill
        if row.get("row") == "sent":
            rows.append(row["unstrained_length"])
    if not len(lengths):
        return 0
    if not rows:
        return len(lengths)
    kept = np.array(rows)
    tree = cKDTree(kept)
    missing = [
        int((tree.query(lengths + first - lengths[0], p=np.inf)[0] > RECORDED_TOLERANCE).sum())
        for first in kept[:FIRST_ROWS]
    ]
    return min(missing)
