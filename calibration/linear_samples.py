"""Linearised measurements: what all samples share, and what each sample has alone."""

from __future__ import annotations

from dataclasses import dataclass

from carosac_toolkit.base.arrays import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class LinearSamples:
    """S samples of m residuals, at some values of k shared unknowns and d of each sample.

    Attributes:
        residual: Measured minus modelled, shape (S, m).
        by_shared: Its derivative by the shared unknowns, shape (S, m, k).
        by_own: Its derivative by the unknowns of the sample: its position, or the error of its
            measured pose, shape (S, m, d).
    """

    residual: Array
    by_shared: Array
    by_own: Array

    def scaled(self, scale: Array) -> LinearSamples:
        """Return the same with each residual multiplied by a number, shape (m,) or (S, m)."""
        return LinearSamples(
            residual=self.residual * scale,
            by_shared=self.by_shared * scale[..., None],
            by_own=self.by_own * scale[..., None],
        )
