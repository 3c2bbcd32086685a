"""The guard on a PLC in a process of its own."""

from __future__ import annotations

import threading
import time
from dataclasses import replace

import numpy as np
import pytest

from carosac_toolkit import trajectories
from carosac_toolkit.base.errors import CarosacError
from carosac_toolkit.cli.main import main
from carosac_toolkit.conformance.capabilities import capabilities_fit
from carosac_toolkit.loop.drive_state import DriveState, Fault
from carosac_toolkit.loop.loop import run
from carosac_toolkit.loop.values import Belief, Command
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.plc.blocks import Injection
from carosac_toolkit.plc.driver import PlcDriver, PlcDriverSettings
from carosac_toolkit.plc.guarded import GuardedAds, GuardedAdsSettings
from carosac_toolkit.recordings.crash_safe import read_run
from carosac_toolkit.safety.guard import IllegalTransition, NotReady
from carosac_toolkit.studies.compare.study import Study
from tests.plc_process import home_pose, plc_process

PERIOD = 0.02
WATCHDOG = 0.6  # [s] patient with a busy machine, as the guards below
OVER = ("over_length", "over_speed", "over_acceleration", "over_jerk", "not_finite", "jumps")


class Kinematics:
    """Believes the reference's start, and asks for the equilibrium lengths along the reference."""

    period, horizon = PERIOD, 0.0

    def __init__(self, robot):
        self.robot, self.then, self.cycles = robot, None, 0

    def reset(self, thing):
        return self._belief(thing) if hasattr(thing, "unstrained_length") else None

    def update(self, belief, command, measurement):
        return self._belief(measurement)

    def _belief(self, measurement):
        robot = self.robot
        return Belief(
            time=measurement.time, position=robot.home_position[None],
            rotation=robot.home_rotation[None],
        )  # fmt: skip

    def command(self, belief, reference):
        self.cycles += 1
        if self.then is not None and self.cycles == 60:
            self.then()
        found = statics.inverse_kinematics(self.robot, reference.position[0, :1])
        return Command(time=belief.time, unstrained_length=found.unstrained_length)


@pytest.fixture(scope="module")
def plc():
    with plc_process("--watchdog", str(WATCHDOG)) as found:
        yield found


def guard_of(plc, place=False, **changes):
    """Patient with a busy machine; `place`: the PLC sets its robot down at home."""
    inner = {"lost_after": 0.5}
    if place:
        inner["start_position"] = tuple(plc.robot.home_position)
    return GuardedAds.build(
        plc.robot,
        GuardedAdsSettings(
            period=PERIOD,
            inner=inner,
            overrun_share=1.0,
            hang_time=2.0,
            stale_time=0.5,
            following_max=0.5,
            jump_max=0.3,
            **changes,
        ),
    )


def follow(guard, plc, then=None, duration=2.0):
    controller = Kinematics(plc.robot)
    controller.then = then
    home = plc.robot.home_position
    path = trajectories.line(home, home + 0.3, speed_max=0.4, acceleration_max=0.8)
    log = run(guard, controller, controller, path, duration=duration)
    return log


def counters(plc):
    with plc.client() as client:
        return client.diagnosis()


def at_rest(plc):
    """Wait until the PLC turns no winch."""
    for _ in range(100):
        if not np.any(counters(plc)["set_speed"]):
            return True
        time.sleep(0.05)
    return False


def test_a_dry_run_writes_nothing_to_the_plc(plc):
    guard = guard_of(plc)
    before = counters(plc)
    log = follow(guard, plc, duration=0.5)
    after = counters(plc)
    assert log.completed
    assert {hit.limit for _, hit in log.limited} >= {"not_enabled"}
    for name in ("commands", "ignored", "foreign"):
        assert after[name] == before[name]


def test_a_rehearsal_finds_a_wrong_home_and_writes_nothing_to_the_plc(plc):
    before = counters(plc)
    home = plc.robot.home_position
    guard = guard_of(plc, rehearse=True, start_position=tuple(home))
    guard.connect()
    try:
        assert guard.state is DriveState.HOMED
        assert guard.inner.exchange.reading.values["owner"] == 0
    finally:
        guard.close()
    guard = guard_of(plc, rehearse=True, start_position=tuple(home + np.array([0.0, 0.5, 0.0])))
    with pytest.raises(NotReady, match="Is the platform at the pose that was given"):
        guard.connect()
    after = counters(plc)
    for name in ("commands", "ignored", "foreign"):
        assert after[name] == before[name]


def test_an_enabled_run_moves_the_robot_within_all_limits_and_ends_at_rest(plc):
    guard = guard_of(plc, motion=True, place=True)
    before = counters(plc)
    log = follow(guard, plc, duration=3.0)
    after = counters(plc)
    assert guard.fault is None
    assert log.completed
    assert log.position[-1, 0] == pytest.approx(plc.robot.home_position + 0.3, abs=0.15)  # sway
    assert after["commands"] > before["commands"] + 50
    assert [after[name] - before[name] for name in OVER] == [0] * len(OVER)
    assert at_rest(plc)


