"""The verdict: errors of moves that were predicted before they were made, against their claim."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from calibration.guide.fit import Surprise
from carosac_toolkit.base.arrays import Array

CHANCE_MIN = 0.01  # probability of errors as large by chance, below which the claim does not hold


@dataclass(frozen=True, kw_only=True, eq=False)
class Verdict:
    """Predictions of K moves and what came of them.

    Attributes:
        checks: One per move.
        position_error: Distances of the predicted from the true positions after a turn about home
            that fits all of them best [m], shape (K,); None where no truth is known.
    """

    checks: tuple[Surprise, ...]
    position_error: Array | None = None

    @property
    def rms(self) -> float:
        """Root mean square error of the line [m]."""
        return float(np.sqrt(np.mean([check.rms**2 for check in self.checks])))

    @property
    def sigma(self) -> float:
        """Root mean square error that was claimed [m]."""
        return float(np.sqrt(np.mean([check.sigma**2 for check in self.checks])))

    @property
    def chance(self) -> float:
        """Probability of errors as large as these, or larger, if the claim is true."""
        from scipy.stats import chi2

        square = sum(check.square for check in self.checks)
        return float(chi2.sf(square, sum(len(check.error) for check in self.checks)))

    @property
    def holds(self) -> bool:
        """True if the errors are within their claim."""
        return self.chance >= CHANCE_MIN

    def sentences(self) -> list[str]:
        """Return the verdict in words."""
        count = len(self.checks)
        moves = "1 move was" if count == 1 else f"{count} moves were"
        lines = [
            f"{moves} predicted before being made: the spare lengths "
            f"were off by {1e3 * self.rms:.2f} mm of line RMS, {1e3 * self.sigma:.2f} mm were "
            "claimed"
        ]
        if self.position_error is not None:
            error = float(np.sqrt(np.mean(self.position_error**2)))
            claimed = float(np.sqrt(np.mean([c.position_sigma**2 for c in self.checks])))
            lines.append(
                f"simulated truth: the positions were off by {1e3 * error:.1f} mm RMS, "
                f"{1e3 * claimed:.1f} mm were claimed"
            )
        if self.holds:
            lines.append("VERDICT: the errors are within their claim")
        else:
            lines.append(
                f"VERDICT: the errors are NOT within their claim: by chance they are as large with "
                f"a probability of {self.chance:.1g}; do not use this calibration. Did a cable "
                "slip, or did the robot change? Start anew with another file"
            )
        return lines

    def data(self) -> dict[str, Any]:
        """Return all numbers, ready for JSON."""
        return {
            "checks": len(self.checks),
            "line_error_rms_m": self.rms,
            "line_error_claimed_m": self.sigma,
            "chance": self.chance,
            "holds": self.holds,
            "position_errors_m": None
            if self.position_error is None
            else self.position_error.tolist(),
            "position_sigmas_m": [check.position_sigma for check in self.checks],
        }


def aligned_errors(predicted: Sequence[Array], true: Sequence[Array], home: Array) -> Array:
    """Return the distances of positions from the truth after the turn about home that fits best.

    Args:
        predicted: Positions in W, the first at home [m], each of shape (3,).
        true: The true ones, in a frame of another origin and heading [m].
        home: Home in W [m], shape (3,).

    Returns:
        Distances [m], one per position.
    """
    from scipy.spatial.transform import Rotation

    arm, true_arm = np.array(predicted) - home, np.array(true) - true[0]
    turn, _ = Rotation.align_vectors(true_arm[1:], arm[1:])
    return np.asarray(np.linalg.norm(turn.apply(arm) - true_arm, axis=1))
