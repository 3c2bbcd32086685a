"""Errors of simulated recordings, and their derivatives by differences."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from calibration.identification.open_loop import OpenLoopRun, OpenLoopStart, simulate_runs
from calibration.identification.runs import FittedRun
from calibration.identification.unknowns import Coordinates
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import CarosacError, InvalidField
from carosac_toolkit.robot.robot import Robot


class RunSimulator:
    """Simulates robots of some coordinates through recordings, all that are alike in one batch."""

    def __init__(
        self, unknowns: Coordinates, own: Sequence[NDArray[np.int64]], names: Sequence[str]
    ) -> None:
        """Take what coordinates stand for.

        Args:
            unknowns: The first k of all coordinates, those of the robot.
            own: Rows of the coordinates that each run depends on, those of the robot first.
            names: Of all coordinates, for messages.
        """
        self._unknowns = unknowns
        self._own = own
        self._names = names
        self._count = len(unknowns.prior.names)

    def errors(
        self,
        runs: Sequence[FittedRun],
        points: Sequence[Array],
        time_step: float,
        *,
        refined: int = 1,
    ) -> tuple[list[Array], list[NDArray[np.bool_]]]:
        """Simulate robots as `pose_errors` does, and return errors as each run sees them.

        Of each run `points` are of all coordinates, shape (B, all coordinates), and its errors
        (B, K', 6).
        """
        own = [each[:, rows] for each, rows in zip(points, self._own, strict=True)]
        errors, exists = self.pose_errors(runs, own, time_step, refined=refined)
        pairs = zip(runs, errors, strict=True)
        return [np.array([run.seen(one) for one in each]) for run, each in pairs], exists

    def pose_errors(
        self,
        runs: Sequence[FittedRun],
        points: Sequence[Array],
        time_step: float,
        *,
        refined: int = 1,
    ) -> tuple[list[Array], list[NDArray[np.bool_]]]:
        """Simulate robots at coordinates, for each run of its own, and compare all poses.

        Args:
            runs: In the order of the coordinates.
            points: Of each run, coordinates of the robot and then of its start, shape (B, p).
            time_step: At most [s].
            refined: Steps that each of these is divided into.

        Returns:
            Of each run: errors of all poses (B, K, 6), and which robots exist and have a finite
            motion (B,).
        """
        known: dict[bytes, Robot | None] = {}
        jobs, exists = [], []
        for run, each in zip(runs, points, strict=True):
            robots = [self._robot(point[: self._count], known) for point in each]
            exists.append(np.array([robot is not None for robot in robots]))
            start = OpenLoopStart(sway=run.sway, coordinates=each[:, self._count :])
            jobs.append(
                OpenLoopRun(
                    robots=[robot or self._unknowns.robot for robot in robots],
                    path=run.path,
                    time=run.poses.time,
                    start=start,
                )
            )
        errors = []
        for k, motion in enumerate(simulate_runs(jobs, time_step=time_step, refined=refined)):
            seen = motion.seen_by(self._unknowns.robot, jobs[k].robots)
            exists[k] &= ~motion.failed
            errors.append(
                np.array([
                    runs[k].poses.errors(seen.position[:, b], seen.rotation[:, b])
                    for b in range(len(points[k]))
                ])
            )  # fmt: skip
        return errors, exists

    def slopes(
        self,
        runs: Sequence[FittedRun],
        at: Array,
        varied: Sequence[NDArray[np.int64]],
        *,
        size: float,
        time_step: float,
        refined: int = 1,
    ) -> list[Array]:
        """Return differences of errors over short changes of one coordinate each.

        Args:
            runs: In the order of the coordinates.
            at: All coordinates.
            varied: Rows of those that each run is differenced by.
            size: Of each change.
            time_step: At most [s].
            refined: Steps that each of these is divided into.

        Returns:
            Of each run, shape (K, 6, p).

        Raises:
            CarosacError: A robot that does not move.
        """
        points = []
        for rows in varied:
            ends = np.tile(at, (1 + len(rows), 1))
            ends[1:, rows] += size * np.eye(len(rows))
            points.append(ends)
        errors, good = self.errors(runs, points, time_step, refined=refined)
        jacobians = []
        for k, (rows, each) in enumerate(zip(varied, errors, strict=True)):
            self._check_motion(good[k], rows)
            jacobians.append(self.by_coordinates(k, rows, (each[1:] - each[0]) / size))
        return jacobians

    def _check_motion(self, sound: NDArray[np.bool_], rows: NDArray[np.int64]) -> None:
        """Refuse a robot that does not move, here or with another value of a coordinate.

        Args:
            sound: Which robots have a finite motion, the first here, shape (1 + p,).
            rows: Of the p coordinates that change, one after the other.

        Raises:
            CarosacError: With the coordinate that changes.
        """
        if not sound.all():
            row = int(np.argmin(sound)) - 1
            beside = "" if row < 0 else f" with another {self._names[rows[row]]}"
            raise CarosacError(f"identification: no finite motion of the robot{beside}")

    def by_coordinates(self, k: int, rows: NDArray[np.int64], slopes: Array) -> Array:
        """Return derivatives (K, 6, p) of a run's errors by all that it depends on.

        Args:
            k: Run.
            rows: Of the p' coordinates that change; derivatives by the others are 0.
            slopes: By these, shape (p', K, 6).
        """
        jacobian = np.zeros((*slopes.shape[1:], len(self._own[k])))
        jacobian[:, :, np.isin(self._own[k], rows)] = np.moveaxis(slopes, 0, 2)
        return jacobian

    def _robot(self, coordinates: Array, known: dict[bytes, Robot | None]) -> Robot | None:
        """Return the robot of some coordinates (k,), made once; None where there is none."""
        key = coordinates.tobytes()
        if key not in known:
            try:
                known[key] = self._unknowns.robot_at(coordinates)
            except InvalidField:
                known[key] = None
        return known[key]
