"""What a study compares where nothing is named: controllers, estimators and sensors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from carosac_toolkit.base.errors import CarosacError
from carosac_toolkit.loop import plugins
from carosac_toolkit.loop.plugins import name_of
from carosac_toolkit.robot.file import load_robot
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


def default_choice(driver: object) -> DefaultChoice:
    """Return the defaults on a driver, a name or a class."""
    return SIMULATED if name_of(driver) == DEFAULT_DRIVER else ON_OTHER_DRIVERS  # type: ignore[arg-type]


def default_controllers(
    driver: object, robots: Sequence[str]
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the default controllers, without those that refuse one of the robots.

    A controller refuses a robot by `check_robot`: a bundled policy was trained for one robot.

    Args:
        driver: Name or class of the driver.
        robots: Bundled names, or paths of robot files.

    Returns:
        Names of controllers, and a sentence for each one left out.

    Raises:
        CarosacError: There is no such robot.
    """
    kept, left_out = [], []
    loaded = [load_robot(robot) for robot in robots]
    for name in default_choice(driver).controllers:
        try:
            controller = plugins.load("controllers", name)
            for robot in loaded if hasattr(controller, "check_robot") else []:
                controller.check_robot(robot)
        except CarosacError as error:
            left_out.append(f"{name} is left out. {error}")
        else:
            kept.append(name)
    return tuple(kept), tuple(left_out)
