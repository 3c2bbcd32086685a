"""What vibrations that noise hides change of the errors of some runs.

Cables are taken for as stiff as all runs say; how far off that may be is left out. Of a run whose
poses do not show the likeliest vibrations only the level is believed. One that has no finite motion
however little it vibrates counts as calm.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calibration.identification.run_simulator import RunSimulator
from calibration.identification.runs import FittedRun
from calibration.identification.vibration_search import VibrationSearch
from calibration.identification.vibrations import HiddenVibrations, VibratingStarts
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.robot.robot import Robot

SEED = 0
HALVINGS_MAX = 3  # of vibrations with which a platform has no finite motion


def hidden_vibrations(
    simulator: RunSimulator,
    runs: Sequence[FittedRun],
    counted: Sequence[FittedRun],
    at: Sequence[Array],
    robot: Robot,
    cables: Array,
    time_step: float,
    begin: Sequence[HiddenVibrations] | None = None,
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
        begin: As of a robot that is nearly this one; None: nothing is known.
    """
    if not runs:
        return []
    rng = np.random.default_rng(SEED)
    starts = [VibratingStarts.of(run, robot, rng) for run in runs]
    nearly = None
    if begin is not None:
        nearly = [
            each.along if len(each.along) else np.zeros(len(start.ways))
            for each, start in zip(begin, starts, strict=True)
        ]
    search = VibrationSearch(simulator, starts, at, cables, time_step, nearly)
    calm = np.zeros((1, len(starts[0].ways)))
    followed = search.run()
    points = [np.concatenate([calm, each.told.sigma_points()]) for each in followed]
    errors, sound = search.errors(starts, points)

    def simulate_again(which: list[int]) -> None:
        some, fine = search.errors(starts, points, which=which)
        for k, own, good in zip(which, some, fine, strict=True):
            errors[k], sound[k] = own, good

    unshown = [
        k
        for k, each in enumerate(followed)
        if not sound[k][:2].all()
        or not each.start.shows(each.told, errors[k][:2, : len(each.start.run.poses.time)])
    ]
    for k in unshown:
        points[k] = np.concatenate([calm, followed[k].told.forgotten.sigma_points()])
    simulate_again(unshown)
    for _ in range(HALVINGS_MAX):
        failed = [k for k, fine in enumerate(sound) if not fine.all()]
        for k in failed:
            points[k] = 0.5 * points[k]
        simulate_again(failed)
    return [
        _changed(run, part, own, each[1])
        if fine.all()
        else HiddenVibrations.none(part.seen(0.0 * own[0]))
        for run, part, own, fine, each in zip(runs, counted, errors, sound, points, strict=True)
    ]


def _changed(run: FittedRun, part: FittedRun, errors: Array, along: Array) -> HiddenVibrations:
    """Return what vibrations change of the errors of a run.

    Args:
        run: With all poses.
        part: With those that count.
        errors: Of all poses, of a calm start, the likeliest one, and others, shape (2 + W, K, 6).
        along: Coefficients of the likeliest one, shape (2 n,).
    """
    rows = np.isin(run.poses.time, part.poses.time)
    calm, _, *others = [part.seen(each[rows]) for each in errors]
    likely = np.mean(others, axis=0)
    off = np.array(others) - likely
    spread = off.reshape(len(off), -1).T / np.sqrt(len(off))
    return HiddenVibrations(drift=likely - calm, spread=spread, along=along)
