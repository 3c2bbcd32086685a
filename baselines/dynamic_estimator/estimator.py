"""The estimator `dynamic_estimator`."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from baselines.center_of_mass import learned_center_of_mass
from baselines.dynamic_estimator.filter_state import DynamicFilterState
from baselines.dynamic_estimator.settings import DynamicEstimatorSettings, settings_for
from baselines.dynamic_estimator.tracker import Track, Tracker
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.base.extras import require
from carosac_toolkit.loop.values import Belief, Command, Innovations, Measurement
from carosac_toolkit.robot.robot import Robot


@dataclass(frozen=True, kw_only=True, eq=False)
class DynamicRecord:
    """Memory of a belief of `DynamicEstimator`.

    Attributes:
        converged: Whether the belief's pose is that of the filter, shape (B,). Where it is False,
            the filter does not stand anywhere, and the pose is the last one, or home.
        innovations: What IMU and poses said against the filter since the last belief.
        updates: Measurements since the last reset, the first one included.
        restarts: How often the platform was hung anew on measured lengths, shape (B,).
        outliers: Length readings that were not believed, shape (B,).
        slips: How often an encoder slipped, shape (B,).
        stale: How often lengths were held for want of readings, shape (B,).
        tracks: State of the filter of each robot.
    """

    converged: NDArray[np.bool_]
    innovations: Innovations
    updates: int
    restarts: NDArray[np.int64]
    outliers: NDArray[np.int64]
    slips: NDArray[np.int64]
    stale: NDArray[np.int64]
    tracks: tuple[Track, ...]


class DynamicEstimator:
    """Platform dynamics driven by the measured lengths, in an extended Kalman filter.

    Lengths alone give an open-loop simulation that starts at rest: sway is in it, as it follows
    from how the cables were wound. IMU and poses correct it where the suite has them. States beside
    pose and twist are the wind, mass and centre of mass, biases of the length readings and of the
    IMU. Lengths count when they were read; the belief is of the time of the measurement, to which
    the last of them are extrapolated.
    """

    Settings: ClassVar = DynamicEstimatorSettings

    def __init__(self, robot: Robot, settings: DynamicEstimatorSettings) -> None:
        require("the dynamic estimator", "pinocchio")
        settings = settings_for(robot, settings)
        self._robot = robot
        self._tracker = Tracker(robot, settings)
        self._settings = settings

    @classmethod
    def build(
        cls, robot: Robot, settings: DynamicEstimatorSettings | None = None, *, seed: int = 0
    ) -> DynamicEstimator:
        """Make one for the nominal robot; it draws no random numbers, so `seed` has no effect."""
        return cls(robot, settings or DynamicEstimatorSettings())

    def reset(self, measurement: Measurement) -> Belief:
        """Hang the platforms at rest on the first lengths."""
        return self._first_belief(measurement, self._at_rest(measurement))

    def reset_moving(self, measurement: Measurement, first: Belief) -> Belief:
        """Start on the first lengths from poses and twists at that time, one for each robot."""
        tracks = tuple(
            self._tracker.moving(track, measurement, row, first)
            for row, track in enumerate(self._at_rest(measurement))
        )
        return self._first_belief(measurement, tracks)

    def _at_rest(self, measurement: Measurement) -> tuple[Track, ...]:
        """Return new tracks, at rest."""
        size = len(measurement.unstrained_length)
        measurement.lengths_of(size, self._robot.n)
        return tuple(self._tracker.start(measurement, row) for row in range(size))

    def _first_belief(self, measurement: Measurement, tracks: tuple[Track, ...]) -> Belief:
        """Return the belief of new tracks."""
        size = len(tracks)
        home = Belief(
            time=measurement.time,
            position=np.tile(self._robot.home_position, (size, 1)),
            rotation=np.tile(self._robot.home_rotation, (size, 1, 1)),
        )
        return _belief(measurement, tracks, home, 1, self._settings)

    def update(self, belief: Belief, command: Command, measurement: Measurement) -> Belief:
        """Move the filter to the time of a measurement; the command is not used.

        Raises:
            InvalidField: Another number of robots or cables than at the reset, or a measurement
                that is not later than the last one.
        """
        record: DynamicRecord = belief.memory
        measurement.lengths_of(len(record.tracks), self._robot.n)
        late = ~(measurement.time > belief.time)
        if late.any():
            row = int(np.argmax(late))
            got = f"{measurement.time[row]} s after {belief.time[row]} s"
            raise InvalidField(f"measurement.time[{row}]", got, "later than the last one")
        tracks = tuple(
            self._tracker.advance(track, measurement, row)
            for row, track in enumerate(record.tracks)
        )
        return _belief(measurement, tracks, belief, record.updates + 1, self._settings)


def _belief(
    measurement: Measurement,
    tracks: tuple[Track, ...],
    before: Belief,
    updates: int,
    settings: DynamicEstimatorSettings,
) -> Belief:
    """Return the belief of the filters; where one is lost, keep what was believed before."""
    now = [track.now for track in tracks]
    good = np.array([state is not None for state in now])
    record = DynamicRecord(
        converged=good,
        innovations=Innovations(
            squares=np.array([track.tally.squares for track in tracks]),
            dof=np.array([float(track.tally.dof) for track in tracks]),
            rejected=np.array([float(track.tally.disturbed) for track in tracks]),
        ),
        updates=updates,
        restarts=np.array([track.restarts for track in tracks]),
        outliers=np.array([track.readings.rejected for track in tracks]),
        slips=np.array([track.readings.slips for track in tracks]),
        stale=np.array([track.stale for track in tracks]),
        tracks=tracks,
    )
    known = [state for state in now if state is not None]
    if len(known) < len(now):
        return replace(
            before, time=measurement.time, memory=record, converged=good,
            innovations=record.innovations,
            position=_kept(now, "position", before.position),
            rotation=_kept(now, "rotation", before.rotation),
            twist=None, covariance=None, tension=None, center_of_mass=None,
        )  # fmt: skip
    return Belief(
        time=measurement.time,
        position=np.stack([state.position for state in known]),
        rotation=np.stack([state.rotation for state in known]),
        twist=np.stack([state.twist for state in known]),
        covariance=np.stack(
            [
                state.platform_covariance(settings.stretch_deviation, settings.rate_noise)
                for state in known
            ]
        ),
        tension=np.stack([state.tension for state in known]),
        center_of_mass=_centers(known, settings.center_of_mass),
        innovations=record.innovations,
        converged=good,
        memory=record,
    )


def _centers(states: list[DynamicFilterState], prior: float) -> Array | None:
    """Return the centres of mass if all have been learned, else None."""
    centers = []
    for state in states:
        where = state.errors.center
        centers.append(learned_center_of_mass(state.center, state.covariance[where, where], prior))
    return None if any(center is None for center in centers) else np.array(centers)


def _kept(now: list[DynamicFilterState | None], name: str, before: Array) -> Array:
    """Return a field of the states that exist, and its earlier belief for the others."""
    return np.stack([
        before[row] if state is None else getattr(state, name) for row, state in enumerate(now)
    ])  # fmt: skip
