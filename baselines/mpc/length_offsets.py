"""What lengths sent differ by from those of the believed pose: offset, and slack."""

from __future__ import annotations

from typing import Any

import numpy as np

from baselines.mpc.arithmetic import NUMBERS, Arithmetic
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.scaled import Ratios, Scaled

SLACK_EXCESS = Scaled(0.05, "m")  # a cable that is longer than believed by more is slack
# Time constant of offsets: short against a path, long against encoder noise.
OFFSET_TIME = Scaled(0.5, "s")
OFFSET_MAX = Scaled(0.1, "m")  # what exceeds it is slack, and reeled in


class LengthOffsets:
    """A first-order filter of offsets, beside what is off so suddenly that it is none.

    Attributes:
        offset: Sent minus modelled [m], shape (n,).
        slack: What lengths differ by so suddenly that it is no offset [m], shape (n,).
        most: Bounds of the offset [m], shape (n,).
    """

    def __init__(self, n: int, *, period: float, ratios: Ratios) -> None:
        """Take the number of cables, the time between two commands [s] and the robot's ratios."""
        self._n, self._share = n, period / OFFSET_TIME.of(ratios)
        self._offset_max, self._slack_excess = OFFSET_MAX.of(ratios), SLACK_EXCESS.of(ratios)
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self.offset, self.slack = np.zeros((2, self._n))
        self.most = np.full(self._n, self._offset_max)

    @property
    def surplus(self) -> Array:
        """Lengths sent beyond modelled ones [m], shape (n,): offset and slack."""
        return np.asarray(self.offset + self.slack)

    @property
    def kept(self) -> Array:
        """Offset within its bounds [m], shape (n,)."""
        return np.asarray(NUMBERS.within(self.offset, -self.most, self.most))

    def rebase(self, missing: Array) -> None:
        """Take what lengths differ by as offset, whatever it is."""
        self.offset, self.slack = missing, np.zeros(self._n)
        self.most = np.maximum(self.most, np.abs(missing))

    def learn(self, missing: Array) -> None:
        """Take a share of what the lengths differ by as offset, and what is far off as slack.

        A slack cable is longer than its chord, and says nothing about where the platform is. Were
        that an offset, it would be sent for ever, and the cable would stay slack.
        """
        self.take(*self.after(self.offset, self.most, missing))

    def after(
        self, offset: Any, most: Any, missing: Any, do: Arithmetic = NUMBERS
    ) -> tuple[Any, Any, Any]:
        """Return offset, slack and bounds of the offset [m] a command later.

        Args:
            offset: Now [m], shape (n,).
            most: Its bounds [m], shape (n,).
            missing: What the lengths differ by [m], shape (n,).
            do: Operations of arrays, or of expressions.
        """
        share = self._share
        most = most + share * (self._offset_max - most)
        error = missing - offset
        near = do.within(error, -self._slack_excess, self._slack_excess)
        slack = (1.0 - share) * (error - near)
        offset = offset + share * near
        return offset + share * (do.within(offset, -most, most) - offset), slack, most

    def take(self, offset: Array, slack: Array, most: Array) -> None:
        """Take an offset, slack and the offset's bounds [m] as those of now, each (n,)."""
        self.offset, self.slack, self.most = offset, slack, most
