"""Connection to the real robot: the section ``hardware`` of a robot file."""

from __future__ import annotations

import ipaddress
import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.base.local_peer import is_loopback
from carosac_toolkit.base.numbers import check_positive, check_whole

NET_ID_PATTERN = re.compile(r"(\d{1,3}\.){5}\d{1,3}")
PORT_MAX = 65535
LOOPBACK_ADDRESS = "127.0.0.1"
ADS_TCP_PORT = 48898  # of ADS, on every machine


@dataclass(frozen=True, kw_only=True)
class AdsAddress:
    """A TwinCAT PLC; by default one on this machine.

    Attributes:
        net_id: Its AMS net id, six numbers with dots.
        ip: Its IP address; the TCP port of ADS is always 48898.
        port: AMS port of the PLC runtime; the first one of TwinCAT 3 is 851.
        timeout: After which a call is given up [s].
        from_host: Symbol of the structure that the host writes.
        to_host: Symbol of the structure that the host reads.
        machine: Symbol of the constants that must agree with the robot file.
    """

    net_id: str = "127.0.0.1.1.1"
    ip: str = LOOPBACK_ADDRESS
    port: int = 851
    timeout: float = 0.05
    from_host: str = "CaRoSaC.from_host"
    to_host: str = "CaRoSaC.to_host"
    machine: str = "CaRoSaC.machine"

    def __post_init__(self) -> None:
        """Refuse an invalid address."""
        numbers = (
            [int(x) for x in self.net_id.split(".")]
            if NET_ID_PATTERN.fullmatch(self.net_id)
            else []
        )
        if not numbers or max(numbers) > 255:
            allowed = "six numbers from 0 to 255 separated by dots, such as 192.168.0.10.1.1"
            raise InvalidField("hardware.ads.net_id", repr(self.net_id), allowed)
        check_whole("hardware.ads.port", self.port, 1, PORT_MAX)
        check_positive("hardware.ads.timeout", self.timeout, "s")
        for name in ("ip", "from_host", "to_host", "machine"):
            if not str(getattr(self, name)).strip():
                raise InvalidField(f"hardware.ads.{name}", "nothing", "a non-empty text")


@dataclass(frozen=True, kw_only=True)
class ImuSource:
    """An inertial sensor that sends its samples to this host.

    Attributes:
        source: How; ``udp`` is one datagram per line of text.
        ip: Address of this host on which to listen.
        port: UDP port.
        sender: IP address of the sensor; datagrams of others are refused. None: this machine
            itself, for an `ip` that only this machine can reach.
    """

    source: str = "udp"
    ip: str = LOOPBACK_ADDRESS
    port: int = 5005
    sender: str | None = None

    def __post_init__(self) -> None:
        """Refuse another protocol, and a sensor elsewhere without its address."""
        if self.source != "udp":
            raise InvalidField("hardware.imu.source", repr(self.source), "'udp'")
        check_whole("hardware.imu.port", self.port, 1, PORT_MAX)
        if self.sender is None and not is_loopback(self.ip):
            allowed = f"the IP address of the sensor, as others can reach {self.ip} too"
            raise InvalidField("hardware.imu.sender", "none", allowed)
        if self.sender is not None and not _is_address(self.sender):
            raise InvalidField("hardware.imu.sender", repr(self.sender), "an IP address")

    def is_sender(self, address: str) -> bool:
        """Return whether the sensor sends from an IP address."""
        return is_loopback(address) if self.sender is None else address == self.sender


def _is_address(text: str) -> bool:
    """Return whether a text is an IP address."""
    try:
        ipaddress.ip_address(text)
    except ValueError:
        return False
    return True


@dataclass(frozen=True, kw_only=True)
class Hardware:
    """The PLC of a robot with n cables, and the units of its numbers.

    An unstrained length is ``sign * scale * number + offset``, where the number is the PLC's.

    Attributes:
        sign: 1 where the number grows as cable is paid out, -1 where it shrinks, n of them.
        scale: Metres per unit of the PLC, n of them.
        offset: Unstrained length at number 0 of the PLC [m], n of them; homing sets it again.
        ads: Address of the PLC.
        imu: The inertial sensor, or None.
    """

    sign: tuple[float, ...]
    scale: tuple[float, ...]
    offset: tuple[float, ...]
    ads: AdsAddress = field(default_factory=AdsAddress)
    imu: ImuSource | None = None

    def __post_init__(self) -> None:
        """Refuse other counts, and numbers that turn no unit into metres."""
        for name in ("sign", "scale", "offset"):
            entries = tuple(float(x) for x in getattr(self, name))
            object.__setattr__(self, name, entries)
            if len(entries) != len(self.sign) or not entries:
                allowed = f"one for each of {len(self.sign)} cables"
                raise InvalidField(f"hardware.{name}", f"{len(entries)} numbers", allowed)
        for i, (sign, scale, offset) in enumerate(
            zip(self.sign, self.scale, self.offset, strict=True)
        ):
            if sign not in (-1.0, 1.0):
                raise InvalidField(f"hardware.sign[{i}]", sign, "1 or -1")
            check_positive(f"hardware.scale[{i}]", scale, "m")
            if not math.isfinite(offset):
                raise InvalidField(f"hardware.offset[{i}]", f"{offset} m", "a finite number")

    @classmethod
    def loopback(cls, n: int) -> Hardware:
        """Return a PLC on this machine that counts unstrained lengths in metres."""
        return cls(sign=(1.0,) * n, scale=(1.0,) * n, offset=(0.0,) * n)

    @classmethod
    def from_record(cls, record: Mapping[str, Any] | None) -> Hardware | None:
        """Make it from what `dataclasses.asdict` made of it."""
        if record is None:
            return None
        known = {f.name: record[f.name] for f in fields(cls) if f.name not in ("ads", "imu")}
        imu = None if record["imu"] is None else ImuSource(**record["imu"])
        return cls(ads=AdsAddress(**record["ads"]), imu=imu, **known)

    @property
    def n(self) -> int:
        """Number of cables."""
        return len(self.sign)

    @property
    def unit(self) -> Array:
        """Change of unstrained length per unit of the PLC, signed [m], shape (n,)."""
        metres: Array = np.array(self.sign) * np.array(self.scale)
        return metres

    def length(self, number: Iterable[float]) -> Array:
        """Convert numbers of the PLC to unstrained lengths [m], shape (n,)."""
        lengths: Array = self.unit * np.asarray(number, dtype=np.float64) + np.array(self.offset)
        return lengths

    def number(self, length: Iterable[float]) -> Array:
        """Convert unstrained lengths [m] to numbers of the PLC, shape (n,)."""
        numbers: Array = (np.asarray(length, dtype=np.float64) - np.array(self.offset)) / self.unit
        return numbers
