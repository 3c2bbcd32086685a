"""The result of a self-calibration."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.estimate import ParameterEstimate
from calibration.result import CalibrationResult
from calibration.self_calibration.frame import Frame
from calibration.self_calibration.rivals import OUTSIDE_SHARE, Rival
from calibration.self_calibration.scale import Scale
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.robot.parameter_names import field_of


@dataclass(frozen=True, kw_only=True)
class SampleBlunder:
    """A sample that does not fit the others and was left out.

    Attributes:
        sample: Its name.
        what: ``motor angles`` or ``known position``.
        sigmas: Root mean square misfit in its own standard deviations.
    """

    sample: str
    what: str
    sigmas: float


@dataclass(frozen=True, kw_only=True, eq=False)
class LeftOut:
    """A known position that was predicted from all other data.

    Attributes:
        sample: Its name.
        error: Predicted less known position [m], shape (3,); NaN along an axis that is unknown.
        sigma: One standard deviation of that error [m], shape (3,).
    """

    sample: str
    error: Array
    sigma: Array

    @property
    def distance(self) -> float:
        """Distance of the predicted from the known position along the known axes [m]."""
        return float(np.sqrt(np.nansum(self.error**2)))


@dataclass(frozen=True, kw_only=True, eq=False)
class SelfCalibration(CalibrationResult):
    """Parameters and positions from motor angles; N samples, n cables.

    Attributes:
        samples: Names.
        position: Platform origin in W [m], shape (N, 3).
        rotation: From P to W, shape (N, 3, 3): home's unless lengths tell it.
        position_sigma: One standard deviation [m], shape (N, 3); infinite for a sample whose motor
            angles are a blunder and whose position is not known.
        residual: Length by the drum less straight length [m], shape (N, n).
        used: Samples whose motor angles were used, shape (N,).
        is_known: Samples with a known coordinate, shape (N,).
        known_axes: True for each coordinate that is known, shape (N, 3).
        known_position: Known positions, 0 elsewhere [m], shape (N, 3).
        advantage: Line paid out per length of cable, shape (n,).
        length_at_zero: Lengths where the motor angles are 0 [m], shape (n,).
        length_at_zero_sigma: [m], shape (n,).
        line_sigma: Noise of the line paid out, as estimated or set [m].
        redundancy: Lengths beyond those that the unknowns take.
        blunders: Samples that were left out.
        left_out: Known positions predicted one at a time, where the others suffice.
        frame: Convention that holds what nothing that was measured tells.
        scale: How well the size of everything is known, and from what.
        rivals: Other solutions, the best of them first.
    """

    samples: tuple[str, ...]
    position: Array
    rotation: Array
    position_sigma: Array
    residual: Array
    used: NDArray[np.bool_]
    is_known: NDArray[np.bool_]
    known_axes: NDArray[np.bool_]
    known_position: Array
    advantage: Array
    length_at_zero: Array
    length_at_zero_sigma: Array
    line_sigma: float
    redundancy: float
    blunders: tuple[SampleBlunder, ...]
    left_out: tuple[LeftOut, ...]
    frame: Frame
    scale: Scale
    rivals: tuple[Rival, ...]

    @property
    def robot_estimate(self) -> ParameterEstimate:
        """The estimate; motions that are held by convention are as uncertain as before.

        A robot file is read by those who know nothing of the frame of this result.
        """
        covariance = self.estimate.covariance.copy()
        exits = self.before.exit_points.size  # the first parameters
        covariance[:exits, :exits] += self.frame.convention
        return replace(self.estimate, covariance=covariance)

    @property
    def residual_rms(self) -> float:
        """Root mean square residual of the lengths that were used [m of cable]."""
        return float(np.sqrt((self.residual[self.used] ** 2).mean()))

    @property
    def line_residual_rms(self) -> float:
        """The same of the line that the drums paid out: the advantage times as much [m]."""
        return float(np.sqrt(((self.residual * self.advantage)[self.used] ** 2).mean()))

    def data(self) -> dict[str, Any]:
        """Return all numbers, ready for JSON."""
        rows = zip(self.samples, self.position, self.position_sigma, self.residual, strict=True)
        each = [(name, place, sigma, miss) for name, place, sigma, miss in rows]
        return {
            "robot": self.before.name,
            "positions_m": {name: place for name, place, _, _ in each},
            "positions_sigma_m": {name: sigma for name, _, sigma, _ in each},
            "rotations": dict(zip(self.samples, self.rotation, strict=True)),
            "residuals_m": {name: miss for name, _, _, miss in each},
            "residual_rms_m": self.residual_rms,
            "line_residual_rms_m": self.line_residual_rms,
            "line_sigma_m": self.line_sigma,
            "redundancy": self.redundancy,
            "parameters": self.estimate.data(),
            "length_at_zero_m": dict(
                zip(self.before.cable_names, self.length_at_zero.tolist(), strict=True)
            ),
            "observability": self.observability.data(),
            "blunders": [
                {"sample": b.sample, "what": b.what, "sigmas": b.sigmas} for b in self.blunders
            ],
            "left_out": {
                one.sample: {"error_m": one.error, "sigma_m": one.sigma} for one in self.left_out
            },
            "frame": self.frame.data(),
            "scale": {"sigma": self.scale.sigma, "sources": self.scale.sources},
            "other_solutions": [
                {
                    "cost": rival.cost,
                    "distance_m": rival.distance,
                    "mirrored": rival.mirrored,
                    "outside_workspace": rival.outside > OUTSIDE_SHARE,
                }
                for rival in self.rivals
            ],
            "warnings": list(self.warnings),
        }

    def sentences(self) -> list[str]:
        """Return what was found, in words."""
        residual, line = 1e3 * self.residual_rms, 1e3 * self.line_residual_rms
        sure = 1e3 * self.position_sigma[np.isfinite(self.position_sigma)]
        lines = [
            f"lengths of cable fit to {residual:.2f} mm RMS ({line:.2f} mm of line, which is the "
            f"length times the drum's advantage) over {int(self.used.sum())} of "
            f"{len(self.samples)} samples",
            f"the line has {1e3 * self.line_sigma:.2f} mm of noise, told by "
            f"{self.redundancy:.0f} lengths more than the unknowns take",
            f"positions are known to {sure.min():.1f} to {sure.max():.1f} mm (1 sigma per axis)",
        ]
        if self.left_out:
            error = [1e3 * one.distance for one in self.left_out]
            worst = self.left_out[int(np.argmax(error))].sample
            lines.append(
                f"known positions, left out one at a time, are predicted within {max(error):.1f} "
                f"mm (worst: sample {worst}), {np.sqrt(np.mean(np.square(error))):.1f} mm RMS"
            )
        elif self.is_known.any():
            lines.append(
                "no known position can be left out: the others do not suffice to predict it"
            )
        lines += self.frame.sentences()
        lines.append(self.scale.sentence())
        lines += self._rival_sentences()
        lines.append(self._stretch_sentence())
        return lines

    def _stretch_sentence(self) -> str:
        """Return how stretch was treated."""
        stiff = [name for name in self.estimate.names if field_of(name) == "axial_stiffness"]
        if not stiff:
            return (
                "cables were taken as straight and stiff, as no tensions are known; what a "
                "constant tension stretches counts as drum radius"
            )
        known = self.estimate.select(stiff)
        share = 100.0 * float((known.sigma / known.value).max())
        return (
            f"cables were taken as straight, and stretch by the measured tensions; their stiffness "
            f"is known to {share:.0f} %"
        )

    def _rival_sentences(self) -> list[str]:
        """Return how much worse the best other solution is."""
        if not self.rivals:
            return ["no other solution was found"]
        rival = self.rivals[0]
        kind = "its mirror image" if rival.mirrored else "another one"
        end = (
            ", and has positions outside of the workspace" if rival.outside > OUTSIDE_SHARE else ""
        )
        return [
            f"the best other solution, {kind}, is {abs(rival.cost):.3g} squared standard "
            f"deviations {'worse' if rival.cost >= 0.0 else 'better'}{end}"
        ]
