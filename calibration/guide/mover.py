"""Slow moves of a robot whose geometry is hardly known, with tensions kept by feedback.

Lengths alone would stretch or slacken the cables of a robot with more cables than its platform
needs: their errors by wrong exit points are large against how far a cable stretches. So the lengths
follow the geometry as it is known, and what no move of the platform changes (the spare directions
of the lengths) is wound until all tensions are between the lowest and the highest that are used on
purpose. A move slows down as tensions leave that range, waits half-way to a limit, and turns back
where they do not come back. Wherever it ends with taut cables is as good a sample.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np

from calibration.guide.rest import Periods, Stopped
from calibration.guide.samples import Rest
from calibration.guide.settings import GuideSettings
from calibration.self_calibration.balance import force_balance, operating_tensions
from calibration.self_calibration.knowledge import Knowledge, expected_angles, spare_directions
from calibration.self_calibration.safe_tensions import tension_error
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.loop.protocols import Driver
from carosac_toolkit.physics.cable.drum import drums_of
from carosac_toolkit.physics.rest import tension_distribution
from carosac_toolkit.robot.robot import Robot

T = TypeVar("T")
PATH_STEPS = 200  # points of a path at which lengths and spare directions are computed
FEEDBACK_PERIODS = 5  # in which tensions come back
WAIT_PERIODS = 400  # after which a move whose tensions do not come back turns round
SLOWED_SHARE = 0.25  # of the way from a tension used on purpose to its limit: slower from there on
WAITING_SHARE = 0.5  # the same: waits from there on
CREEP_SHARE = 0.1  # of the speed: at either end of a path, and on the way back
PREDICTED_SHARE = 0.5  # of the way to a limit: predicted departure of a tension at full speed
SLACK_SHARE = 0.5  # of the way from a limit to the lowest tension used on purpose: slack below
SLACK_STRAIN_MAX = 0.01  # of a cable: wound in while it, or another, is slack
CARRIED_SHARE = 0.5  # of the weight: sum of tensions below which load cells are wrong
PROBE_SHARE = 0.5  # of the way from a limit to the lowest tension used on purpose: wound to probe
PROBE_PERIODS = 10  # in which tensions follow, and over which they are averaged
PROBE_SEEN_MIN = 0.25  # of the change that is expected: a load cell that shows less is broken
PROBE_LEAST = 0.5  # of the largest change of a tension: cables that change less are not judged
WOUND_RATIO = 2.0  # of the winding that turns a move back: winding that stops the guide


class Mover(Protocol):
    """Whatever takes the platform to a place and reads its sensors there."""

    @property
    def measures_tension(self) -> bool:
        """True if tensions are measured, and kept on the way."""

    def rest(self) -> Rest:
        """Read the sensors of the platform at rest."""

    def move(self, known: Knowledge, start: Array, end: Array) -> str:
        """Go from one place to another by what is known [m]; return why it ended early."""

    def while_holding(self, work: Callable[[], T]) -> T:
        """Compute something while the robot stands still."""


class DriverMover:
    """Moves a robot by its driver."""

    def __init__(
        self, driver: Driver, robot: Robot, settings: GuideSettings, *, real_time: bool
    ) -> None:
        """Take a driver that is connected and lets commands through.

        Args:
            driver: Of one robot.
            robot: As in its file.
            settings: Speeds and times.
            real_time: Whether the driver has to be called while the host computes.
        """
        self._settings, self._real_time = settings, real_time
        self._robot = robot
        self._low, self._high = operating_tensions(robot)
        self._limits = robot.tension_min, robot.tension_max
        self._periods = Periods(driver, settings)
        self._command = np.array(self._periods.measured.unstrained_length[0])

    @property
    def measures_tension(self) -> bool:
        """True if the driver has load cells."""
        return self._periods.measures_tension

    def rest(self) -> Rest:
        """Wait until the platform rests, and return the mean of what the sensors say."""
        return self._periods.rest(self._command)

    def while_holding(self, work: Callable[[], T]) -> T:
        """Compute while the winches hold; in real time the driver goes on meanwhile."""
        if not self._real_time:
            return work()
        with ThreadPoolExecutor(max_workers=1) as pool:
            future = pool.submit(work)
            while not future.done():
                self._pass()
        return future.result()

    def move(self, known: Knowledge, start: Array, end: Array) -> str:
        """Move slowly on a straight line, as far as tensions allow.

        Args:
            known: Present knowledge of the robot.
            start: Where the platform rests, by what is known [m], shape (3,).
            end: Where it should go, or `start` to tighten cables only [m], shape (3,).

        Returns:
            Why the move ended early, or nothing.

        Raises:
            Stopped: The driver does not go on, or load cells do not show what is wound.
        """
        path = self.while_holding(lambda: self._path(known, start, end))
        if path.way and self.measures_tension:
            self._probe(path)
        share, length, waited, back = 0.0, path.length[0], 0, False
        winding = _Winding(self._robot, self._low - self._limits[0])
        while True:
            pull, away = self._correction(path, share)
            change = path.wound(share, pull)
            error = path.tension_error(share)
            back = winding.is_too_much(pull, self._periods.tension, error) or back
            if back and (share <= 0.0 or away < SLOWED_SHARE):
                return "its tensions did not come back"
            if not back and share >= 1.0 and away < SLOWED_SHARE:
                return ""
            room = (WAITING_SHARE - away) / (WAITING_SHARE - SLOWED_SHARE)
            pace = CREEP_SHARE if back else float(np.clip(room, 0.0, 1.0))
            waited = waited + 1 if pace == 0.0 or share >= 1.0 else 0
            back = back or waited > WAIT_PERIODS
            step = pace * path.speed(share) * self._settings.period / path.way if path.way else 1.0
            share = float(np.clip(share - step if back else share + step, 0.0, 1.0))
            following = path.at(share)
            self._command = self._command + following - length + change
            length = following
            self._pass()

    def _probe(self, path: _Path) -> None:
        """Wind a little before a move, and require that every load cell notices.

        Raises:
            Stopped: One does not, though the platform stands still.
        """
        _, spare, _ = path.point(0.0)
        pull = spare @ spare.sum(axis=0)
        pull = pull * np.sign(pull.sum())
        pull = pull * PROBE_SHARE * float((self._low - self._limits[0]).min()) / np.abs(pull).max()
        before = self._averaged()
        for _ in range(PROBE_PERIODS):
            self._command = self._command + path.wound(0.0, pull / PROBE_PERIODS)
            self._pass()
        change = self._averaged() - before
        judged = np.abs(pull) >= PROBE_LEAST * np.abs(pull).max()
        seen = np.where(judged, change / pull, 1.0)
        k = int(np.argmin(seen))
        if seen[k] < PROBE_SEEN_MIN:
            raise Stopped(
                f"the load cell of cable {self._robot.cable_names[k]} shows {change[k]:+.2g} N "
                f"where winding should make {pull[k]:+.2g} N: look at cell and cable"
            )

    def _averaged(self) -> Array:
        """Return the mean tensions, once they have followed the last command [N], shape (n,)."""
        readings = []
        for k in range(2 * PROBE_PERIODS):
            self._pass()
            if k >= PROBE_PERIODS and self._periods.tension is not None:
                readings.append(self._periods.tension)
        return np.asarray(np.mean(readings, axis=0))

    def _pass(self) -> None:
        """Send the command and let one period pass.

        With tensions the next command follows from what limits have let through, so that nothing
        is held back to be wound later; without, the lengths of all cables must keep together.

        Raises:
            Stopped: The driver does not go on.
        """
        sent = self._periods.one(self._command)
        if sent is not None and self.measures_tension:
            self._command = sent

    def _correction(self, path: _Path, share: float) -> tuple[Array, float]:
        """Return the change of tensions to be wound, and how far off they are.

        The wanted tensions balance the same force as the measured ones, so that a wrong weight
        does no harm.

        Returns:
            Change [N], shape (n,), in the spare directions, and the largest departure from the
            tensions used on purpose, as a share of the way to the limit.
        """
        now = self._periods.tension
        if now is None:
            return np.zeros(len(self._low)), 0.0
        matrix, spare, _ = path.point(share)
        low, high = self._limits
        away = float(
            np.maximum(
                (self._low - now) / (self._low - low), (now - self._high) / (high - self._high)
            ).max()
        )
        wanted = _wanted(now, matrix, spare, self._low, self._high)
        if wanted is None:  # no winding helps
            return np.zeros(len(self._low)), max(away, WAITING_SHARE)
        return spare @ (spare.T @ (wanted - now)) / FEEDBACK_PERIODS, away

    def _path(self, known: Knowledge, start: Array, end: Array) -> _Path:
        """Compute lengths and spare directions along a line, as they are known."""
        share = np.linspace(0.0, 1.0, PATH_STEPS + 1)[:, None]
        place = start + share * (end - start)
        problem, robot = known.problem, known.problem.robot
        matrix, _ = force_balance(problem, known.shared, place)
        straight, _ = problem.straight(known.shared, place)
        drums = drums_of(robot)
        reference = drums.motor_angle(problem.prior.mean[problem.zeros])
        settings, way = self._settings, float(np.linalg.norm(end - start))
        speed = settings.speed
        error = tension_error(known, start, place)
        if way > 0.0:
            rate = float(error[-1]) / 3.0 / way  # 1 sigma, N per metre
            room = PREDICTED_SHARE * float((self._low - self._limits[0]).min())
            speed = min(speed, room / (rate * FEEDBACK_PERIODS * settings.period))
        return _Path(
            length=drums.length(expected_angles(known, place) + reference),
            matrix=matrix,
            spare=spare_directions(matrix[:, :3].swapaxes(1, 2)),
            softness=(straight + robot.run_length) / robot.axial_stiffness,
            error=error,
            way=way,
            speed_max=max(speed, CREEP_SHARE * settings.speed),
            acceleration=settings.acceleration,
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class _Path:
    """Lengths by the drums of the robot file, structure and spare directions along a path."""

    length: Array
    matrix: Array
    spare: Array
    softness: Array
    error: Array
    way: float
    speed_max: float
    acceleration: float

    def at(self, share: float) -> Array:
        """Return the lengths at a share of the way [m], shape (n,)."""
        k = min(int(share * PATH_STEPS), PATH_STEPS - 1)
        part = share * PATH_STEPS - k
        return np.asarray((1.0 - part) * self.length[k] + part * self.length[k + 1])

    def point(self, share: float) -> tuple[Array, Array, Array]:
        """Return structure matrix (6, n), spare directions (n, n - 3), m per N of each cable."""
        k = round(share * PATH_STEPS)
        return self.matrix[k], self.spare[k], self.softness[k]

    def wound(self, share: float, pull: Array) -> Array:
        """Return the change of lengths [m] that changes tensions in the spare directions [N]."""
        _, spare, softness = self.point(share)
        return np.asarray(-spare @ ((spare.T * softness) @ spare) @ (spare.T @ pull))

    def tension_error(self, share: float) -> float:
        """Return three standard deviations of tensions by lengths alone, since the start [N]."""
        return float(self.error[round(share * PATH_STEPS)])

    def speed(self, share: float) -> float:
        """Return the speed from rest to rest [m/s]."""
        left = min(share, 1.0 - share) * self.way
        limit = np.sqrt(2.0 * self.acceleration * left)
        return float(np.clip(limit, CREEP_SHARE * self.speed_max, self.speed_max))


class _Winding:
    """What a move has wound to keep tensions, as the change that it should have made to them."""

    def __init__(self, robot: Robot, margin: Array) -> None:
        """Begin a move; `margin`: winding that a load cell must notice [N], shape (n,)."""
        self._robot, self._margin = robot, margin
        self._total, self._unseen = np.zeros(robot.n), np.zeros(robot.n)
        self._taken = np.zeros(robot.n)  # strain, while cables were slack
        self._shown: Array | None = None
        self._allowed = 0.0

    def is_too_much(self, pull: Array, tension: Array | None, error: float) -> bool:
        """Return whether wrong lengths no longer explain what was wound.

        Args:
            pull: Winding of this period [N], shape (n,).
            tension: Measured [N], shape (n,), or None.
            error: Largest change of a tension by lengths alone, as predicted [N].

        Raises:
            Stopped: A load cell does not notice the winding, or it is far too much.
        """
        if tension is None:
            return False
        self._check_sum(tension)
        slack = tension < self._robot.tension_min + SLACK_SHARE * self._margin
        same = self._shown is not None and (tension == self._shown) & (not slack.any())
        self._unseen, self._shown = np.where(same, self._unseen + pull, 0.0), tension
        stuck = np.flatnonzero(np.abs(self._unseen) > self._margin)
        if len(stuck):
            k = int(stuck[0])
            raise Stopped(
                f"the load cell of cable {self._robot.cable_names[k]} shows {tension[k]:.4g} N "
                f"all the time, though the cable was wound by {abs(self._unseen[k]):.3g} N: it "
                "is stuck"
            )
        if slack.any():
            self._take_in(pull, int(np.argmin(tension)), float(tension.min()))
            return False
        self._total = self._total + pull
        self._allowed = max(self._allowed, error + self._robot.weight)
        wound = float(np.abs(self._total).max())
        if wound > WOUND_RATIO * self._allowed:
            raise Stopped(
                f"cables were wound by {wound:.3g} N to keep their tensions, where "
                f"{self._allowed:.3g} N were expected: look at load cells and cables"
            )
        return wound > self._allowed

    def _check_sum(self, tension: Array) -> None:
        """Require that cables carry the platform: together they pull more than it weighs."""
        carried, weight = float(tension.sum()), self._robot.weight
        if carried < CARRIED_SHARE * weight:
            raise Stopped(
                f"the load cells show {carried:.3g} N in all, and the platform weighs "
                f"{weight:.3g} N: it does not hang free, or they are wrong"
            )

    def _take_in(self, pull: Array, k: int, tension: float) -> None:
        """Count what is wound while cables are slack, the slackest of them cable k."""
        self._taken = self._taken + pull / self._robot.axial_stiffness
        if np.abs(self._taken).max() > SLACK_STRAIN_MAX:
            raise Stopped(
                f"cable {self._robot.cable_names[k]} shows {tension:.3g} N still, though "
                f"{100 * SLACK_STRAIN_MAX:g} % of a cable was wound in: pull it taut by hand, and "
                "look at its load cell"
            )


def _wanted(now: Array, matrix: Array, spare: Array, low: Array, high: Array) -> Array | None:
    """Return the least tensions in a range that balance what others balance, or None [N], (n,)."""
    if spare.shape[1] == 1:  # of every robot with one cable more than it needs: by far the quickest
        along = spare[:, 0]
        ends = np.sort(np.stack([low - now, high - now]) / np.where(along == 0.0, 1e-12, along), 0)
        least, most = ends[0].max(), ends[1].min()
        return None if least > most else now + along * np.clip(-along @ now, least, most)
    force = np.zeros((1, 6))
    force[:, :3] = -(matrix[:3] @ now)
    found = tension_distribution.solve(matrix[None], force, low, high, arm=1.0)
    return np.asarray(found.tension[0]) if found.feasible[0] else None
