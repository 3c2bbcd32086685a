r"""The pose of rest at measured lengths (KS), and how it depends on what is not known.

With the stiffness K at constant lengths and the weight mg at the centre of mass :math:`R c`,

.. math:: \delta x = \frac{\partial x}{\partial L} \delta L
          + K^{-1} \begin{bmatrix} 0 \\ R\,\delta c \times m g \end{bmatrix}.

Sway about it is described by equal energy E in all modes: covariance :math:`E K^{-1}` of the pose,
:math:`E M^{-1}` of the twist.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.rotations import cross_matrix
from carosac_toolkit.physics.rest.modes import mass_matrix
from carosac_toolkit.physics.rest.statics import Equilibrium, forward_kinematics
from carosac_toolkit.robot.robot import Robot


@dataclass(frozen=True, kw_only=True, eq=False)
class RestPose:
    """A stable equilibrium of one robot of n cables.

    Attributes:
        position: Platform origin in W [m], shape (3,).
        rotation: From P to W, shape (3, 3).
        tension: At the platform [N], shape (n,).
        per_length: Pose error [m, rad] per length error, shape (6, n).
        per_center: Pose error per error of the centre of mass in P, shape (6, 3).
        softness: K^-1, shape (6, 6).
        lightness: M^-1, shape (6, 6).
        solution: Where the next solve starts.
    """

    position: Array
    rotation: Array
    tension: Array
    per_length: Array
    per_center: Array
    softness: Array
    lightness: Array
    solution: Equilibrium

    def energy(self, sway: float) -> float:
        """Return the energy per mode [J] at which the position sways by `sway` (RMS) [m]."""
        return sway**2 / float(np.trace(self.softness[:3, :3]))


def find_rest(
    robot: Robot, lengths: Array, center: Array, guess: Equilibrium | None, step: float
) -> RestPose | None:
    """Solve for rest at lengths with a shifted centre of mass.

    Args:
        robot: Nominal robot, n cables.
        lengths: [m], shape (n,).
        center: Shift of the centre of mass in P [m], shape (3,).
        guess: Where to start, or None.
        step: For derivatives by differences [m].

    Returns:
        None where there is no stable equilibrium.
    """
    n = robot.n
    if (lengths <= 2.0 * step).any() or not np.isfinite(lengths).all():
        return None
    rows = np.concatenate([lengths[None], lengths + step * np.eye(n)])
    rests = forward_kinematics(robot, rows, guess=guess)
    if guess is not None and not (rests.converged & rests.stable).all():
        rests = forward_kinematics(robot, rows)
    if not (rests.converged & rests.stable).all():
        return None
    return _with_derivatives(robot, rests, center, step)


def _with_derivatives(robot: Robot, rests: Equilibrium, center: Array, step: float) -> RestPose:
    """Return the first row's rest with derivatives from the others, and its shifted centre."""
    import pinocchio

    rotation = rests.rotation[0]
    shifts = rests.position[1:] - rests.position[0]
    turns = [pinocchio.log3(other @ rotation.T) for other in rests.rotation[1:]]
    softness = np.linalg.inv(rests.stiffness[0])
    # (R dc) x (0, 0, -mg), per dc
    moment = robot.weight * cross_matrix(np.array([0.0, 0.0, 1.0])) @ rotation
    per_center = softness[:, 3:] @ moment
    lean = per_center @ center
    at = rests.unstrained_length[:1]
    return RestPose(
        position=rests.position[0] + lean[:3],
        rotation=pinocchio.exp3(lean[3:]) @ rotation,
        tension=rests.tension[0],
        per_length=np.concatenate([shifts, np.array(turns)], axis=1).T / step,
        per_center=per_center,
        softness=0.5 * (softness + softness.T),
        lightness=np.linalg.inv(mass_matrix(robot, rests.rotation[:1], at)[0]),
        solution=rests,
    )
