"""The simulator on recorded lengths alone: many robots at once, seen when poses were measured.

Readings are smoothed first. Their noise would shake the simulated platform, and a fit would then
rather detune its modes than find them. Cables are quasi-static catenaries: waves in cables of
particles grow differently in robots that differ by a millionth, and no derivative survives that.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.identification.sway import FreeSway, swaying_states
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import CarosacError, InvalidField
from carosac_toolkit.loop.values import Pose
from carosac_toolkit.physics.motion.winch import lagging_lengths
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.physics.rest.statics import Equilibrium
from carosac_toolkit.recordings.encoders import unstrained_lengths
from carosac_toolkit.recordings.length_path import LengthPath
from carosac_toolkit.robot.parameters import turn_between
from carosac_toolkit.robot.robot import Robot
from sim_warp import Simulator

LENGTH_GRID_S = 0.05  # [s]: lengths go straight over no longer time
TIME_ROUNDING_S = 1e-9  # [s]: less is rounding


@dataclass(frozen=True, kw_only=True, eq=False)
class OpenLoop:
    """Motion of B robots, sampled at K times.

    Attributes:
        position: Platform origins in W [m], shape (K, B, 3).
        rotation: From P to W, shape (K, B, 3, 3).
        failed: Worlds without a finite motion, shape (B,).
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
        coordinates: Of each robot, shape (B, 2 m).
    """

    sway: FreeSway
    coordinates: Array


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
    """Let platforms hang on the first lengths, and wind on as recorded; each is seen in its own W.

    They start displaced from the equilibrium and with a speed as `start` says, and move with the
    winches; without it they start at rest.

    What each robot says of its length sensors turns readings into lengths, late by their delay.

    Args:
        robots: B robots.
        path: Readings.
        time: When to look, increasing, not before the first reading, shape (K,).
        time_step: Of the simulator, at most [s].
        start: Sway at the first reading; None: at rest.

    Raises:
        CarosacError: The first robot cannot hang on the first lengths.
    """
    size, count = len(robots), len(time)
    grid = np.arange(path.first, time[-1], LENGTH_GRID_S)
    when = np.unique(np.concatenate([grid, time]))
    when = when[np.concatenate([[True], np.diff(when) > TIME_ROUNDING_S])]
    lengths = _lengths(robots, path, when)
    simulator = Simulator(robots, cables="catenary", time_step=time_step)
    hangs = _hang(simulator, lengths[0])
    if start is not None:
        rate = np.zeros_like(lengths[0])
        if len(when) > 1:
            rate = (lengths[1] - lengths[0]) / (when[1] - when[0])
        hangs = _release(simulator, robots, lengths[0], rate, start, np.flatnonzero(hangs))
    motion = OpenLoop(
        position=np.empty((count, size, 3)),
        rotation=np.empty((count, size, 3, 3)),
        failed=~hangs,
    )
    rows = np.searchsorted(when, time - TIME_ROUNDING_S)
    row = 0
    for k, end in enumerate(rows):
        while row < end:
            row += 1
            simulator.follow(lengths[row], float(when[row] - when[row - 1]))
        state = simulator.state.numpy()
        motion.position[k], motion.rotation[k] = state.position, state.rotation
    motion.failed[:] |= state.failed
    return motion


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


def _release(
    simulator: Simulator,
    robots: Sequence[Robot],
    lengths: Array,
    rate: Array,
    start: OpenLoopStart,
    which: NDArray[np.int64],
) -> NDArray[np.bool_]:
    """Release worlds that hang at rest with their sway, see `simulate`; say which of all could."""
    state = simulator.state.numpy()
    position, rotation, twist = swaying_states(
        start.sway, [robots[b] for b in which],
        Pose(position=state.position[which], rotation=state.rotation[which]),
        lengths[which], rate[which], start.coordinates[which],
    )  # fmt: skip

    def reset(rows: NDArray[np.int64]) -> None:
        worlds = which[rows]
        simulator.reset(
            position[rows], rotation[rows], unstrained_length=lengths[worlds], twist=twist[rows],
            worlds=worlds,
        )  # fmt: skip

    done = np.zeros(len(robots), dtype=np.bool_)
    done[which] = [error is None for error in _each(len(which), reset)]
    return done


def _hang(simulator: Simulator, lengths: Array) -> NDArray[np.bool_]:
    """Hang worlds at rest; say which do."""

    def reset(rows: NDArray[np.int64]) -> None:
        simulator.reset(unstrained_length=lengths[rows], worlds=rows)

    errors = _each(len(lengths), reset)
    if errors[0] is not None:
        raise CarosacError(
            f"the robot cannot hang at rest on the first recorded lengths: {errors[0]}"
        ) from errors[0]
    return np.array([error is None for error in errors])


def _each(count: int, reset: Callable[[NDArray[np.int64]], None]) -> Sequence[InvalidField | None]:
    """Reset worlds, one by one where not all can be; return the error of each."""
    rows = np.arange(count)
    try:
        reset(rows)
        return [None] * count
    except InvalidField:
        pass
    errors: list[InvalidField | None] = [None] * count
    for row in rows:
        try:
            reset(rows[row : row + 1])
        except InvalidField as error:
            errors[row] = error
    return errors
