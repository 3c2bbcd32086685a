"""What vibrations that noise hides change of the errors of some runs."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calibration.identification.run_simulator import RunSimulator
from calibration.identification.runs import FittedRun
from calibration.identification.vibration_search import HALVINGS_MAX, VibrationSearch
from calibration.identification.vibrations import HiddenVibrations, VibratingStarts
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import CarosacError
from carosac_toolkit.robot.robot import Robot

SEED = 0


def hidden_vibrations(
    simulator: RunSimulator,
    runs: Sequence[FittedRun],
    counted: Sequence[FittedRun],
    at: Sequence[Array],
    robot: Robot,
    cables: Array,
    time_step: float,
) -> list[HiddenVibrations]:
    """Return what hidden vibrations change of the errors of runs.

    Args:
        simulator: Of the robot.
        runs: With all poses. Vibrations are no unknowns of their starts.
        counted: The same with the poses that count.
        at: Coordinates of each run, those of the robot first.
        robot: At these coordinates.
        cables: Changes of the robot's coordinates by one sigma of what is known of its cables,
            which all runs together tell, shape (q, k).
        time_step: Of a sway, at most [s].

    Raises:
        CarosacError: A platform has no finite motion, as little as it vibrates.
    """
    if not runs:
        return []
    rng = np.random.default_rng(SEED)
    starts = [VibratingStarts.of(run, robot, rng) for run in runs]
    search = VibrationSearch(simulator, starts, at, cables, time_step)
    calm = np.zeros((1, len(starts[0].ways)))
    points = [np.concatenate([calm, each.sigma_points()]) for each in search.run()]
    for _ in range(1 + HALVINGS_MAX):
        vibrating, sound = search.errors(starts, points)
        if all(sound):
            break
        points = [along if fine else 0.5 * along for along, fine in zip(points, sound, strict=True)]
    else:
        raise CarosacError("identification: no finite motion of a robot whose cables vibrate")
    hidden = []
    for run, part, errors in zip(runs, counted, vibrating, strict=True):
        rows = np.isin(run.poses.time, part.poses.time)
        still, _, *others = [part.seen(each[rows]) for each in errors]
        likely = np.mean(others, axis=0)
        off = np.array(others) - likely
        spread = off.reshape(len(off), -1).T / np.sqrt(len(off))
        hidden.append(HiddenVibrations(drift=likely - still, spread=spread))
    return hidden
