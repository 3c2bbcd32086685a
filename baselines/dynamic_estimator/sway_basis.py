r"""Basis of the sway: slow motions of the platform, and those that follow the lengths.

Cables are stiff: a millimetre too short is a tension of tens of newtons. A filter that let the pose
err freely would read tensions out of the third digit of a millimetre, which no linearisation is
good for. Pose errors are therefore slow motions of coordinates s, and what goes with errors of the
lengths:

.. math:: \delta x = N s + S\, \delta b, \qquad A^T S = 1, \quad N^T M N = 1

with the structure matrix A and the mass matrix M. Slow are the 6 - n motions that leave all lengths
as they are, for which :math:`A^T N = 0` and :math:`N^T M S = 0`, and beside them those on cables
that sag and stretch (`softness`): a platform near a face of its workspace may bounce on its
slackest cables only twice as fast as it sways.
"""

from __future__ import annotations

from itertools import product
from typing import NamedTuple

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.scaled import Scaled
from carosac_toolkit.physics.cable.softness import softness
from carosac_toolkit.physics.rest.modes import mass_matrix, natural_frequencies
from carosac_toolkit.physics.rest.statics import inverse_kinematics
from carosac_toolkit.physics.rest.structure import constrained_motion, structure_matrix
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.robot.robot import Robot

# Natural frequency below which a mode is a way to sway: an IMU that is heard at each time step
# feels six times a period how it moves. A controller answers to all that it sees of a belief, at
# 3 Hz as at 10: what vibrates in the belief must be what vibrates in truth.
SLOW_FREQUENCY = Scaled(16.0, "1/s")
WORKSPACE_SHARES = (-0.9, 0.0, 0.9)  # of the half box along each axis, where modes are looked at


class SwayBasis(NamedTuple):
    """At one pose.

    Attributes:
        ways: N, shape (6, m): slow twists of unit kinetic energy 1/2, so that their coordinates
            have the unit m kg^0.5. The last 6 - n leave the lengths as they are.
        slaved: S, shape (6, n): pose per length that a cable is shorter, of least kinetic energy;
            with more than six cables the least squares.
        momentum: N^T M, shape (m, 6), which takes s out of a pose error without that part.
        pulls: Acceleration per tension of a cable, shape (6, n) [1/kg, 1/(kg m)].
    """

    ways: Array
    slaved: Array
    momentum: Array
    pulls: Array


def count_ways(robot: Robot) -> int:
    """Return the number m of slow motions of a robot, the most anywhere in its workspace."""
    middle = 0.5 * (robot.workspace_min + robot.workspace_max)
    half = 0.5 * (robot.workspace_max - robot.workspace_min)
    places = middle + half * np.array(list(product(WORKSPACE_SHARES, repeat=3)))
    rests = inverse_kinematics(robot, np.vstack([robot.home_position, places]))
    slow = natural_frequencies(robot, rests) < SLOW_FREQUENCY.of(Scales(robot).ratios)
    return int(max(6 - robot.n, slow.sum(axis=1).max()))  # where it cannot rest, none is


def sway_at(
    robot: Robot,
    position: Array,
    rotation: Array,
    unstrained_length: Array,
    tension: Array,
    count: int,
) -> SwayBasis:
    """Return the basis of the sway at a pose.

    Args:
        robot: n cables.
        position: Platform origin in W [m], shape (3,).
        rotation: From P to W, shape (3, 3).
        unstrained_length: [m], shape (n,), whose inertia rides along.
        tension: Of the cables [N], shape (n,).
        count: Number m of ways, at least 6 - n.
    """
    structure = structure_matrix(robot, position[None], rotation[None])[0]
    mass = mass_matrix(robot, rotation[None], unstrained_length[None])[0]
    root = np.linalg.cholesky(mass)
    soft = softness(robot, structure[:3].T, unstrained_length, tension)
    springs = np.linalg.solve(root, structure) / np.sqrt(soft)  # in coordinates of unit mass
    left, _, _ = np.linalg.svd(springs)  # stiffest first
    ways = np.linalg.solve(root.T, left[:, 6 - count :])
    return SwayBasis(
        ways=ways,
        slaved=constrained_motion(mass, structure.T),
        momentum=ways.T @ mass,
        pulls=np.linalg.solve(mass, structure),
    )
