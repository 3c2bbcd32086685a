"""The simulator on recorded lengths alone: many robots at once, seen when poses were measured.

Readings are smoothed first. Their noise would shake the simulated platform, and a fit would then
rather detune its modes than find them. Cables are quasi-static catenaries: waves in cables of
particles grow differently in robots that differ by a millionth, and no derivative survives that.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import CarosacError, InvalidField
from carosac_toolkit.recordings.encoders import unstrained_lengths
from carosac_toolkit.recordings.length_path import LengthPath
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


def simulate(
    robots: Sequence[Robot], path: LengthPath, time: Array, *, time_step: float
) -> OpenLoop:
    """Let platforms hang at rest on the first lengths, and wind on as recorded.

    What each robot says of its length sensors turns readings into lengths, late by their delay.

    Args:
        robots: B robots.
        path: Readings.
        time: When to look, increasing, not before the first reading, shape (K,).
        time_step: Of the simulator, at most [s].

    Raises:
        CarosacError: The first robot cannot hang on the first lengths.
    """
    size, count = len(robots), len(time)
    grid = np.arange(path.first, time[-1], LENGTH_GRID_S)
    when = np.unique(np.concatenate([grid, time]))
    when = when[np.concatenate([[True], np.diff(when) > TIME_ROUNDING_S])]
    delays = np.array([robot.length_delay or 0.0 for robot in robots])
    readings = path.at(when[:, None] - delays)  # (M, B, n)
    lengths = np.stack(
        [unstrained_lengths(robot, readings[:, b]) for b, robot in enumerate(robots)], axis=1
    )
    if not (lengths > 0.0).all():
        raise CarosacError(f"a length of {lengths.min():.4g} m: do readings and offsets belong?")
    simulator = Simulator(robots, cables="catenary", time_step=time_step)
    hangs = _hang(simulator, lengths[0])
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


def _hang(simulator: Simulator, lengths: Array) -> NDArray[np.bool_]:
    """Hang worlds at rest, one by one where not all can; say which do."""
    try:
        simulator.reset(unstrained_length=lengths)
        return np.ones(len(lengths), dtype=np.bool_)
    except InvalidField:
        pass
    hangs = np.zeros(len(lengths), dtype=np.bool_)
    for world, row in enumerate(lengths):
        try:
            simulator.reset(unstrained_length=row[None], worlds=[world])
            hangs[world] = True
        except InvalidField as error:
            if world == 0:
                raise CarosacError(
                    f"the robot cannot hang at rest on the first recorded lengths: {error}"
                ) from error
    return hangs
