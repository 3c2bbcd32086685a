"""The file of another robot moves nothing: refused by field on the host, and by the PLC itself."""

import threading
import time
from dataclasses import replace

import numpy as np
import pytest

from carosac_toolkit.base.errors import CarosacError
from carosac_toolkit.cli.main import main
from carosac_toolkit.loop.drive_state import DriveState, Fault
from carosac_toolkit.plc import blocks, identity
from carosac_toolkit.plc.driver import PlcDriver, PlcDriverSettings
from carosac_toolkit.plc.emulator.client import PlcClient
from carosac_toolkit.plc.emulator.emulator import Emulator
from carosac_toolkit.plc.emulator.settings import EmulatorSettings
from carosac_toolkit.plc.identity import declaration, machine_values
from carosac_toolkit.robot.file import load_robot, parse_robot, robot_text
from tests.plc.udp_link import udp_server
from tests.plc_process import home_pose, own_address, robot_at
from tests.robots import eight_cable_robot

PATIENCE = 2.0  # [s]; the PLC shares this process with its host, and the processor with others
IP = own_address()
TEXT = robot_at("carosac", IP)  # millimetres, signs 1 and -1 in turn
ROBOT = parse_robot(TEXT)


@pytest.fixture(scope="module")
def emulator():
    """A PLC in this process, in real time."""
    plc = Emulator(ROBOT, ROBOT, EmulatorSettings(watchdog=PATIENCE), ip=IP)
    thread = threading.Thread(target=plc.run, daemon=True)
    thread.start()
    yield plc
    plc.stop()
    thread.join(5.0)
    plc.close()


@pytest.fixture(params=["ads", "udp"])
def settings(request, emulator):
    """Both wires to the same PLC."""
    common = {"motion": True, "lost_after": PATIENCE, "timeout": 0.5}
    if request.param == "ads":
        yield PlcDriverSettings(**common)
        return
    with udp_server(emulator) as server:
        link = {"link": "tests.plc.udp_link:UdpLink", "link_settings": {"port": server.port}}
        yield PlcDriverSettings(**common, **link)


def swapped(text):
    """The file with the first two chains in the other order."""
    first, second = (line for line in text.splitlines() if "{name: front_" in line)
    return text.replace(f"{first}\n{second}", f"{second}\n{first}")


def rewired(text):
    """The file in which the first two chains have the points of each other, all limits equal."""
    for word in ("exit_point: ", "anchor_point: "):
        left, right = f"{word}front_left", f"{word}front_right"
        text = text.replace(left, "<>").replace(right, left).replace("<>", right)
    return text


def changed(old, new):
    assert old in TEXT
    return lambda: parse_robot(TEXT.replace(old, new))


OTHERS = {
    "speed": (changed("speed_max: 2.5 m/s", "speed_max: 5 m/s"),
              r"speed_max of front_left: the PLC has 2500, the robot file 5000 \[unit/s\]"),
    "acceleration": (changed("acceleration_max: 5 m/s^2", "acceleration_max: 10 m/s^2"),
                     "acceleration_max of front_left: the PLC has 5000, the robot file 10000"),
    "shortest": (changed("length_min: 1 m", "length_min: 0.2 m"),
                 "length_min of front_left: the PLC has 1000, the robot file 200"),
    "longest": (changed("length_max: 20 m", "length_max: 30 m"),
                "length_max of front_left: the PLC has 20000, the robot file 30000"),
    "tension": (changed("max: 500 N", "max: 900 N"), "hash: the PLC has 16#[0-9A-F]{16}, the robot "
                "file 16#[0-9A-F]{16}: geometry, .* tension limits or workspace differ"),
    "mass": (changed("mass: 23.655 kg", "mass: 80 kg"),
             r"mass: the PLC has 23.655, the robot file 80 \[kg\]"),
    "order": (lambda: parse_robot(swapped(TEXT)), "chains: the PLC has front_left, front_right, .*"
              "the robot file front_right, front_left"),
    "rewired": (lambda: parse_robot(rewired(TEXT)), "hash: the PLC has"),
    "sign": (changed("front_right: {sign: -1", "front_right: {sign: 1"),
             "sign of front_right: the PLC has -1, the robot file 1"),
    "scale": (changed("front_left: {sign: 1, scale: 1 mm", "front_left: {sign: 1, scale: 1 cm"),
              r"scale of front_left: the PLC has 0.001, the robot file 0.01 \[m\]"),
    "geometry": (changed("rear_left: [-0.21,", "rear_left: [-0.25,"),
                 "hash: the PLC has"),
    "another of four": (lambda: replace(load_robot("scampi"), hardware=ROBOT.hardware),
                        "ROBOT --print-machine"),
    "more cables": (lambda: at_the_plc(eight_cable_robot()), "cables: the PLC has 4, .* 8"),
    "fewer cables": (lambda: at_the_plc(without_a_chain()), "cables: the PLC has 4, .* 3"),
}  # fmt: skip


