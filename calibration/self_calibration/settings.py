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
        drum_radius_sigma: Of a drum's radius [m]; alike drums are wrong by the same.
        drum_buildup_sigma: Of a drum's build-up, relative.
        length_at_zero: Lengths of the cables at motor angle 0, roughly measured [m], shape (n,);
            None: those that the robot file has at home.
        length_at_zero_sigma: Of these lengths [m].
        known_sigma: Of known positions per axis, where the file says nothing [m], shape (3,).
        line_sigma: Of the line paid out by a drum [m]; None: found from the residuals.
        blunder: Probability below which a sample is a blunder.
    """

    exit_sigma: float = 0.5
    drum_radius_sigma: float = 2e-3
    drum_buildup_sigma: float = 0.15
    length_at_zero: Array | None = None
    length_at_zero_sigma: float = 0.02
    known_sigma: Array | tuple[float, float, float] = (1e-3, 1e-3, 1e-3)
    line_sigma: float | None = None
    blunder: float = 1e-5

    def __post_init__(self) -> None:
        """Freeze arrays and refuse deviations that are none."""
        object.__setattr__(self, "known_sigma", frozen_array("known_sigma", self.known_sigma, (3,)))
        for name in (
            "exit_sigma", "drum_radius_sigma", "drum_buildup_sigma", "length_at_zero_sigma",
            "known_sigma", "line_sigma",
        ):  # fmt: skip
            value = getattr(self, name)
            if value is not None and not (np.asarray(value) > 0.0).all():
                raise InvalidField(name, value, "> 0")
        if not 0.0 < self.blunder < 0.1:
            raise InvalidField("blunder", self.blunder, "0 < blunder < 0.1")
