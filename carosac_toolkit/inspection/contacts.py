"""Cables that touch each other, or run through the platform, at home."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.inspection.home import RobotAtHome

HULL_POINTS = 400  # of a straight cable, over twice the size of the platform
HULL_DEPTH_RATIO = 0.01  # of the size of the platform: a cable deeper inside runs through it


def touching(report: RobotAtHome) -> Iterator[str]:
    """Name the pairs of cables whose surfaces meet at home, by hanging cables."""
    from carosac_toolkit.physics.rest.distance import cable_distances

    if not report.equilibrium.converged[0]:
        return
    names = report.robot.cable_names
    distances, pairs = cable_distances(report.robot, report.equilibrium)
    for k in np.flatnonzero(distances[0] < 0.0):
        i, j = pairs[k]
        diameter = 0.5 * (report.robot.cable_diameter[i] + report.robot.cable_diameter[j])
        yield (
            f"cables {names[i]} and {names[j]} touch at home: their middles are "
            f"{(distances[0, k] + diameter) * 1e3:.1f} mm apart, their radii are "
            f"{diameter * 1e3:.1f} mm together"
        )


def through_platform(report: RobotAtHome) -> Iterator[str]:
    """Name cables that run through the hull of the anchor points at home."""
    robot = report.robot
    if not report.straight.valid[0].all():
        return
    size = float(np.ptp(robot.anchor_points, axis=0).max())
    outward = -report.straight.direction[0] @ report.rotation  # (n, 3) in P, from the anchor
    away = np.linspace(0.0, 2.0 * size, HULL_POINTS)[:, None]
    for i, name in enumerate(robot.cable_names):
        depth = _depth(robot.anchor_points, robot.anchor_points[i] + away * outward[i])
        if depth > HULL_DEPTH_RATIO * size:
            yield (
                f"cable {name} runs through the hull of the anchor points at home, "
                f"{depth * 1e3:.0f} mm deep: does it touch the platform?"
            )


def _depth(anchors: Array, points: Array) -> float:
    """Return how deep the deepest of some points (K, 3) is inside the hull of points [m]."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        sides = ConvexHull(
            anchors
        ).equations  # fewer than four points, or all in a plane, have none
    except (QhullError, ValueError):
        return 0.0
    return float(np.max(-(points @ sides[:, :3].T + sides[:, 3]).max(axis=1)))
