"""The user behind a network peer on this machine, so that other users of it can be refused."""

from __future__ import annotations

import errno
import ipaddress
import os
import socket
import struct
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Literal

SOCKET_TABLES = Path("/proc/net")
ROOT_UID = 0
_LOCAL, _REMOTE, _UID, _INODE = 1, 2, 7, 9  # columns
_MAPPED = bytes(10) + b"\xff\xff"  # before an IPv4 address in IPv6

# linux/sock_diag.h and linux/inet_diag.h
_SOCK_DIAG, _BY_FAMILY, _REQUEST, _DUMP, _NETLINK_HEADER = 4, 20, 1, 0x301, 16
_ALL_STATES, _NO_COOKIE = 0xFFFFFFFF, 0xFFFFFFFFFFFFFFFF
_DIAG_MESSAGE = struct.Struct("=64xII")  # uid and inode
_ONLY_IPV6, _DONE = 11, 3  # a kind of attribute, and of message
_ANSWER_BYTES_MAX, _ANSWER_TIMEOUT_S = 65536, 0.1

Protocol = Literal["tcp", "udp"]
Address = tuple[str, int]
"""IP address and port."""


def is_loopback(host: str) -> bool:
    """Return whether only this machine can reach an address."""
    if host == "localhost":
        return True
    try:
        return _plain_ip(host).is_loopback
    except ValueError:
        return False


def socket_owner(protocol: Protocol, local: Address, remote: Address | None = None) -> int | None:
    """Return the uid of the process that owns a socket of this machine.

    A closed socket has no owner any more: the kernel then shows uid 0, which is not believed.

    Args:
        protocol: Protocol of the socket.
        local: Address to which it is bound; for a server this is the address of its peer. A UDP
            socket bound to all addresses matches as well, if it can send from this one.
        remote: Address to which it is connected, for TCP, where sockets of several users may share
            a local address. None for UDP.

    Returns:
        The uid; None if it cannot be known: the socket is closed or not on this machine, sockets
        of several users match, or the system is not Linux.
    """
    if sys.platform != "linux":
        return None
    if remote is not None and (answer := _ask_kernel(local, remote)) is not None:
        uid, inode = answer
        return uid if inode else None
    if protocol == "udp" and not _is_here(local[0]):
        return None
    wanted = _table_entries(local, protocol)
    remotes = remote and _table_entries(remote, protocol)
    owners = {}  # by inode
    for table in (SOCKET_TABLES / protocol, SOCKET_TABLES / f"{protocol}6"):
        lines = table.read_text().splitlines()[1:] if table.exists() else []
        for columns in map(str.split, lines):
            matches = not remotes or columns[_REMOTE] in remotes
            if matches and columns[_LOCAL] in wanted and columns[_INODE] != "0":
                owners[int(columns[_INODE])] = int(columns[_UID])
    if protocol == "udp" and len(set(owners.values())) > 1 and _plain_ip(local[0]).version == 4:
        for inode in _only_ipv6(local[1]):  # anybody may bind one beside a socket of IPv4
            owners.pop(inode, None)
    return next(iter(owners.values())) if len(set(owners.values())) == 1 else None


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


def _ask_kernel(local: Address, remote: Address) -> tuple[int, int] | None:
    """Return uid and inode of a TCP socket by netlink, 1000 times faster than from the table.

    Returns:
        Uid and inode, 0 if the socket is closed; None if there is no such socket, or no answer.
    """
    ends = [_plain_ip(local[0]), _plain_ip(remote[0])]
    family = socket.AF_INET if ends[0].version == 4 else socket.AF_INET6
    ports = struct.pack("!HH", local[1], remote[1])
    hosts = b"".join(end.packed.ljust(16, b"\0") for end in ends)
    for _, found in _messages(family, socket.IPPROTO_TCP, _REQUEST, ports + hosts):
        if len(found) >= _DIAG_MESSAGE.size and found[4:8] == ports:  # no error, and no listener
            uid, inode = _DIAG_MESSAGE.unpack_from(found)
            return uid, inode
    return None


def _only_ipv6(port: int) -> Iterator[int]:
    """Give the inodes of UDP sockets at a port that can neither send nor receive IPv4."""
    ends = struct.pack("!HH", port, 0) + bytes(32)
    for kind, found in _messages(socket.AF_INET6, socket.IPPROTO_UDP, _DUMP, ends):
        if kind != _BY_FAMILY or len(found) < _DIAG_MESSAGE.size:
            return
        _, inode = _DIAG_MESSAGE.unpack_from(found)
        place = _DIAG_MESSAGE.size
        while place + 4 < len(found):
            size, attribute = struct.unpack_from("=HH", found, place)
            if attribute == _ONLY_IPV6 and found[place + 4]:
                yield inode
            place += max(size + 3 & ~3, 4)


def _messages(family: int, protocol: int, flags: int, ends: bytes) -> Iterator[tuple[int, bytes]]:
    """Ask the kernel for sockets; give kinds and contents of its messages, none if it is silent."""
    query = struct.pack("=BBxxI", family, protocol, _ALL_STATES) + ends
    query += struct.pack("=IQ", 0, _NO_COOKIE)
    header = struct.pack("=IHHII", _NETLINK_HEADER + len(query), _BY_FAMILY, flags, 1, 0)
    try:
        with socket.socket(socket.AF_NETLINK, socket.SOCK_RAW, _SOCK_DIAG) as kernel:
            kernel.settimeout(_ANSWER_TIMEOUT_S)
            kernel.send(header + query)
            while True:
                answer = kernel.recv(_ANSWER_BYTES_MAX)
                while len(answer) >= _NETLINK_HEADER:
                    size, kind = struct.unpack_from("=IH", answer)
                    if kind == _DONE:
                        return
                    yield kind, answer[_NETLINK_HEADER:size]
                    answer = answer[max(size + 3 & ~3, _NETLINK_HEADER) :]
                if flags == _REQUEST:
                    return
    except OSError:
        return


def _is_here(host: str) -> bool:
    """Return whether an address is one of this machine, to which a socket can be bound."""
    ip = _plain_ip(host)
    try:
        with socket.socket(
            socket.AF_INET if ip.version == 4 else socket.AF_INET6, socket.SOCK_DGRAM
        ) as probe:
            probe.bind((str(ip), 0))
    except OSError as error:
        return error.errno != errno.EADDRNOTAVAIL
    return True


def _plain_ip(host: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address:
    """Return an IP address; an IPv4 address written as IPv6 becomes IPv4."""
    ip = ipaddress.ip_address(host)
    return getattr(ip, "ipv4_mapped", None) or ip


def _table_entries(address: Address, protocol: Protocol) -> set[str]:
    """Return the entries in the system's tables that stand for an address: IPv4, IPv6 and any."""
    ip = _plain_ip(address[0])
    hosts = [ip.packed, _MAPPED + ip.packed] if ip.version == 4 else [ip.packed]
    entries = {f"{_table_host(host)}:{address[1]:04X}" for host in hosts}
    if protocol == "udp":
        entries |= {f"{_table_host(bytes(size))}:{address[1]:04X}" for size in (4, 16)}
    return entries


def _table_host(packed: bytes) -> str:
    """Return an address as the tables write it: words of 32 bits in the machine's byte order."""
    words = (packed[i : i + 4] for i in range(0, len(packed), 4))
    return "".join(f"{int.from_bytes(word, sys.byteorder):08X}" for word in words)
