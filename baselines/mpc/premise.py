"""Premise of the prediction model: cables keep the lengths that winches give them.

The model has no stretch: it follows at once where a real platform swings on its cables. That holds
as long as those swings are quick against the plan. On a robot whose cables sag or stretch so much
that the platform bounces on them as slowly as it sways, a plan of rigid cables drives it on.
"""

from __future__ import annotations

import numpy as np

from carosac_toolkit.base.scaled import Scaled
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.physics.rest.modes import natural_modes
from carosac_toolkit.physics.rest.structure import structure_matrix
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.robot.robot import Robot

# Of the slowest mode that stretches cables: of robots drawn at random, those whose platforms bounce
# more slowly were lost by the plan in one of two (`python -m benchmarks.any_robot`).
BOUNCE_PERIOD_MAX = Scaled(0.54, "s")
STRETCHING_SHARE = 0.4  # length change of all cables over the move of the mass: less is a sway


def slowest_bounce(robot: Robot) -> float:
    """Return the frequency of the slowest mode at home that stretches cables [Hz].

    Infinite where the robot cannot rest at home, and where no mode stretches any.
    """
    rest = statics.inverse_kinematics(robot, robot.home_position[None])
    if not rest.converged[0]:
        return np.inf
    modes = natural_modes(robot, rest)
    stretch = structure_matrix(robot, rest.position, rest.rotation)[0].T @ modes.shape[0]
    share = np.linalg.norm(stretch, axis=0) * np.sqrt(robot.mass)
    return float(modes.frequency[0][share > STRETCHING_SHARE].min(initial=np.inf))


def broken_premise(robot: Robot) -> str | None:
    """Return in words why plans of rigid cables do not fit a robot, or None where they do."""
    slowest = slowest_bounce(robot)
    allowed = 1.0 / BOUNCE_PERIOD_MAX.of(Scales(robot).ratios)
    if slowest >= allowed:
        return None
    return (
        f"the platform bounces on its cables at {slowest:.3g} Hz; plans of rigid cables need "
        f"{allowed:.3g} Hz at this size: its commands are those of kinematic_solver"
    )
