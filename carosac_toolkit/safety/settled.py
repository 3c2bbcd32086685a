"""Settings of drivers in numbers, with all that follows from the size of a robot."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, TypeVar

from carosac_toolkit.base.scaled import resolved
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.safety.limiter import LimitSettings

T = TypeVar("T")


def settled(settings: T, robot: Robot) -> T:
    """Return settings of a driver in which a robot has settled what was left to it.

    Drivers do so by themselves, for the robot that they get. Where that is a plant drawn at random,
    settle its settings for the nominal robot before, so that all plants have the same limits.

    Args:
        settings: Settings of a driver. What a method ``derived(robot)`` of them returns counts; a
            field ``limits`` counts for a field ``period``.
        robot: The nominal robot.
    """
    known: Any = resolved(settings, Scales(robot).ratios)
    limits = getattr(known, "limits", None)
    if isinstance(limits, LimitSettings):
        chosen = limits.jump_max is not None and hasattr(known, "slowed")
        winds = known.slowed(robot) if chosen else robot  # as fast as it may, for what was chosen
        known = replace(known, limits=limits.of(winds, period=known.period))
    if hasattr(known, "derived"):
        known = known.derived(robot)
    found: T = known
    return found
