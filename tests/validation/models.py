"""Estimators made up for tests; ``module:Class`` finds them."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np

from carosac_toolkit.loop.values import Belief

NAME = "tests.validation.models"


class Constant:
    """Believes to be at home, whatever is measured."""

    def __init__(self, robot, seed=0):
        self.robot = robot
        self.seed = seed

    @classmethod
    def build(cls, robot, settings, *, seed):
        return cls(robot, seed)

    def reset(self, measurement):
        return self.believe(measurement, 0)

    def update(self, belief, command, measurement):
        return self.believe(measurement, belief.memory.count + 1)

    def believe(self, measurement, count, converged=True, shift=0.0):
        return Belief(
            time=measurement.time,
            position=self.robot.home_position[None] + shift,
            rotation=self.robot.home_rotation[None],
            converged=np.array([converged]),
            memory=SimpleNamespace(count=count),
        )


class Counting(Constant):
    """Lies one metre higher with every update."""

    def believe(self, measurement, count):
        return super().believe(measurement, count, shift=float(count))


class Failing(Constant):
    """Finds no pose at every fourth update, where its last one is far off."""

    def believe(self, measurement, count):
        bad = count % 4 == 3
        return super().believe(measurement, count, converged=not bad, shift=100.0 * bad)


class Seeded(Constant):
    """Its seed is its shift."""

    def believe(self, measurement, count):
        return super().believe(measurement, count, shift=float(self.seed))


class Spying(Constant):
    """Keeps the commands and measurements that it is given."""

    seen: list = []  # noqa: RUF012

    def reset(self, measurement):
        Spying.seen = [(None, measurement)]
        return super().reset(measurement)

    def update(self, belief, command, measurement):
        Spying.seen.append((command, measurement))
        return super().update(belief, command, measurement)


@dataclass(frozen=True)
class Uses:
    """Settings of `Using`."""

    swivels: bool = False
    load_cells: str = "a name that a switch has elsewhere"


class Using(Constant):
    """Lies a metre higher if it is told of swivel angles."""

    Settings = Uses

    @classmethod
    def build(cls, robot, settings, *, seed):
        return cls(robot, 1.0 * settings.swivels)

    def believe(self, measurement, count):
        return super().believe(measurement, count, shift=self.seed)


class Raising(Constant):
    """Breaks at its third update."""

    def update(self, belief, command, measurement):
        if belief.memory.count == 2:
            raise RuntimeError("no luck")
        return super().update(belief, command, measurement)


class Hopeless(Constant):
    """Never finds a pose."""

    def believe(self, measurement, count):
        return super().believe(measurement, count, converged=False)


class Unbuildable:
    """Has no ``build``."""


class TwoRows(Constant):
    """Returns a belief of two worlds for one measurement."""

    def believe(self, measurement, count):
        one = super().believe(measurement, count)
        return Belief(
            time=np.repeat(one.time, 2),
            position=np.repeat(one.position, 2, axis=0),
            rotation=np.repeat(one.rotation, 2, axis=0),
        )


class WrongTension(Constant):
    """Returns tensions of three cables."""

    def believe(self, measurement, count):
        one = super().believe(measurement, count)
        return Belief(
            time=one.time, position=one.position, rotation=one.rotation, tension=np.ones((1, 3))
        )


class NoBelief(Constant):
    """Returns something that only looks like a belief."""

    def believe(self, measurement, count):
        return SimpleNamespace(position=np.full((1, 3), np.nan), rotation=np.zeros((1, 3, 3)))


class Quitting(Constant):
    """Leaves."""

    def believe(self, measurement, count):
        raise SystemExit(0)
