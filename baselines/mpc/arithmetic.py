"""Operations of formulas that are evaluated on arrays and built into functions of CasADi."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

Operation = Callable[..., Any]


@dataclass(frozen=True, kw_only=True)
class Arithmetic:
    """Operations, element by element, beside those that arrays and expressions have alike.

    Attributes:
        constant: Turns an array of the robot into what the others work with.
        least: The lesser of two.
        most: The greater of two.
        size: Absolute value.
        choose: Of a condition, what holds if it is true, and what does otherwise.
    """

    constant: Operation
    least: Operation
    most: Operation
    size: Operation
    choose: Operation

    def within(self, values: Any, low: Any, high: Any) -> Any:
        """Return values within bounds; `numpy.clip` takes its time with small arrays."""
        return self.least(self.most(values, low), high)


NUMBERS = Arithmetic(
    constant=np.asarray, least=np.minimum, most=np.maximum, size=np.abs, choose=np.where
)


def expressions() -> Arithmetic:
    """Return the operations of CasADi."""
    import casadi as ca

    return Arithmetic(constant=ca.DM, least=ca.fmin, most=ca.fmax, size=ca.fabs, choose=ca.if_else)
