"""Homing of a guard: offsets of the cables, found while the winches stand still."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.loop.drive_state import DriveState
from carosac_toolkit.loop.protocols import SupportsHoming
from carosac_toolkit.loop.values import Measurement, State
from carosac_toolkit.physics.rest.homing import homing_lengths
from carosac_toolkit.safety.guard.home_check import HomeEvidence, home_evidence
from carosac_toolkit.safety.guard.lifecycle import NotReady
from carosac_toolkit.safety.guard.monitor import Monitor

HOMING_SAMPLES = 10  # of which the mean is homed: a third of the noise of one
SENSED_TIME_S = 1.0  # of which load cells and IMU are averaged for a home anew: it may vibrate
STANDING_CHANGE_MAX_M = 0.003  # fifteen times the noise of an encoder


class Homing:
    """Homing of one robot of n cables.

    Attributes:
        change: Change of the readings by the last homing [m], shape (n,), or None.
        evidence: What the senses say of the last home that was homed anew, or None.
    """

    def __init__(self, monitor: Monitor) -> None:
        """Home the robot of a monitor."""
        self._monitor = monitor
        self.change: Array | None = None
        self.evidence: HomeEvidence | None = None
        self._standing: list[Measurement] = []

    def home(self, position: State, *, anew: bool, confirmed: bool) -> None:
        """Find the offset of each cable; see `GuardedDriver.home`."""
        monitor = self._monitor
        lengths = homing_lengths(monitor.robot, position)
        samples = HOMING_SAMPLES
        if anew:
            samples = max(samples, round(SENSED_TIME_S / monitor.settings.period))
        change = lengths - self.standing_still(samples)
        far = float(np.abs(change).max()) > monitor.settings.home_change_max
        if anew:
            self._check_senses(position, confirmed=confirmed or not far)
        else:
            self._check_change(change)
        if isinstance(monitor.inner, SupportsHoming):
            monitor.inner.home(replace(position, unstrained_length=lengths[None]))
        else:
            monitor.offset = monitor.offset + change
        monitor.restart_checks()
        monitor.checks.first_way |= far
        monitor.lifecycle.go(DriveState.HOMED)
        self.change = change
        changes = ", ".join(f"{x:+.4f}" for x in change)
        monitor.event("home", f"readings changed by {changes} m")
        monitor.measure()

    def start(self) -> State:
        """Return the pose by which `enable_at_once` homes."""
        robot, point = self._monitor.robot, self._monitor.settings.start_position
        position = robot.home_position if point is None else np.asarray(point, dtype=float)
        rotation = robot.home_rotation
        return State(
            time=np.zeros(1), position=position.reshape(1, 3), rotation=rotation.reshape(1, 3, 3)
        )

    def standing_still(self, samples: int = HOMING_SAMPLES) -> Array:
        """Return the mean of some samples of winches that stand [m], shape (n,).

        Raises:
            NotReady: A fault, or lengths that change.
        """
        monitor = self._monitor
        self._standing = []
        for _ in range(samples):
            self._standing.append(monitor.measure())
            monitor.pass_period()
            if monitor.lifecycle.fault is not None:
                raise NotReady(str(monitor.lifecycle.fault))
        lengths = [measurement.unstrained_length[0] for measurement in self._standing]
        moved = float(np.ptp(lengths, axis=0).max())
        if moved > STANDING_CHANGE_MAX_M:
            allowed = f"allowed: {STANDING_CHANGE_MAX_M:g} m"
            raise NotReady(f"the winches do not stand still: {moved:.4f} m of change; {allowed}")
        return np.asarray(np.mean(lengths, axis=0))

    def _check_senses(self, home: State, *, confirmed: bool) -> None:
        """Refuse a home that the senses contradict, or that nobody and nothing can vouch for."""
        monitor = self._monitor
        settings = monitor.settings
        self.evidence = evidence = home_evidence(
            monitor.robot, home, self._standing, settings.senses
        )
        where = " ".join(f"{x:.3f}" for x in home.position[0]) + " m"
        monitor.event("home_check", evidence.sensitivity)
        if evidence.contradicts:
            raise NotReady(
                f"home: {' and '.join(evidence.senses)} contradict a platform at rest at {where}: "
                f"{evidence.worst}; all readings together are {evidence.deviation:.1f} standard "
                f"deviations off, allowed: {evidence.limit:.1f}. Let it hang without sway and "
                "measure its position again; check the mass in the robot file and the errors of "
                "the sensors (senses)"
            )
        if not (confirmed or evidence.detectable_worst <= settings.workspace_margin):
            raise NotReady(
                f"home: {evidence.sensitivity}; needed: {settings.workspace_margin:g} m in every "
                f"direction, or a person's word. Measure again that the platform is at {where}, "
                "then confirm it (home_confirmed, --home-confirmed)"
            )

    def _check_change(self, change: Array) -> None:
        """Refuse to change an offset by more than an everyday homing does."""
        i, change_max = int(np.argmax(np.abs(change))), self._monitor.settings.home_change_max
        if abs(change[i]) > change_max:
            cable = self._monitor.robot.cable_names[i]
            raise NotReady(
                f"home: the offset of cable '{cable}' would change by {change[i]:+.3f} m; allowed: "
                f"{change_max:g} m. Is the platform at the pose that was given? Where that was "
                "measured, home anew (home_anew, --home-anew)"
            )
