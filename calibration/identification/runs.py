"""Recordings whose poses one robot is fitted to."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calibration.identification.measured_poses import MeasuredPoses
from calibration.identification.sway import FreeSway
from carosac_toolkit.recordings.length_path import LengthPath


@dataclass(frozen=True, kw_only=True, eq=False)
class FittedRun:
    """A recording, as a fit sees it.

    Attributes:
        path: Readings.
        poses: Measured ones to be fitted.
        sway: Unknown motion at the start.
    """

    path: LengthPath
    poses: MeasuredPoses
    sway: FreeSway

    def first(self, share: float) -> FittedRun:
        """Return the run with a share of its poses, from the first."""
        count = max(1, round(share * len(self.poses.time)))
        return replace(self, poses=self.poses.rows(np.arange(count)))
