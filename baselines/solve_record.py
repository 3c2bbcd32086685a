"""Memory of the quasi-static estimators: how their solves went."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carosac_toolkit.base.arrays import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class SolveRecord:
    """Memory of a belief whose pose comes from solving equations at every measurement.

    Attributes:
        converged: Whether the last solve gave the belief's pose, shape (B,). Where it is False, the
            pose is the last good one, or home if there was none yet.
        residual: What the last solve left: length error [m] or wrench [N], shape (B,).
        updates: Measurements since the last reset, the first one included.
        failures: Measurements among them without a solution, shape (B,).
        restarts: Solves that failed from their seed and were done again without, shape (B,).
        unseeded: Measurements that lacked the pose their solve should have started from.
        solution: The last solution, to start the next solve from; None after a failure.
    """

    converged: NDArray[np.bool_]
    residual: Array
    updates: int
    failures: NDArray[np.int64]
    restarts: NDArray[np.int64]
    unseeded: int = 0
    solution: Any = None


def empty_record(size: int) -> SolveRecord:
    """Return the record before the first solve of a batch."""
    return SolveRecord(
        converged=np.zeros(size, dtype=np.bool_),
        residual=np.zeros(size),
        updates=0,
        failures=np.zeros(size, dtype=np.int64),
        restarts=np.zeros(size, dtype=np.int64),
    )
