"""Drives in a training's own worlds that show how beliefs of an estimator err there."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.robot.robot import Robot
from learned.belief_errors import BeliefErrorModel, Episode, errors_of, fit_belief_errors, reach_of
from learned.environment import CableEnvironment, EnvironmentSettings

DRIVES = 48
STEPS = 200  # of a drive: some periods of slow sway
ACTION_SPREAD = 0.25  # of the action, which wanders; exploration is as large at first
WANDER_STEPS = 30.0  # until it has forgotten where it was
SEED_OFFSET = 4_000_037  # plants, paths and sensors are none of the training
WatchCallback = Callable[[int, int], None]


def learn_belief_errors(
    robot: Robot, settings: EnvironmentSettings, seed: int, *, device: str = "cpu",
    watch: WatchCallback = lambda step, of: None,
) -> BeliefErrorModel:  # fmt: skip
    """Drive behind the estimator of some settings, and fit a model to how its belief errs.

    Args:
        robot: The nominal robot.
        settings: Of a training whose estimator is modelled.
        seed: Of the training.
        device: Warp device of the worlds.
        watch: Called with the steps that are done, and of how many.

    Raises:
        CarosacError: It loses the platform in most drives, or its errors do not fade.
    """
    moving = replace(settings.moving, modelled=False, estimated=1.0)
    cables = CableEnvironment(
        robot, replace(settings, moving=moving), size=DRIVES, seed=SEED_OFFSET + seed,
        device=device,
    )  # fmt: skip
    rng = np.random.default_rng([seed, 13])
    cables.reset()
    steps = min(STEPS, settings.path.steps - 1)
    looks = [_look(cables)]
    lost = np.zeros(DRIVES, dtype=bool)
    action: Array = np.zeros((DRIVES, cables.action_size))
    left = np.exp(-1.0 / WANDER_STEPS)
    for k in range(steps):
        fresh = rng.standard_normal(action.shape)
        action = left * action + ACTION_SPREAD * np.sqrt(1.0 - left**2) * fresh
        lost |= cables.step(np.clip(action, -1.0, 1.0)).truncated
        looks.append(_look(cables))
        watch(k + 1, steps)
    error, twist, reach = (np.stack(part, axis=1) for part in zip(*looks, strict=True))
    if settings.lost is not None:
        lost |= np.linalg.norm(error[..., :3], axis=2).max(axis=1) > settings.lost
    return fit_belief_errors([
        Episode(error=error[row], twist=twist[row], reach=reach[row])
        for row in np.flatnonzero(~lost)
    ])  # fmt: skip


def _look(cables: CableEnvironment) -> tuple[Array, Array, Array]:
    """Return errors, twists and reaches of now, of all worlds."""
    reached = cables.reached
    assert reached.belief is not None
    return (
        errors_of(reached, reached.belief),
        reached.twist,
        reach_of(cables.robot, reached.position, reached.rotation, reached.length),
    )
