"""Input shaping: impulses by theory, and a platform that comes to rest in the simulator."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from baselines.input_shaping import InputShaping, InputShapingSettings
from baselines.kinematic_solver import KinematicSolver
from baselines.kinematic_solver_controller import KinematicSolverController, UnreachableReference
from baselines.shaped_signal import ShapedSignal
from baselines.shapers import impulses, mean_delay, residual
from baselines.sway_modes import sway_modes
from carosac_toolkit import trajectories
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.conformance import CONTROLLER_CHECKS
from carosac_toolkit.drivers.sensors import PERFECT_SENSORS
from carosac_toolkit.loop.loop import run
from carosac_toolkit.loop.values import Belief, Reference
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.physics.rest.modes import natural_modes
from sim_warp import Simulator
from sim_warp.driver import SimDriver, SimDriverSettings
from tests.robots import eight_cable_robot, hanging, simple_robot

PERIOD = 0.02
START = 2.5  # [s] of rest before the move: the look ahead has grown to its full size
USUAL = InputShapingSettings()


class Move:
    """From home by an offset in a short time, smoothly; rest before and after."""

    def __init__(self, offset, seconds):
        self.offset, self.seconds = np.asarray(offset, dtype=float), seconds
        self.duration = START + seconds
        self.home = simple_robot().home_position

    def window(self, time, horizon, period):
        rows = 1 + int(np.floor(horizon / period + 1e-9))
        when = time + period * np.arange(rows)
        share = np.clip((when - START) / self.seconds, 0.0, 1.0)
        course = share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
        bend = (60.0 * share - 180.0 * share**2 + 120.0 * share**3) / self.seconds**2
        zero = np.zeros((1, rows, 3))
        return Reference(
            time=when[None], position=(self.home + np.outer(course, self.offset))[None],
            velocity=zero, acceleration=np.outer(bend, self.offset)[None],
        )  # fmt: skip


def swing_after(controller, offset=(0.1, 0.0, 0.0), seconds=0.5, robot=None):
    """Largest distance from the mean position at rest, 2.5 s after the move and later [m]."""
    robot = robot or simple_robot()
    settings = SimDriverSettings(sensors=PERFECT_SENSORS, cables="catenary", wind_force=0.0)
    driver = SimDriver.build(robot, settings)
    move = Move(offset, seconds)
    log = run(
        driver, KinematicSolver.build(robot), controller, move, duration=START + seconds + 5.0
    )
    rest = log.position[log.time > move.duration + 2.5, 0]
    return np.linalg.norm(rest - rest.mean(axis=0), axis=1).max()


def commanded(controller, window, count):
    """Positions of rest at the commanded lengths, for references `window(k)`."""
    robot = simple_robot()
    belief = Belief(time=np.zeros(1), position=robot.home_position[None], rotation=np.eye(3)[None])
    controller.reset(belief)
    sent = []
    for k in range(count):
        reference = window(k * PERIOD, controller.horizon, PERIOD)
        sent.append(controller.command(belief, reference).unstrained_length)
    return statics.forward_kinematics(robot, np.concatenate(sent)).position


@pytest.fixture(scope="module")
def unshaped_swing():
    """What 0.1 m in half a second leaves unshaped [m]."""
    swing = swing_after(KinematicSolverController.build(simple_robot()))
    assert swing > 0.05
    return swing


@pytest.mark.parametrize("shaper", ["zv", "zvd"])
@pytest.mark.parametrize("damping", [0.0, 0.1])
def test_a_shaper_leaves_nothing_of_an_oscillator_and_does_not_scale(shaper, damping):
    frequency = np.array([0.45, 2.0])
    times, amplitudes = impulses(shaper, frequency, np.full(2, damping))
    assert amplitudes.sum(axis=1) == pytest.approx(1.0)
    assert residual((times, amplitudes), frequency, np.full(2, damping)) == pytest.approx(0.0)
    # the impulse responses of the oscillator itself, added up after the last impulse
    rate = 2.0 * np.pi * frequency[:, None] * np.sqrt(1.0 - damping**2)
    later = times[:, -1:] + np.linspace(0.0, 2.0, 50)
    since = later[:, :, None] - times[:, None, :]
    decay = np.exp(-damping * 2.0 * np.pi * frequency[:, None, None] * since)
    response = amplitudes[:, None, :] * decay * np.sin(rate[:, :, None] * since)
    assert response.sum(axis=2) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize(("shaper", "power"), [("zv", 1), ("zvd", 2)])
@pytest.mark.parametrize("off", [0.9, 1.1])
def test_a_wrong_frequency_leaves_what_theory_says(shaper, power, off):
    made_for = impulses(shaper, np.array([0.5]), np.zeros(1))
    left = residual(made_for, np.array([0.5 * off]), np.zeros(1))
    assert left == pytest.approx(abs(np.cos(0.5 * np.pi * off)) ** power)
    assert mean_delay(made_for) == pytest.approx(0.5 * power)


def test_impulses_are_set_apart_by_phase_where_the_frequency_changes():
    """A step meets its second impulse after half a swing, at whatever frequency that goes by."""
    signal, time = ShapedSignal("zv"), np.arange(0.0, 4.0, 0.01)
    frequency = 0.5 + 0.25 * time
    made = [
        signal.next(np.array([t]), np.full((1, 3), float(t >= 0.5)), np.array([f]), np.zeros(1))
        for t, f in zip(time, frequency, strict=True)
    ]
    jumps = time[np.flatnonzero(np.diff(np.concatenate(made)[:, 0]) > 0.1)]
    swung = [0.5 * t + 0.125 * t**2 for t in jumps]  # [1]
    assert swung[-1] - swung[0] == pytest.approx(0.5, abs=0.02)


def test_sway_modes_are_damped_by_drag_and_excited_along_their_own_direction():
    robot = simple_robot()
    rest = statics.inverse_kinematics(robot, robot.home_position[None])
    modes = sway_modes(robot, rest, 2)
    assert modes.frequency[0] == pytest.approx([0.448, 1.545], rel=0.02)
    assert (modes.damping > 0.0).all() and (modes.damping < 0.02).all()
    slow, fast = np.abs(modes.excitation[0])
    assert slow[0] > 20.0 * slow[1:].max() and fast[1] > 20.0 * fast[[0, 2]].max()
    calm = replace(
        robot, drag=0.0, angular_drag=0.0, axial_damping=np.zeros(4), cable_drag=0.0
    )  # fmt: skip
    assert sway_modes(calm, rest, 2).damping == pytest.approx(0.0)
    turning = [
        sway_modes(replace(calm, angular_drag=1.0, angular_drag_axes=axes), rest, 2).damping
        for axes in (*np.eye(3), np.ones(3))
    ]
    assert sum(turning[:3]) == pytest.approx(turning[3])


@pytest.mark.parametrize("air", [{"cable_drag": 3.0}, {"drag": 1.0}])
def test_a_sway_decays_in_the_simulation_as_its_mode_is_damped(air):
    still = {"drag": 0.0, "angular_drag": 0.0, "axial_damping": np.zeros(4), "cable_drag": 0.0}
    robot = replace(simple_robot(), **(still | air))
    rest = statics.inverse_kinematics(robot, robot.home_position[None])
    modes = sway_modes(robot, rest, 1)
    shape = natural_modes(robot, rest).shape[0, :, 0]
    shape = shape / np.linalg.norm(shape[:3])
    simulator = Simulator(robot, cables="catenary", time_step=1.0 / 200.0)
    simulator.reset(rest.position, twist=0.05 * shape[None])
    hold, speed = np.array(simulator.state.unstrained_length.numpy()), []
    for _ in range(1200):
        simulator.step(hold, 0.02)
        speed.append(simulator.state.twist.numpy()[0] @ shape)
    speed = np.array(speed)
    top = 1 + np.flatnonzero((speed[1:-1] > speed[:-2]) & (speed[1:-1] >= speed[2:]))
    rate = -np.polyfit(0.02 * top, np.log(speed[top]), 1)[0]
    damping = rate / (2.0 * np.pi * modes.frequency[0, 0])
    assert damping == pytest.approx(modes.damping[0, 0], rel=5e-3)


@pytest.mark.parametrize("settings", [
    USUAL, replace(USUAL, shaper="zvd"), replace(USUAL, directions="all"),
    replace(USUAL, preview=False),
])  # fmt: skip
def test_the_platform_is_left_at_rest(settings, unshaped_swing):
    """Under 5 % of the sway that the same move leaves unshaped."""
    assert swing_after(InputShaping.build(simple_robot(), settings)) < 0.05 * unshaped_swing


def test_a_move_through_other_frequencies_leaves_little():
    """0.6 m up and along in 2 s, the frequency rising by 13 % meanwhile."""
    robot, offset = simple_robot(), (0.6, 0.3, 0.6)
    unshaped = swing_after(KinematicSolverController.build(robot), offset, 2.0)
    assert swing_after(InputShaping.build(robot, USUAL), offset, 2.0) < 0.05 * unshaped


@pytest.mark.parametrize(("shaper", "power"), [("zv", 1), ("zvd", 2)])
def test_a_wrong_frequency_leaves_as_much_sway_as_theory_says(
    shaper, power, monkeypatch, unshaped_swing
):
    """The modes that the controller knows are 10 % too fast."""

    def too_fast(robot, rest, count):
        modes = sway_modes(robot, rest, count)
        return replace(modes, frequency=1.1 * modes.frequency)

    monkeypatch.setattr("baselines.input_shaping.sway_modes", too_fast)
    left = swing_after(InputShaping.build(simple_robot(), replace(USUAL, shaper=shaper)))
    expected = np.cos(0.5 * np.pi / 1.1) ** power  # 0.142, 0.020
    assert left / unshaped_swing == pytest.approx(expected, rel=0.15)


def test_at_rest_it_sends_the_lengths_of_rest_there():
    robot, still = simple_robot(), Move((0.0, 0.0, 0.0), 1.0)
    belief = Belief(time=np.zeros(1), position=robot.home_position[None], rotation=np.eye(3)[None])
    expected = statics.inverse_kinematics(robot, robot.home_position[None]).unstrained_length
    controller = InputShaping.build(robot)
    for k in range(100):
        reference = still.window(k * PERIOD, controller.horizon, PERIOD)
        sent = controller.command(belief, reference).unstrained_length
        assert sent == pytest.approx(expected, abs=1e-9)


def test_with_preview_the_shaped_path_is_centred_on_the_reference():
    """At constant velocity it is where the reference is; without preview it is late."""
    velocity = np.array([0.05, 0.0, 0.0])

    def window(time, horizon, period):
        rows = 1 + int(np.floor(horizon / period + 1e-9))
        when = time + period * np.arange(rows)
        position = simple_robot().home_position + np.outer(when - 3.0, velocity)
        zero = np.zeros((1, rows, 3))
        return Reference(time=when[None], position=position[None], velocity=zero, acceleration=zero)

    settings = replace(USUAL, delay=0.0)
    for preview in (True, False):
        controller = InputShaping.build(simple_robot(), replace(settings, preview=preview))
        error = commanded(controller, window, 250)[-1] - window(4.98, 0.0, PERIOD).position[0, 0]
        late = 0.0 if preview else controller.lag[0]
        assert error == pytest.approx(-late * velocity, abs=5e-4)


def test_a_changing_frequency_makes_no_jumps():
    """Along a path on which it doubles, the command is as smooth as the reference is."""
    low, high = np.array([0.4, -1.8, 1.2]), np.array([0.9, -1.4, 4.8])
    path = trajectories.line(low, high, speed_max=1.5, acceleration_max=1.5)
    count = int(path.duration / PERIOD)
    sent = commanded(InputShaping.build(simple_robot(), USUAL), path.window, count)
    settled = sent[int(1.1 / PERIOD) :]
    bend = np.linalg.norm(np.diff(settled, 2, axis=0), axis=1) / PERIOD**2
    assert bend.max() < 1.5 * path.peak_acceleration
    assert np.abs(np.diff(bend)).max() < 0.15 * path.peak_acceleration


@pytest.mark.parametrize("make", [simple_robot, eight_cable_robot])
@pytest.mark.parametrize("check", CONTROLLER_CHECKS.values(), ids=CONTROLLER_CHECKS)
def test_it_keeps_the_contract(check, make):
    check(InputShaping.build, make())


def test_a_stiff_robot_gets_no_shaping():
    robot = eight_cable_robot()
    controller = InputShaping.build(robot)
    assert controller.modes == 0
    assert controller.horizon == KinematicSolverController.build(robot).horizon


def test_modes_that_are_not_slower_than_is_set_are_left_unshaped():
    modes = [
        InputShaping.build(simple_robot(), InputShapingSettings(frequency_max=limit)).modes
        for limit in (0.0, 3.0, 100.0)
    ]
    assert modes[0] == 0 < modes[1] < modes[2] == 6


def test_the_look_ahead_is_whole_only_after_the_start_time():
    """A move that begins before that is prepared less early."""
    begins = []
    for start_time in (1.0, 8.0):
        controller = InputShaping.build(simple_robot(), InputShapingSettings(start_time=start_time))
        position = commanded(controller, Move((0.3, 0.0, 0.0), 0.5).window, 140)
        moved = np.linalg.norm(position - position[0], axis=1) > 1e-3
        begins.append(moved.argmax() * PERIOD)
    assert begins[0] < START < begins[1] + controller.horizon
    assert begins[1] - begins[0] > 0.1


def test_what_cannot_be_is_said():
    robot, still = simple_robot(), Move((0.0, 0.0, 0.0), 1.0)
    controller = InputShaping.build(robot)
    belief = Belief(time=np.zeros(1), position=robot.home_position[None], rotation=np.eye(3)[None])
    reference = still.window(0.0, controller.horizon, PERIOD)
    controller.command(belief, reference)
    with pytest.raises(InvalidField, match=r"reference.time\[0\]: .*reset\(\) in between"):
        controller.command(belief, reference)
    controller.reset(belief)
    up = replace(reference, position=reference.position + np.array([0.0, 0.0, 7.0]))
    with pytest.raises(UnreachableReference, match="input_shaping: position"):
        controller.command(belief, up)


def test_a_platform_that_turns_freely_is_refused():
    robot = replace(hanging(2), anchor_points=np.zeros((2, 3)))
    with pytest.raises(UnreachableReference, match="at home: rest is not stable there"):
        InputShaping.build(robot)


def test_the_slowest_sway_of_two_cables_is_found_where_they_let_the_platform_rest():
    """Wherever the box is across the plane of rest: its grid need not meet it."""
    robot = hanging(2)
    shifted = replace(
        robot, workspace_min=robot.workspace_min + np.array([0.0, 0.07, 0.0]),
        workspace_max=robot.workspace_max + np.array([0.0, 0.07, 0.0]),
    )  # fmt: skip
    lag = InputShaping.build(robot).lag
    assert InputShaping.build(shifted).lag == pytest.approx(lag, rel=1e-6)


@pytest.mark.parametrize(
    ("name", "value"),
    [("shaper", "ei"), ("directions", "x"), ("preview", 1), ("frequency_max", -1.0),
     ("start_time", 0.0), ("period", 0.0)],
)  # fmt: skip
def test_settings_that_make_no_sense_are_refused(name, value):
    with pytest.raises(InvalidField, match=f"{name}: got"):
        InputShapingSettings(**{name: value})


@pytest.mark.parametrize(
    ("name", "arguments"),
    [("shaper", ("ei", np.ones(1), np.zeros(1))), ("frequency", ("zv", np.zeros(1), np.zeros(1))),
     ("damping", ("zv", np.ones(1), np.ones(1)))],
)  # fmt: skip
def test_shapers_that_make_no_sense_are_refused(name, arguments):
    with pytest.raises(InvalidField, match=f"{name}: got"):
        impulses(*arguments)


def test_a_shaper_without_a_mode_says_that_it_does_nothing():
    """So the table of a study can say so; on a robot that sways there is nothing to remark."""
    robot = simple_robot()
    assert InputShaping.build(robot).remark is None
    stiff = InputShaping.build(robot, InputShapingSettings(frequency_max=0.0))
    assert stiff.modes == 0 and "commands are those of kinematic_solver" in stiff.remark
