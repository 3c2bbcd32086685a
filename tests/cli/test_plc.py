import contextlib
import io
import json
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from carosac_toolkit.base.errors import CarosacError, InvalidField
from carosac_toolkit.cli.main import main
from carosac_toolkit.cli.plc import listen, obey
from carosac_toolkit.loop.drive_state import DriveState, Fault
from carosac_toolkit.plc import blocks
from carosac_toolkit.plc.blocks import from_host
from carosac_toolkit.plc.emulator.client import PlcClient
from carosac_toolkit.plc.emulator.emulator import Emulator
from carosac_toolkit.plc.emulator.settings import EmulatorSettings
from tests.plc_process import own_address
from tests.robots import simple_robot


@pytest.fixture(scope="module")
def emulator():
    """An emulator that nobody runs: its cycles are stepped by hand."""
    robot = simple_robot()
    found = Emulator(robot, robot, EmulatorSettings(), ip=own_address())
    yield found
    found.close()


@pytest.fixture
def address(emulator):
    return emulator.server._socket.getsockname()[0]


def test_lines_of_the_standard_input_do_what_they_say(emulator):
    machine = emulator.machine
    assert obey(emulator, "trip 2") == "ok"
    emulator.step()
    assert (machine.fault, machine.fault_axis) == (Fault.DRIVE_TRIP, 2)
    said = json.loads(obey(emulator, "state"))
    assert said == {"state": "fault", "fault": "drive_trip", "axis": 2, "owner": None}
    assert obey(emulator, "trip 2 off") == "ok"
    assert not machine.wires.tripped.any()
    obey(emulator, "network 0.02 0.01")
    assert (emulator.server.delay, emulator.server.jitter) == (0.02, 0.01)
    obey(emulator, "freeze-counter on")
    beats = machine.output(emulator.world.inputs)["sequence"]
    emulator.step()
    assert machine.output(emulator.world.inputs)["sequence"] == beats
    obey(emulator, "clear")
    emulator.step()
    assert machine.output(emulator.world.inputs)["sequence"] == beats + 1
    before = emulator.world.inputs.length
    obey(emulator, "jump 1 0.05")
    assert emulator.world.inputs.length[0] - before[0] == pytest.approx(0.05)
    obey(emulator, "place 0.5 -1.5 2.0")
    assert emulator.world.truth().position[0] == pytest.approx([0.5, -1.5, 2.0], abs=1e-3)
    assert machine.state is DriveState.FAULT  # latched
    machine.stop(Fault.NONE)


@pytest.mark.parametrize(
    ("line", "match"),
    [
        ("jmup 1 0.05", "control: got 'jmup 1 0.05'; allowed: trip, jump"),
        ("jump 9 0.05", "axis: got 9; allowed: 1 to 4"),
        ("place 0 0", "2 numbers; allowed: x y z"),
        ("network fast", "numbers, on or off"),
        ("place 90 0 2", "start_position"),
    ],
)
def test_lines_that_mean_nothing_are_refused(emulator, line, match):
    with pytest.raises(InvalidField, match=match):
        obey(emulator, line)


def test_any_client_reads_the_counters_and_injects_faults(emulator, address):
    with PlcClient(4, address) as client:
        cycles = client.diagnosis()["cycles"]
        emulator.step()
        assert client.diagnosis()["cycles"] == cycles + 1
        block = blocks.control()
        values = {"number": 77, "kind": 1, "axis": 9, "value": 1.0}
        client.write(blocks.CONTROL, block.pack(values))
        emulator.step()
        assert client.diagnosis()["control_refused"] == 77
        with pytest.raises(CarosacError, match="ADS code 0x710"):
            client.read("CaRoSaC.nothing", 8)
        with pytest.raises(CarosacError, match="ADS code 0x704"):
            client.write(blocks.TRUTH, bytes(blocks.truth(4).size))
        with pytest.raises(CarosacError, match="ADS code 0x705"):
            client.write("CaRoSaC.from_host", b"short")
        with pytest.raises(CarosacError, match="ADS code 0x704"):
            client.read("CaRoSaC.from_host", 4)
        assert client.read("carosac.TO_HOST", 4) == bytes([3, 0, 0, 0])  # names without case


def test_data_of_another_layout_are_not_heard(emulator, address):
    values = {"layout": 9, "cables": 4, "session": 3, "host_number": 3, "sequence": 1,
              "sequence_end": 1, "request": 1, "request_number": 5}  # fmt: skip
    with PlcClient(4, address) as client:
        client.write("CaRoSaC.from_host", from_host(4).pack(values))
        emulator.step()
        assert emulator.machine.output(emulator.world.inputs)["answered"] != 5
        client.write("CaRoSaC.from_host", bytes(from_host(4).size))


def test_what_is_no_ads_ends_its_connection_only(emulator, address):
    import socket

    with socket.create_connection((address, 48898), 2.0) as rude:
        rude.sendall(b"GET / HTTP/1.1\r\n\r\n")
        with contextlib.suppress(ConnectionResetError):
            assert rude.recv(10) == b""
    with PlcClient(4, address) as client:
        assert client.diagnosis()["cycles"] > 0


def test_packets_may_come_in_pieces(emulator, address):
    with PlcClient(4, address) as client:
        whole = client._socket

        class Pieces:
            def sendall(self, data):
                for k in range(0, len(data), 7):
                    whole.sendall(data[k : k + 7])
                    time.sleep(0.001)

            def __getattr__(self, name):
                return getattr(whole, name)

        client._socket = Pieces()
        assert client.truth()["position"] == pytest.approx(
            emulator.world.truth().position[0], abs=1e-6
        )


def test_the_robot_stands_still_while_the_drives_are_off(emulator):
    before = emulator.world.truth().unstrained_length
    for _ in range(100):
        emulator.step()
    assert emulator.world.truth().unstrained_length == pytest.approx(before, abs=1e-9)


def test_a_taken_address_is_one_message(emulator, address, capsys):
    assert main(["plc", "carosac", "--ip", address]) == 2
    assert f"plc: cannot listen on {address}:48898" in capsys.readouterr().err


@pytest.mark.parametrize("typed", ["", "quit\n", "nonsense\nquit\ntrip 1\n"])
def test_the_end_of_the_input_and_quit_end_the_cycle(emulator, monkeypatch, capsys, typed):
    stops = []
    monkeypatch.setattr(emulator, "stop", lambda: stops.append(True))
    monkeypatch.setattr(sys, "stdin", io.StringIO(typed))
    listen(emulator)
    assert stops
    assert ("refused: control: got 'nonsense'" in capsys.readouterr().out) == ("non" in typed)


def test_a_signal_ends_the_process_and_the_counters_are_written(tmp_path):
    report = tmp_path / "plc.json"
    process = subprocess.Popen(
        [sys.executable, "-m", "carosac_toolkit.cli.main", "plc", "--ip", own_address(),
         "--control", "--json", str(report)],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    try:
        assert "ready: carosac" in process.stdout.readline()
        process.send_signal(signal.SIGTERM)
        out, _ = process.communicate(timeout=60.0)
    finally:
        process.kill()
        process.wait()
    assert process.returncode in (0, 1)
    assert "over limits: length 0, speed 0" in out
    found = json.loads(report.read_text())
    assert found["cycles"] > 0 and np.isfinite(found["lost_time"])
