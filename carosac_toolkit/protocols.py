"""What the loop calls: the contracts between the toolkit and everything that plugs into it."""

from __future__ import annotations

from typing import Protocol

from carosac_toolkit.values import Belief, Command, Measurement


class Estimator(Protocol):
    """Turns applied commands and measurements into a belief over the platform state.

    An estimator's module or class offers ``build(robot, settings, *, seed)``; it is found through
    the entry-point group ``carosac.estimators`` or as ``module:Class``.
    """

    def reset(self, measurement: Measurement) -> Belief:
        """Start from a first measurement, without any earlier belief."""
        ...

    def update(self, belief: Belief, command: Command, measurement: Measurement) -> Belief:
        """Advance the belief.

        Args:
            belief: The belief after the last measurement.
            command: The command that was really applied since then.
            measurement: The new measurement.

        Returns:
            The new belief.
        """
        ...
