"""Commands of a guard: limited, of a stop along the path, and those that a dry run would send."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.scaled import Scaled
from carosac_toolkit.loop.values import Command, LimitHit
from carosac_toolkit.physics.motion.braking import WinchMotion
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.safety.guard.monitor import Monitor
from carosac_toolkit.safety.limiter import Limiter
from carosac_toolkit.safety.stop import CoordinatedStop

ACCELERATION_MEAN_TIME = Scaled(0.1, "s")  # time constant of the mean that a stop goes on with


class Commander:
    """Sender to one robot of n cables, one command a period.

    Attributes:
        dry: Whether a dry run has begun.
    """

    def __init__(self, monitor: Monitor) -> None:
        """Send through a monitor, within the limits of its robot and settings."""
        robot, settings = monitor.robot, monitor.settings
        slowed = settings.slowed(robot)
        self._limiter = Limiter(slowed, settings.limits, period=settings.period)
        mean_time = ACCELERATION_MEAN_TIME.of(Scales(robot).ratios)
        self._share = min(1.0, settings.period / mean_time)
        self._monitor = monitor
        self._bend = np.zeros(robot.n)
        self._stop: CoordinatedStop | None = None
        self.dry = False

    @property
    def motion(self) -> WinchMotion:
        """Motion that was last sent, in lengths with the offsets of homing."""
        return self._limiter.motion

    @property
    def at_rest(self) -> bool:
        """True where the last command does not move."""
        return self._limiter.stopped

    @property
    def slowing(self) -> bool:
        """True where the last command belongs to a stop."""
        return self._stop is not None

    def start(self, standing: Array) -> None:
        """Begin at rest where the winches stand [m], shape (n,).

        Raises:
            InvalidField: That is outside the limits.
        """
        self._limiter.reset(standing[None])
        self._bend = np.zeros(len(standing))
        self._stop, self.dry = None, False

    def follow(self, command: Command, actual: Array) -> Command:
        """Send a command within the limits; `actual` are the measured lengths [m], (1, n)."""
        self._stop = None
        asked = self._slowed(command) if self._monitor.checks.first_way else command
        sent = self._limiter.apply(asked, actual)
        acceleration = self._limiter.motion.acceleration[0]
        self._bend = self._bend + self._share * (acceleration - self._bend)
        return self._monitor.send(sent, self.motion, command)

    def _slowed(self, command: Command) -> Command:
        """Return the command, or the part of its step that `GuardSettings.first_speed` allows."""
        settings, start = self._monitor.settings, self._limiter.motion.length
        step = command.unstrained_length - start
        share = settings.first_speed * settings.period / max(float(np.abs(step).max()), 1e-12)
        if share >= 1.0:
            return command
        length = start + share * step
        hits = (*command.limited, *changed("first_way", command, length))
        return Command(time=command.time, unstrained_length=length, limited=hits)

    def brake(self, time: Array, asked: Command | None, why: str) -> Command:
        """Send the next command of the stop along the path, unless this period has its command.

        Args:
            time: Time of the command [s], shape (1,).
            asked: Command of a controller instead; the limit `why` is named as having changed it.
            why: Name of the limit.
        """
        if self._monitor.sent:
            return Command(time=time, unstrained_length=self._limiter.motion.length)
        if self._stop is None:
            self._stop = CoordinatedStop(self._limiter, self._bend)
        sent = self._stop.step(time)
        if asked is not None:
            hits = changed(why, asked, sent.unstrained_length)
            sent = replace(sent, limited=(*sent.limited, *hits))
        return self._monitor.send(sent, self.motion, asked)

    def would_send(self, command: Command, held: Array) -> Command:
        """Return what the limits would leave of a command, at first from where the winches stand.

        Raises:
            InvalidField: The winches stand outside the limits.
        """
        if not self.dry:
            self._limiter.reset(held)
        self.dry = True
        return self._limiter.apply(command)


def changed(limit: str, asked: Command, sent: Array) -> list[LimitHit]:
    """Return a hit for every cable that was not sent what was asked."""
    pairs = zip(asked.unstrained_length[0], sent[0], strict=True)
    return [
        LimitHit(limit=limit, cable=i, asked=float(a), sent=float(s))
        for i, (a, s) in enumerate(pairs)
        if a != s
    ]
