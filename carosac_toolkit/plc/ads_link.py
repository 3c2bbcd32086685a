"""The link to a TwinCAT PLC over ADS, by pyads.

pyads is not safe in several threads, and closing one of its connections removes the route that
others to the same PLC share: one process needs one link to each PLC.
"""

from __future__ import annotations

import contextlib
import ctypes
import socket
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, ClassVar

from carosac_toolkit.base.extras import require
from carosac_toolkit.plc.blocks import CONTROL, DIAGNOSIS, FROM_HOST, MACHINE, TO_HOST, TRUTH
from carosac_toolkit.plc.link import LinkError
from carosac_toolkit.robot.hardware import ADS_TCP_PORT, AdsAddress, Hardware

CONNECT_TIMEOUT_MIN_S = 0.2  # opening TCP takes a round trip more than a call
_VALUE_BY_HANDLE = 0xF005  # index group, TE1000 "ADS/AMS Specification"
_SYMBOL_NOT_FOUND = 0x710  # ADS return code


@dataclass(frozen=True, kw_only=True)
class AdsLinkSettings:
    """Settings of `AdsLink`; all else is in the robot file, section ``hardware.ads``.

    Attributes:
        ip: IP address of the PLC, whose AMS net id is then the same with .1.1; None: as in the
            robot file.
        timeout: Time after which a call gives up [s]; None: as in the robot file.
    """

    ip: str | None = None
    timeout: float | None = None


class AdsLink:
    """A connection to the runtime of a TwinCAT PLC; its blocks are symbols.

    Attributes:
        address: AMS net id and IP address, for messages.
        timeout: Time after which a call gives up [s].
    """

    Settings: ClassVar[type[AdsLinkSettings]] = AdsLinkSettings

    def __init__(self, ads: AdsAddress) -> None:
        """Keep the address; `connect` connects."""
        self.address = f"{ads.net_id} at {ads.ip}"
        self.timeout = ads.timeout
        self._ads = ads
        self._plc: Any = None
        self._handles: dict[str, int] = {}

    @classmethod
    def build(cls, hardware: Hardware, settings: AdsLinkSettings | None = None) -> AdsLink:
        """Make a link to the PLC of the robot file.

        Raises:
            InvalidField: An address that is none, or a time limit that is not positive.
        """
        settings, ads = settings or AdsLinkSettings(), hardware.ads
        if settings.ip is not None:
            ads = replace(ads, ip=settings.ip, net_id=f"{settings.ip}.1.1")
        if settings.timeout is not None:
            ads = replace(ads, timeout=settings.timeout)
        return cls(ads)

    def connect(self, *, writing: bool) -> None:
        """Open a connection and ask for the handles of the symbols.

        Raises:
            MissingExtra: pyads is not installed.
            LinkError: Nothing answers, or a symbol is missing.
        """
        require("the ADS link", "pyads")
        import pyads

        ads = self._ads
        with _link_errors("cannot connect: "):
            # The library has no time limit of its own for a host that does not answer.
            limit = max(self.timeout, CONNECT_TIMEOUT_MIN_S)
            socket.create_connection((ads.ip, ADS_TCP_PORT), limit).close()
            plc = pyads.Connection(ads.net_id, ads.port, ads.ip)
            plc.open()
        self._plc = plc
        plc.set_timeout(max(1, round(1000.0 * self.timeout)))
        symbols = {TO_HOST: ads.to_host, MACHINE: ads.machine}
        symbols |= {FROM_HOST: ads.from_host} if writing else {}
        self._handles = {}
        for block, symbol in symbols.items():
            with _link_errors(f"cannot find the symbol {symbol}: "):
                self._handles[block] = plc.get_handle(symbol)
        with _link_errors("cannot look for an emulated PLC: "):
            try:
                for symbol in (TRUTH, CONTROL, DIAGNOSIS):
                    self._handles[symbol] = plc.get_handle(symbol)
            except pyads.ADSError as error:
                if error.err_code != _SYMBOL_NOT_FOUND:
                    raise

    def has(self, block: str) -> bool:
        """Return whether the PLC had the symbol of this block at the last `connect`."""
        return block in self._handles

    def read(self, block: str, size: int) -> bytes:
        """Return the bytes of a block.

        Raises:
            LinkError: Not connected, no such symbol, or no answer in time.
        """
        handle = self._handle(block)
        with _link_errors():
            return bytes(
                self._plc.read(_VALUE_BY_HANDLE, handle, ctypes.c_ubyte * size, return_ctypes=True)
            )

    def write(self, block: str, data: bytes) -> None:
        """Write the bytes of a block.

        Raises:
            LinkError: Not connected, no such symbol, or refused.
        """
        handle = self._handle(block)
        with _link_errors():
            self._plc.write(_VALUE_BY_HANDLE, handle, data, ctypes.c_ubyte * len(data))

    def close(self) -> None:
        """Close the connection; safe to call twice."""
        plc, self._plc = self._plc, None
        if plc is not None:
            with _link_errors():
                plc.close()

    def _handle(self, block: str) -> int:
        """Return the handle of a block."""
        if self._plc is None or block not in self._handles:
            state = "not connected" if self._plc is None else f"the PLC has no block '{block}'"
            raise LinkError(f"{self.address}: {state}")
        return self._handles[block]


@contextlib.contextmanager
def _link_errors(prefix: str = "") -> Iterator[None]:
    """Turn errors of the network and of pyads into `LinkError`."""
    import pyads

    try:
        yield
    except (pyads.ADSError, OSError, RuntimeError) as error:  # pyads raises RuntimeError, too
        raise LinkError(f"{prefix}{error}") from error
