r"""Motions of the whole set-up, and priors of a shape that is known better than where it is.

A robot that was calibrated without known positions has exit points that are known well among each
other and badly in W. A normal distribution of such points holds near its mean only: turned by
:math:`\omega` along a straight line, a shape grows by :math:`\omega^2 / 2`. So its mean is first
moved along the badly known motions M to where the points are, by R, and there

.. math:: \Lambda' = Q R \Lambda_s R^\top Q + M^{+\top} W M^+, \qquad
          \Lambda_s = \Lambda - \Lambda M (M^\top \Lambda M)^{-1} M^\top \Lambda,
          \qquad Q = I - M M^+

is their information: :math:`\Lambda_s` is that of the shape alone, and W that of the motions. It is
:math:`M^\top \Lambda M`, and more along those that the data leave free, which are held there.
"""

from __future__ import annotations

from copy import copy
from dataclasses import replace

import numpy as np

from calibration.self_calibration.problem import MotorAngleProblem
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.rotations import from_rotation_vector
from carosac_toolkit.robot.parameter_names import point_names

FREE_MOTION_SHARE = 0.05  # of the longest cable: a motion known less well than that is free
HELD_SIGMA_SHARE = 1e-3  # of the longest cable: a free motion that is held is known that well
ALIGNING_STEPS = 20


def moves(ray: Array, lever: float) -> Array:
    """Return the displacement of points by six motions, shape (N, 3, 6).

    Args:
        ray: Points less the point that turns leave where it is [m], shape (N, 3).
        lever: Length that makes turns motions in metres [m].
    """
    x, y, z = ray.T
    motion = np.zeros((len(ray), 3, 6))
    motion[:, :, :3] = np.eye(3)
    zero = np.zeros_like(x)
    cross = np.array([[zero, z, -y], [-z, zero, x], [y, -x, zero]])  # omega x ray by omega
    motion[:, :, 3:] = cross.transpose(2, 0, 1) / lever
    return motion


def independent(problem: MotorAngleProblem) -> MotorAngleProblem:
    """Return the problem with exit points known before one by one, not among each other.

    A start far off is not held by a shape that is exact near the mean only.
    """
    if _badly_known(problem).shape[1] == 0:
        return problem
    covariance = problem.prior.covariance.copy()
    block = problem.exits.ravel()
    apart = np.kron(np.eye(problem.robot.n), np.ones((3, 3)))
    covariance[np.ix_(block, block)] *= apart
    return _with_prior(problem, problem.prior.mean, covariance)


def around(problem: MotorAngleProblem, shared: Array, free: Array) -> MotorAngleProblem:
    """Return the problem with the prior of the shape moved to where the exit points are.

    Args:
        problem: The samples.
        shared: Values of the shared unknowns, shape (m,).
        free: Motions that the data leave free, shape (6, f).
    """
    motions = _badly_known(problem)
    if motions.shape[1] == 0:
        return problem
    home, lever, block = problem.robot.home_position, problem.longest, problem.exits.ravel()
    points, here = problem.points(shared), problem.points(problem.prior.mean)
    first = _by_motion(here - home, lever, motions)
    turn = np.eye(3)
    for _ in range(ALIGNING_STEPS):
        slope = _by_motion(here - home, lever, motions)
        step = motions @ np.linalg.lstsq(slope, (points - here).ravel(), rcond=None)[0]
        rotation = from_rotation_vector(step[3:] / lever)
        here = (here - home) @ rotation.T + home + step[:3]
        turn = rotation @ turn
    information = problem.prior.information[np.ix_(block, block)]
    of_motions = first.T @ information @ first
    pull = information @ first
    shape = information - pull @ np.linalg.solve(of_motions, pull.T)
    by_motion = _by_motion(points - home, lever, motions)
    back = np.linalg.pinv(by_motion)
    turned = (np.eye(len(block)) - by_motion @ back) @ np.kron(np.eye(problem.robot.n), turn)
    held = motions.T @ free / (HELD_SIGMA_SHARE * lever)
    shape = turned @ shape @ turned.T + back.T @ (of_motions + held @ held.T) @ back
    spread = np.linalg.inv(shape)
    covariance = problem.prior.covariance.copy()
    covariance[np.ix_(block, block)] = 0.5 * (spread + spread.T)
    mean = problem.prior.mean.copy()
    mean[problem.exits] += here - problem.points(mean)
    return _with_prior(problem, mean, covariance)


def _badly_known(problem: MotorAngleProblem) -> Array:
    """Return the motions of a calibrated robot that its file knows badly, shape (6, c)."""
    robot, block = problem.robot, problem.exits.ravel()
    names = set(point_names("exit_points", robot.cable_names))
    if robot.calibrated is None or not names <= set(robot.calibrated):
        return np.zeros((6, 0))
    rays = problem.points(problem.prior.mean) - robot.home_position
    motion = moves(rays, problem.longest).reshape(-1, 6)
    information = motion.T @ problem.prior.information[np.ix_(block, block)] @ motion
    values, vectors = np.linalg.eigh(information / robot.n)
    return np.asarray(vectors[:, values < (FREE_MOTION_SHARE * problem.longest) ** -2])


def _by_motion(rays: Array, lever: float, motions: Array) -> Array:
    """Return the displacements of all points by some motions (6, c), shape (3 n, c)."""
    return np.asarray(moves(rays, lever).reshape(-1, 6) @ motions)


def _with_prior(problem: MotorAngleProblem, mean: Array, covariance: Array) -> MotorAngleProblem:
    """Return the problem with another prior."""
    other = copy(problem)
    other.prior = replace(problem.prior, mean=mean, covariance=covariance)
    return other
