"""Candidates for places to measure at, in the workspace box of a robot."""

from __future__ import annotations

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.robot.robot import Robot

EDGE_SHARE = 0.5  # of the candidates lie on edges of the box, where they tend to teach most


def draw_in_box(
    robot: Robot, rng: np.random.Generator, count: int, edges: float = EDGE_SHARE
) -> Array:
    """Draw positions uniformly from the workspace box, and from its edges [m], shape (count, 3).

    Args:
        robot: Whose workspace it is.
        rng: Random numbers.
        count: Number of positions.
        edges: Share of them on the edges.
    """
    share = rng.uniform(-1.0, 1.0, (count, 3))
    for row in share[: int(edges * count)]:
        ends = rng.permutation(3)[:2]
        row[ends] = np.sign(row[ends])
    middle = 0.5 * (robot.workspace_min + robot.workspace_max)
    half = 0.5 * (robot.workspace_max - robot.workspace_min)
    return np.asarray(middle + half * share)
