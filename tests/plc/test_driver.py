import signal
import threading
import time
from dataclasses import replace

import numpy as np
import pytest

from carosac_toolkit.base.errors import CarosacError, InvalidField
from carosac_toolkit.loop.drive_state import DriveState, Fault
from carosac_toolkit.loop.values import Command
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.plc.blocks import BLOCK_LAYOUT, FROM_HOST, Injection, Request, from_host
from carosac_toolkit.plc.driver import PlcDriver, PlcDriverSettings
from carosac_toolkit.safety.limiter import Limiter
from tests.plc_process import home_pose, own_address, plc_process

WATCHDOG = 0.6  # [s]; loaded machines let a process wait for tenths of a second
SETTINGS = PlcDriverSettings(motion=True, lost_after=0.5)


@pytest.fixture(scope="module")
def plc():
    with plc_process("--shift", "0.2", "--watchdog", str(WATCHDOG), imu=5005) as found:
        yield found


@pytest.fixture
def driver(plc):
    """Connected, homed, enabled; faults of the last test are gone."""
    with plc.client() as client:
        client.inject(Injection.CLEAR)
    found = PlcDriver(plc.robot, SETTINGS)
    found.connect()
    if found.state is DriveState.FAULT:
        found.reset_fault()
    found.home(home_pose(plc.robot))
    found.enable()
    yield found
    found.close()


def until(condition, patience=3.0):
    end = time.monotonic() + patience
    while not condition():
        assert time.monotonic() < end, "not in time"
        time.sleep(0.002)


def follow(driver, seconds, amplitude=0.08, frequency=0.5):
    """Follow a sine within the limits; lengths asked and measured, shape (T, n)."""
    limiter = Limiter(driver._robot, driver._settings.limits, period=0.01)
    start = driver.measure().unstrained_length
    limiter.reset(start)
    asked, measured = [], []
    signs = (-1.0) ** np.arange(start.shape[1])
    for k in range(round(seconds / 0.01)):
        m = driver.measure()
        wave = amplitude * (1.0 - np.cos(2 * np.pi * frequency * k * 0.01)) * signs
        wanted = limiter.apply(Command(time=m.time, unstrained_length=start + wave))
        asked.append(driver.command(wanted).unstrained_length[0])
        measured.append(m.unstrained_length[0])
        if not driver.wait(0.01):
            break
    return np.array(asked), np.array(measured)


def test_lengths_are_metres_of_cable_whatever_the_units_of_the_plc(plc, driver):
    pose = statics.inverse_kinematics(plc.robot, plc.robot.home_position[None])
    truth = driver.truth()
    measured = driver.measure().unstrained_length
    # The platform is at home, whatever the encoders said before homing; 1 mm is five times noise.
    assert measured == pytest.approx(pose.unstrained_length, abs=1e-3)
    assert truth.unstrained_length == pytest.approx(pose.unstrained_length, abs=2e-3)
    numbers = driver.exchange.reading.values["length"]
    assert (np.abs(numbers) > 1000.0).all()  # millimetres


def test_enabling_moves_nothing(plc, driver):
    before = driver.truth().unstrained_length
    driver.disable()
    driver.enable()
    time.sleep(0.1)
    assert driver.state is DriveState.ENABLED
    assert driver.truth().unstrained_length == pytest.approx(before, abs=2e-3)
    with plc.client() as client:
        assert not client.diagnosis()["set_speed"].any()


def test_inertial_samples_come_over_udp_in_the_time_of_the_driver(plc):
    driver = PlcDriver(plc.robot, PlcDriverSettings(suite="lengths+imu"))
    driver.connect()
    try:
        driver.measure()
        until(lambda: driver._imu.received > 80)
        measurement = driver.measure()
    finally:
        driver.close()
    imu = measurement.imu
    assert imu.time.shape[1] > 50
    assert (np.diff(imu.time[0]) > 0.0).all()
    assert np.abs(measurement.time[0] - imu.time[0, -1]) < 0.2
    # At rest, up to the tilt of the platform and the bias of the sensor: gravity along z.
    assert imu.specific_force[0].mean(axis=0) == pytest.approx([0, 0, 9.81], abs=0.5)
    assert not [t for t in threading.enumerate() if t.name == "imu-udp"]


