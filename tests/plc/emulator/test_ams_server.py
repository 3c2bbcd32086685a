"""The ADS server of the emulated PLC serves its own user."""

import socket
import struct
from contextlib import closing

import pytest

from carosac_toolkit.cli.main import main
from carosac_toolkit.plc.emulator.ams_server import AMS_HEADER, AmsServer
from carosac_toolkit.plc.emulator.symbols import Symbols
from carosac_toolkit.robot.hardware import ADS_TCP_PORT
from tests.another_user import as_another_user, as_root
from tests.plc_process import own_address

READ_DEVICE_INFO = 1


@pytest.fixture(params=[False, True])
def server(request):
    with closing(AmsServer(Symbols(), own_address(), allow_others=request.param)) as server:
        server.start()
        yield server


def ask(server):
    """Return whether the server answers."""
    request = AMS_HEADER.pack(bytes(6), 851, bytes(6), 40000, READ_DEVICE_INFO, 4, 0, 0, 7)
    with socket.socket() as client:
        client.settimeout(20.0)
        client.connect((server.ip, ADS_TCP_PORT))
        try:
            client.sendall(bytes(2) + struct.pack("<I", len(request)) + request)
            return b"carosac plc" in client.recv(1000)
        except ConnectionError:
            return False


def test_this_user_is_served(server):
    assert ask(server)


@as_root
def test_another_user_is_served_only_where_others_are_allowed(server, capsys):
    allowed = server.allow_others
    assert as_another_user(lambda: [ask(server), ask(server)]) == [allowed, allowed]
    assert server.refused == (0 if allowed else 2)
    assert capsys.readouterr().err.count("uid 65534; --allow-others") == (not allowed)


def test_an_address_that_others_can_reach_is_to_be_confirmed(capsys):
    assert main(["plc", "--ip", "0.0.0.0", "--duration", "0.01"]) == 2
    refusal = capsys.readouterr().err
    assert "--ip: got '0.0.0.0'" in refusal
    assert "add --allow-others" in refusal and "inject faults" in refusal
