"""Links between driver and PLC: one contract, two wires, and a second one that is plugged in."""

import ast
import threading
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from carosac_toolkit.base.errors import CarosacError, InvalidField
from carosac_toolkit.loop import plugins
from carosac_toolkit.loop.drive_state import DriveState, Fault
from carosac_toolkit.loop.values import Command
from carosac_toolkit.plc import blocks
from carosac_toolkit.plc.ads_link import AdsLink
from carosac_toolkit.plc.driver import PlcDriver, PlcDriverSettings
from carosac_toolkit.plc.emulator.emulator import Emulator
from carosac_toolkit.plc.emulator.settings import EmulatorSettings
from carosac_toolkit.plc.guarded import GuardedAds, GuardedAdsSettings
from carosac_toolkit.plc.link import LINK_ATTRIBUTES, LINK_METHODS, LinkError, PlcLink, build_link
from carosac_toolkit.robot.hardware import AdsAddress, Hardware
from tests.loop.test_plugins import install
from tests.plc.udp_link import UdpLink, udp_server
from tests.plc_process import home_pose, own_address
from tests.robots import simple_robot

ROOT = Path(__file__).resolve().parents[2]
ROBOT = simple_robot()
PATIENCE = 2.0  # [s]; the PLC shares this process with its host, and the processor with others


@pytest.fixture(scope="module")
def emulator():
    """A PLC in this process, in real time."""
    ip = own_address()
    hardware = replace(
        Hardware.loopback(ROBOT.n), ads=AdsAddress(ip=ip, net_id=f"{ip}.1.1", timeout=0.2)
    )
    robot = replace(ROBOT, hardware=hardware)
    plc = Emulator(robot, robot, EmulatorSettings(watchdog=PATIENCE), ip=ip)
    thread = threading.Thread(target=plc.run, daemon=True)
    thread.start()
    yield plc
    plc.stop()
    thread.join(5.0)
    plc.close()


@pytest.fixture(scope="module")
def udp(emulator):
    with udp_server(emulator) as server:
        yield server


@pytest.fixture(params=["ads", "tests.plc.udp_link:UdpLink"])
def link(request, emulator, udp):
    settings = {} if request.param == "ads" else {"port": udp.port}
    made = build_link(request.param, emulator.hardware, settings)
    yield made
    made.close()


def until(condition, patience=5.0):
    end = time.monotonic() + patience
    while not condition():
        assert time.monotonic() < end, "not in time"
        time.sleep(0.002)


# The contract of `PlcLink`, which every wire keeps.


def test_a_link_says_where_the_plc_is_and_how_long_a_call_may_take(link):
    assert isinstance(link.address, str) and link.address
    assert link.timeout == 0.2


def test_a_link_knows_the_blocks_of_its_plc(link):
    link.connect(writing=True)
    assert all(
        link.has(x) for x in (blocks.FROM_HOST, blocks.TO_HOST, blocks.MACHINE, blocks.TRUTH)
    )
    assert not link.has("nothing")


def test_bytes_pass_unchanged_both_ways(link, emulator):
    link.connect(writing=True)
    block = blocks.from_host(ROBOT.n)
    data = block.pack({"layout": 99, "length": [1.0, -2.0, 1e-9, np.pi]})  # nobody obeys layout 99
    link.write(blocks.FROM_HOST, data)
    assert emulator.symbols.read(emulator.symbol_names[blocks.FROM_HOST]) == data
    constants = emulator.symbols.read(emulator.symbol_names[blocks.MACHINE])
    assert link.read(blocks.MACHINE, blocks.machine(ROBOT.n).size) == constants
    values = blocks.to_host(ROBOT.n).unpack(link.read(blocks.TO_HOST, blocks.to_host(ROBOT.n).size))
    assert values["layout"] == blocks.BLOCK_LAYOUT and values["boot"] == emulator.machine.boot


def test_what_the_plc_refuses_is_a_link_error(link):
    link.connect(writing=True)
    with pytest.raises(LinkError):
        link.read("nothing", 8)
    with pytest.raises(LinkError):
        link.write("nothing", bytes(8))
    with pytest.raises(LinkError):
        link.write(blocks.FROM_HOST, b"short")
    with pytest.raises(LinkError):
        link.write(blocks.TRUTH, bytes(blocks.truth(ROBOT.n).size))  # read only
    with pytest.raises(LinkError):
        link.read(blocks.FROM_HOST, blocks.from_host(ROBOT.n).size)  # write only: a secret is in it
    assert link.read(blocks.TO_HOST, blocks.to_host(ROBOT.n).size)  # it still works


