"""Premise of the prediction model: cables are taut, so that their lengths say where they end.

The model has no sag that changes with the motion. Where a cable pulls with little more than its own
weight, its sag gives way like a soft spring, and a plan of taut cables drives the platform on.
"""

from __future__ import annotations

import numpy as np

from carosac_toolkit.physics.rest import statics
from carosac_toolkit.robot.robot import Robot

# At home, over the weight of the cable. Of robots drawn at random, all with less were lost by the
# plan, and few with more (`python -m benchmarks.any_robot`).
TENSION_MIN_CABLE_WEIGHTS = 1.5


def broken_premise(robot: Robot) -> str | None:
    """Return in words why plans of taut cables do not fit a robot, or None where they do.

    A robot that cannot rest at home is not judged.
    """
    rest = statics.inverse_kinematics(robot, robot.home_position[None])
    if not rest.converged[0]:
        return None
    weights = rest.tension[0] / (robot.weight_per_length * rest.unstrained_length[0])
    i = int(np.argmin(weights))
    if weights[i] >= TENSION_MIN_CABLE_WEIGHTS:
        return None
    return (
        f"cable {robot.cable_names[i]} pulls with {weights[i]:.2g} times its own weight at home; "
        f"plans of taut cables need {TENSION_MIN_CABLE_WEIGHTS:g}: its commands are those of "
        "kinematic_solver"
    )