def at_the_plc(robot):
    """A robot that counts metres, with the PLC of this one."""
    hardware = ROBOT.hardware
    n = robot.n
    own = replace(hardware, sign=(1.0,) * n, scale=(1.0,) * n, offset=(0.0,) * n)
    return replace(robot, hardware=own)


def without_a_chain():
    text = robot_text("carosac")
    last = next(line for line in text.splitlines() if "{name: rear_left" in line)
    return parse_robot(text.replace(last + "\n", ""))


@pytest.mark.parametrize("kind", OTHERS)
def test_the_file_of_another_robot_is_refused_by_field_before_anything_is_written(
    emulator, settings, kind
):
    make, message = OTHERS[kind]
    machine = emulator.machine
    driver = PlcDriver(make(), settings)
    with pytest.raises(CarosacError, match=f"the PLC is of another robot: .*{message}"):
        driver.connect()
    assert emulator.symbols.read(emulator.symbol_names[blocks.FROM_HOST]).strip(b"\0") == b""
    assert machine.owner == machine.counters.foreign == machine.counters.commands == 0
    assert not machine.winches.speed_peak.any()
    assert not [t for t in threading.enumerate() if t.name == "plc-exchange"]


@pytest.mark.parametrize("kind", ["speed", "mass", "order", "rewired", "sign", "scale"])
def test_a_host_that_does_not_compare_is_refused_by_the_plc(emulator, settings, kind, monkeypatch):
    monkeypatch.setattr(identity, "refusal", lambda *_: None)
    driver = PlcDriver(OTHERS[kind][0](), settings)
    driver.connect()
    try:
        driver.home(home_pose(ROBOT))
        with pytest.raises(CarosacError, match="refused to enable: it is of another robot than"):
            driver.enable()
    finally:
        driver.close()
        emulator_forgets(emulator)
    assert emulator.machine.state is DriveState.CONNECTED and emulator.machine.owner == 0
    assert not emulator.machine.winches.speed_peak.any()


def emulator_forgets(emulator):
    """Clear what a host wrote last, for the test of a block that nobody has written."""
    name = emulator.symbol_names[blocks.FROM_HOST]
    emulator.symbols.write(name, bytes(blocks.from_host(ROBOT.n).size))


def test_the_same_robot_from_a_file_with_another_address_and_offset_is_enabled(emulator, settings):
    text = TEXT.replace("offset: 0.5 m", "offset: 0.7 m").replace("# ", "# other ")
    robot = parse_robot(text + "  imu: {source: udp, port: 5099}\n")
    driver = PlcDriver(robot, settings)
    driver.connect()
    try:
        driver.home(home_pose(robot))
        driver.enable()
        assert driver.state is DriveState.ENABLED
    finally:
        driver.close()
        emulator_forgets(emulator)


def test_a_plc_of_another_robot_after_a_lost_connection_is_not_written_to(emulator):
    other = machine_values(replace(ROBOT, mass=80.0))
    name, block = emulator.symbol_names[blocks.MACHINE], blocks.machine(ROBOT.n)
    with udp_server(emulator) as server:
        link = {"link": "tests.plc.udp_link:UdpLink", "link_settings": {"port": server.port}}
        driver = PlcDriver(ROBOT, PlcDriverSettings(motion=True, lost_after=0.5, **link))
        driver.connect()
        try:
            server.cut = True
            until(lambda: driver.fault is Fault.LOST_CONNECTION)
            until(lambda: driver.exchange.counters.errors > 4)  # it connects anew
            emulator.symbols.write(name, block.pack(other))
            server.cut = False
            until(lambda: driver.exchange.refusal)
            message = "mass: the PLC has 80, the robot file 23.655 [kg]"
            until(lambda: message in driver.fault_text)
            with pytest.raises(CarosacError, match="mass: the PLC has 80"):
                driver.reset_fault()
            emulator.symbols.write(name, block.pack(machine_values(ROBOT)))
            until(lambda: driver.fault is Fault.NONE)
            assert driver.exchange.refusal is None
        finally:
            emulator.symbols.write(name, block.pack(machine_values(ROBOT)))
            driver.close()


