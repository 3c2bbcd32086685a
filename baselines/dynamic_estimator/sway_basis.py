r"""Basis of the sway: motions that the cables leave free, and those that follow their lengths.

Cables are stiff: a millimetre too short is a tension of tens of newtons. Pose errors are therefore
those that leave all lengths as they are, and those that go with errors of the lengths:

.. math:: \delta x = N s + S\, \delta b, \qquad A^T N = 0, \quad A^T S = 1, \quad N^T M N = 1,
    \quad N^T M S = 0

with the structure matrix A and the mass matrix M. A filter that let the pose err freely would read
tensions out of the third digit of a millimetre, which no linearisation is good for.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.physics.rest.modes import mass_matrix
from carosac_toolkit.physics.rest.structure import constrained_motion, structure_matrix
from carosac_toolkit.robot.robot import Robot


class SwayBasis(NamedTuple):
    """At one pose.

    Attributes:
        ways: N, shape (6, m): twists that leave the lengths as they are, of unit kinetic energy
            1/2, so that their coordinates have the unit m kg^0.5.
        slaved: S, shape (6, n): pose per length that a cable is shorter; with more than six cables
            the least squares.
        momentum: N^T M, shape (m, 6), which takes s out of a pose error.
        pulls: Acceleration per tension of a cable, shape (6, n) [1/kg, 1/(kg m)].
    """

    ways: Array
    slaved: Array
    momentum: Array
    pulls: Array


def sway_at(robot: Robot, position: Array, rotation: Array, unstrained_length: Array) -> SwayBasis:
    """Return the basis of the sway at a pose.

    Args:
        robot: n cables.
        position: Platform origin in W [m], shape (3,).
        rotation: From P to W, shape (3, 3).
        unstrained_length: [m], shape (n,), whose inertia rides along.
    """
    structure = structure_matrix(robot, position[None], rotation[None])[0]
    mass = mass_matrix(robot, rotation[None], unstrained_length[None])[0]
    root = np.linalg.cholesky(mass)
    white = np.linalg.solve(root, structure)  # columns in coordinates of unit mass
    count = max(0, 6 - robot.n)
    left, _, _ = np.linalg.svd(white)
    ways = np.linalg.solve(root.T, left[:, 6 - count :])
    return SwayBasis(
        ways=ways,
        slaved=constrained_motion(mass, structure.T),
        momentum=ways.T @ mass,
        pulls=np.linalg.solve(mass, structure),
    )
