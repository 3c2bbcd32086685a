"""The simulator on recorded lengths alone: many robots at once, seen when poses were measured.

Readings are smoothed first. Their noise would shake the simulated platform, and a fit would then
rather detune its modes than find them. Cables are quasi-static catenaries: waves in cables of
particles grow differently in robots that differ by a millionth, and no derivative survives that.
"""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.identification.sway import FreeSway, swaying_states
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import CarosacError, InvalidField
from carosac_toolkit.base.scaled import Scaled
from carosac_toolkit.loop.values import Pose
from carosac_toolkit.physics.fleet import Fleet
from carosac_toolkit.physics.motion.winch import lagging_lengths
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.physics.rest.statics import Equilibrium
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.recordings.encoders import unstrained_lengths
from carosac_toolkit.recordings.length_path import LengthPath
from carosac_toolkit.robot.parameters import turn_between
from carosac_toolkit.robot.robot import Robot
from sim_warp import Simulator

LENGTH_GRID = Scaled(0.05, "s", most=0.05)  # lengths go straight over no longer time
STEP_ROUNDING = 1e-6  # share of a time step
TIME_ROUNDING_S = 1e-9  # [s]: less is rounding
WORLDS_PER_THREAD_MIN = 16  # fewer worlds are not worth a thread of their own


