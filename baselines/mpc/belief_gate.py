"""Gate for beliefs to plan from: they must agree with the lengths that were sent."""

from __future__ import annotations

from baselines.mpc.length_offsets import SLACK_EXCESS
from baselines.mpc.observer import BELIEF_GATE
from carosac_toolkit.base.scaled import Ratios, Scaled

TAUT_TIME = Scaled(0.3, "s")  # with all cables taut, before a new plan begins
# Of disagreement while the winches rest: then the lengths are wrong.
STUCK_TIME = Scaled(1.0, "s")


class BeliefGate:
    """Counts beliefs that agree, one a period.

    On slack cables a platform flies, and a plan for taut ones would drive it on. Such a plan is
    given up, and none is made before all cables have been taut for some time.

    Attributes:
        usable: Whether to plan from the last belief.
    """

    def __init__(self, period: float, ratios: Ratios) -> None:
        """Start with the time between two beliefs [s], and the size of the robot."""
        self._taut = max(1, round(TAUT_TIME.of(ratios) / period))  # beliefs in a row
        self._stuck = max(1, round(STUCK_TIME.of(ratios) / period))
        self._gate, self._slack = BELIEF_GATE.of(ratios), SLACK_EXCESS.of(ratios)
        self.reset()

    def reset(self) -> None:
        """Start over."""
        self.usable = True
        self._near, self._far = self._taut, 0

    @property
    def stuck(self) -> bool:
        """True if it has disagreed for long with winches at rest."""
        return self._far >= self._stuck

    def within(self, resting: bool) -> float:
        """Return the distance up to which a belief is learned from [m]."""
        return self._slack if resting else self._gate

    def update(self, distance: float, *, resting: bool, still: bool) -> None:
        """Take in one more belief.

        Args:
            distance: Largest difference of believed and sent lengths [m].
            resting: Whether the last plan was given up.
            still: Whether the winches rest.
        """
        near = distance <= self.within(True)
        self._near = self._near + 1 if near else 0
        self._far = self._far + 1 if resting and still and not near else 0
        self.usable = self._near >= self._taut if resting else distance <= self._gate