def until(condition, patience=10.0):
    end = time.monotonic() + patience
    while not condition():
        assert time.monotonic() < end, "not in time"
        time.sleep(0.002)


def test_nobody_reads_the_session_of_the_owner(emulator):
    driver = PlcDriver(ROBOT, PlcDriverSettings(motion=True, lost_after=PATIENCE, timeout=0.5))
    driver.connect()
    try:
        driver.home(home_pose(ROBOT))
        driver.enable()
        written = emulator.symbols.read(emulator.symbol_names[blocks.FROM_HOST])
        values = blocks.from_host(ROBOT.n).unpack(written)
        secret = int(values["session"]).to_bytes(8, "little")
        assert secret in written
        read = b""
        with PlcClient(ROBOT.n, IP) as client:
            with pytest.raises(CarosacError, match="ADS code 0x704"):
                client.read("CaRoSaC.from_host", len(written))
            for name, symbol in emulator.symbol_names.items():
                if name != blocks.FROM_HOST:
                    read += client.read(symbol, 1 << 15)
        assert values["host_number"].to_bytes(4, "little") in read  # what owner shows
        assert secret[:4] not in read and secret[4:] not in read
    finally:
        driver.close()
        emulator_forgets(emulator)


@pytest.mark.parametrize("more", [(), ("--home", "0.4", "-1.8", "2.2"), ("--reset",),
                                  ("--enable", "--home", "0.4", "-1.8", "2.2")])  # fmt: skip
def test_a_run_with_another_robot_is_one_message_and_no_recording(emulator, tmp_path, capsys, more):
    file = tmp_path / "heavy.yaml"
    file.write_text(TEXT.replace("mass: 23.655 kg", "mass: 80 kg"))
    recording = tmp_path / "run.jsonl"
    words = ("run", "--driver", "ads", "--robot", str(file), "--duration", "0.2",
             "--recording", str(recording), *more)  # fmt: skip
    assert main([*words]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "the PLC is of another robot: mass: the PLC has 80" not in said
    assert "the PLC is of another robot: mass: the PLC has 23.655, the robot file 80 [kg]" in said
    assert not recording.exists()


# What a PLC programmer declares.


def test_the_declaration_has_every_member_in_order_with_the_values_of_the_block(capsys):
    assert main(["plc", "carosac", "--print-machine"]) == 0
    text = capsys.readouterr().out
    assert text.strip() == declaration(load_robot("carosac"))
    members = [line.split(" := ")[0].strip() for line in text.splitlines()[1:]]
    assert members == [f.name for f in blocks.machine(4).fields]
    assert f"hash := 16#{machine_values(load_robot('carosac'))['hash']:016X}," in text
    assert "length_max := [20.0, 20.0, 20.0, 20.0]," in text


def test_texts_and_small_numbers_are_structured_text():
    names = ("it's $5", "über", "x" * 40, "line\nbreak")
    hardware = replace(ROBOT.hardware, scale=(1e-7,) * 4)
    text = declaration(replace(ROBOT, cable_names=names, hardware=hardware))
    assert f"name := ['it$'s $$5', '?ber', '{'x' * 31}', 'line?break']);" in text
    assert "scale := [0.0000001, 0.0000001, 0.0000001, 0.0000001]," in text


def test_a_name_of_the_plc_ends_at_its_zero_and_brings_no_escape_sequences():
    file = machine_values(ROBOT)
    padded = [name.ljust(20, b"\0") + b"rubbish" for name in file["name"]]
    assert identity.refusal(file | {"name": np.array(padded)}, file) is None
    coloured = [b"\x1b[31m" + name for name in file["name"]]
    assert "\x1b" not in identity.refusal(file | {"name": np.array(coloured)}, file)


@pytest.mark.parametrize("value", [np.nan, np.inf, 0.0])
def test_numbers_of_the_plc_that_are_none_are_refused(value):
    file = machine_values(ROBOT)
    assert "mass: the PLC has" in identity.refusal(file | {"mass": value}, file)
