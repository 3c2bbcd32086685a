"""Robots and recordings that the tests of this folder share."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np

import carosac_toolkit as ct
from calibration.lengths.synthetic import LengthScene, LengthSceneSettings, draw_length_scene
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.robot.robot import Robot


def with_pulleys(name: str, *, exit_sigma: float | None = None) -> Robot:
    """A bundled robot over pulleys of 5 cm, its exit points known as by a tachymeter or not."""
    robot = ct.load_robot(name)
    n = robot.n
    surveyed = None if exit_sigma is None else np.tile(exit_sigma**2 * np.eye(3), (n, 1, 1))
    return replace(
        robot,
        pulley_radius=np.full(n, 0.05),
        swivel_axis=np.tile([0.0, 0.0, 1.0], (n, 1)),
        exit_covariance=surveyed,
    )


@cache
def scene(
    name: str, seed: int, *, exit_sigma: float | None = None, samples: int = 250,
    relative: bool = False, outliers: float = 0.05,
) -> LengthScene:  # fmt: skip
    """A recording of a robot that differs from its description, the same for the same numbers."""
    return draw_length_scene(
        with_pulleys(name, exit_sigma=exit_sigma),
        np.random.default_rng(seed),
        settings=LengthSceneSettings(samples=samples, outliers=outliers),
        relative=relative,
    )


def exit_error(scene: LengthScene, robot: Robot) -> Array:
    """Distance of each exit point of a robot from the truth [m], shape (n,)."""
    truth = [[scene.truth[f"exit_points[{c}].{a}"] for a in "xyz"] for c in robot.cable_names]
    return np.asarray(np.linalg.norm(robot.exit_points - np.array(truth), axis=1))
