"""Drivers of a guided robot, each behind the guard, and hands that move it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calibration.guide.settings import GuideSettings
from calibration.guide.simulated import MisjudgedPlant
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.drivers.quasi_static import QuasiStaticSettings
from carosac_toolkit.drivers.simulated import SimulatedDriver
from carosac_toolkit.loop.protocols import Driver
from carosac_toolkit.loop.values import State
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.safety.guard import GuardedDriver, GuardSettings

SUITE = "lengths+tension"
SLACK_TIME_S = 30.0  # [s] in which the guide itself has slack cables tightened, or gives up
SPEED_RATIO = 1.5  # of the fastest winch to the platform, with the feedback of tensions


def guard_limits(robot: Robot, settings: GuideSettings) -> dict[str, object]:
    """Return the settings of the guard for a robot whose geometry is not known yet.

    What follows from winches and load cells is checked as ever; poses by the lengths are not, as
    they mean nothing yet.
    """
    size = float(np.linalg.norm(robot.exit_points - robot.home_position, axis=1).max())
    return {
        "closure_max": size, "belief_max": size, "workspace_margin": size,
        "tension_shift_max": None, "enable_at_once": False, "slack_time": SLACK_TIME_S,
        "speed_max": SPEED_RATIO * settings.speed,
    }  # fmt: skip


def check_speed(speed: float, robot: Robot) -> None:
    """Refuse a speed of the platform [m/s] that its winches do not follow with feedback.

    Raises:
        InvalidField: Too fast.
    """
    slowest = float(robot.speed_max.min())
    if SPEED_RATIO * speed > slowest:
        allowed = (
            f"at most {slowest / SPEED_RATIO:.3g} m/s: the slowest winch does {slowest:.3g} m/s, "
            f"and {SPEED_RATIO:g} times the speed is needed"
        )
        raise InvalidField("--speed", f"{speed:g} m/s", allowed)


def simulated_driver(
    robot: Robot, true_robot: Robot, settings: GuideSettings, *, seed: int, tension: bool = True
) -> SimulatedDriver:
    """Return a simulated robot that rests at home.

    Args:
        robot: As in its file.
        true_robot: The plant.
        settings: Of the guide.
        seed: Of the noise of its sensors.
        tension: Whether it has load cells.
    """
    suite = SUITE if tension else "lengths"
    chosen = QuasiStaticSettings(suite=suite, period=settings.period)
    return SimulatedDriver(MisjudgedPlant(robot, true_robot), chosen, seed)


def guarded(driver: Driver, robot: Robot, settings: GuideSettings) -> GuardedDriver:
    """Return a guard around a simulated robot."""
    limits = GuardSettings(motion=True, period=settings.period)
    limits = replace(limits, **guard_limits(robot, settings))  # type: ignore[arg-type]
    return GuardedDriver(driver, robot, limits, real_time=False)


def enable_where_it_is(guard: GuardedDriver, robot: Robot) -> None:
    """Connect a guard and let commands through; its lengths keep their meaning.

    Raises:
        CarosacError: Why it cannot be enabled.
    """
    guard.connect()
    length = guard.measure().unstrained_length
    guard.home(
        State(
            time=np.zeros(1),
            position=robot.home_position[None],
            rotation=robot.home_rotation[None],
            unstrained_length=length,
        )
    )
    guard.enable()
