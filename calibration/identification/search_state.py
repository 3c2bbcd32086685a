"""Where a search stands: a correction, the end of a step, its own end, and when it has settled."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from carosac_toolkit.base.arrays import Array

DAMPING_START = 1e-3  # of the Hessian's diagonal, to begin with and after a step that fails
# Squared sigmas by which a step must promise to lower the cost: for each axis that counts, or each
# coordinate of the starts.
SETTLED_DECREASE = 0.1
# Called before each step with the number of poses that it looks at, and their RMS errors [m] and
# [rad].
ProgressCallback = Callable[[int, float, float], None]


@dataclass(frozen=True, kw_only=True, eq=False)
class Correction:
    """What corrects simulated errors: what time steps and hidden vibrations change of them.

    Attributes:
        at: All coordinates where it was found.
        errors: What is added to the errors of each run, shape (K, 6) or (6,).
    """

    at: Array
    errors: list[Array]


@dataclass(frozen=True, kw_only=True, eq=False)
class Step:
    """End of a step.

    Attributes:
        at: All coordinates there.
        errors: Of each run, shape (K, 6).
        cost: As the search judged it.
        damping: To begin the next one with.
        decrease: Of the cost.
    """

    at: Array
    errors: list[Array]
    cost: float
    damping: float = DAMPING_START
    decrease: float = 0.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Search:
    """End of a search.

    Attributes:
        at: All coordinates there.
        errors: Of each run, shape (K, 6).
        jacobians: Of each run, where the last step began, shape (K, 6, p).
        count: Steps.
        settled: True if the last one promised little, or brought little by exact derivatives.
    """

    at: Array
    errors: list[Array]
    jacobians: list[Array]
    count: int
    settled: bool
