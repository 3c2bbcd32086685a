"""Clearance between cables."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import warp as wp
from numpy.typing import NDArray

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.physics import warp_setup
from carosac_toolkit.physics.rest import distance_kernels
from carosac_toolkit.physics.rest.statics import Equilibrium, cable_shape
from carosac_toolkit.robot.robot import Robot


def separate_pairs(robot: Robot) -> NDArray[np.int64]:
    """Return pairs of cables that touch nowhere by design, shape (K, 2).

    Two cables that end at one anchor point, or leave the frame at one exit point, within the sum
    of their radii, are no such pair.
    """
    kept = []
    for i, j in combinations(range(robot.n), 2):
        thick = 0.5 * (robot.cable_diameter[i] + robot.cable_diameter[j])
        ends = (
            np.linalg.norm(points[i] - points[j])
            for points in (robot.exit_points, robot.anchor_points)
        )
        if min(ends) > thick:
            kept.append((i, j))
    return np.array(kept, dtype=np.int64).reshape(-1, 2)


def cable_distances(
    robot: Robot, equilibrium: Equilibrium, *, pieces: int = 8, device: str = "cpu"
) -> tuple[Array, NDArray[np.int64]]:
    """Return the smallest distance between the surfaces of every two free cables.

    Args:
        robot: Robot description, n cables.
        equilibrium: B equilibria of this robot.
        pieces: Straight pieces that stand for a hanging cable: a cable of sag f is followed to
            about f / pieces^2.
        device: Warp device.

    Returns:
        Distances [m], shape (B, K), negative where cables overlap, and the pairs, shape (K, 2): see
        `separate_pairs`.
    """
    pairs = separate_pairs(robot)
    size = len(equilibrium.position)
    if len(pairs) == 0 or size == 0:
        return np.zeros((size, len(pairs))), pairs
    warp_setup.load(distance_kernels, device)
    points = cable_shape(robot, equilibrium, pieces + 1, device=device)
    distance = wp.zeros((size, len(pairs)), dtype=wp.float64, device=device)
    inputs = [
        wp.array(points, dtype=wp.vec3d, device=device),
        wp.array(pairs, dtype=int, device=device),
        distance,
    ]
    wp.launch(distance_kernels.smallest_distances, (size, len(pairs)), inputs=inputs, device=device)
    thick = 0.5 * robot.cable_diameter[pairs].sum(axis=1)
    return distance.numpy() - thick, pairs
