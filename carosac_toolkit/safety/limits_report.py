"""Report of the limits that changed a command: value asked for and value sent."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.loop.values import LimitHit
from carosac_toolkit.physics.motion.braking import Brakes, Extremes, WinchMotion, box_slack
from carosac_toolkit.robot.robot import Robot


class _Check(NamedTuple):
    """One limit: where it was in the way, and the values asked and sent; all of shape (B, n)."""

    limit: str
    broken: NDArray[np.bool_]
    asked: Array
    sent: Array


def limit_hits(
    robot: Robot, jerk_max: float, jump_max: float, period: float, brakes: Brakes,
    before: WinchMotion,
    asked_length: Array, sent: WinchMotion, measured: Array | None,
) -> list[LimitHit]:  # fmt: skip
    """List every limit that changed the command, row by row, cable by cable.

    Args:
        robot: Robot description, n cables.
        jerk_max: [m/s^3].
        jump_max: Largest distance from the measured length [m].
        period: Time between two commands [s].
        brakes: Looks ahead.
        before: The motion before the step.
        asked_length: Lengths asked for [m], shape (B, n).
        sent: The motion that was sent.
        measured: Measured lengths [m], shape (B, n), or None.

    Returns:
        The hits; rows that were not changed have none but of the jump limit.
    """
    with np.errstate(over="ignore", invalid="ignore"):  # asked may be anything finite
        asked = _motion_to(asked_length, before, period)
        ahead, behind = brakes.look_ahead(asked), brakes.look_ahead(sent)
        changed = sent.length != asked_length
        rows = changed.any(axis=1)
        checks = [
            _length_check(robot, brakes, asked, sent, ahead, behind),
            _Check(
                "speed", ahead.speed > robot.speed_max + brakes.slack.speed,
                _signed(asked.speed, ahead.speed), _signed(sent.speed, behind.speed),
            ),
            _Check(
                "acceleration",
                ~(np.abs(asked.acceleration) <= robot.acceleration_max + brakes.slack.acceleration),
                asked.acceleration, sent.acceleration,
            ),
            _jerk_check(jerk_max, period, brakes, before, asked, sent),
        ]  # fmt: skip
        checks = [c._replace(broken=c.broken & rows[:, None]) for c in checks]
        if measured is not None:
            far, kept = np.abs(asked_length - measured), np.abs(sent.length - measured)
            checks.append(_Check("jump", (far > jump_max) | (kept > jump_max), far, kept))
    alone = changed & ~np.any([c.broken for c in checks], axis=0)
    checks.append(_Check("coordination", alone, asked_length, sent.length))
    outside = rows & (ahead.outside > box_slack(robot))
    return _listed(checks, outside, ahead.outside, behind.outside)


def rate_hits(asked: Array | None, sent: Array) -> list[LimitHit]:
    """List every rate that was changed, row by row [m/s]."""
    if asked is None:
        return []
    return [
        _hit("length_rate", b, int(i), asked[b, i], sent[b, i])
        for b, i in np.argwhere(asked != sent)
    ]


def _hit(limit: str, row: int, cable: int | None, asked: float, sent: float) -> LimitHit:
    """Return a limit hit of plain numbers."""
    return LimitHit(limit=limit, cable=cable, asked=float(asked), sent=float(sent), row=int(row))


def _motion_to(length: Array, before: WinchMotion, period: float) -> WinchMotion:
    """Return the motion of a step to a length."""
    speed = (length - before.length) / period
    return WinchMotion(length, speed, (speed - before.speed) / period, before.position)


def _signed(speed: Array, peak: Array) -> Array:
    """Return the speed, or the peak to come where that is larger."""
    return np.where(peak > np.abs(speed), peak, speed)


def _length_check(
    robot: Robot,
    brakes: Brakes,
    asked: WinchMotion,
    sent: WinchMotion,
    ahead: Extremes,
    behind: Extremes,
) -> _Check:
    """Compare lengths with their limits; where only the stop would exceed one, by its extremes."""
    long = ahead.high > robot.length_max + brakes.slack.length
    short = ahead.low < robot.length_min - brakes.slack.length
    past = (asked.length > robot.length_max) | (asked.length < robot.length_min)
    return _Check(
        "length",
        long | short,
        np.where(past, asked.length, np.where(long, ahead.high, ahead.low)),
        np.where(past, sent.length, np.where(long, behind.high, behind.low)),
    )


def _jerk_check(
    jerk_max: float,
    period: float,
    brakes: Brakes,
    before: WinchMotion,
    asked: WinchMotion,
    sent: WinchMotion,
) -> _Check:
    """Compare the jerks of the step with their limit; the stop that follows never exceeds it."""
    wanted = (asked.acceleration - before.acceleration) / period
    done = (sent.acceleration - before.acceleration) / period
    return _Check("jerk", ~(np.abs(wanted) <= jerk_max + brakes.slack.jerk), wanted, done)


def _listed(
    checks: list[_Check], outside: NDArray[np.bool_], box_asked: Array, box_sent: Array
) -> list[LimitHit]:
    """List the hits in order of rows, within a row of cables, the box last."""
    entries: list[tuple[int, int, LimitHit]] = []
    n = checks[0].broken.shape[1]
    for check in checks:
        for b, i in np.argwhere(check.broken):
            hit = _hit(check.limit, b, int(i), check.asked[b, i], check.sent[b, i])
            entries.append((int(b), int(i), hit))
    for b in np.flatnonzero(outside):
        entries.append((int(b), n, _hit("box", int(b), None, box_asked[b], box_sent[b])))
    return [hit for _, _, hit in sorted(entries, key=lambda entry: entry[:2])]
