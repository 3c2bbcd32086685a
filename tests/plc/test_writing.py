"""When a host writes and when not: hosts and a PLC program in one process, no network."""

import contextlib
import socket
import threading
import time
from dataclasses import replace

import numpy as np
import pytest

from carosac_toolkit.base.errors import CarosacError
from carosac_toolkit.loop.drive_state import DriveState, Fault
from carosac_toolkit.plc import blocks, reader
from carosac_toolkit.plc import driver as driver_module
from carosac_toolkit.plc.driver import PlcDriver, PlcDriverSettings
from carosac_toolkit.plc.emulator.machine import Inputs, Machine
from carosac_toolkit.plc.emulator.settings import winch_limits
from carosac_toolkit.plc.guarded import GuardedAds, GuardedAdsSettings
from carosac_toolkit.plc.identity import machine_values
from carosac_toolkit.plc.imu_udp import imu_line
from carosac_toolkit.robot.hardware import Hardware, ImuSource
from carosac_toolkit.robot.identity import machine_hash
from tests.plc_process import home_pose
from tests.robots import simple_robot

ROBOT = simple_robot()
N = ROBOT.n
START = (ROBOT.length_min + ROBOT.length_max) / 2


class Program:
    """The program of a PLC and the link to it; a cycle a read. `deaf`: it finds no request."""

    address, timeout = "in this process", 0.05

    def __init__(self):
        self.lock = threading.Lock()
        self.from_host, self.to_host = blocks.from_host(N), blocks.to_host(N)
        self.memory = bytes(self.from_host.size)
        self.writers = []
        self.deaf, self.said = False, {}
        self.start()

    def say(self, name, value, cable=None):
        """Have the PLC say a number from now on, of one cable if it has one."""
        self.said[name] = (value, cable)

    def start(self):
        limits = winch_limits(ROBOT, Hardware.loopback(N))
        self.machine = Machine(limits, cycle=0.005, watchdog=0.1, identity=machine_hash(ROBOT))
        self.machine.place(START)
        self.memory = bytes(self.from_host.size)

    def connect(self, *, writing):
        pass

    def has(self, block):
        return block in (blocks.FROM_HOST, blocks.TO_HOST, blocks.MACHINE)

    def write(self, block, data):
        with self.lock:
            self.memory = data
            self.writers.append(self.from_host.unpack(data)["host_number"])

    def read(self, block, size):
        if block == blocks.MACHINE:
            return blocks.machine(N).pack(machine_values(ROBOT))
        with self.lock:
            host = self.from_host.unpack(self.memory)
            if self.deaf:
                host["request"] = 0
            inputs = Inputs(length=self.machine.winches.position, rate=np.zeros(N))
            self.machine.cycle(host if host["layout"] else None, inputs)
            output = self.machine.output(inputs)
            for name, (value, cable) in self.said.items():
                if cable is None:
                    output[name] = value
                else:
                    output[name] = np.where(np.arange(N) == cable, value, output[name])
            return self.to_host.pack(output)

    def close(self):
        pass


@pytest.fixture
def program(monkeypatch):
    found = Program()

    monkeypatch.setattr(driver_module, "build_link", lambda *_: found)
    monkeypatch.setattr(reader, "ANSWER_TIMEOUT_S", 0.6)
    return found


@pytest.fixture
def host(program):
    """Makes hosts: connected and homed."""
    made = []

    def make():
        driver = PlcDriver(ROBOT, PlcDriverSettings(motion=True, lost_after=1.0))
        driver.connect()
        driver.home(home_pose(ROBOT))
        made.append(driver)
        return driver

    yield make
    for driver in made:
        driver.close()


def until(condition, patience=3.0):
    end = time.monotonic() + patience
    while not condition():
        assert time.monotonic() < end, "not in time"
        time.sleep(0.002)


def written(program, seconds=0.05):
    """Public numbers of the hosts that write in a span of time."""
    count = len(program.writers)
    time.sleep(seconds)
    return set(program.writers[count:])


WRONG = [
    *(("rate", x, 1, Fault.ENCODER_JUMP) for x in (1e6, 1e300, np.nan, np.inf, -6.0)),
    *(("length", x, 1, Fault.ENCODER_JUMP) for x in (1e6, 1e300, np.nan, -np.inf)),
    *(("tension", x, 1, Fault.TENSION) for x in (1e6, 1e300, np.nan, np.inf)),
    *(("set_length", x, 1, Fault.FOLLOWING_ERROR) for x in (1e6, 1e300, np.nan)),
    *(("time", x, None, Fault.LOST_CONNECTION) for x in (1e300, np.nan, np.inf)),
]


