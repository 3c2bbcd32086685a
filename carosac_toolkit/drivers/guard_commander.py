"""What a guard sends: limited commands, the stop along the path, and what a dry run would send."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.drivers.guard_settings import GuardSettings
from carosac_toolkit.loop.values import Command, LimitHit
from carosac_toolkit.physics.motion.braking import WinchMotion
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.safety.limiter import Limiter
from carosac_toolkit.safety.stop import CoordinatedStop

MEMORY = 0.1  # time constant of the mean acceleration that a stop goes on with [s]


class Commander:
    """Sends to one robot of n cables, one command a period.

    Attributes:
        offset: What homing adds to readings and takes from commands [m], shape (n,).
        sent: Whether this period has its command.
    """

    def __init__(
        self, robot: Robot, settings: GuardSettings, send: Callable[[Command], Command]
    ) -> None:
        """Set up; `send` hands a command to the driver and returns what it sent."""
        slowed = settings.slowed(robot)
        self._limiter = Limiter(slowed, settings.limits, period=settings.period)
        self._share = min(1.0, settings.period / MEMORY)
        self._hand_over = send
        self._bend = np.zeros(robot.n)
        self._stop: CoordinatedStop | None = None
        self._dry = False
        self.offset = np.zeros(robot.n)
        self.sent = False

    @property
    def motion(self) -> WinchMotion:
        """What was last sent, without the offsets of homing."""
        return self._limiter.motion

    @property
    def at_rest(self) -> bool:
        """Whether what was last sent does not move."""
        return self._limiter.stopped

    @property
    def slowing(self) -> bool:
        """Whether what was last sent belongs to a stop."""
        return self._stop is not None

    @property
    def dry(self) -> bool:
        """Whether a dry run has begun."""
        return self._dry

    def start(self, standing: Array) -> None:
        """Begin at rest where the winches stand [m], shape (n,).

        Raises:
            InvalidField: That is outside the limits.
        """
        self._limiter.reset(standing[None])
        self._bend = np.zeros(len(standing))
        self._stop, self._dry = None, False

    def follow(self, command: Command, actual: Array) -> Command:
        """Send a command within the limits; `actual` are the measured lengths [m], (1, n)."""
        self._stop = None
        sent = self._limiter.apply(command, actual)
        acceleration = self._limiter.motion.acceleration[0]
        self._bend = self._bend + self._share * (acceleration - self._bend)
        return self._send(sent)

    def brake(self, time: Array, asked: Command | None, why: str) -> Command:
        """Send the next command of the stop along the path, unless this period has its command.

        Args:
            time: Of the command [s], shape (1,).
            asked: What a controller asked for instead; it is named as changed by the limit `why`.
            why: Name of the limit.
        """
        if self.sent:
            return Command(time=time, unstrained_length=self._limiter.motion.length)
        if self._stop is None:
            self._stop = CoordinatedStop(self._limiter, self._bend)
        sent = self._stop.step(time)
        if asked is not None:
            hits = changed(why, asked, sent.unstrained_length)
            sent = replace(sent, limited=(*sent.limited, *hits))
        return self._send(sent)

    def would_send(self, command: Command, held: Array) -> Command:
        """What the limits would leave of a command, from where the winches stand at first.

        Raises:
            InvalidField: The winches stand outside the limits.
        """
        if not self._dry:
            self._limiter.reset(held)
        self._dry = True
        return self._limiter.apply(command)

    def _send(self, command: Command) -> Command:
        """Hand over, in the lengths of the driver."""
        self.sent = True
        if not self.offset.any():
            return self._hand_over(command)
        lengths = command.unstrained_length - self.offset
        sent = self._hand_over(replace(command, unstrained_length=lengths))
        return replace(sent, unstrained_length=sent.unstrained_length + self.offset)


def changed(limit: str, asked: Command, sent: Array) -> list[LimitHit]:
    """A hit for every cable that was not sent what was asked."""
    pairs = zip(asked.unstrained_length[0], sent[0], strict=True)
    return [
        LimitHit(limit=limit, cable=i, asked=float(a), sent=float(s))
        for i, (a, s) in enumerate(pairs)
        if a != s
    ]
