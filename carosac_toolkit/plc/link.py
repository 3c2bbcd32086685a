"""The seam between driver and wire: a link moves blocks of bytes to and from one PLC.

A link is found by the name of an entry point in the group ``carosac.links``, or as
``module:Class``; another wire is one class and nothing else. It knows no robot: heartbeat, session
and requests belong to `carosac_toolkit.plc.exchange`, the layout of the bytes to
`carosac_toolkit.plc.blocks`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

from carosac_toolkit.base.errors import CarosacError, InvalidField
from carosac_toolkit.loop import plugins
from carosac_toolkit.loop.plugin_builder import settings_of
from carosac_toolkit.robot.hardware import Hardware

LINK_METHODS = ("build", "connect", "has", "read", "write", "close")
LINK_ATTRIBUTES = ("address", "timeout")


class LinkError(CarosacError):
    """A call of a link that failed: no connection, no answer in time, or a refusal."""


class PlcLink(Protocol):
    """One connection to a PLC, over which whole blocks are read and written.

    Blocks go by the names in `carosac_toolkit.plc.blocks`: every PLC has `FROM_HOST`, which may be
    write-only, `TO_HOST` and `MACHINE`; `CONTROL`, `DIAGNOSIS` and `TRUTH` exist in an emulated
    one only. Their bytes pass unchanged. A block that is torn on its way is detected by its
    sequence numbers and discarded.

    Errors: every failure of the network, of its library or of the PLC is a `LinkError`. The
    exchange counts it, and after several in a row it calls `close` and then `connect`. Any other
    exception ends the exchange.

    Threads: the exchange makes all calls from one thread of its own; `address` and `timeout` may
    be read from any thread.

    An optional class attribute ``Settings`` names the dataclass of the settings, all with defaults.

    Attributes:
        address: Place of the PLC, for messages.
        timeout: Time after which `read` and `write` give up [s].
    """

    address: str
    timeout: float

    @classmethod
    def build(cls, hardware: Hardware, settings: Any = None) -> PlcLink:
        """Make a link; it connects later.

        Args:
            hardware: Section ``hardware`` of the robot file.
            settings: An instance of ``Settings``, or None if there is no such class.
        """

    def connect(self, *, writing: bool) -> None:
        """Open the connection anew and find the blocks.

        Args:
            writing: Whether `write` will be called; if not, `FROM_HOST` need not exist.

        Raises:
            LinkError: Nothing answers, or a block is missing; `close` is called next.
        """

    def has(self, block: str) -> bool:
        """Return whether the PLC had this block at the last `connect`."""

    def read(self, block: str, size: int) -> bytes:
        """Return the newest bytes of a block.

        Args:
            block: Name of the block.
            size: Its size [bytes].

        Raises:
            LinkError: Not connected, no such block, or no answer within `timeout`.
        """

    def write(self, block: str, data: bytes) -> None:
        """Replace the bytes of a block; return when the PLC has them or they are on their way.

        Raises:
            LinkError: Not connected, no such block, or refused.
        """

    def close(self) -> None:
        """Close the connection in whatever state it is; safe to call twice.

        Raises:
            LinkError: It did not close properly; it counts as closed all the same.
        """


def build_link(name: str, hardware: Hardware, settings: Mapping[str, Any]) -> PlcLink:
    """Make the link of this name.

    Args:
        name: Entry point in ``carosac.links``, or ``module:Class``.
        hardware: Section ``hardware`` of the robot file.
        settings: Settings of the link that differ from their defaults, by name.

    Raises:
        InvalidField: No such link, an incomplete one, or a setting that it does not have.
    """
    plugin = plugins.load("links", name)
    _refuse_missing(name, [x for x in LINK_METHODS if not callable(getattr(plugin, x, None))])
    chosen = settings_of(plugin, where="link_settings", asked=settings)
    link: PlcLink = plugin.build(hardware, chosen)
    _refuse_missing(name, [x for x in LINK_ATTRIBUTES if not hasattr(link, x)])
    return link


def _refuse_missing(name: str, missing: list[str]) -> None:
    """Refuse a plug-in that lacks members of `PlcLink`."""
    if missing:
        members = ", ".join(LINK_METHODS + LINK_ATTRIBUTES)
        allowed = f"a link, which has {members}; missing here: {', '.join(missing)}"
        raise InvalidField("link", repr(name), allowed)