def test_a_run_whose_cycles_stall_reaches_its_goal(plc, tmp_path):
    """It ends by cycles: by the clock, which goes on, it would be cut off on its way."""
    home = [f"{x:g}" for x in plc.robot.home_position]
    goal = plc.robot.home_position + np.array([0.0, 0.0, 0.03])
    words = ["run", "--driver", "ads", "--robot", str(plc.file), "--enable", "--home", *home]
    words += ["--to", *(f"{x:g}" for x in goal), "--speed", "0.05", "--rate", "50"]
    words += ["--controller", "tests.live_controllers:Stalling"]
    words += ["--recording", str(tmp_path / "run.jsonl"), "--json", str(tmp_path / "run.json")]
    place = f"inner.start_position=[{','.join(home)}]"
    for setting in (place, "inner.lost_after=0.5", "stale_time=0.5", "overrun_share=1.0",
                    "hang_time=2.0"):  # fmt: skip
        words += ["--set", f"driver.{setting}"]
    assert main(words) == 0
    run = read_run(tmp_path / "run.jsonl")
    lengths = statics.inverse_kinematics(plc.robot, goal[None]).unstrained_length[0]
    assert run.asked.value[-1] == pytest.approx(lengths, abs=1e-4)


def test_a_drive_that_trips_is_named_and_needs_a_reset(plc):
    guard = guard_of(plc, motion=True, place=True)

    def trip():
        with plc.client() as client:
            client.inject(Injection.TRIP, axis=2)

    log = follow(guard, plc, then=trip)
    assert not log.completed
    assert guard.fault.fault is Fault.DRIVE_TRIP
    assert at_rest(plc)
    time.sleep(2.0 * WATCHDOG)  # it obeys the first host until that is silent
    again = guard_of(plc, motion=True, enable_at_once=False)
    again.connect()
    try:
        for _ in range(5):
            again.measure()
            again.wait(PERIOD)
        with pytest.raises(IllegalTransition, match=r"fault \(drive_trip\)"):
            again.enable()
        with pytest.raises(CarosacError, match="cause"):
            again.reset_fault()
        plc.say("clear")
        time.sleep(0.1)
        again.reset_fault()
        assert again.state is DriveState.CONNECTED
        with plc.client() as client:  # it was stopped on its way
            here = client.truth()["position"]
        again.home(replace(home_pose(plc.robot), position=here[None]))
        assert again.state is DriveState.HOMED
    finally:
        again.close()


def test_a_controller_that_raised_keeps_the_next_host_from_moving(plc):
    """The PLC holds a fault that only the host has seen, for hosts that are started again."""

    def bug():
        raise ZeroDivisionError("a bug")

    guard = guard_of(plc, motion=True, place=True)
    with pytest.raises(ZeroDivisionError):
        follow(guard, plc, then=bug)
    assert guard.fault.fault is Fault.CONTROLLER
    assert at_rest(plc)
    before = counters(plc)["commands"]
    again = guard_of(plc, motion=True)
    with pytest.raises(NotReady, match=r"hold a fault of before: controller: .* \(--reset"):
        again.connect()
    assert counters(plc)["commands"] == before
    cleared = guard_of(plc, motion=True, place=True, reset_at_once=True)
    log = follow(cleared, plc, duration=1.0)
    assert cleared.fault is None
    assert log.completed


@pytest.mark.parametrize("fault", [Fault.TENSION, Fault.LOST_CONNECTION, Fault.STALE_DATA])
def test_a_held_fault_leaves_dry_runs_alone_and_can_be_reset(plc, fault):
    guard = guard_of(plc, motion=True, enable_at_once=False)
    guard.connect()
    try:
        guard.inner.hold_fault(fault)
        dry = guard_of(plc)
        assert follow(dry, plc, duration=0.3).completed
        assert dry.fault is None and dry.held.fault is fault
        guard.measure()
        assert guard.fault.fault is fault
        guard.reset_fault()
        assert guard.state is DriveState.CONNECTED and guard.fault is None
    finally:
        guard.close()


def test_the_command_clears_a_fault_and_moves_nothing(plc, capsys):
    driver = PlcDriver(plc.robot, PlcDriverSettings(motion=True))
    driver.connect()
    driver.hold_fault(Fault.ESTIMATOR)
    driver.close()
    before = counters(plc)["commands"]
    words = ["run", "--driver", "ads", "--robot", str(plc.file), "--reset"]
    assert main(words) == 0
    assert "cleared: estimator" in capsys.readouterr().out
    assert main(words) == 0
    assert "no fault was held; nothing has moved" in capsys.readouterr().out
    assert counters(plc)["commands"] == before


def test_a_study_runs_on_a_plc_by_the_name_of_the_driver(plc, tmp_path):
    """Each case begins where its path does: the emulated robot is set down there, and homed."""
    patient = {"motion": True, "stale_time": 0.5, "hang_time": 2.0, "overrun_share": 1.0}
    for driver in ("quasi_static", "ads"):
        study = Study(
            driver=driver, robots=[str(plc.file)], controllers=["kinematic_solver"],
            estimators=["kinematic_solver"], trajectories=["line"],
            perturbations=["none"], seeds=1, workers=0, speed_max=1.5,
            driver_settings={"ads": patient}, output=tmp_path / driver,
        )  # fmt: skip
        rows = study.run(progress=False).rows
        assert [row["reason"] for row in rows] == [None]
        assert rows[0]["tracking_rmse_norm_m"] < 0.15


def test_the_capabilities_of_the_driver_have_their_shapes(plc):
    capabilities_fit(lambda robot, seed: PlcDriver.build(robot, seed=seed), plc.robot)


def test_a_plc_that_is_killed_is_a_lost_connection_and_leaves_no_thread(plc):
    """The last one here: it kills the PLC of all others."""
    before = set(threading.enumerate())
    guard = guard_of(plc, motion=True, place=True)
    log = follow(guard, plc, then=plc.process.kill)
    assert not log.completed
    assert guard.fault.fault in (Fault.LOST_CONNECTION, Fault.STALE_DATA)
    assert guard.state is DriveState.DISCONNECTED
    assert set(threading.enumerate()) <= before