def test_a_closed_link_refuses_calls_and_connects_again(link):
    size = blocks.to_host(ROBOT.n).size
    for _ in range(2):
        with pytest.raises(LinkError, match="not connected"):
            link.read(blocks.TO_HOST, size)
        link.connect(writing=True)
        assert len(link.read(blocks.TO_HOST, size)) == size
        link.close()
        link.close()


@pytest.mark.parametrize(
    "name, settings",
    [("ads", {"ip": own_address()}), ("tests.plc.udp_link:UdpLink", {"port": 9, "timeout": 0.1})],
)
def test_a_plc_that_is_not_there_is_a_link_error_in_time(name, settings):
    link = build_link(name, Hardware.loopback(4), settings)
    began = time.monotonic()
    with pytest.raises(LinkError):
        link.connect(writing=False)
    link.close()
    assert time.monotonic() - began < PATIENCE


# Finding and refusing links.


def test_the_ads_link_is_an_entry_point_and_the_default():
    assert plugins.load("links", PlcDriverSettings().link) is AdsLink


def test_settings_of_the_driver_reach_the_link():
    settings = PlcDriverSettings(ip="127.0.0.9", timeout=0.7)
    link = build_link(settings.link, Hardware.loopback(4), settings.for_link)
    assert (link.address, link.timeout) == ("127.0.0.9.1.1 at 127.0.0.9", 0.7)
    settings = PlcDriverSettings(timeout=0.3, link_settings={"port": 7})
    link = build_link("tests.plc.udp_link:UdpLink", Hardware.loopback(4), settings.for_link)
    assert (link.address, link.timeout) == ("udp 127.0.0.1:7", 0.3)


class Deaf(UdpLink):
    write = None


class Nameless:
    @classmethod
    def build(cls, hardware, settings=None):
        return cls()

    connect = has = read = write = close = build


@pytest.mark.parametrize(
    "name, settings, message",
    [
        ("udq", {}, r"link: got 'udq'; allowed: one of \[.*'ads'.*\], or 'module:Class'"),
        ("tests.plc.test_link:Deaf", {},
         "link: got 'tests.plc.test_link:Deaf'; allowed: a link, which has build, connect, has, "
         "read, write, close, address, timeout; missing here: write"),
        ("tests.plc.test_link:Nameless", {}, "missing here: address, timeout"),
        ("tests.plc.test_link:Nameless", {"port": 1}, "allowed: nothing: Nameless has no Settings"),
        ("ads", {"port": 1}, r"link_settings.port: got 1; allowed: one of \['ip', 'timeout'\]"),
        ("ads", {"timeout": -1.0}, "hardware.ads.timeout: got -1.0 s"),
    ],
)  # fmt: skip
def test_a_link_that_lacks_something_is_refused_by_what_it_lacks(name, settings, message):
    with pytest.raises(InvalidField, match=message):
        build_link(name, Hardware.loopback(4), settings)


def test_the_check_covers_the_whole_protocol():
    members = {x for x in vars(PlcLink) if not x.startswith("_")} | set(PlcLink.__annotations__)
    assert members == {*LINK_METHODS, *LINK_ATTRIBUTES}


def test_only_the_command_imports_the_emulator():
    """Who moves a real robot loads no line of the emulated one."""
    users = set()
    for package in ("carosac_toolkit", "baselines", "sim_warp", "learned", "calibration"):
        for path in sorted((ROOT / package).rglob("*.py")):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                names = [x.name for x in node.names] if isinstance(node, ast.Import) else []
                if isinstance(node, ast.ImportFrom):
                    names = [node.module or "", *(f"{node.module}.{x.name}" for x in node.names)]
                if any(name.startswith("carosac_toolkit.plc.emulator") for name in names):
                    users.add(path.relative_to(ROOT).as_posix())
    own = {x for x in users if x.startswith("carosac_toolkit/plc/emulator/")}
    assert users - own == {"carosac_toolkit/cli/plc.py"}
    assert own


