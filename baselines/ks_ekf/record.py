"""Memory of a belief of the filter."""

from __future__ import annotations

from dataclasses import dataclass

from baselines.ks_ekf.cable_swing import CableSwing
from baselines.ks_ekf.filter_state import KsEkfState
from baselines.ks_ekf.rest_detection import RecentMeasurements
from baselines.ks_ekf.timed_lengths import TimedLengths
from baselines.length_readings import LengthReadings
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.loop.values import Innovations

NO_SWING = CableSwing()


@dataclass(frozen=True, kw_only=True, eq=False)
class KsEkfRecord:
    """Memory of a belief of `KsEkf`; counts are since the last reset.

    Attributes:
        state: The filter itself, at the time of the lengths used last, with its biases.
        reading: The newest lengths whose time has come.
        waiting: Lengths whose time is still to come, in its order.
        window: The last measurements, from which rest is detected.
        encoders: The last lengths as they were read, and by how much encoders have slipped.
        slid: By how much they are believed to have slipped [m], shape (n,).
        innovations: Of the lengths or poses of rest since the last belief, rejected ones left out
            of the squares.
        tension: At the platform [N], shape (n,), when it was last computed, or None.
        swing: Of the cables themselves, when lengths were used last; the tight coupling knows it.
        resting: Whether the platform was found to rest.
        rest_used: When that was used last [s].
        updates: Measurements, the first one included.
        rejected: Measurements of lengths that did not pass the gate, or were held back as no winch
            can have wound them.
        excluded: Measurements of lengths of which one cable contradicted all others and was left
            out.
        misfit_since: When the first of the last lengths that did not fit was read, without any in
            between that did [s]; None where the last ones fit.
        doubts: How often the covariance was raised, after lengths had not fit for long.
        restarts: How often the filter started anew at a pose of rest: where that did not
            help, or as inertial samples came back.
        coasted: Measurements without inertial samples, whose belief is the pose of rest.
        failures: Measurements whose lengths gave no pose of rest where one was needed; the pose
            is then kept.
        late: Measurements of lengths that were older than ones before, and not used.
        slack: Lengths that were left out because the cable was not taut.
        held: Measurements with rest detected that contradicted the rest, and were not used.
    """

    state: KsEkfState
    reading: TimedLengths
    window: RecentMeasurements
    encoders: LengthReadings
    slid: Array
    innovations: Innovations
    waiting: tuple[TimedLengths, ...] = ()
    tension: Array | None = None
    swing: CableSwing = NO_SWING
    resting: bool = False
    rest_used: float = -float("inf")
    updates: int = 0
    rejected: int = 0
    excluded: int = 0
    misfit_since: float | None = None
    doubts: int = 0
    restarts: int = 0
    coasted: int = 0
    failures: int = 0
    late: int = 0
    slack: int = 0
    held: int = 0
