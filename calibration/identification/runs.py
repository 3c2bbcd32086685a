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
        poses: Measured ones that may be fitted.
        rate: Of poses that are fitted, of all of them [Hz].
        sway: Unknown motion at the start.
    """

    path: LengthPath
    poses: MeasuredPoses
    rate: float
    sway: FreeSway

    def first(self, share: float) -> FittedRun:
        """Return the run with the poses of a share of it, from the first.

        As many as are fitted of the whole, if they were measured so often: fast vibrations of the
        cables are followed from their beginning.
        """
        time = self.poses.time
        rows = np.flatnonzero(time <= time[0] + share * (time[-1] - time[0]))
        return replace(self, poses=self.poses.rows(rows).thinned(self.rate / share))
