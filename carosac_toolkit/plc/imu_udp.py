"""An inertial sensor that sends lines of text over UDP, one sample for each datagram.

A line is ``imu NUMBER TIME GX GY GZ AX AY AZ``: a number that grows by one, the time by the clock
of the sensor [s], the angular rate [rad/s] and the specific force [m/s^2] in the platform frame.
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
from carosac_toolkit.loop.values import Imu
from carosac_toolkit.plc.clock_offset import ClockOffset
from carosac_toolkit.robot.hardware import ImuSource

_LONGEST = 512  # bytes of a line
_KEPT = 2000  # samples that nobody asked for
_PATIENCE = 0.1  # [s] in which the thread sees that it is to end


def imu_line(
    number: int, stamp: float, angular_rate: Sequence[float] | Array,
    specific_force: Sequence[float] | Array,
) -> str:  # fmt: skip
    """The line of one sample; the inverse of `parse_imu_line`."""
    values = " ".join(f"{x:.7g}" for x in (*angular_rate, *specific_force))
    return f"imu {number} {stamp:.6f} {values}"


def parse_imu_line(line: str) -> tuple[int, float, Array] | None:
    """Number, time [s] and the six values of a line; None where it is no sample."""
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
    """Listens in a thread of its own.

    Attributes:
        received: Samples taken.
        refused: Lines that are no sample, or come from before a sample taken already.
        lost: Numbers that never came.
    """

    def __init__(self, source: ImuSource) -> None:
        """Listen from now on.

        Raises:
            CarosacError: The port is taken, or the address is not of this host.
        """
        self.received, self.refused, self.lost = 0, 0, 0
        self._samples: deque[tuple[float, Array]] = deque(maxlen=_KEPT)
        self._offset = ClockOffset()
        self._last: int | None = None
        self._stamp = -math.inf
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.bind((source.ip, source.port))
        except OSError as error:
            self._socket.close()
            raise CarosacError(
                f"imu: cannot listen on {source.ip}:{source.port}: {error.strerror or error}"
            ) from error
        self._socket.settimeout(_PATIENCE)
        self._running = True
        self._thread = threading.Thread(target=self._listen, name="imu-udp", daemon=True)
        self._thread.start()

    def take(self, origin: float) -> Imu | None:
        """All samples since the last call, in the time of this host from `origin` on [s]."""
        found = [self._samples.popleft() for _ in range(len(self._samples))]
        if not found:
            return None
        values = np.stack([sample for _, sample in found])[None]
        stamps = np.array([[self._offset.here(stamp) - origin for stamp, _ in found]])
        return Imu(time=stamps, angular_rate=values[..., :3], specific_force=values[..., 3:])

    def close(self) -> None:
        """End the thread; safe to call twice."""
        self._running = False
        self._thread.join(10.0 * _PATIENCE)
        self._socket.close()

    def _listen(self) -> None:
        while self._running:
            try:
                data = self._socket.recv(_LONGEST)
            except TimeoutError:
                continue
            except OSError:
                return
            self._take(data, time.monotonic())

    def _take(self, data: bytes, received: float) -> None:
        """Keep one sample."""
        found = parse_imu_line(data.decode("ascii", "replace"))
        if found is None:
            self.refused += 1
            return
        number, stamp, values = found
        if self._last is not None and number <= self._last:
            if stamp > self._stamp - 1.0:  # late or doubled; a sensor that restarts begins anew
                self.refused += 1
                return
            self._offset.clear()
        elif self._last is not None:
            self.lost += number - self._last - 1
        self._last, self._stamp = number, stamp
        self._offset.add(received, stamp)
        self.received += 1
        self._samples.append((stamp, values))
