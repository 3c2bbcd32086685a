"""Reference ahead of now that every kinematic controller aims at."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.numbers import check_not_negative, check_positive
from carosac_toolkit.loop.values import Belief, Command, Reference
from carosac_toolkit.robot.robot import Robot


@dataclass(frozen=True, kw_only=True)
class LookaheadSettings:
    """Settings of a controller that sends the lengths of a pose ahead of now.

    Attributes:
        period: Time between two commands [s].
        delay: How far ahead to aim [s]: what winches and the hold of the command take. None is
            the mean winch lag of the nominal robot and half a period.
        gain: Share of the believed position error that is corrected per second [1/s]; 0 sends
            the reference as it is.
    """

    period: float = 0.02
    delay: float | None = None
    gain: float = 0.0

    def __post_init__(self) -> None:
        """Refuse numbers that make no sense."""
        check_positive("period", self.period, "s")
        if self.delay is not None:
            check_not_negative("delay", self.delay, "s")
        check_not_negative("gain", self.gain, "1/s")


def delay_of(robot: Robot, settings: LookaheadSettings) -> float:
    """Return how far ahead to aim [s], by the settings."""
    if settings.delay is not None:
        return settings.delay
    return float(robot.winch_lag.mean()) + 0.5 * settings.period


def interpolated(where: Array, at: Array, value: Array) -> Array:
    """Interpolate values (B, T, 3) at (B, T) to (B, M), constant outside: (B, M, 3)."""
    return np.stack(
        [
            np.stack([np.interp(w, t, v[:, axis]) for axis in range(3)], axis=-1)
            for w, t, v in zip(where, at, value, strict=True)
        ]
    )


class Lookahead:
    """Point to aim at, cycle by cycle."""

    def __init__(self, robot: Robot, settings: LookaheadSettings) -> None:
        delay = delay_of(robot, settings)
        self._gain = settings.gain * settings.period
        self._delay = delay
        self.horizon = settings.period * float(np.ceil(delay / settings.period + 1e-9))
        self._correction: Array = np.zeros((1, 3))

    def reset(self, belief: Belief) -> None:
        """Forget the correction."""
        self._correction = np.zeros_like(belief.position)

    def aim(self, belief: Belief, reference: Reference) -> tuple[Array, Array]:
        """Return position [m] and velocity [m/s] to command now, each of shape (B, 3).

        Linear between the rows of the reference; the correction integrates the believed error.
        """
        error = reference.position[:, 0] - belief.position
        self._correction = self._correction + self._gain * error
        ahead = reference.time[:, 0] + self._delay
        position, velocity = (
            interpolated(ahead[:, None], reference.time, values)[:, 0]
            for values in (reference.position, reference.velocity)
        )
        return position + self._correction, np.broadcast_to(velocity, error.shape)


class LookaheadController(ABC):
    """A controller that sends the lengths of the pose ahead; subclasses say which lengths.

    Attributes:
        period: Time between two commands [s].
        horizon: How far ahead of now it needs the reference [s].
        feedback: False if its commands follow from the reference alone, with a gain of 0.
    """

    Settings: ClassVar = LookaheadSettings
    batched: ClassVar = True

    def __init__(self, robot: Robot, settings: LookaheadSettings) -> None:
        self._robot = robot
        self._ahead = Lookahead(robot, settings)
        self.period = settings.period
        self.horizon = self._ahead.horizon
        self.feedback = settings.gain > 0.0

    @classmethod
    def build(
        cls, robot: Robot, settings: LookaheadSettings | None = None, *, seed: int = 0
    ) -> Self:
        """Make one for the nominal robot; it draws no random numbers, so `seed` has no effect."""
        return cls(robot, settings or cls.Settings())

    def reset(self, belief: Belief) -> None:
        """Forget the correction."""
        self._ahead.reset(belief)

    @abstractmethod
    def command(self, belief: Belief, reference: Reference) -> Command:
        """Return the lengths of the pose ahead."""
