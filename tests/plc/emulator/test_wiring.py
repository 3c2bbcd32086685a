"""Cables wired otherwise than the robot file says: what the PLC does, and what the guard sees."""

import numpy as np
import pytest

from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.cli.main import main
from carosac_toolkit.cli.plc import _cables
from carosac_toolkit.cli.run_builder import TENSION_SHIFT_MAX
from carosac_toolkit.drivers.sensors import SensorSettings
from carosac_toolkit.loop.drive_state import Fault
from carosac_toolkit.loop.values import Command, Measurement, Stamped
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.plc.emulator.settings import EmulatorSettings
from carosac_toolkit.plc.emulator.world import World
from carosac_toolkit.robot.hardware import Hardware
from carosac_toolkit.safety.guard import GuardedDriver, GuardSettings
from carosac_toolkit.trajectories import minimum_snap
from tests.robots import simple_robot

ROBOT = simple_robot()
PERIOD, SPEED = 0.02, 0.05  # [s], [m/s] of a first motion
QUIET = SensorSettings(encoder_bias=0.0, encoder_noise=0.0, encoder_resolution=0.0)


def world(**wired):
    settings = EmulatorSettings(cycle=PERIOD, sensors=QUIET, **wired)
    found = World(ROBOT, Hardware.loopback(ROBOT.n), settings, 1)
    found.place(np.array(ROBOT.home_position))
    return found


class WiredDriver:
    """The world of a PLC as a driver: its numbers are lengths, its drives follow at once."""

    def __init__(self, **wired):
        self.world = world(**wired)
        self.told = self.start = self.world.inputs.length
        self.time = 0.0

    def connect(self):
        self.standing = self.world.standing

    def measure(self):
        inputs, time = self.world.inputs, np.array([self.time])
        return Measurement(
            time=time, unstrained_length=inputs.length[None],
            tension=Stamped(time=time, value=inputs.tension[None]),
        )  # fmt: skip

    def command(self, command):
        self.told = command.unstrained_length[0]
        return command

    def wait(self, duration):
        self.world.advance(self.standing + self.told - self.start)
        self.time += duration
        return True

    def stop(self, reason):
        pass

    def close(self):
        pass


def moved_until_seen(direction, **wired):
    """The fault of a slow straight motion, and how far the platform truly moved [m]."""
    driver = WiredDriver(**wired)
    settings = GuardSettings(period=PERIOD, motion=True, speed_max=1.5 * SPEED,
                             tension_shift_max=TENSION_SHIFT_MAX, home_anew=True)  # fmt: skip
    guard = GuardedDriver(driver, ROBOT, settings, real_time=False)
    guard.connect()
    start = driver.world.truth().position[0]
    home = ROBOT.home_position
    move = minimum_snap([home, home + 0.1 * np.asarray(direction)], speed_max=SPEED,
                        acceleration_max=0.3)  # fmt: skip
    path = move.sample(np.arange(0.0, move.duration + PERIOD, PERIOD)).position
    lengths = statics.inverse_kinematics(ROBOT, path).unstrained_length
    for k in range(len(lengths)):
        measurement = guard.measure()
        guard.command(Command(time=measurement.time, unstrained_length=lengths[k : k + 1]))
        if not guard.wait(PERIOD):
            break
    guard.stop("seen")
    moved = float(np.linalg.norm(driver.world.truth().position[0] - start))
    fault = guard.fault
    guard.close()
    return fault, moved


def test_what_is_wired_the_other_way_reads_and_turns_the_other_way():
    right, wrong, reversed_ = world(), world(wrong_sign=(1,)), world(reversed_drive=(1,))
    step = np.array([0.0, 0.02, 0.0, 0.0])
    for one in (right, wrong, reversed_):
        assert one.inputs.length == pytest.approx(right.inputs.length, abs=2e-3)
    start = [one.truth().unstrained_length[0] for one in (right, wrong, reversed_)]
    read = [one.inputs.length for one in (right, wrong, reversed_)]
    for one in (right, wrong, reversed_):
        standing = one.standing
        for _ in range(100):
            one.advance(standing + step)
    worlds = zip((right, wrong, reversed_), start, read, strict=True)
    changes = [
        (one.truth().unstrained_length[0] - was, one.inputs.length - said)
        for one, was, said in worlds
    ]
    for (true, said), turned, shown in zip(changes, (1, -1, -1), (1, 1, -1), strict=True):
        assert true == pytest.approx(turned * step, abs=1e-3)
        assert said == pytest.approx(shown * step, abs=1e-3)


@pytest.mark.parametrize("direction", [(0.0, 1.0, 0.0), (0.0, 0.0, 1.0)])
def test_a_wrong_sign_shows_in_the_tensions_before_5_cm_of_motion(direction):
    """All lengths follow their commands; it is the load that goes where it should not."""
    fault, moved = moved_until_seen(direction, wrong_sign=(1,))
    assert fault is not None
    assert fault.fault is Fault.CLOSURE
    assert "turn the other way than its sign" in fault.text
    assert moved < 0.05


def test_a_reversed_drive_is_seen_at_once_and_named():
    fault, moved = moved_until_seen((0.0, 0.0, 1.0), reversed_drive=(2,))
    assert fault.fault is Fault.FOLLOWING_ERROR
    assert fault.cable == ROBOT.cable_names[2]
    assert "it turns the other way" in fault.text
    assert moved < 0.03


def test_right_wires_are_no_fault():
    fault, moved = moved_until_seen((0.7, 0.0, 0.7))
    assert fault is None
    assert moved == pytest.approx(0.1, abs=0.02)


def test_cables_go_by_name_or_number_and_a_wrong_word_is_refused(capsys):
    first, third = ROBOT.cable_names[0], ROBOT.cable_names[2]
    words = (f"wrong_sign={first}", "wrong_sign=4", f"reversed_drive={third}")
    assert _cables(words, "wrong_sign", ROBOT) == (0, 3)
    assert _cables(words, "reversed_drive", ROBOT) == (2,)
    with pytest.raises(InvalidField, match="--fault: got 'wrong_sign=9'; allowed: wrong_sign or"):
        _cables(("wrong_sign=9",), "wrong_sign", ROBOT)
    assert main(["plc", "carosac", "--fault", "wrong=1"]) == 2
    assert "--fault: got 'wrong=1'" in capsys.readouterr().err
