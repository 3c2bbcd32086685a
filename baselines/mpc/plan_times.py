"""Times of a plan: how long its stages are, and how quickly it corrects errors.

Both follow the size of the robot, and are shorter where a platform turns fast on its cables, as a
small one on cables that pull hard does. The prediction model advances by one Runge-Kutta step a
stage, which is stable up to 2.8 radians of its fastest motion. And a plan that corrects errors more
slowly than the platform moves by itself leaves them to that motion.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from baselines.mpc import model
from baselines.mpc.geometry import geometry_at
from baselines.mpc.settings import MpcSettings
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.scaled import Ratios, Scaled, resolved
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.robot.robot import Robot

STAGE_ANGLE_MAX_RAD = 1.5  # of the fastest motion in a stage: half of what is stable
FASTEST = Scaled(11.3, "rad/s")  # motion for which weights are right by the size alone
WEIGHTS = ("position_weight", "velocity_weight")  # that of spin damps sway, and stays


def stage_durations(settings: MpcSettings) -> Array:
    """Return how long the stages of a plan are [s], shape (N,), for settings in numbers."""
    count = settings.stages - 1
    return np.array([settings.period, *[(settings.lookahead - settings.period) / count] * count])


def times_of(durations: Array) -> Array:
    """Return the times of the states from now [s], shape (N + 1,)."""
    return np.concatenate([[0.0], np.cumsum(durations)])


def settings_for(robot: Robot, settings: MpcSettings) -> tuple[MpcSettings, float]:
    """Return settings in numbers for a robot, and the unit of time of its weights [s].

    What was chosen stays. The unit of time is over that of ``carosac``.
    """
    ratios, fastest = Scales(robot).ratios, fastest_motion(robot)
    share = min(1.0, FASTEST.of(ratios) / fastest) if fastest > 0.0 else 1.0
    quicker = Ratios(ratios.mass, ratios.length * share**2, ratios.time * share)
    weighed = resolved(settings, quicker)
    found = replace(
        resolved(settings, ratios), **{name: getattr(weighed, name) for name in WEIGHTS}
    )
    if isinstance(settings.lookahead, Scaled) and fastest > 0.0:
        longest = (found.stages - 1) * STAGE_ANGLE_MAX_RAD / fastest
        found = replace(found, lookahead=min(found.lookahead, found.period + longest))
    return found, quicker.time


def fastest_motion(robot: Robot) -> float:
    """Return the rate of the fastest motion of the model about home [rad/s]; 0 without rest."""
    rest = statics.inverse_kinematics(robot, robot.home_position[None])
    if not rest.converged[0]:
        return 0.0
    geometry = geometry_at(robot, rest.position[0], rest.rotation[0])
    state = np.zeros(model.STATE_SIZE)
    state[:3] = rest.position[0]
    parameters = model.parameters(
        robot, rotation=rest.rotation[0], length=geometry.free, exits=geometry.exits,
        disturbance=np.zeros(6),
    )  # fmt: skip
    rate_by_state = model.continuous(robot.n)(state, rest.tension[0], parameters)[1]
    return float(np.abs(np.linalg.eigvals(np.array(rate_by_state))).max())