@dataclass(frozen=True, kw_only=True, eq=False)
class OpenLoop:
    """Motion of B robots, sampled at K times.

    Attributes:
        position: Platform origins in W [m], shape (K, B, 3).
        rotation: From P to W, shape (K, B, 3, 3).
        failed: Worlds without a finite motion, shape (B,); they are shown at the origin.
    """

    position: Array
    rotation: Array
    failed: NDArray[np.bool_]

    def seen_by(self, robot: Robot, robots: Sequence[Robot]) -> OpenLoop:
        """Return the motion of B robots, each in its own W, in W of one, by how they see poses."""
        back = np.array([turn_between(each, robot) for each in robots])
        return OpenLoop(
            position=np.einsum("bij,kbj->kbi", back, self.position),
            rotation=back @ self.rotation,
            failed=self.failed,
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class OpenLoopStart:
    """Sway of B robots at the first reading.

    Attributes:
        sway: Free directions.
        coordinates: Of each robot, as the sway has them, shape (B, k).
    """

    sway: FreeSway
    coordinates: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class OpenLoopRun:
    """B robots that wind on as one recording says.

    Attributes:
        robots: B robots.
        path: Readings.
        time: When to look, increasing, not before the first reading, shape (K,).
        start: Sway at the first reading; None: at rest.
    """

    robots: Sequence[Robot]
    path: LengthPath
    time: Array
    start: OpenLoopStart | None = None


def first_equilibrium(robot: Robot, path: LengthPath) -> Equilibrium:
    """Return where a robot hangs at rest on the first lengths.

    Raises:
        CarosacError: It cannot.
    """
    lengths = _lengths([robot], path, np.array([path.first]))[0]
    rest = statics.forward_kinematics(robot, lengths)
    if not (rest.converged & rest.stable).all():
        raise CarosacError("the robot cannot hang at rest on the first recorded lengths")
    return rest


def simulate(
    robots: Sequence[Robot],
    path: LengthPath,
    time: Array,
    *,
    time_step: float,
    start: OpenLoopStart | None = None,
) -> OpenLoop:
    """Simulate robots on one recording; see `simulate_runs`.

    Args:
        robots: B robots.
        path: Readings.
        time: When to look, increasing, not before the first reading, shape (K,).
        time_step: Of the simulator, at most [s].
        start: Sway at the first reading; None: at rest.

    Raises:
        CarosacError: The first robot cannot hang on the first lengths.
    """
    run = OpenLoopRun(robots=robots, path=path, time=time, start=start)
    return simulate_runs([run], time_step=time_step)[0]


def simulate_runs(
    runs: Sequence[OpenLoopRun], *, time_step: float, refined: int = 1
) -> list[OpenLoop]:
    """Let platforms hang on the first lengths, and wind on as recorded; each is seen in its own W.

    They start displaced from the equilibrium and with a speed as `start` says, and move with the
    winches; without it they start at rest. What each robot says of its length sensors turns
    readings into lengths, late by their delay. Runs that are sampled alike share a batch of worlds,
    and the batch is divided among the processor's cores.

    Args:
        runs: R runs, each with robots of its own.
        time_step: Of the simulator, at most [s].
        refined: Steps that each of these is divided into.

    Returns:
        One motion a run.

    Raises:
        CarosacError: The first robot of a run cannot hang on the first lengths.
    """
    drives = [_Drive.of(run) for run in runs]
    motions: list[OpenLoop | None] = [None] * len(runs)
    for members in _alike(drives):
        together = _simulate_alike(
            [runs[r] for r in members], [drives[r] for r in members], time_step, refined
        )
        for r, motion in zip(members, together, strict=True):
            motions[r] = motion
    return [motion for motion in motions if motion is not None]


@dataclass(frozen=True, kw_only=True, eq=False)
class _Drive:
    """Lengths of B worlds at M times.

    Attributes:
        when: Since the first reading [s], shape (M,).
        rows: Which of them are looked at, shape (K,).
        lengths: Unstrained [m], shape (M, B, n).
    """

    when: Array
    rows: NDArray[np.int64]
    lengths: Array

    @classmethod
    def of(cls, run: OpenLoopRun) -> _Drive:
        """Return the lengths of a run."""
        first = run.path.first
        if run.start is not None and run.start.sway.begin is not None:
            first = run.start.sway.begin
        seen = run.time - first
        when = _evenly(seen, LENGTH_GRID.of(Scales(run.robots[0]).ratios))
        return cls(
            when=when,
            rows=np.searchsorted(when, seen - TIME_ROUNDING_S),
            lengths=_lengths(run.robots, run.path, first + when),
        )

    def continues(self, other: _Drive) -> bool:
        """Return True if the times begin with those of another one."""
        count = len(other.when)
        if len(self.when) < count:
            return False
        return bool(np.abs(self.when[:count] - other.when).max() <= TIME_ROUNDING_S)

    def held(self, count: int) -> Array:
        """Return lengths at `count` times, held after the last."""
        missing = count - len(self.when)
        return np.concatenate([self.lengths, np.repeat(self.lengths[-1:], missing, axis=0)])


def _evenly(seen: Array, step: float) -> Array:
    """Return times from 0 on (M,) that divide the intervals of others (K,) evenly.

    Intervals of very different lengths would end the memory of the integrator, and damp the motion.
    """
    edges = np.concatenate([[0.0], seen])
    edges = edges[np.concatenate([[True], np.diff(edges) > TIME_ROUNDING_S])]
    width = np.diff(edges)
    parts = np.ceil(width / step - TIME_ROUNDING_S).astype(np.int64)
    part = np.arange(parts.sum()) - np.repeat(np.cumsum(parts) - parts, parts)
    inner = np.repeat(edges[:-1], parts) + part * np.repeat(width / parts, parts)
    return np.append(inner, seen[-1])


def _alike(drives: Sequence[_Drive]) -> list[list[int]]:
    """Return groups of drives whose times begin alike, the longest first."""
    groups: list[list[int]] = []
    for r in sorted(range(len(drives)), key=lambda r: -len(drives[r].when)):
        for group in groups:
            if drives[group[0]].continues(drives[r]):
                group.append(r)
                break
        else:
            groups.append([r])
    return groups


def _simulate_alike(
    runs: Sequence[OpenLoopRun], drives: Sequence[_Drive], time_step: float, refined: int
) -> list[OpenLoop]:
    """Simulate runs whose times begin alike, the longest first."""
    when = drives[0].when
    robots = [robot for run in runs for robot in run.robots]
    lengths = np.concatenate([drive.held(len(when)) for drive in drives], axis=1)
    edges = np.cumsum([0] + [len(run.robots) for run in runs])
    runs_of = np.repeat(np.arange(len(runs)), np.diff(edges))
    looked = np.unique(np.concatenate([drive.rows for drive in drives]))

    def wind(rows: NDArray[np.int64]) -> OpenLoop:
        """Simulate the worlds of some rows, in a thread of their own."""
        own, fleet = np.ascontiguousarray(lengths[:, rows]), Fleet([robots[b] for b in rows])
        given = [
            None if start is None else (start.sway, start.coordinates[b - edges[r]])
            for b, r in zip(rows, runs_of[rows], strict=True)
            for start in [runs[r].start]
        ]
        starts = _Starts.of(fleet, given, own[: min(2, len(when))], when)
        starts.check(np.isin(rows, edges[:-1]))
        return _Worlds(fleet.robots, own, starts, time_step, refined).wind(when, looked)

    chunks = np.array_split(np.arange(len(robots)), _threads(len(robots)))
    with ThreadPoolExecutor(len(chunks)) as pool:
        parts = list(pool.map(wind, chunks))
    position = np.concatenate([part.position for part in parts], axis=1)
    rotation = np.concatenate([part.rotation for part in parts], axis=1)
    failed = np.concatenate([part.failed for part in parts])
    motions = []
    for k, drive in enumerate(drives):
        seen, own = np.searchsorted(looked, drive.rows), slice(edges[k], edges[k + 1])
        motions.append(
            OpenLoop(position=position[seen, own], rotation=rotation[seen, own], failed=failed[own])
        )
    return motions


def _threads(worlds: int) -> int:
    """Return among how many cores worlds are divided."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return max(1, min(cores or 1, worlds // WORLDS_PER_THREAD_MIN))


@dataclass(frozen=True, kw_only=True, eq=False)
class _Starts:
    """Where B worlds start.

    Attributes:
        hangs: True where a world hangs at rest on its first lengths, shape (B,).
        moves: True where it starts from the pose and twist given here, shape (B,).
        position: [m], shape (B, 3).
        rotation: From P to W, shape (B, 3, 3).
        twist: Shape (B, 6).
        status: Of the search for rest, an index into `statics.STATUS_REASONS`, shape (B,).
    """

    hangs: NDArray[np.bool_]
    moves: NDArray[np.bool_]
    position: Array
    rotation: Array
    twist: Array
    status: NDArray[np.int32]

    @classmethod
    def of(
        cls,
        fleet: Fleet,
        given: Sequence[tuple[FreeSway, Array] | None],
        lengths: Array,
        when: Array,
    ) -> _Starts:
        """Find where worlds hang on the first of some lengths, and move them by their sway.

        Args:
            fleet: B robots.
            given: Free directions and coordinates of each start; None: at rest.
            lengths: At the first one or two times, shape (1 or 2, B, n).
            when: Times.
        """
        rest = statics.forward_kinematics(fleet, lengths[0])
        hangs = rest.converged & rest.stable
        rate = np.zeros_like(lengths[0])
        if len(lengths) > 1:
            rate = (lengths[1] - lengths[0]) / (when[1] - when[0])
        position, rotation = rest.position.copy(), rest.rotation.copy()
        twist = np.zeros((len(fleet), 6))
        moves = hangs & np.array([start is not None for start in given])
        which = np.flatnonzero(moves)
        if len(which):
            starts = [start for start, go in zip(given, moves, strict=True) if start and go]
            position[which], rotation[which], twist[which] = swaying_states(
                [sway for sway, _ in starts], fleet.rows(which),
                Pose(position=rest.position[which], rotation=rest.rotation[which]),
                lengths[0, which], rate[which], [coordinates for _, coordinates in starts],
            )  # fmt: skip
        return cls(
            hangs=hangs, moves=moves, position=position, rotation=rotation, twist=twist,
            status=rest.status,
        )  # fmt: skip

    def check(self, must: NDArray[np.bool_]) -> None:
        """Refuse worlds of which some (B,) must hang but do not.

        Raises:
            CarosacError: Says why one does not.
        """
        loose = np.flatnonzero(must & ~self.hangs)
        if len(loose):
            raise CarosacError(
                "the robot cannot hang at rest on the first recorded lengths "
                f"({statics.STATUS_REASONS[self.status[loose[0]]]})"
            )


class _Worlds:
    """Worlds that one thread advances."""

    def __init__(
        self, robots: Sequence[Robot], lengths: Array, starts: _Starts, time_step: float,
        refined: int,
    ) -> None:  # fmt: skip
        """Place B worlds; lengths have the shape (M, B, n)."""
        self._lengths, self._time_step, self._refined = lengths, time_step, refined
        self._simulator = Simulator(robots, cables="catenary", time_step=time_step, at_home=False)
        self._ready = np.zeros(len(robots), dtype=np.bool_)
        for which in (starts.hangs & ~starts.moves, starts.moves):
            self._place(np.flatnonzero(which), starts)

    def _place(self, which: NDArray[np.int64], starts: _Starts) -> None:
        """Place worlds, one by one where not all can be."""
        if not len(which):
            return

        def reset(worlds: NDArray[np.int64]) -> None:
            beside = starts.moves[worlds[0]]
            self._simulator.reset(
                starts.position[worlds] if beside else None,
                starts.rotation[worlds] if beside else None,
                unstrained_length=self._lengths[0, worlds],
                twist=starts.twist[worlds],
                worlds=worlds,
            )
            self._ready[worlds] = True

        try:
            reset(which)
            return
        except InvalidField:
            pass
        for row in range(len(which)):
            with suppress(InvalidField):
                reset(which[row : row + 1])

    def wind(self, when: Array, looked: NDArray[np.int64]) -> OpenLoop:
        """Wind through lengths at times (M,); return the motion at some of them."""
        count, size = len(looked), len(self._ready)
        position, rotation = np.empty((count, size, 3)), np.empty((count, size, 3, 3))
        row = 0
        for k, end in enumerate(looked):
            while row < end:
                row += 1
                duration = float(when[row] - when[row - 1])
                steps = self._refined * math.ceil(duration / self._time_step - STEP_ROUNDING)
                self._simulator.time_step = duration / steps * (1.0 + STEP_ROUNDING)
                self._simulator.follow(self._lengths[row], duration)
            state = self._simulator.state.numpy()
            position[k], rotation[k] = state.position, state.rotation
        failed = ~self._ready | self._simulator.state.numpy().failed
        position[:, failed], rotation[:, failed] = 0.0, np.eye(3)
        return OpenLoop(position=position, rotation=rotation, failed=failed)


def _lengths(robots: Sequence[Robot], path: LengthPath, when: Array) -> Array:
    """Return the unstrained lengths of B robots at M times [m], shape (M, B, n)."""
    delays = np.array([robot.length_delay or 0.0 for robot in robots])
    readings = path.at(when[:, None] - delays)  # (M, B, n)
    wound = np.stack(
        [unstrained_lengths(robot, readings[:, b]) for b, robot in enumerate(robots)], axis=1
    )
    lengths = lagging_lengths(wound, np.array([robot.length_hysteresis for robot in robots]))
    if not (lengths > 0.0).all():
        raise CarosacError(f"a length of {lengths.min():.4g} m: do readings and offsets belong?")
    return lengths
