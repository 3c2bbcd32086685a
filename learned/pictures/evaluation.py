"""Pictures of one evaluation, of the paths on which nothing failed."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from carosac_toolkit.robot.robot import Robot
from learned.evaluation import trajectory_errors
from learned.pictures.accuracy import error_histograms, error_violins, sample_paths
from learned.scores import PolicyScores, sound_paths

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PATHS_DRAWN = 4  # paths that are drawn


def draw_histograms(scores: PolicyScores, robot: Robot, path: Path) -> Figure:
    """Draw mean position error and mean length error of each path."""
    sound = sound_paths(scores)
    distance, length = trajectory_errors(scores)
    return error_histograms(distance[sound], length[sound], path, robot=robot)


def draw_violins(scores: PolicyScores, robot: Robot, path: Path) -> Figure:
    """Draw the signed error per axis over all points of all paths."""
    sound = sound_paths(scores)
    return error_violins(scores.error[sound][scores.counted[sound]], path, robot=robot)


def draw_paths(scores: PolicyScores, robot: Robot, path: Path) -> Figure:
    """Draw the first paths in space."""
    shown = np.flatnonzero(sound_paths(scores))[:PATHS_DRAWN, None]
    last = scores.counted.sum(axis=1)[shown] - 1
    steps = np.minimum(np.arange(scores.counted.shape[1]), last)  # what does not count is not drawn
    return sample_paths(scores.target[shown, steps], scores.position[shown, steps], robot, path)
