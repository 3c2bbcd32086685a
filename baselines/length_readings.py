"""Length readings in time: between them straight, after the last one for a while as before."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from carosac_toolkit.arrays import Array
from carosac_toolkit.robot import Robot

SHORTEST = 1e-6  # [s] between two readings
AHEAD = 0.1  # [s] for which the last rate goes on
PATIENCE = 5  # readings in a row that cannot all be outliers
STAYS = 0.5  # of a jump: by how much less or more it may be after these readings
BACK = 0.25  # of a jump: encoders that are off by less after it have come back to where they were
JITTER = 5e-3  # [m] by which a reading may miss what the last ones led to expect
SLIP_DOUBT = 5e-3  # [m]: one sigma of how far an encoder slipped
FROZEN = 3  # equal readings in a row: the encoder is stuck, or the winch rests


@dataclass(frozen=True, kw_only=True, eq=False)
class Readings:
    """The last length readings of one robot.

    Attributes:
        time: When they count, increasing [s], shape (K,).
        length: What they say [m], shape (K, n).
        slid: By how much encoders have slipped since the start [m], shape (n,).
        had_slid: The same before the last of these slips, shape (n,).
        outliers: Readings in a row, up to the last one, that were not believed.
        rejected: Readings that were not believed since the start.
        offset: By how much the first of these outliers was off [m], shape (n,), or None.
        frozen: How many of the last readings of each cable were the same, shape (n,), or None.
        slipped: By how much encoders slipped with the last reading [m], shape (n,), or None.
        slips: How often one did since the start.
    """

    time: Array
    length: Array
    slid: Array
    had_slid: Array
    outliers: int = 0
    rejected: int = 0
    offset: Array | None = None
    frozen: Array | None = None
    slipped: Array | None = None
    slips: int = 0

    @classmethod
    def first(cls, time: float, length: Array) -> Readings:
        """One reading (n,) [m], from which encoders slip."""
        nothing = np.zeros(len(length))
        return cls(time=np.array([time]), length=length[None], slid=nothing, had_slid=nothing)

    def taken(self, time: float, length: Array, robot: Robot, jump: float, keep: float) -> Readings:
        """With one more reading, if it is one, and can be true.

        A cable that jumps farther than its winch can wind, and stays there, has not moved: its
        encoder slipped, and so have others that jumped with it, less far. Earlier readings are then
        moved as well, so that the path has no step. Encoders that jump back are where they were.
        One whose readings stood still before is believed: it was stuck, and has come free.

        Args:
            time: When it counts [s]; one that is not later than the last says nothing new.
            length: [m], shape (n,).
            robot: Nominal robot, whose winches are only so fast.
            jump: Distance beyond what winches can do from which a reading is an outlier [m].
            keep: Time from which on earlier readings are needed [s].
        """
        step = time - self.time[-1]
        if step < SHORTEST:
            return self
        far = np.abs(length - self.length[-1]) > robot.speed_max * step + jump
        off = length - self.at(time)
        start = self.offset
        if start is None:
            with_them = far.any() & (np.abs(off) > JITTER + robot.acceleration_max * step**2)
            start = np.where(far | with_them, off, 0.0)
        far |= (start != 0.0) & (np.abs(off) > STAYS * np.abs(start))
        if far.any() and self.outliers + 1 < PATIENCE:
            return replace(
                self, outliers=self.outliers + 1, rejected=self.rejected + 1, offset=start,
                slipped=None,
            )  # fmt: skip
        still = np.zeros(len(length)) if self.frozen is None else self.frozen
        stays = far & (np.abs(off - start) <= STAYS * np.abs(start)) & (start != 0.0)
        slipped = np.where(stays & (still < FROZEN), start, 0.0)
        slid, had_slid = self.slid + slipped, self.had_slid
        if np.linalg.norm(slid - had_slid) < BACK * np.linalg.norm(slipped):
            slid, slipped = had_slid, had_slid - self.slid
        first = max(0, int(np.searchsorted(self.time, keep, side="right")) - 2)
        return replace(
            self,
            time=np.append(self.time[first:], time),
            length=np.vstack([self.length[first:] + slipped, length]),
            outliers=0,
            offset=None,
            frozen=np.where(length == self.length[-1], still + 1, 0),
            slipped=slipped if slipped.any() else None,
            slid=slid,
            had_slid=self.slid if slipped.any() else had_slid,
            slips=self.slips + int(np.count_nonzero(slipped)),
        )

    def held(self, time: float) -> Readings:
        """As if the last reading had come once more at a later time [s]."""
        return replace(
            self,
            time=np.append(self.time[-1:], time),
            length=np.vstack([self.length[-1:], self.length[-1:]]),
        )

    def at(self, time: float) -> Array:
        """Reading at a time [m], shape (n,)."""
        last = self.time[-1]
        if time > last and len(self.time) > 1:
            rate = (self.length[-1] - self.length[-2]) / (last - self.time[-2])
            return np.asarray(self.length[-1] + min(time - last, AHEAD) * rate)
        k = int(np.clip(np.searchsorted(self.time, time), 1, max(1, len(self.time) - 1)))
        if len(self.time) == 1 or time <= self.time[0]:
            return np.asarray(self.length[0])
        share = (time - self.time[k - 1]) / (self.time[k] - self.time[k - 1])
        return np.asarray(self.length[k - 1] + share * (self.length[k] - self.length[k - 1]))

    def knots(self, start: float, end: float, short: float) -> list[float]:
        """Times at which the path bends between two others [s], the end included.

        Where those are no farther apart than `short` [s], the bend is lost in the noise.
        """
        if end - start <= short:
            return [end]
        inside = self.time[(self.time > start + SHORTEST) & (self.time < end - SHORTEST)]
        return [*inside.tolist(), end]
