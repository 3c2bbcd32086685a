r"""The coordinated stop: cables slow down along the path they are on, by one common factor.

With length :math:`L_0`, speed :math:`v_0` and acceleration :math:`a_0` of the last command, the
path ahead is taken as

.. math:: L(\sigma) = L_0 + v_0 \sigma + b\, g(\sigma, \tau) + (a_0 - b)\, g(\sigma, \epsilon),
          \quad g(\sigma, \tau) = \tau^2 (e^{-\sigma/\tau} - 1 + \sigma/\tau),

a curve in length space with the mean acceleration b of the last commands as its bend, which fades,
since nobody knows what the controller would have asked next; noise in the commands fades at once.
Without a stop :math:`\sigma` would be time; the stop takes :math:`\dot\sigma` from 1 to 0 as fast
as speed, acceleration and jerk of every cable allow. Length, speed and acceleration are continuous
where it begins, and cables in proportion stay so.

Each step goes through the `Limiter`, whose promise holds: where it changes one (near a length limit
or the box), or none is within the limits, the cables brake each on its own from there.
"""

from __future__ import annotations

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.scaled import Scaled
from carosac_toolkit.loop.values import Command
from carosac_toolkit.physics.motion.braking import Slack
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.safety.limiter import Limiter

BEND_FADE_TIME = Scaled(0.2, "s")  # tau, for how long the path keeps its bend
NOISE_FADE_TIME = Scaled(0.02, "s")  # epsilon, for how long it keeps what differs from that
RATE_CHANGE_CANDIDATES = 96
CREEP_FACTOR_MAX = 1e-3  # factor below which what is left of the stop is the winches' own


class CoordinatedStop:
    """Stop of one robot; call `step` once a period until `Limiter.stopped`.

    Attributes:
        coordinated: True if all steps up to now kept the cables on their common path.
    """

    def __init__(self, limiter: Limiter, bend: Array | None = None) -> None:
        """Begin where the limiter is now; nothing has been sent yet.

        Args:
            limiter: After `reset`, of a batch of one; only this object sends through it from now.
            bend: Mean acceleration of the last commands [m/s^2], shape (n,); None: that of the
                last one.
        """
        self._limiter = limiter
        limiter.begin_path()
        robot, jerk = limiter.robot, limiter.jerk_max
        slack = Slack.of(robot, jerk, limiter.period)
        self._most = (
            robot.speed_max + slack.speed,
            robot.acceleration_max + slack.acceleration,
            np.full(robot.n, jerk + slack.jerk),
        )
        ratios = Scales(robot).ratios
        self._fade_times = BEND_FADE_TIME.of(ratios), NOISE_FADE_TIME.of(ratios)
        start = limiter.motion
        self._start = tuple(x[0] for x in (start.length, start.speed, start.acceleration))
        self._bend = self._start[2] if bend is None else bend
        self._sigma, self._factor, self._change = 0.0, 1.0, 0.0
        self.coordinated = True
        self._alone = not start.speed.any()

    def step(self, time: Array) -> Command:
        """Return the next command of the stop.

        Args:
            time: Of the command [s], shape (1,).
        """
        change = None if self._alone else self._next_change()
        if change is None:
            self.coordinated &= self._factor <= CREEP_FACTOR_MAX or self._alone
            self._alone = True
            braked = self._limiter.brake()
            return Command(time=time, unstrained_length=braked.unstrained_length)
        h = self._limiter.period
        self._change = change
        self._factor += change * h
        self._sigma += self._factor * h
        asked = Command(time=time, unstrained_length=self._path(np.array([self._sigma])))
        sent = self._limiter.apply(asked)
        if sent.limited:
            self.coordinated, self._alone = False, True
        return sent

    def _path(self, sigma: Array) -> Array:
        """Return lengths along the path [m], shape (K, n), for sigma of shape (K,)."""
        length, speed, acceleration = self._start
        s = sigma[:, None]
        slow, fast = (tau**2 * (np.expm1(-s / tau) + s / tau) for tau in self._fade_times)
        return np.asarray(
            length + speed * s + self._bend * slow + (acceleration - self._bend) * fast
        )

    def _next_change(self) -> float | None:
        """Return the change of the factor [1/s] that slows down most within the limits, or None."""
        if self._factor <= CREEP_FACTOR_MAX:
            return None
        limiter, h = self._limiter, self._limiter.period
        motion = limiter.motion
        pace = float(np.abs(self._start[1]).max())
        jerk = 0.5 * limiter.jerk_max / pace
        low = max(self._change - 4.0 * jerk * h, -self._factor / h)
        changes = np.linspace(low, min(0.0, self._change + 2.0 * jerk * h), RATE_CHANGE_CANDIDATES)
        factors = self._factor + changes * h
        lengths = self._path(self._sigma + factors * h)
        speed = (lengths - motion.length) / h
        acceleration = (speed - motion.speed) / h
        rates = (speed, acceleration, (acceleration - motion.acceleration) / h)
        good = (factors >= 0.0) & (factors >= changes**2 / (2.0 * jerk) + 0.5 * changes * h)
        for rate, most in zip(rates, self._most, strict=True):
            good &= (np.abs(rate) <= most).all(axis=1)
        return float(changes[np.argmax(good)]) if good.any() else None
