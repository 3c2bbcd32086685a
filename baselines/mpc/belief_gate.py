"""Gate for beliefs to plan from: they must agree with the lengths that were sent."""

from __future__ import annotations

from baselines.mpc.observer import BELIEF_GATE_M, SLACK_EXCESS_M

TAUT_TIME_S = 0.3  # with all cables taut, before a new plan begins
STUCK_TIME_S = 1.0  # of disagreement while the winches rest: then the lengths are wrong


class BeliefGate:
    """Counts beliefs that agree, one a period.

    On slack cables a platform flies, and a plan for taut ones would drive it on. Such a plan is
    given up, and none is made before all cables have been taut for some time.

    Attributes:
        usable: Whether to plan from the last belief.
    """

    def __init__(self, period: float) -> None:
        """Start with the time between two beliefs [s]."""
        self._taut = max(1, round(TAUT_TIME_S / period))  # beliefs in a row
        self._stuck = max(1, round(STUCK_TIME_S / period))
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
        return SLACK_EXCESS_M if resting else BELIEF_GATE_M

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
        self.usable = self._near >= self._taut if resting else distance <= BELIEF_GATE_M
