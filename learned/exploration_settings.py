"""Settings of the exploration noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from carosac_toolkit.base.errors import InvalidField


@dataclass(frozen=True, kw_only=True)
class ExplorationSettings:
    """Settings of the exploration noise.

    Attributes:
        start: Standard deviation at the start, of actions in [-1, 1].
        end: Standard deviation at the end; it decays linearly.
    """

    start: float = 0.2
    end: float = 0.01

    def __post_init__(self) -> None:
        """Refuse negative numbers."""
        if not 0.0 <= self.end <= self.start < np.inf:
            raise InvalidField("exploration", f"{self.start} to {self.end}", "start >= end >= 0")