# The second wire drives the robot through the same driver.


@pytest.fixture
def installed(tmp_path, monkeypatch):
    """Another distribution that brings the link `udp`."""
    monkeypatch.syspath_prepend(str(tmp_path))
    install(tmp_path, "their-wire", "[carosac.links]\nudp = tests.plc.udp_link:UdpLink\n")
    assert "udp" in plugins.names("links")


@pytest.fixture
def settings(installed, udp):
    return PlcDriverSettings(
        link="udp", link_settings={"port": udp.port}, timeout=0.2, motion=True,
        lost_after=PATIENCE, start_position=tuple(ROBOT.home_position),
    )  # fmt: skip


@pytest.fixture
def driver(emulator, settings):
    made = PlcDriver(ROBOT, settings)
    made.connect()
    yield made
    made.close()
    assert not [t for t in threading.enumerate() if t.name == "plc-exchange"]


def test_a_second_wire_homes_enables_moves_and_stops_the_emulated_robot(driver, emulator):
    calls, counters = emulator.server.requests, emulator.machine.counters
    assert driver.emulated and driver.state is DriveState.CONNECTED
    driver.home(home_pose(ROBOT))
    driver.enable()
    assert driver.state is DriveState.ENABLED
    start = driver.measure().unstrained_length
    before = driver.truth().unstrained_length
    for k in range(1, 101):  # each cable longer by 5 cm within a second, from rest to rest
        s = k / 100
        change = 0.05 * s**3 * (10 - 15 * s + 6 * s**2)
        time_now = driver.measure().time
        driver.command(Command(time=time_now, unstrained_length=start + change))
        assert driver.wait(0.01)
    assert driver.state is DriveState.FOLLOWING
    until(lambda: np.abs(driver.measure().unstrained_length - start - 0.05).max() < 3e-3)
    # The truth is of the winches of the simulated robot, without noise of the encoders.
    assert driver.truth().unstrained_length - before == pytest.approx(0.05, abs=3e-3)
    until(lambda: driver.exchange.reading.values["command_echo"] == 100)  # the newest has arrived
    assert counters.over_speed == counters.not_finite == 0
    driver.stop("test")
    assert not driver.wait(0.01)
    until(lambda: driver.state is DriveState.ENABLED)
    driver.disable()
    assert driver.state is DriveState.HOMED and emulator.machine.owner == 0
    assert driver.fault is Fault.NONE
    assert emulator.server.requests == calls  # nothing of it went over ADS


def test_the_robot_is_set_down_over_the_second_wire(driver, emulator):
    place = ROBOT.home_position + np.array([0.3, 0.2, 0.1])
    driver.set_down(tuple(place))
    assert driver.truth().position[0] == pytest.approx(place, abs=1e-2)
    with pytest.raises(CarosacError, match="plc: refused place"):
        driver.set_down((90.0, 0.0, 2.0))


def test_a_cut_wire_is_a_lost_connection_and_is_opened_anew(settings, emulator, udp):
    driver = PlcDriver(ROBOT, replace(settings, lost_after=0.5))
    driver.connect()
    try:
        udp.cut = True
        until(lambda: driver.fault is Fault.LOST_CONNECTION)
        assert "udp 127.0.0.1" in driver.fault_text and "timed out" in driver.fault_text
        until(lambda: driver.exchange.counters.errors > 4)
        with pytest.raises(LinkError, match="timed out"):
            driver.exchange.read(blocks.TRUTH, blocks.truth(ROBOT.n).size)
        udp.cut = False
        until(lambda: driver.fault is Fault.NONE)
        assert driver.exchange.counters.reconnects >= 1
    finally:
        udp.cut = False
        driver.close()


def test_the_guard_of_the_driver_ads_runs_on_the_second_wire(installed, udp, emulator):
    inner = {"link": "udp", "link_settings": {"port": udp.port}, "lost_after": PATIENCE}
    guard = GuardedAds.build(ROBOT, GuardedAdsSettings(inner=inner))
    guard.connect()
    try:
        guard.home(home_pose(ROBOT), anew=True)
        assert guard.measure().unstrained_length.shape == (1, ROBOT.n)
        assert guard.state is DriveState.HOMED
    finally:
        guard.close()
