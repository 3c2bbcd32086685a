import socket
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
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
        for line in lines:
            out.sendto(line.encode(), listener._socket.getsockname())
    end = time.monotonic() + 2.0
    while listener.received + listener.refused < len(lines) and time.monotonic() < end:
        time.sleep(0.005)


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
