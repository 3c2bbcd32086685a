"""Checks that any controller, estimator or driver can be run through, under pytest or without.

A test file of three lines::

    @conformance.each(conformance.CONTROLLER_CHECKS)
    def test_my_controller(check):
        check(MyController.build, ct.load_robot("carosac"))

Each check takes a factory, called as ``factory(robot, seed=...)``, and a robot. A plug-in's
``build`` is such a factory; ``functools.partial(MyController.build, settings=...)`` is another.
A check returns nothing, or raises `NotConforming`, which is an ``AssertionError``, and says what is
wrong. `check_controller`, `check_estimator` and `check_driver` run all checks of their kind.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from carosac_toolkit.conformance.controllers import CONTROLLER_CHECKS
from carosac_toolkit.conformance.drivers import DRIVER_CHECKS
from carosac_toolkit.conformance.estimators import ESTIMATOR_CHECKS
from carosac_toolkit.conformance.verdicts import Check, Factory, NotConforming, run_all
from carosac_toolkit.robot.robot import Robot

__all__ = [
    "CONTROLLER_CHECKS",
    "DRIVER_CHECKS",
    "ESTIMATOR_CHECKS",
    "Check",
    "Factory",
    "NotConforming",
    "check_controller",
    "check_driver",
    "check_estimator",
    "each",
]


def check_controller(factory: Factory, robot: Robot, *, skip: tuple[str, ...] = ()) -> None:
    """Run a controller through all `CONTROLLER_CHECKS`.

    Args:
        factory: Makes one: ``factory(robot, seed=...)``.
        robot: A robot that it works for, with a home position at which it can rest.
        skip: Names of checks to leave out.

    Raises:
        NotConforming: Lists every check that failed, with its reason.
    """
    run_all("controller", CONTROLLER_CHECKS, factory, robot, skip)


def check_estimator(factory: Factory, robot: Robot, *, skip: tuple[str, ...] = ()) -> None:
    """Run an estimator through all `ESTIMATOR_CHECKS`; see `check_controller`."""
    run_all("estimator", ESTIMATOR_CHECKS, factory, robot, skip)


def check_driver(factory: Factory, robot: Robot, *, skip: tuple[str, ...] = ()) -> None:
    """Run a driver through all `DRIVER_CHECKS`; see `check_controller`.

    The factory makes it with a sensor suite without poses. It is commanded every 20 ms, within a
    quarter of the speed limits, and stopped: on hardware the robot moves. A real robot never
    measures the same twice: skip ``connecting_again_starts_over`` and ``same_seed_same_data``.
    """
    run_all("driver", DRIVER_CHECKS, factory, robot, skip)


def each(checks: Mapping[str, Check]) -> Any:
    """Decorate a test to run once per check, which it gets as its argument ``check``."""
    import pytest

    return pytest.mark.parametrize("check", list(checks.values()), ids=list(checks))
