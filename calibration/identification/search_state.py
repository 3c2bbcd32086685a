"""Where a search stands: derivatives that it took, the end of a step, and its own end."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calibration.identification.runs import FittedRun
from calibration.identification.spread import STALE_SIGMAS
from carosac_toolkit.base.arrays import Array

DAMPING_START = 1e-3  # of the Hessian's diagonal, to begin with and after a step that fails


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
class Near:
    """Derivatives over short steps, by the time steps of the search.

    Attributes:
        at: All coordinates where they were taken.
        runs: Of which, the same object.
        jacobians: Of errors of each run, shape (K, 6, p).
    """

    at: Array
    runs: tuple[FittedRun, ...]
    jacobians: list[Array]


@dataclass(frozen=True, kw_only=True, eq=False)
class Wide:
    """Derivatives over some sigmas, of errors of each run, shape (K, 6, p).

    Attributes:
        at: All coordinates where they were taken.
        rough: Of the time steps of the search.
        exact: Of vanishing ones; those of the search along rough axes.
        near: Over short steps, of the time steps of the search; the same along rough axes.
        rough_axes: True if along axes of a covariance by rough derivatives: these mix what is known
            well with what is not, so that some sigmas of one are too many of another.
    """

    at: Array
    rough: list[Array]
    exact: list[Array]
    near: list[Array]
    rough_axes: bool = False

    @property
    def jacobians(self) -> list[Array]:
        """Means of the exact ones and of those over short steps."""
        return [0.5 * (exact + near) for exact, near in zip(self.exact, self.near, strict=True)]

    def is_stale(self, at: Array, hessian: Array, robot: int) -> bool:
        """Say whether a search has left them by more than a sigma of each coordinate of the robot.

        Args:
            at: All coordinates now.
            hessian: Of the cost.
            robot: How many coordinates are of the robot, the first ones.
        """
        own, start = slice(robot), slice(robot, None)
        off = (at - self.at)[own]
        follow = np.linalg.solve(hessian[start, start], hessian[start, own] @ off)
        return bool(
            off @ (hessian[own, own] @ off - hessian[own, start] @ follow) > STALE_SIGMAS**2 * robot
        )


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
