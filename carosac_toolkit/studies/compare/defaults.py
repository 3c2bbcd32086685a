"""What a study compares where nothing is named: controllers, estimators and sensors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from carosac_toolkit.base.errors import CarosacError
from carosac_toolkit.base.extras import MissingExtra
from carosac_toolkit.loop import plugins
from carosac_toolkit.loop.plugins import name_of
from carosac_toolkit.robot.file import load_robot
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.studies.run.run_case import DEFAULT_DRIVER
from carosac_toolkit.trajectories.catalogue import FAST_MOVE

DEFAULT_SEEDS = 10
QUICK_SEEDS = 2
DEFAULT_TRAJECTORIES = (FAST_MOVE,)


@dataclass(frozen=True)
class DefaultChoice:
    """Choice of plug-ins and sensors.

    Attributes:
        controllers: Names of controllers, the baseline first.
        estimators: Names of estimators.
        sensors: Sensors of the driver.
    """

    controllers: tuple[str, ...]
    estimators: tuple[str, ...]
    sensors: tuple[str, ...]


SIMULATED = DefaultChoice(
    ("straight_line", "kinematic_solver", "input_shaping", "mpc", "td3"),
    ("dynamic_estimator",),
    ("lengths+imu",),
)
# Other drivers may have no inertia, no IMU, or replay a run that no controller can change.
ON_OTHER_DRIVERS = DefaultChoice(
    ("straight_line", "kinematic_solver"), ("kinematic_solver",), ("lengths",)
)


def default_controllers(
    driver: object, robots: Sequence[str]
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the default controllers, without those that need a missing extra or refuse a robot.

    A controller refuses a robot by `check_robot`: a bundled policy was trained for one robot.

    Args:
        driver: Name or class of the driver.
        robots: Bundled names, or paths of robot files.

    Returns:
        Names of controllers, and a sentence for each one left out.

    Raises:
        CarosacError: There is no such robot, or a plug-in is broken.
    """
    kept, left_out = [], []
    loaded = [load_robot(robot) for robot in robots]
    for name in _usual(driver).controllers:
        reason = _refusal(name, loaded)
        if reason is None:
            kept.append(name)
        else:
            left_out.append(reason)
    return tuple(kept), tuple(left_out)


def default_estimation(driver: object) -> tuple[DefaultChoice, tuple[str, ...]]:
    """Return default estimators and sensors, and a sentence if those of the driver need an extra.

    Raises:
        CarosacError: A plug-in is broken.
    """
    usual = _usual(driver)
    try:
        for name in usual.estimators:
            plugins.load("estimators", name)
    except MissingExtra as error:
        other = ON_OTHER_DRIVERS
        text = (
            f"Left out: {error}. Instead the default estimator is {other.estimators[0]}, and the "
            f"default sensors are {other.sensors[0]}."
        )
        return other, (text,)
    return usual, ()


def _usual(driver: object) -> DefaultChoice:
    """Return the defaults on a driver where nothing is missing."""
    return SIMULATED if _is_simulator(driver) else ON_OTHER_DRIVERS


def _is_simulator(driver: object) -> bool:
    """Return whether a driver is the default one, however it is named."""
    name = name_of(driver)  # type: ignore[arg-type]
    if name == DEFAULT_DRIVER or ":" not in name:
        return name == DEFAULT_DRIVER
    try:
        return plugins.load("drivers", name) is plugins.load("drivers", DEFAULT_DRIVER)
    except CarosacError:  # the study says why when it checks its driver
        return False


def _refusal(name: str, robots: Sequence[Robot]) -> str | None:
    """Say why a controller is left out for these robots, or None if all can use it."""
    try:
        controller = plugins.load("controllers", name)
    except MissingExtra as error:
        return f"Left out: {error}"
    try:
        for robot in robots if hasattr(controller, "check_robot") else []:
            controller.check_robot(robot)
    except CarosacError as error:
        return f"{name} is left out. {error}"
    return None
