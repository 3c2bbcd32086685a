"""An inertial sensor that sends one line of text per sample over UDP.

A line is ``imu NUMBER TIME GX GY GZ AX AY AZ``: a number that grows by one, the time by the clock
of the sensor [s], the angular rate [rad/s] and the specific force [m/s^2] in the platform frame.
UDP knows no senders: only datagrams from the address of the robot file count, and of those that
come from this machine only the ones of this user or root.
"""

from __future__ import annotations

import math
import socket
import threading
import time
from collections import deque
from collections.abc import Sequence

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import CarosacError
from carosac_toolkit.base.local_peer import is_another_user
from carosac_toolkit.loop.values import Imu
from carosac_toolkit.plc.clock_offset import ClockOffset
from carosac_toolkit.plc.imu_track import SampleTrack, Verdict
from carosac_toolkit.robot.hardware import ImuSource

LINE_BYTES_MAX = 512
SAMPLES_KEPT_MAX = 2000  # 10 s at 200 Hz
CHECK_PERIOD_S = 1.0  # between two looks at the user of a sender
CHECK_INTERVAL_MIN_S = 0.002  # between looks at new senders: each takes tenths of that
RECEIVE_TIMEOUT_S = 0.1  # within which the thread notices that it has to end


def imu_line(
    number: int, stamp: float, angular_rate: Sequence[float] | Array,
    specific_force: Sequence[float] | Array,
) -> str:  # fmt: skip
    """Return the line of one sample; the inverse of `parse_imu_line`."""
    values = " ".join(f"{x:.7g}" for x in (*angular_rate, *specific_force))
    return f"imu {number} {stamp:.6f} {values}"


def parse_imu_line(line: str) -> tuple[int, float, Array] | None:
    """Return number, time [s] and the six values of a line; None if it is no sample."""
    words = line.split()
    if len(words) != 9 or words[0] != "imu":
        return None
    try:
        number, values = int(words[1]), [float(word) for word in words[2:]]
    except ValueError:
        return None
    if not all(math.isfinite(value) for value in values):
        return None
    return number, values[0], np.array(values[1:])


class ImuListener:
    """A listener with a thread of its own.

    Attributes:
        received: Number of samples taken.
        refused: Number of lines that are no sample, or do not go on from those taken already.
        foreign: Number of datagrams of other senders, or of other users of this machine.
        lost: Number of samples that never came.
    """

    def __init__(self, source: ImuSource) -> None:
        """Start to listen.

        Raises:
            CarosacError: The port is in use, or the address is not of this host.
        """
        self.received = self.refused = self.foreign = self.lost = 0
        self._samples: deque[tuple[float, Array]] = deque(maxlen=SAMPLES_KEPT_MAX)
        self._offset = ClockOffset()
        self._track = SampleTrack()
        self._source = source
        self._trusted: tuple[str, int] | None = None  # sender whose user was checked
        self._checked = self._looked = -math.inf
        self._accepted = time.monotonic()
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.bind((source.ip, source.port))
        except OSError as error:
            self._socket.close()
            raise CarosacError(
                f"imu: cannot listen on {source.ip}:{source.port}: {error.strerror or error}"
            ) from error
        self._socket.settimeout(RECEIVE_TIMEOUT_S)
        self._running = True
        self._thread = threading.Thread(target=self._listen, name="imu-udp", daemon=True)
        self._thread.start()

    @property
    def silence(self) -> float:
        """Time since the newest sample that was taken, or since the start [s]."""
        return time.monotonic() - self._accepted

    def take(self, origin: float) -> Imu | None:
        """Return all samples since the last call, with times of this host since `origin` [s]."""
        samples = [self._samples.popleft() for _ in range(len(self._samples))]
        if not samples:
            return None
        values = np.stack([sample for _, sample in samples])[None]
        stamps = np.array([[self._offset.here(stamp) - origin for stamp, _ in samples]])
        return Imu(time=stamps, angular_rate=values[..., :3], specific_force=values[..., 3:])

    def close(self) -> None:
        """End the thread; safe to call twice."""
        self._running = False
        self._thread.join(10.0 * RECEIVE_TIMEOUT_S)
        self._socket.close()

    def _listen(self) -> None:
        while self._running:
            try:
                data, sender = self._socket.recvfrom(LINE_BYTES_MAX)
            except TimeoutError:
                continue
            except OSError:
                return
            received = time.monotonic()
            if self._trusts(sender, received):
                self._take(data, received)
            else:
                self.foreign += 1

    def _trusts(self, sender: tuple[str, int], now: float) -> bool:
        """Return whether a datagram is of the sensor: its address, and no other user of here."""
        if not self._source.is_sender(sender[0]):
            return False
        known = sender == self._trusted
        if known and now - self._checked < CHECK_PERIOD_S:
            return True
        if not known and now - self._looked < CHECK_INTERVAL_MIN_S:
            return False
        self._looked = now
        trusted = not is_another_user("udp", sender)
        if trusted:
            self._trusted, self._checked = sender, now
        elif known:
            self._trusted = None
        return trusted

    def _take(self, data: bytes, received: float) -> None:
        """Keep one sample."""
        sample = parse_imu_line(data.decode("ascii", "replace"))
        if sample is None:
            self.refused += 1
            return
        number, stamp, values = sample
        last = self._track.number
        verdict = self._track.judge(number, stamp, received)
        if verdict is Verdict.REFUSED:
            self.refused += 1
            return
        if verdict is Verdict.RESTARTED:
            self._offset.clear()
        elif last is not None:
            self.lost += number - last - 1
        self._accepted = received
        self._offset.add(received, stamp)
        self.received += 1
        self._samples.append((stamp, values))
