import os
import socket
import subprocess
import sys
import threading
import time

import numpy as np
import pytest

from carosac_toolkit.base.errors import CarosacError
from carosac_toolkit.plc.clock_offset import ClockOffset
from carosac_toolkit.plc.imu_udp import ImuListener, imu_line, parse_imu_line
from carosac_toolkit.robot.hardware import ImuSource


def free_port():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as found:
        found.bind(("127.0.0.1", 0))
        return found.getsockname()[1]


@pytest.fixture
def listener():
    found = ImuListener(ImuSource(port=free_port()))
    yield found
    found.close()


def send(listener, *lines):
    before = listener.received + listener.refused + listener.foreign
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
        for line in lines:
            out.sendto(line.encode(), listener._socket.getsockname())
        wait_for(listener, before + len(lines))


def wait_for(listener, count):
    """Wait until some datagrams are judged; their socket must stay open, as its user counts."""
    end = time.monotonic() + 5.0
    while listener.received + listener.refused + listener.foreign < count:
        assert time.monotonic() < end, "not in time"
        time.sleep(0.005)


def stream(listener, seconds, first=1, clock=100.0, between=()):
    """Send samples at 200 Hz from one socket; `between` comes after the first tenth of them."""
    begin, sent = time.monotonic(), 0
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
        while (passed := time.monotonic() - begin) < seconds:
            lines = [imu_line(first + sent, clock + passed, [0, 0, 0], [0, 0, 9.81])]
            lines += between if sent == 20 else []
            for line in lines:
                out.sendto(line.encode(), listener._socket.getsockname())
            sent += 1
            time.sleep(0.005)
        wait_for(listener, sent + len(between))
    return sent


def test_a_line_comes_back_as_it_was_written():
    number, stamp, values = parse_imu_line(imu_line(7, 1.25, [0.1, 0.2, 0.3], [0, 0, 9.81]))
    assert (number, stamp) == (7, 1.25)
    assert values == pytest.approx([0.1, 0.2, 0.3, 0, 0, 9.81])


@pytest.mark.parametrize(
    "line",
    ["", "imu 1 2 3", "gps 1 2 3 4 5 6 7 8", "imu x 1 2 3 4 5 6 7", "imu 1 1 nan 3 4 5 6 7 8"],
)
def test_what_is_no_sample_is_none(line):
    assert parse_imu_line(line) is None


def test_samples_come_in_order_once_with_their_spacing(listener):
    lines = [imu_line(k, 100.0 + 0.005 * k, [k, 0, 0], [0, 0, 9.81]) for k in (1, 2, 3, 5)]
    send(listener, *lines, "noise", lines[0])
    imu = listener.take(origin=0.0)
    assert imu.angular_rate[0, :, 0].tolist() == [1, 2, 3, 5]
    assert np.diff(imu.time[0]) == pytest.approx([0.005, 0.005, 0.01], abs=5e-3)
    assert imu.time[0, -1] == pytest.approx(time.monotonic(), abs=1.0)
    assert (listener.lost, listener.refused) == (1, 2)
    assert listener.take(origin=0.0) is None


FORGED = (
    "imu 999999999999 100.2 0 0 0 0 0 9",
    "imu 40 1e15 0 0 0 0 0 9",
    "imu 60 100.3 0 0 0 0 0 9",
)


@pytest.mark.parametrize("line", FORGED)
def test_one_wrong_datagram_does_not_shut_the_sensor_out(listener, line):
    """Where it is so near that it passes, the true samples are soon back."""
    sent = stream(listener, 1.0, between=[line])
    assert listener.received > 0.6 * sent
    assert listener.silence < 0.3


def test_a_wrong_first_datagram_and_a_restart_of_the_sensor_end_in_its_samples(listener):
    send(listener, FORGED[0])
    assert listener.received == 1
    stream(listener, 0.5, first=5000, clock=900.0)
    before = listener.received
    assert before > 20
    stream(listener, 0.5, first=1, clock=3.0)
    assert listener.received > before + 20
    assert listener.take(origin=0.0).time[0, -1] == pytest.approx(time.monotonic(), abs=1.0)


def test_only_the_address_of_the_sensor_is_heard():
    found = ImuListener(ImuSource(port=free_port(), sender="127.0.0.9"))
    try:
        send(found, imu_line(1, 1.0, [0, 0, 0], [0, 0, 9.81]))
        assert (found.received, found.foreign) == (0, 1)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sensor:
            sensor.bind(("127.0.0.9", 0))
            line = imu_line(1, 1.0, [0, 0, 0], [0, 0, 9.81])
            sensor.sendto(line.encode(), found._socket.getsockname())
            wait_for(found, 2)
        assert (found.received, found.foreign) == (1, 1)
    finally:
        found.close()


@pytest.mark.skipif(os.geteuid() != 0, reason="needs a second user")
def test_another_user_of_this_machine_is_not_heard(listener):
    """Nor one that closes its socket at once, so that nobody can tell whose it was."""
    line = imu_line(1, 1.0, [0, 0, 0], [0, 0, 9.81])
    code = (
        "import os, socket, sys; os.setuid(65534); "
        "out = socket.socket(socket.AF_INET, socket.SOCK_DGRAM); "
        f"out.sendto({line.encode()!r}, {listener._socket.getsockname()!r}); sys.stdin.read()"
    )
    other = subprocess.Popen([sys.executable, "-S", "-c", code], stdin=subprocess.PIPE)
    try:
        wait_for(listener, 1)
    finally:
        other.communicate()
    assert (listener.received, listener.foreign) == (0, 1)
    send(listener, line)
    assert listener.received == 1


@pytest.mark.skipif(os.geteuid() != 0, reason="needs a second user")
def test_another_user_cannot_silence_the_sensor(listener):
    """Not by a socket at the same port for IPv6 alone, which sends nothing to IPv4."""
    code = (
        "import os, socket, sys; os.setuid(65534); "
        "other = socket.socket(socket.AF_INET6, socket.SOCK_DGRAM); "
        "other.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1); "
        "other.bind(('::', int(sys.argv[1]))); print('bound', flush=True); sys.stdin.read()"
    )
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sensor:
        sensor.bind(("", 0))
        other = subprocess.Popen(
            [sys.executable, "-S", "-c", code, str(sensor.getsockname()[1])],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE,
        )  # fmt: skip
        try:
            assert other.stdout.readline() == b"bound\n"
            line = imu_line(1, 1.0, [0, 0, 0], [0, 0, 9.81])
            sensor.sendto(line.encode(), listener._socket.getsockname())
            wait_for(listener, 1)
        finally:
            other.communicate()
    assert (listener.received, listener.foreign) == (1, 0)


def test_a_taken_port_is_one_message_and_closing_ends_the_thread(listener):
    port = listener._socket.getsockname()[1]
    with pytest.raises(CarosacError, match=f"imu: cannot listen on 127.0.0.1:{port}"):
        ImuListener(ImuSource(port=port))
    listener.close()
    listener.close()
    assert not [t for t in threading.enumerate() if t.name == "imu-udp"]


def test_clock_offset_is_that_of_the_quickest_answer_and_follows_a_drift():
    rng = np.random.default_rng(0)
    offset = ClockOffset(span=5.0)
    drift = 50e-6
    for k in range(4000):
        stamp = k * 0.01
        offset.add(1000.0 + stamp * (1 + drift) + rng.exponential(5e-3) + 1e-3, stamp)
    here = offset.here(39.99)
    assert here == pytest.approx(1000.0 + 39.99 * (1 + drift) + 1e-3, abs=1e-3)
