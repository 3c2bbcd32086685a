"""The result of every calibration: a robot with its evidence."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from calibration.estimate import ParameterEstimate
from calibration.observability import Observability
from calibration.robot_update import updated
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.robot.parameter_names import point_names
from carosac_toolkit.robot.robot import Robot


@dataclass(frozen=True, kw_only=True, eq=False)
class CalibrationResult(ABC):
    """A calibrated robot with its evidence.

    Attributes:
        before: The robot as it was known.
        estimate: The parameters that go into the robot.
        observability: Judgement of what the data alone can tell.
        warnings: Sentences that must not be overlooked.
    """

    before: Robot
    estimate: ParameterEstimate
    observability: Observability
    warnings: tuple[str, ...] = ()

    @cached_property
    def robot(self) -> Robot:
        """The calibrated robot, with the covariance of its parameters."""
        return updated(self.before, self.robot_estimate)

    @property
    def robot_estimate(self) -> ParameterEstimate:
        """The estimate with the covariance that the robot gets."""
        return self.estimate

    @property
    def exit_covariance_before(self) -> Array | None:
        """Covariance of each exit point before [m^2], shape (n, 3, 3); None: unknown."""
        if self.before.exit_covariance is not None:
            return self.before.exit_covariance
        names = point_names("exit_points", self.before.cable_names)
        if not set(names) <= set(self.estimate.names):
            return None
        sigma = self.estimate.select(names).prior_sigma.reshape(-1, 3)
        return np.array([np.diag(row**2) for row in sigma])

    def exit_points_of(self, cables: Sequence[str]) -> tuple[Array, Array]:
        """Return estimated exit points [m], (c, 3), and their covariances [m^2], (c, 3, 3)."""
        exits = self.estimate.select(point_names("exit_points", cables))
        blocks = exits.covariance.reshape(len(cables), 3, len(cables), 3)
        own = np.arange(len(cables))
        return exits.value.reshape(-1, 3), blocks[own, :, own]

    @abstractmethod
    def sentences(self) -> list[str]:
        """Return what was found, in words."""

    @abstractmethod
    def data(self) -> dict[str, Any]:
        """Return all numbers under names with units, ready for JSON."""
