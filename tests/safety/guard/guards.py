"""A guard on a robot without inertia whose sensors and drives can be made to fail."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from carosac_toolkit.base.errors import CarosacError
from carosac_toolkit.drivers.quasi_static import QuasiStaticDriver, QuasiStaticSettings
from carosac_toolkit.loop.drive_state import DriveState, Fault
from carosac_toolkit.loop.values import Command, State
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.safety.guard import GuardedDriver, GuardSettings
from tests.robots import simple_robot

PERIOD = 0.02
ROBOT = simple_robot()


class FailingDriver(QuasiStaticDriver):
    """Fails as its attributes say; sees every command."""

    def connect(self):
        super().connect()
        self.seen, self.jump, self.trip, self.lost, self.estop = [], 0.0, False, False, False
        self.frozen, self.holding = None, False
        self.told, self.stops, self.disables, self.closes = None, 0, 0, 0

    def measure(self):
        if self.lost:
            raise CarosacError("the cable is out")
        if self.frozen is not None:
            return self.frozen
        found = super().measure()
        lengths = found.unstrained_length + np.array([self.jump, 0.0, 0.0, 0.0])
        if isinstance(self.told, Exception):
            raise self.told
        return replace(found, unstrained_length=lengths)

    def freeze(self):
        self.frozen = super().measure()

    def command(self, command):
        if not self.holding:
            self.seen.append(np.array(command.unstrained_length[0]))
        return super().command(command)

    def wait(self, duration):
        self.holding = True  # a simulated driver holds by a command of its own
        try:
            return super().wait(duration)
        finally:
            self.holding = False

    def status(self):
        if self.estop:
            return str(DriveState.ESTOP)
        if isinstance(self.told, DriveState):
            return str(self.told)
        return str(DriveState.FAULT if self.trip else DriveState.FOLLOWING)

    @property
    def fault(self):
        return Fault.DRIVE_TRIP if self.trip else Fault.NONE

    def disable(self):
        self.disables += 1

    def stop(self, reason):
        self.stops += 1
        super().stop(reason)

    def close(self):
        self.closes += 1
        super().close()

    def reset_fault(self):
        if self.trip or self.estop:
            raise CarosacError("the cause is still there")


class Notes:
    """A journal that keeps everything."""

    def __init__(self):
        self.lengths, self.commands, self.events, self.beliefs = [], [], [], []

    def measured(self, measurement):
        self.lengths.append(measurement)

    def sent(self, asked, sent, *, really):
        self.commands.append((asked, sent, really))

    def believed(self, belief):
        self.beliefs.append(belief)

    def event(self, time, name, text):
        self.events.append((time, name, text))

    def names(self):
        return [name for _, name, _ in self.events]


def guarded(*, motion=True, at_once=True, robot=ROBOT, real_time=False, **changes):
    settings = GuardSettings(
        driver="quasi_static", period=PERIOD, motion=motion, enable_at_once=at_once, **changes
    )
    chosen = QuasiStaticSettings(period=PERIOD, real_time=real_time)
    inner = FailingDriver.build(robot, chosen, seed=1)
    guard = GuardedDriver(inner, robot, settings, real_time=real_time)
    guard.journal = Notes()
    return guard


def connected(**changes):
    guard = guarded(**changes)
    guard.connect()
    return guard


def home_state(robot=ROBOT):
    return State(
        time=np.zeros(1), position=robot.home_position[None], rotation=robot.home_rotation[None]
    )


def lengths_at(position, robot=ROBOT):
    found = statics.inverse_kinematics(robot, np.asarray(position, dtype=float)[None])
    assert found.converged[0]
    return found.unstrained_length


def standing(guard):
    return np.array(guard.measure().unstrained_length)


def ask(guard, lengths):
    """One cycle: whether the run goes on, and what was sent."""
    measurement = guard.measure()
    sent = guard.command(Command(time=measurement.time, unstrained_length=np.asarray(lengths)))
    return guard.wait(PERIOD), sent


def drive(guard, cycles, speed=0.3):
    """Move the platform along x from where the last drive ended; the lengths asked last."""
    here = getattr(guard, "driven", 0.0)
    start = standing(guard) - lengths_at(ROBOT.home_position + np.array([here, 0.0, 0.0]))
    for _ in range(cycles):
        here += speed * PERIOD
        asked = start + lengths_at(ROBOT.home_position + np.array([here, 0.0, 0.0]))
        alive, _ = ask(guard, asked)
        assert alive, guard.fault
    guard.driven = here
    return asked


def to_the_end(guard, cycles=200):
    """Ask to hold until `wait` says that it is over; how many cycles that took."""
    held = standing(guard)
    for k in range(cycles):
        if not ask(guard, held)[0]:
            return k + 1
    raise AssertionError("the run went on")


def within_limits(seen, robot=ROBOT, jerk=200.0):
    """Whether commands keep speed, acceleration and jerk, as seen by the drives."""
    lengths = np.array(seen)
    speed = np.diff(lengths, axis=0) / PERIOD
    acceleration = np.diff(speed, axis=0) / PERIOD
    jerks = np.diff(acceleration, axis=0) / PERIOD
    pairs = ((speed, robot.speed_max), (acceleration, robot.acceleration_max), (jerks, jerk))
    return all((np.abs(value) <= most * (1 + 1e-6) + 1e-6).all() for value, most in pairs)