@pytest.mark.parametrize("name, value, cable, fault", WRONG)
def test_a_number_that_no_winch_can_do_is_a_fault_by_its_name(program, name, value, cable, fault):
    settings = GuardedAdsSettings(
        motion=True, enable_at_once=False, period=0.02, inner={"lost_after": 0.3}, overrun_share=1.0
    )
    program.say("has_tension", int(name == "tension"))
    guard = GuardedAds.build(ROBOT, settings)
    guard.connect()
    try:
        if name == "set_length":
            guard.home(home_pose(ROBOT), anew=True, confirmed=True)
            guard.inner.enable()
        guard.measure()
        program.say(name, value, cable)
        with contextlib.suppress(CarosacError):
            for _ in range(200):
                guard.measure()
                guard.wait(0.02)
        assert guard.fault is not None and guard.fault.fault is fault, guard.fault
    finally:
        guard.close()


def test_a_host_writes_from_enable_until_the_plc_has_let_go(program, host):
    driver = host()
    assert not program.writers
    driver.enable()
    assert written(program) == {driver.exchange.number}
    driver.disable()
    assert program.machine.state is DriveState.CONNECTED
    until(lambda: not written(program))
    assert program.from_host.unpack(program.memory)["request"] == 0
    driver.enable()
    assert driver.state is DriveState.ENABLED


def test_a_host_resets_and_is_silent_again(program, host):
    driver = host()
    program.machine.stop(Fault.FOLLOWING_ERROR)
    until(lambda: driver.fault is Fault.FOLLOWING_ERROR)
    driver.reset_fault()
    assert driver.fault is Fault.NONE
    until(lambda: not written(program))
    program.machine.wires.tripped[0] = True
    until(lambda: driver.fault is Fault.DRIVE_TRIP)
    with pytest.raises(CarosacError, match="cause of the fault is still there"):
        driver.reset_fault()
    until(lambda: not written(program))


def test_a_plc_that_was_started_anew_holds_the_fault_of_its_host_all_the_same(program, host):
    driver = host()
    driver.enable()
    program.start()
    until(lambda: driver.link_fault is Fault.LOST_CONNECTION)
    driver.hold_fault(Fault.LOST_CONNECTION)
    assert program.machine.fault is Fault.LOST_CONNECTION
    until(lambda: not written(program))
    other = host()
    assert (other.fault, other.link_fault) == (Fault.LOST_CONNECTION, Fault.NONE)
    with pytest.raises(CarosacError, match="call reset_fault"):
        other.enable()
    other.reset_fault()
    other.enable()


def test_a_fault_that_the_plc_did_not_take_is_said(program, host):
    driver = host()
    driver.enable()
    program.machine._request = lambda host, mine: blocks.Answer.UNKNOWN
    with pytest.raises(CarosacError, match="does not hold controller: it does not know this"):
        driver.hold_fault(Fault.CONTROLLER)


def test_a_plc_that_does_not_answer_is_not_said_to_hold_a_fault(program, host):
    driver = host()
    driver.enable()
    program.deaf = True
    with pytest.raises(CarosacError, match="does not hold controller: no answer"):
        driver.hold_fault(Fault.CONTROLLER)
    until(lambda: program.machine.fault is Fault.HEARTBEAT_LOST)


def test_only_an_emulated_plc_sets_its_robot_down(program, host):
    driver = host()
    assert not driver.emulated
    with pytest.raises(CarosacError, match="emulated PLC"):
        driver.set_down((0.0, 0.0, 1.0))
    assert not program.writers


def test_a_second_host_writes_nothing_and_is_refused(program, host):
    first, second = host(), host()
    first.enable()
    until(lambda: second.exchange.other == first.exchange.number)
    for refused in (second.enable, second.reset_fault):
        with pytest.raises(
            CarosacError, match=f"obeys another host, number {first.exchange.number}"
        ):
            refused()
    assert written(program) == {first.exchange.number}
    assert second.exchange.number not in program.writers
    assert program.machine.counters.foreign == 0
    second.close()
    assert first.state is DriveState.ENABLED
    first.disable()


def test_a_host_that_lost_the_plc_to_another_stops_writing_and_says_so(program, host):
    first, second = host(), host()
    first.enable()
    with program.lock:  # as where the PLC gave it up while it was silent
        program.machine._release()
        program.machine.state = DriveState.CONNECTED
    second.enable()
    until(lambda: first.fault is Fault.OWNER)
    assert first.state is DriveState.FAULT and not first.wait(0.01)
    assert written(program) == {second.exchange.number}
    with pytest.raises(CarosacError, match=f"obeys another host, number {second.exchange.number}"):
        first.disable()
    assert program.machine.state is DriveState.ENABLED
    second.disable()


def test_an_enable_that_fails_half_way_leaves_the_drives_off(program, host, monkeypatch):
    driver = host()

    def refuse(*_):
        raise ValueError("no such length")

    with monkeypatch.context() as patch:
        patch.setattr(driver._limiter, "reset", refuse)
        with pytest.raises(ValueError, match="no such length"):
            driver.enable()
    assert program.machine.state is DriveState.CONNECTED
    assert program.machine.output(program.machine._inputs)["owner"] == 0
    driver.enable()
    assert program.machine.state is DriveState.ENABLED


