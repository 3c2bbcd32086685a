"""The simplest estimator: straight cables, and an orientation that never changes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from baselines.solve_record import SolveRecord, belief_at_home
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.loop.values import Belief, Command, Measurement
from carosac_toolkit.physics.cable.straight_line import forward_kinematics
from carosac_toolkit.robot.robot import Robot


@dataclass(frozen=True, kw_only=True)
class StraightLineSettings:
    """Settings of `StraightLine`.

    Attributes:
        residual_max: Root mean square length error [m] above which a fit counts as a failure: the
            lengths contradict straight cables too much for its position to mean anything.
    """

    residual_max: float = float("inf")

    def __post_init__(self) -> None:
        """Refuse a bound that no fit can meet."""
        if not self.residual_max > 0.0:
            raise InvalidField("residual_max", f"{self.residual_max} m", "residual_max > 0")


class StraightLine:
    """Position of least squared length error, orientation held at home, as on most cable robots.

    It reads unstrained lengths as straight distances: neither sag nor stretch nor tilt. Each fit
    starts at the last position, the first one at home; failures are in ``belief.memory``, a
    `SolveRecord`, and keep the last good position.
    """

    Settings: ClassVar = StraightLineSettings
    batched: ClassVar = True

    def __init__(self, robot: Robot, settings: StraightLineSettings) -> None:
        self._robot = robot
        self._settings = settings

    @classmethod
    def build(
        cls, robot: Robot, settings: StraightLineSettings | None = None, *, seed: int = 0
    ) -> StraightLine:
        """Make one for the nominal robot; it draws no random numbers, so `seed` has no effect."""
        return cls(robot, settings or StraightLineSettings())

    def reset(self, measurement: Measurement) -> Belief:
        """Start at home and fit the first lengths."""
        home = belief_at_home(self._robot, measurement)
        return self._fit(home, measurement)

    def update(self, belief: Belief, command: Command, measurement: Measurement) -> Belief:
        """Fit the new lengths from the last position; the command is not used."""
        return self._fit(belief, measurement)

    def _fit(self, belief: Belief, measurement: Measurement) -> Belief:
        fit = forward_kinematics(self._robot, measurement.unstrained_length, guess=belief.position)
        good = fit.converged & (fit.residual <= self._settings.residual_max)
        record: SolveRecord = belief.memory
        return replace(
            belief,
            time=measurement.time,
            position=np.where(good[:, None], fit.position, belief.position),
            converged=good,
            memory=replace(
                record,
                converged=good,
                residual=fit.residual,
                updates=record.updates + 1,
                failures=record.failures + ~good,
            ),
        )
