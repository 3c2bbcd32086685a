"""The user behind a network peer on this machine, so that other users of it can be refused."""

from __future__ import annotations

import ipaddress
import os
import sys
from pathlib import Path
from typing import Literal

SOCKET_TABLES = Path("/proc/net")
ROOT_UID = 0
_LOCAL, _REMOTE, _UID, _INODE = 1, 2, 7, 9  # columns
_MAPPED = bytes(10) + b"\xff\xff"  # before an IPv4 address in IPv6

Protocol = Literal["tcp", "udp"]
Address = tuple[str, int]
"""IP address and port."""


def is_loopback(host: str) -> bool:
    """Return whether only this machine can reach an address."""
    if host == "localhost":
        return True
    try:
        address = ipaddress.ip_address(host)
    except ValueError:
        return False
    return (getattr(address, "ipv4_mapped", None) or address).is_loopback


def socket_owner(protocol: Protocol, local: Address, remote: Address | None = None) -> int | None:
    """Return the uid of the process that owns a socket of this machine.

    A closed socket has no owner any more: the kernel then shows uid 0, which is not believed.

    Args:
        protocol: Protocol of the socket.
        local: Address to which it is bound; for a server this is the address of its peer. A UDP
            socket bound to all addresses matches as well.
        remote: Address to which it is connected, for TCP, where sockets of several users may share
            a local address. None for UDP.

    Returns:
        The uid; None if it cannot be known: the socket is closed or not on this machine, sockets
        of several users match, or the system is not Linux.
    """
    wanted = _table_entries(local, protocol)
    remotes = remote and _table_entries(remote, protocol)
    owners = set()
    for table in (SOCKET_TABLES / protocol, SOCKET_TABLES / f"{protocol}6"):
        lines = table.read_text().splitlines()[1:] if table.exists() else []
        for columns in map(str.split, lines):
            is_open = columns[_INODE] != "0"
            if (
                is_open
                and columns[_LOCAL] in wanted
                and (not remotes or columns[_REMOTE] in remotes)
            ):
                owners.add(int(columns[_UID]))
    return owners.pop() if len(owners) == 1 else None


def is_another_user(protocol: Protocol, local: Address, remote: Address | None = None) -> bool:
    """Return whether a peer is a process of another user of this machine, other than root.

    A loopback peer whose user cannot be known counts as another user on Linux: it may have closed
    its socket to hide. Elsewhere nobody can be told apart.

    Args:
        protocol: Protocol of its socket.
        local: Address of the peer.
        remote: Address of ours to which it is connected, for TCP.
    """
    owner = socket_owner(protocol, local, remote)
    if owner is None:
        return sys.platform == "linux" and is_loopback(local[0])
    return owner not in (ROOT_UID, os.geteuid())


def _table_entries(address: Address, protocol: Protocol) -> set[str]:
    """Return the entries in the system's tables that stand for an address: IPv4, IPv6 and any."""
    ip = ipaddress.ip_address(address[0])
    ip = getattr(ip, "ipv4_mapped", None) or ip
    hosts = [ip.packed, _MAPPED + ip.packed] if ip.version == 4 else [ip.packed]
    entries = {f"{_table_host(host)}:{address[1]:04X}" for host in hosts}
    if protocol == "udp":
        entries |= {f"{_table_host(bytes(size))}:{address[1]:04X}" for size in (4, 16)}
    return entries


def _table_host(packed: bytes) -> str:
    """Return an address as the tables write it: words of 32 bits in the machine's byte order."""
    words = (packed[i : i + 4] for i in range(0, len(packed), 4))
    return "".join(f"{int.from_bytes(word, sys.byteorder):08X}" for word in words)
