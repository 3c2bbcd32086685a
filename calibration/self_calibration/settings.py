"""Settings of a self-calibration: what is known before it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from carosac_toolkit.base.arrays import Array, frozen_array
from carosac_toolkit.base.errors import InvalidField


@dataclass(frozen=True, kw_only=True, eq=False)
class SelfCalibrationSettings:
    """One standard deviation of what is known before, and what counts as a blunder.

    Attributes:
        exit_sigma: Of exit points per axis, where the robot file says nothing [m].
        length_at_zero: Lengths of the cables at motor angle 0, roughly measured [m], shape (n,);
            None: those that the robot file has at home.
        known_sigma: Of known positions per axis, where the file says nothing [m], shape (3,).
        line_sigma: Of the line paid out by a drum [m]; None: estimated from the residuals.
        blunder: Probability of a good sample's misfit below which it counts as a blunder [1].
    """

    exit_sigma: float = 0.5
    length_at_zero: Array | None = None
    known_sigma: Array | tuple[float, float, float] = (1e-3, 1e-3, 1e-3)
    line_sigma: float | None = None
    blunder: float = 1e-5

    def __post_init__(self) -> None:
        """Freeze arrays and refuse deviations that are none."""
        object.__setattr__(self, "known_sigma", frozen_array("known_sigma", self.known_sigma, (3,)))
        for name in ("exit_sigma", "known_sigma", "line_sigma"):
            value = getattr(self, name)
            if value is not None and not (np.asarray(value) > 0.0).all():
                raise InvalidField(name, value, "> 0")
        if not 0.0 < self.blunder < 0.1:
            raise InvalidField("blunder", self.blunder, "0 < blunder < 0.1")
