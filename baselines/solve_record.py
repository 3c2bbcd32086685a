"""Memory of the quasi-static estimators: how their solves went."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.loop.values import Belief, Measurement
from carosac_toolkit.robot.robot import Robot


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


def belief_at_home(robot: Robot, measurement: Measurement) -> Belief:
    """Return the belief before the first solve of a batch: at home, nothing solved yet."""
    size = len(measurement.unstrained_length)
    return Belief(
        time=measurement.time,
        position=np.tile(robot.home_position, (size, 1)),
        rotation=np.tile(robot.home_rotation, (size, 1, 1)),
        memory=SolveRecord(
            converged=np.zeros(size, dtype=np.bool_),
            residual=np.zeros(size),
            updates=0,
            failures=np.zeros(size, dtype=np.int64),
            restarts=np.zeros(size, dtype=np.int64),
        ),
    )
