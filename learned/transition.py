"""One step of a batch of environments: all quantities that rewards and scores depend on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.physics.cable import straight_line
from carosac_toolkit.robot.robot import Robot


@dataclass(frozen=True, kw_only=True, eq=False)
class Transition:
    """One step of B environments with n cables.

    Attributes:
        robot: The nominal robot.
        target: Platform origin that was asked for in W [m], shape (B, 3).
        position_before: Platform origin before the step [m], shape (B, 3).
        position: Platform origin after it [m], shape (B, 3).
        length_before: Wound before the step [m], shape (B, n).
        length: Wound after it [m], shape (B, n).
        asked: Lengths that the action asks for [m], shape (B, n).
        inconsistency: What each length lacks to the one that inverse kinematics of the same model
            gives at `position` [m], shape (B, n); zero where the lengths agree with each other,
            NaN, unknown, for a platform in motion.
        tension: At the platform [N], shape (B, n); None where no forces are known.
        velocity: Of the platform origin less that of its target [m/s], shape (B, 3); zero where
            set-points settle.
        effort: How far the action moves the target off the reference, over its range, shape (B,);
            zero for actions that are lengths.
        jerk: Of the push that was applied: norm of its change in this step, over its range [-],
            without the feedforward, shape (B,); zero for actions that are lengths.
        failed: Steps without a solution, in which the platform stays where it was, shape (B,).
    """

    robot: Robot
    target: Array
    position_before: Array
    position: Array
    length_before: Array
    length: Array
    asked: Array
    inconsistency: Array
    tension: Array | None
    velocity: Array
    effort: Array
    jerk: Array
    failed: NDArray[np.bool_]

    @property
    def distance(self) -> Array:
        """From the target, after the step [m], shape (B,)."""
        return np.asarray(np.linalg.norm(self.position - self.target, axis=1))

    @property
    def straight_position(self) -> Array:
        """Straight-line lengths at `position` [m], shape (B, n)."""
        return straight_line.straight_length(self.robot, self.position).length

    @property
    def straight_target(self) -> Array:
        """Straight-line lengths at `target` [m], shape (B, n)."""
        return straight_line.straight_length(self.robot, self.target).length
