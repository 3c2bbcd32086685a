"""Robots, surveys and files that the tests share."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from calibration.tachymeter.observations import Instrument
from calibration.tachymeter.sightings import SightedPulley
from calibration.tachymeter.synthetic import DrawnSurvey, SurveyPlan, draw_survey
from carosac_toolkit import load_robot
from carosac_toolkit.robot.robot import Robot

ROBOT = load_robot("carosac")
RADIUS = 0.05
EXACT = Instrument(angle=1e-9, distance=1e-7, distance_ppm=0.0, pointing=0.0, compensator=1e-10)

PULLEY = SightedPulley(
    cable="front_left",
    radius=RADIUS,
    axis=np.array([0.36, -0.48, 0.8]),  # not upright, on purpose
    towards=np.array([0.2, -1.6, 2.2]),
)
EXIT = np.array([-1.98, -8.31, 8.47])


def pulley_robot() -> Robot:
    n = ROBOT.n
    axes = np.tile([0.0, 0.0, 1.0], (n, 1))
    return replace(ROBOT, pulley_radius=np.full(n, RADIUS), swivel_axis=axes)


def drawn(seed: int = 0, robot: Robot = ROBOT, **plan: object) -> DrawnSurvey:
    return draw_survey(robot, np.random.default_rng(seed), SurveyPlan(**plan))  # type: ignore[arg-type]


def write(folder: Path, name: str, text: str) -> str:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return str(path)


def finite_difference(function, x, step=1e-6):
    columns = []
    for i in range(len(x)):
        up, down = np.array(x, dtype=float), np.array(x, dtype=float)
        up[i] += step
        down[i] -= step
        columns.append((function(up) - function(down)) / (2.0 * step))
    return np.stack(columns, axis=-1)
