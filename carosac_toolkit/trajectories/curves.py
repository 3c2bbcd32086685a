"""Curves: positions over their own nominal time, with derivatives; no limits yet."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from carosac_toolkit.base.arrays import Array, frozen_array
from carosac_toolkit.base.errors import InvalidField

DERIVATIVE_ORDERS = 4  # position, velocity, acceleration, jerk


class Curve(Protocol):
    """The platform origin in world frame W over nominal time, from 0 to the last break."""

    @property
    def breaks(self) -> Array:
        """Times at which smooth pieces meet, from 0 to the nominal duration [s], shape (S + 1,)."""
        ...

    def derivatives(self, time: Array) -> Array:
        """Evaluate position and three derivatives.

        Args:
            time: Nominal time within the breaks [s], shape (K,).

        Returns:
            Position [m] to jerk [m/s^3], shape (K, 4, 3).
        """
        ...


@dataclass(frozen=True, kw_only=True, eq=False)
class PiecewisePolynomial:
    """Polynomials in the time since the start of each piece.

    Attributes:
        breaks: From 0, strictly increasing [s], shape (S + 1,).
        coefficients: Of ascending powers [m/s^k], shape (S, degree + 1, 3).
    """

    breaks: Array
    coefficients: Array

    def __post_init__(self) -> None:
        """Freeze the arrays and check the order of the breaks."""
        pieces, powers, _ = self.coefficients.shape
        breaks = frozen_array("breaks", self.breaks, (pieces + 1,))
        if breaks[0] != 0.0 or (np.diff(breaks) <= 0.0).any():
            raise InvalidField("breaks", breaks, "strictly increasing from 0")
        object.__setattr__(self, "breaks", breaks)
        frozen = frozen_array("coefficients", self.coefficients, (pieces, powers, 3))
        object.__setattr__(self, "coefficients", frozen)

    def derivatives(self, time: Array) -> Array:
        """Evaluate position and three derivatives, shape (K, 4, 3); see `Curve`."""
        return self.evaluate(time, orders=DERIVATIVE_ORDERS)

    def evaluate(self, time: Array, *, orders: int) -> Array:
        """Evaluate the polynomials and their first derivatives.

        Args:
            time: [s], shape (K,).
            orders: Number of orders, the position included.

        Returns:
            Shape (K, orders, 3); at a break it is the later piece that counts.
        """
        last = len(self.coefficients) - 1
        piece = np.clip(np.searchsorted(self.breaks, time, side="right") - 1, 0, last)
        local = (time - self.breaks[piece])[:, None]
        coefficients = self.coefficients[piece]  # (K, degree + 1, 3)
        result = np.zeros((len(time), orders, 3))
        for order in range(orders):
            for power in range(coefficients.shape[1] - 1, -1, -1):
                result[:, order] = result[:, order] * local + coefficients[:, power]
            coefficients = coefficients[:, 1:] * np.arange(1, coefficients.shape[1])[:, None]
        return result
