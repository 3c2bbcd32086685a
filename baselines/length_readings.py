"""Length readings in time: smooth between them, after the last one for a while as before."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.scaled import Scaled, resolved
from carosac_toolkit.physics.motion.length_curve import (
    LENGTH_SEGMENT_MAX,
    curved_length,
    is_curved,
    segment_ends,
)
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.robot.robot import Robot

READING_INTERVAL_MIN_S = 1e-6
AGREEING_READINGS_MIN = 5  # readings in a row that agree with each other cannot all be outliers
JUMP_KEPT_RATIO = 0.5  # of a jump: a reading that is off by less is no part of it
JUMP_RETURN_RATIO = 0.25  # of a jump: an encoder that is off by less soon after has come back
JITTER_DEVIATIONS = 10.0  # of encoder noise, that jitter covers at the least
FROZEN_READINGS_MIN = 3  # equal readings in a row: the encoder is stuck, or the winch rests


@dataclass(frozen=True, kw_only=True)
class ReadingTolerances:
    """What readings may do; the defaults are those of ``carosac``, and scale with the robot.

    Attributes:
        extrapolation_time: For which the last rate goes on [s].
        return_time: In which a fault that ends has ended [s].
        jitter: By which a reading may miss the expectation [m].
        slip_deviation: Of the estimated slip of an encoder [m].
        segment: Between two readings, beyond which the path is not straight [s].
    """

    extrapolation_time: float = Scaled(0.1, "s")
    return_time: float = Scaled(2.0, "s")
    jitter: float = Scaled(5e-3, "m")
    slip_deviation: float = Scaled(5e-3, "m")
    segment: float = LENGTH_SEGMENT_MAX


def reading_tolerances(robot: Robot, noise: float) -> ReadingTolerances:
    """Return the tolerances for a robot with encoders of some noise [m]."""
    here = resolved(ReadingTolerances(), Scales(robot).ratios)
    return replace(here, jitter=max(here.jitter, JITTER_DEVIATIONS * noise))


@dataclass(frozen=True, kw_only=True, eq=False)
class LengthOutliers:
    """The last readings of one robot, which are not believed so far.

    Attributes:
        time: Of the last of them [s].
        length: What it says [m], shape (n,).
        offset: By how much the first of those in a row that agree with each other is off what was
            expected [m], shape (n,); zero for cables that it says nothing wrong of.
        prompt: Whether that came so soon after a reading that was believed that the offset is no
            motion.
        agree: How many in a row agree.
    """

    time: float
    length: Array
    offset: Array
    prompt: bool
    agree: int = 1


@dataclass(frozen=True, kw_only=True, eq=False)
class LengthReadings:
    """The last length readings of one robot.

    Attributes:
        time: When they count, increasing [s], shape (K,).
        length: What they say [m], shape (K, n).
        tolerances: Of this robot.
        slid: By how much encoders have slipped since the start [m], shape (n,).
        had_slid: The same before the last of these slips, shape (n,).
        slid_at: When that was noticed [s].
        outliers: Readings since the last one that was believed, or None.
        sound: How many in a row were believed.
        rejected: Readings that were not believed since the start.
        frozen: How many of the last readings of each cable were the same, shape (n,).
        slipped: By how much encoders slipped with the last reading [m], shape (n,), or None.
        slips: How often one did since the start.
        corrected: How often readings that had been believed were found to be wrong instead.
    """

    time: Array
    length: Array
    tolerances: ReadingTolerances
    slid: Array
    had_slid: Array
    frozen: Array
    slid_at: float = -np.inf
    outliers: LengthOutliers | None = None
    sound: int = 1
    rejected: int = 0
    slipped: Array | None = None
    slips: int = 0
    corrected: int = 0

    @classmethod
    def first(
        cls, time: float, length: Array, tolerances: ReadingTolerances, slid: Array | None = None
    ) -> LengthReadings:
        """Start with one reading (n,) [m] of encoders that slipped by (n,) [m] before."""
        nothing = np.zeros(len(length))
        slid = nothing if slid is None else slid
        return cls(
            time=np.array([time]), length=length[None], tolerances=tolerances, slid=slid,
            had_slid=slid, frozen=nothing,
        )  # fmt: skip

    def taken(
        self, time: float, length: Array, robot: Robot, jump: float, keep: float
    ) -> LengthReadings:
        """Add a reading, if it is new and can be true.

        A cable that jumps farther than its winch can wind, and stays there, has not moved: its
        encoder slipped, and so have others that jumped with it, less far. Earlier readings are then
        moved as well, so that the path has no step. Encoders that soon jump back are where they
        were. One whose readings stood still before, while others changed, is believed: it was
        stuck, and has come free. Readings that contradict others which were few themselves are
        believed as well: the others were wrong.

        Args:
            time: When it counts [s]; one that is not later than the last says nothing new.
            length: [m], shape (n,).
            robot: Nominal robot, whose winches are only so fast.
            jump: Distance beyond what winches can do from which a reading is an outlier [m].
            keep: Time from which on earlier readings are needed [s].
        """
        last = self.time[-1] if self.outliers is None else self.outliers.time
        if time - last < READING_INTERVAL_MIN_S:
            return self
        outliers = self._outliers(time, length, robot, jump)
        nothing = np.zeros(len(length))
        if outliers is None:
            sound = self.sound + 1 if self.outliers is None else 1
            return self._believed(time, length, nothing, sound, keep)
        if outliers.agree < AGREEING_READINGS_MIN:
            return replace(self, outliers=outliers, rejected=self.rejected + 1, slipped=None)
        if self.sound < AGREEING_READINGS_MIN or not outliers.prompt:
            new = self._believed(time, length, nothing, AGREEING_READINGS_MIN, keep)
            return replace(new, corrected=self.corrected + 1)
        stuck = (self.frozen >= FROZEN_READINGS_MIN) & (self.frozen < FROZEN_READINGS_MIN).any()
        return self._believed(
            time, length, np.where(stuck, 0.0, outliers.offset), AGREEING_READINGS_MIN, keep
        )

    def _outliers(
        self, time: float, length: Array, robot: Robot, jump: float
    ) -> LengthOutliers | None:
        """Return the outliers with one more reading; None if it is none."""
        before = self.outliers
        if before is not None:
            wound = robot.speed_max * (time - before.time)
            if (np.abs(length - before.length) <= wound + self.tolerances.jitter).all():
                return replace(before, time=time, length=length, agree=before.agree + 1)
        step = time - self.time[-1]
        far = np.abs(length - self.length[-1]) > robot.speed_max * step + jump
        off = length - self.at(time)
        if before is not None:
            wound = robot.speed_max * max(step - self.tolerances.extrapolation_time, 0.0)
            far |= np.abs(off) > np.maximum(JUMP_KEPT_RATIO * np.abs(before.offset), wound + jump)
        if not far.any():
            return None
        jumped = far | (np.abs(off) > self.tolerances.jitter + robot.acceleration_max * step**2)
        offset = np.where(jumped, off, 0.0)
        return LengthOutliers(
            time=time,
            length=length,
            offset=offset,
            prompt=step <= self.tolerances.extrapolation_time + READING_INTERVAL_MIN_S,
        )

    def _believed(
        self, time: float, length: Array, slipped: Array, sound: int, keep: float
    ) -> LengthReadings:
        """Add a reading that is believed, before which encoders slipped by (n,) [m]."""
        slid, had_slid, slid_at = self.slid + slipped, self.had_slid, self.slid_at
        if slipped.any():
            left = np.linalg.norm(slid - had_slid)
            soon = time - slid_at < self.tolerances.return_time
            if soon and left < JUMP_RETURN_RATIO * np.linalg.norm(slipped):
                slid, slipped = had_slid, had_slid - self.slid
            had_slid, slid_at = self.slid, time
        first = max(0, int(np.searchsorted(self.time, keep, side="right")) - 2)
        return replace(
            self,
            time=np.append(self.time[first:], time),
            length=np.vstack([self.length[first:] + slipped, length]),
            outliers=None,
            sound=sound,
            frozen=np.where(length == self.length[-1], self.frozen + 1, 0),
            slipped=slipped if slipped.any() else None,
            slid=slid,
            had_slid=had_slid,
            slid_at=slid_at,
            slips=self.slips + int(np.count_nonzero(slipped)),
        )

    def held(self, time: float) -> LengthReadings:
        """Repeat the last reading at a later time [s]."""
        return replace(
            self,
            time=np.append(self.time[-1:], time),
            length=np.vstack([self.length[-1:], self.length[-1:]]),
        )

    def at(self, time: float) -> Array:
        """Return the reading at a time [m], shape (n,)."""
        last = self.time[-1]
        if time > last and len(self.time) > 1:
            rate = (self.length[-1] - self.length[-2]) / (last - self.time[-2])
            return np.asarray(
                self.length[-1] + min(time - last, self.tolerances.extrapolation_time) * rate
            )
        k = int(np.clip(np.searchsorted(self.time, time), 1, max(1, len(self.time) - 1)))
        if len(self.time) == 1 or time <= self.time[0]:
            return np.asarray(self.length[0])
        if k > 1 and is_curved(self.time[k - 2 : k + 1], self.tolerances.segment):
            return curved_length(self.time[k - 2 : k + 1], self.length[k - 2 : k + 1], time)
        share = (time - self.time[k - 1]) / (self.time[k] - self.time[k - 1])
        return np.asarray(self.length[k - 1] + share * (self.length[k] - self.length[k - 1]))

    def knots(self, start: float, end: float, short: float) -> list[float]:
        """Return the times between two others at which the path bends [s], with the end.

        Where those are no farther apart than `short` [s], the bend is lost in the noise. A path
        that is curved is cut into segments that are straight enough.
        """
        if end - start <= short:
            return [end]
        inside = self.time[
            (self.time > start + READING_INTERVAL_MIN_S)
            & (self.time < end - READING_INTERVAL_MIN_S)
        ]
        ends: list[float] = []
        for stop in (*inside.tolist(), end):
            ends += segment_ends(ends[-1] if ends else start, stop, self.tolerances.segment)
        return ends
