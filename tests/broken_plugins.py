"""Controllers, estimators and drivers that each break one rule of their contract."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from baselines.kinematic_solver import KinematicSolver
from baselines.lookahead import LookaheadSettings
from baselines.straight_line import StraightLine
from baselines.straight_line_controller import StraightLineController
from carosac_toolkit.drivers.quasi_static import QuasiStaticDriver, QuasiStaticSettings
from carosac_toolkit.drivers.replay import ReplayDriver
from carosac_toolkit.loop.values import Command


class Wrapped:
    """Passes everything on to one of ours."""

    Inner: Any = None
    settings: Any = None

    def __init__(self, robot, seed):
        self.robot = robot
        self.inner = self.Inner.build(robot, self.settings, seed=seed)

    @classmethod
    def build(cls, robot, settings=None, *, seed=0):
        return cls(robot, seed)

    def __getattr__(self, name):
        return getattr(self.__dict__["inner"], name)


class Control(Wrapped):
    Inner = StraightLineController

    def lengths(self, belief, reference):
        return self.inner.command(belief, reference).unstrained_length

    def command(self, belief, reference):
        lengths = np.asarray(self.lengths(belief, reference), dtype=np.float64)
        return Command(time=belief.time, unstrained_length=lengths)


class NoPeriod(Control):
    period = float("inf")


class Wide(Control):
    def lengths(self, belief, reference):
        return np.tile(super().lengths(belief, reference), (1, 2))


class Tuple(Control):
    def command(self, belief, reference):
        return super().command(belief, reference).unstrained_length


class Negative(Control):
    def lengths(self, belief, reference):
        return -super().lengths(belief, reference)


class OtherClock(Control):
    def command(self, belief, reference):
        return replace(super().command(belief, reference), time=belief.time + 1.0)


class Integrates(Control):
    settings = LookaheadSettings(gain=1.0)

    def reset(self, belief):
        pass


class Dices(Control):
    def lengths(self, belief, reference):
        return super().lengths(belief, reference) + 1e-3 * np.random.random()  # noqa: NPY002


class DicesByAnotherClock(Dices, OtherClock):
    pass


class NanFarAway(Control):
    def lengths(self, belief, reference):
        with np.errstate(all="ignore"):
            # finite near home, and 0 / 0 a kilometre away
            far = np.float64(np.abs(belief.position).max() < 500.0)
            return super().lengths(belief, reference) * far / far


class CrashesFarAway(Control):
    def lengths(self, belief, reference):
        if np.abs(reference.position).max() > 500.0:
            raise np.linalg.LinAlgError("Singular matrix")
        return super().lengths(belief, reference)


class WantsTwist(Control):
    def lengths(self, belief, reference):
        return super().lengths(belief, reference) + 0.0 * belief.twist[:, :1]


class FourCables(Control):
    def lengths(self, belief, reference):
        return super().lengths(belief, reference)[:, :4]


class FourGains(Control):
    def lengths(self, belief, reference):
        return super().lengths(belief, reference) * np.ones(4)


class FirstRowOnly(Control):
    def lengths(self, belief, reference):
        lengths = super().lengths(belief, reference)
        return np.tile(lengths[:1], (len(lengths), 1))


class OneRowByReshape(Control):
    def lengths(self, belief, reference):
        return super().lengths(belief, reference).reshape(1, self.robot.n)


class Estimate(Wrapped):
    Inner = StraightLine

    def reset(self, measurement):
        return self.change(self.inner.reset(measurement))

    def update(self, belief, command, measurement):
        return self.change(self.inner.update(belief, command, measurement))

    def change(self, belief):
        return belief


class Array(Estimate):
    def change(self, belief):
        return belief.position

    def update(self, belief, command, measurement):
        return self.reset(measurement)


class Late(Estimate):
    def change(self, belief):
        return replace(belief, time=belief.time - 0.01)


class NanTension(Estimate):
    def change(self, belief):
        return replace(belief, tension=np.full((1, self.robot.n), np.nan))


class Remembers(Estimate):
    count = 0

    def change(self, belief):
        self.count += 1
        return replace(belief, position=belief.position + 1e-3 * self.count)


class DicesToo(Estimate):
    def change(self, belief):
        noise = 1e-3 * np.random.random(3)  # noqa: NPY002
        return replace(belief, position=belief.position + noise)


class DividesByTime(Estimate):
    def update(self, belief, command, measurement):
        new = super().update(belief, command, measurement)
        with np.errstate(all="ignore"):
            speed = (new.position - belief.position) / (measurement.time - belief.time)[:, None]
        return replace(new, twist=np.concatenate([speed, 0.0 * speed], axis=1))


class TakesFour(Estimate):
    def reset(self, measurement):
        cut = measurement.unstrained_length[:, : self.robot.n]
        return super().reset(replace(measurement, unstrained_length=cut))


class AddsPerCable(Estimate):
    def reset(self, measurement):
        bias = measurement.unstrained_length - np.full(self.robot.n, 0.0)
        return super().reset(replace(measurement, unstrained_length=bias))


class NeedsPose(Estimate):
    def reset(self, measurement):
        return replace(super().reset(measurement), position=measurement.pose.position)


class AveragesBatch(Estimate):
    Inner = KinematicSolver

    def change(self, belief):
        return replace(belief, position=belief.position * 0.0 + belief.position.mean(axis=0))


class Drive(Wrapped):
    Inner = QuasiStaticDriver


class MeasuresAlways(Drive):
    def measure(self):
        if not self.inner._connected:
            self.inner.connect()
        return self.inner.measure()


class TracebackBeforeConnect(Drive):
    def measure(self):
        return self.socket.read()


class StopNeedsConnection(Drive):
    def stop(self, reason):
        self.inner.measure()


class ClosesOnce(Drive):
    def close(self):
        self.inner.measure()
        self.inner.close()


class StandsStill(Drive):
    def measure(self):
        return replace(self.inner.measure(), time=np.zeros(1))


class MissesCable(Drive):
    def measure(self):
        found = self.inner.measure()
        return replace(found, unstrained_length=found.unstrained_length[:, 1:], length_rate=None)


class Leaks(Drive):
    settings = QuasiStaticSettings(suite="lengths+pose")


class CutsCommand(Drive):
    def command(self, command):
        held = command.unstrained_length[:, : self.robot.n]
        return self.inner.command(Command(time=command.time, unstrained_length=held))


class Echoes(Drive):
    def command(self, command):
        self.inner.command(command)
        return command


class ChangesSilently(Drive):
    def command(self, command):
        return replace(self.inner.command(command), limited=())


class ReplayEchoes(Drive):
    Inner = ReplayDriver

    def command(self, command):
        self.inner.command(command)
        return command


class IgnoresStop(Drive):
    def stop(self, reason):
        pass


class StopsDead(Drive):
    held: Any = None
    stopping = False

    def stop(self, reason):
        self.stopping = True

    def command(self, command):
        if not self.stopping:
            self.held = self.inner.command(command)
        return self.held

    def wait(self, duration):
        return self.inner.wait(duration) and not self.stopping


class WaitReturnsNone(Drive):
    def wait(self, duration):
        self.inner.wait(duration)


class Drifts(Drive):
    connections = 0

    def connect(self):
        self.connections += 1
        self.inner.connect()

    def measure(self):
        found = self.inner.measure()
        drift = 1e-3 * self.connections
        return replace(found, unstrained_length=found.unstrained_length + drift)


class Unseeded(Drive):
    @classmethod
    def build(cls, robot, settings=None, *, seed=0):
        return cls(robot, int(np.random.randint(2**31)))  # noqa: NPY002


class StatusWord(Drive):
    status = "following"


class OwnStatus(Drive):
    def status(self):
        return "running"


class FaultText(Drive):
    fault = "drive_trip"


class HoldsAnyFault(Drive):
    def hold_fault(self):
        pass


class SetsDownOnly(Drive):
    def set_down(self, position):
        pass


class PatienceText(Drive):
    lost_after = "0.1 s"