def test_winches_follow_and_no_limit_is_passed(plc, driver):
    asked, measured = follow(driver, 2.0)
    assert driver.state is DriveState.FOLLOWING
    # 50 ms of winch lag, 20 ms of interpolation, 10 ms of network at up to 0.25 m/s: 20 mm.
    assert np.abs(measured - asked).max() < 0.04
    assert np.abs(measured - asked).max() > 0.001
    with plc.client() as client:
        found = client.diagnosis()
    assert found["over_length"] == found["over_speed"] == found["not_finite"] == 0
    assert found["over_acceleration"] == found["over_jerk"] == 0
    robot = plc.robot
    assert (found["speed_peak"] * 1e-3 <= robot.speed_max).all()
    assert (found["acceleration_peak"] * 1e-3 <= robot.acceleration_max + 1e-9).all()


def test_stop_is_a_ramp_of_all_winches_together(plc, driver):
    follow(driver, 0.5)
    driver.stop("test")
    with plc.client() as client:
        speeds = []
        until(lambda: (speeds.append(client.diagnosis()["set_speed"]), not speeds[-1].any())[1])
    assert not driver.wait(0.01)
    moving = np.array([s for s in speeds if s.any()])
    if len(moving) > 3:  # one common factor: the ratios of the speeds stay
        ratio = moving / np.abs(moving).max(axis=1, keepdims=True)
        assert np.ptp(ratio[2:], axis=0).max() < 1e-6
    until(lambda: driver.state is DriveState.ENABLED)
    held = driver.command(Command(time=np.zeros(1), unstrained_length=np.full((1, 4), 9.0)))
    assert {hit.limit for hit in held.limited} == {"stopped"}


def test_commands_go_on_while_the_plc_is_silent(driver, monkeypatch):
    """Else a stop would go on a period behind, and turn back at its end."""
    asked = follow(driver, 0.3)[0][-1]
    monkeypatch.setattr(type(driver.exchange), "age", property(lambda _: 10.0))
    assert driver.fault is Fault.LOST_CONNECTION
    for _ in range(3):
        before = driver._limiter.motion.length
        asked = asked + 1e-5
        sent = driver.command(Command(time=np.zeros(1), unstrained_length=asked[None]))
        assert "stopped" not in {hit.limit for hit in sent.limited}
        assert (driver._limiter.motion.length != before).all()
    driver.stop("test")
    sent = driver.command(Command(time=np.zeros(1), unstrained_length=asked[None]))
    assert {hit.limit for hit in sent.limited} == {"stopped"}


def test_a_drive_trip_is_named_latched_and_reset_on_purpose(plc, driver):
    follow(driver, 0.3)
    with plc.client() as client:
        client.inject(Injection.TRIP, axis=2)
        until(lambda: driver.state is DriveState.FAULT)
        assert driver.fault is Fault.DRIVE_TRIP
        assert plc.robot.cable_names[1] in driver.fault_text
        assert driver.measure().drive_status[1] == "tripped"
        assert not driver.wait(0.01)
        with pytest.raises(CarosacError, match="cause of the fault is still there"):
            driver.reset_fault()
        client.inject(Injection.TRIP, axis=2, value=0.0)
        assert driver.fault is Fault.DRIVE_TRIP  # latched
        driver.reset_fault()
    assert driver.state is DriveState.HOMED
    with pytest.raises(CarosacError, match="not enabled"):
        driver.command(Command(time=np.zeros(1), unstrained_length=np.full((1, 4), 9.0)))
    driver.enable()


