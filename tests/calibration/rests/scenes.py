"""A robot on four cables over pulleys, whose exit points are known to 1 mm, and its rests."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

import carosac_toolkit as ct
from calibration import RestScene, RestSceneSettings, draw_rest_scene
from carosac_toolkit.robot.robot import Robot


def surveyed_robot() -> Robot:
    robot = ct.load_robot("scampi")
    return replace(
        robot,
        pulley_radius=np.full(4, 0.03),
        swivel_axis=np.tile([0.0, 0.0, 1.0], (4, 1)),
        exit_covariance=np.tile(1e-6 * np.eye(3), (4, 1, 1)),
    )


def scene(seed: int, robot: Robot | None = None, **settings: object) -> RestScene:
    made = RestSceneSettings(**settings)  # type: ignore[arg-type]
    return draw_rest_scene(robot or surveyed_robot(), np.random.default_rng(seed), settings=made)