def test_a_disable_without_answer_stays_and_the_watchdog_stops_the_winches(program, host):
    driver = host()
    driver.enable()
    program.deaf = True
    with pytest.raises(CarosacError, match="the PLC does not disable: no answer"):
        driver.disable()
    until(lambda: program.machine.fault is Fault.HEARTBEAT_LOST)
    until(lambda: program.machine.output(program.machine._inputs)["owner"] == 0)
    assert program.from_host.unpack(program.memory)["request"] == blocks.Request.DISABLE
    program.deaf = False
    until(lambda: not written(program))
    driver.reset_fault()
    driver.enable()
    assert driver.state is DriveState.ENABLED


def test_a_run_whose_plc_does_not_answer_at_its_end_has_a_fault(program):
    """It would pass for a success while the PLC latches `heartbeat_lost`."""
    settings = GuardedAdsSettings(
        motion=True, home_anew=True, home_confirmed=True, period=0.02, overrun_share=1.0,
        inner={"lost_after": 0.3},
    )  # fmt: skip
    guard = GuardedAds.build(ROBOT, settings)
    guard.connect()
    program.deaf = True
    guard.stop("end of the trajectory")
    assert guard.state is DriveState.FAULT
    guard.close()
    assert guard.fault.fault is program.machine.fault is Fault.HEARTBEAT_LOST


def test_a_disable_that_is_heard_late_is_obeyed(program, host, monkeypatch):
    driver = host()
    driver.enable()
    monkeypatch.setattr(reader, "ANSWER_TIMEOUT_S", 0.02)
    program.deaf = True
    with pytest.raises(CarosacError, match="no answer"):
        driver.disable()
    program.deaf = False
    until(lambda: program.machine.state is DriveState.CONNECTED)
    assert program.machine.fault is Fault.NONE
    until(lambda: not written(program))


def test_a_plc_that_starts_anew_with_a_clock_that_goes_on_is_seen(program, host):
    driver = host()
    driver.enable()
    with program.lock:
        ticks = program.machine._ticks
        program.start()
        program.machine._ticks = ticks + 1000
        program.machine.place(START + 0.3)  # its encoders count anew
    until(lambda: driver.fault is Fault.LOST_CONNECTION)
    assert "started anew" in driver.fault_text
    assert not driver.wait(0.01)
    time.sleep(0.05)
    assert driver.state is DriveState.FAULT  # latched
    with pytest.raises(CarosacError, match="started anew"):
        driver.enable()
    driver.reset_fault()
    assert driver.state is DriveState.CONNECTED
    with pytest.raises(CarosacError, match="not homed"):
        driver.enable()


def test_a_suite_with_an_imu_that_is_silent_is_a_fault(program):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        source = ImuSource(port=free.getsockname()[1])
    robot = replace(ROBOT, hardware=replace(Hardware.loopback(N), imu=source))
    settings = GuardedAdsSettings(suite="lengths+imu", inner={"imu_lost_after": 0.2})
    guard = GuardedAds.build(robot, settings)
    guard.connect()
    try:
        until(lambda: guard.measure() and not guard.wait(settings.period))
        assert guard.fault.fault is Fault.STALE_DATA
        assert "no sample of the IMU for 0.2" in guard.fault.text
    finally:
        guard.close()


def test_inertial_samples_reach_the_measurement_at_the_times_of_the_sensor(program):
    """The sensor has a clock of its own, and some datagrams come late; the spacing is exact."""
    ahead, late, count = 1234.5, 0.03, 40  # [s] of its clock, [s], samples
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    source = ImuSource(port=port)
    robot = replace(ROBOT, hardware=replace(Hardware.loopback(N), imu=source))
    driver = PlcDriver(robot, PlcDriverSettings(suite="lengths+imu", lost_after=1.0))
    driver.connect()
    try:
        assert driver.measure().imu is None
        taken, values = [], np.random.default_rng(1).normal(size=(count, 6)).round(3)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sensor:
            for k in range(count):
                taken.append(time.monotonic())
                line = imu_line(k + 1, taken[-1] + ahead, values[k, :3], values[k, 3:])
                if k % 5 == 2:
                    time.sleep(late)
                sensor.sendto(line.encode(), (source.ip, port))
                time.sleep(0.003)
        until(lambda: driver._imu.received == count)
        before = driver._ticks.origin
        measurement = driver.measure()
        imu = measurement.imu
        assert driver.measure().imu is None  # each sample once
    finally:
        driver.close()
    assert imu.angular_rate[0] == pytest.approx(values[:, :3], abs=1e-6)
    assert imu.specific_force[0] == pytest.approx(values[:, 3:], abs=1e-6)
    shown = imu.time[0] + before
    assert np.diff(shown) == pytest.approx(np.diff(taken), abs=2e-6)  # microseconds in the line
    # By the quickest datagram, which takes no time on this machine; never before it was taken.
    assert 0.0 <= shown[0] - taken[0] + 1e-5 < 0.02
    assert imu.time[0, -1] <= measurement.time[0]