def test_a_silent_host_stops_the_winches_within_the_watchdog_and_the_ramp(plc, driver, monkeypatch):
    follow(driver, 0.3)
    with monkeypatch.context() as patch:
        patch.setattr(driver.exchange._link, "write", lambda *_: None)
        until(lambda: driver.state is DriveState.FAULT)
        assert driver.fault is Fault.HEARTBEAT_LOST
        with plc.client() as client:
            until(lambda: not client.diagnosis()["set_speed"].any(), 1.0)
    driver.reset_fault()
    driver.enable()


def test_an_encoder_that_jumps_is_a_fault_and_moves_nothing(plc, driver):
    with plc.client() as client:
        before = client.truth()["length"]
        said = driver.measure().unstrained_length[0]
        client.inject(Injection.JUMP, axis=1, value=0.05)
        until(lambda: driver.fault is Fault.ENCODER_JUMP)
        change = driver.measure().unstrained_length[0] - said
        assert np.abs(change) == pytest.approx([0.05, 0.0, 0.0, 0.0], abs=5e-3)
        driver.reset_fault()
        driver.home(home_pose(plc.robot))
        driver.enable()
        time.sleep(0.2)
        assert client.truth()["length"] == pytest.approx(before, abs=5e-3)


@pytest.mark.parametrize(("what", "kind"), [("counter", 3), ("data", 4)])
def test_what_freezes_shows_in_the_time_of_the_measurement(plc, driver, what, kind):
    with plc.client() as client:
        client.inject(Injection(kind))
        time.sleep(0.1)
        first = driver.measure()
        until(lambda: driver.fault is Fault.STALE_DATA)
        second = driver.measure()
        assert driver.exchange.age < SETTINGS.lost_after  # it answers
        assert not driver.wait(0.01)
        client.inject(Injection.CLEAR)
    assert second.time > first.time
    frozen = second.length_rate.time == first.length_rate.time
    assert frozen.all()


def test_a_second_host_is_refused_and_does_not_disturb(plc, driver):
    name, block = plc.robot.hardware.ads.from_host, from_host(4)
    number = driver.exchange.number  # anybody reads it: it must not help
    other = {"layout": BLOCK_LAYOUT, "cables": 4, "session": number, "host_number": number,
             "follow": 1, "request": int(Request.STOP), "length": [9e3] * 4,
             "period": 0.01}  # fmt: skip
    with plc.client() as client:
        before = client.diagnosis()["foreign"]
        for k in range(1, 30):
            values = {"sequence": k, "sequence_end": k, "request_number": k, "command": k}
            client.write(name, block.pack(other | values))
            time.sleep(0.007)
        after = client.diagnosis()
    assert after["foreign"] > before
    assert driver.state is DriveState.ENABLED
    assert driver.exchange.reading.values["owner"] == driver.exchange.number
    assert not after["set_speed"].any()


def test_read_only_is_the_default_and_writes_nothing(plc):
    driver = PlcDriver(plc.robot)
    driver.connect()
    try:
        sequence = driver.exchange.reading.values["owner"]
        assert sequence == 0
        driver.home(home_pose(plc.robot))
        with pytest.raises(CarosacError, match="read only"):
            driver.enable()
        with pytest.raises(CarosacError, match="not enabled"):
            driver.command(Command(time=np.zeros(1), unstrained_length=np.full((1, 4), 9.0)))
        assert not driver.exchange._link.has(FROM_HOST)
        with pytest.raises(CarosacError, match="nothing may be written"):
            driver.exchange.write(FROM_HOST, from_host(4).pack({}))
    finally:
        driver.close()


def test_motion_needs_homing(plc):
    driver = PlcDriver(plc.robot, SETTINGS)
    driver.connect()
    try:
        with pytest.raises(CarosacError, match="not homed"):
            driver.enable()
    finally:
        driver.close()


def test_no_plc_is_one_clear_message_and_leaves_no_thread(plc):
    ip = own_address()
    ads = replace(plc.robot.hardware.ads, ip=ip, net_id=f"{ip}.1.1")
    robot = replace(plc.robot, hardware=replace(plc.robot.hardware, ads=ads))
    with pytest.raises(CarosacError, match=rf"PLC {ip}.1.1 at {ip}: cannot connect"):
        PlcDriver(robot).connect()
    assert not [t for t in threading.enumerate() if t.name == "plc-exchange"]


def test_a_period_that_the_plc_would_refuse_is_refused_by_name():
    with pytest.raises(InvalidField, match=r"period: got 0\.2 s; allowed: <= 0\.1 s"):
        PlcDriverSettings(period=0.2)


def test_a_suite_needs_its_sensors(plc):
    blind = replace(plc.robot, hardware=replace(plc.robot.hardware, imu=None))
    with pytest.raises(InvalidField, match=r"hardware\.imu"):
        PlcDriver(blind, PlcDriverSettings(suite="lengths+imu")).connect()


def test_a_suite_with_tensions_needs_load_cells():
    with plc_process("--no-load-cells") as bare:
        with pytest.raises(InvalidField, match=r"suite: got 'lengths\+tension'.*no load cells"):
            PlcDriver(bare.robot, PlcDriverSettings(suite="lengths+tension")).connect()
        driver = PlcDriver(bare.robot, PlcDriverSettings())
        driver.connect()
        assert driver.measure().tension is None
        driver.close()


def test_a_plc_that_stands_still_is_seen_and_comes_back(plc, driver):
    plc.signal(signal.SIGSTOP)
    try:
        until(lambda: driver.fault is Fault.LOST_CONNECTION)
        began = time.monotonic()
        driver.measure()
        assert time.monotonic() - began < 0.1  # nobody waits for the network
    finally:
        plc.signal(signal.SIGCONT)
    until(lambda: driver.exchange.age < 0.05)


def test_a_slow_network_delays_and_loses_nothing(plc, driver):
    with plc.client() as client:
        client.inject(Injection.NETWORK, value=0.01, second=0.01)
        before = client.diagnosis()
        asked, measured = follow(driver, 0.5)
        after = client.diagnosis()
        client.inject(Injection.CLEAR)
    assert driver.state is DriveState.FOLLOWING
    assert after["over_acceleration"] == before["over_acceleration"]
    assert np.abs(measured - asked).max() < 0.1


def test_a_robot_with_a_plc_elsewhere_is_rehearsed_on_this_machine(plc):
    ads = replace(plc.robot.hardware.ads, ip="192.0.2.1", net_id="192.0.2.1.1.1")
    robot = replace(plc.robot, hardware=replace(plc.robot.hardware, ads=ads))
    driver = PlcDriver(robot, PlcDriverSettings(ip=plc.ip))
    driver.connect()
    assert driver.exchange.reading.values["cables"] == 4
    driver.close()


def test_a_killed_plc_is_a_lost_connection_and_a_new_one_needs_reset_and_homing(plc, driver):
    """The last one here: it kills the PLC of all others."""
    follow(driver, 0.3)
    plc.process.kill()
    until(lambda: driver.fault is Fault.LOST_CONNECTION)
    assert not driver.wait(0.01)
    with plc_process("--watchdog", str(WATCHDOG), ip=plc.ip, imu=5005) as second:
        until(lambda: driver.exchange.age < 0.1, 10.0)
        assert driver.state is DriveState.FAULT  # latched, although it answers again
        assert "started anew" in driver.fault_text
        driver.reset_fault()
        with pytest.raises(CarosacError, match="not homed"):
            driver.enable()
        driver.home(home_pose(second.robot))
        driver.enable()
        follow(driver, 0.2)
        assert driver.state is DriveState.FOLLOWING
        driver.close()
    assert not [t for t in threading.enumerate() if t.name == "plc-exchange"]
