"""Variables of the emulated PLC: bytes by name, read and written as a whole."""

from __future__ import annotations

import threading
from typing import ClassVar


class Symbols:
    """Named variables of fixed size; reads and writes are atomic."""

    NOT_FOUND: ClassVar[int] = 0x710
    WRONG_HANDLE: ClassVar[int] = 0x703
    NO_ACCESS: ClassVar[int] = 0x704
    WRONG_SIZE: ClassVar[int] = 0x705

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._names: list[str] = []
        self._data: dict[str, bytes] = {}
        self._writable: set[str] = set()

    def add(self, name: str, size: int, *, writable: bool) -> None:
        """Declare a variable of zeros; names are not case-sensitive, as in a PLC."""
        self._names.append(name.lower())
        self._data[name.lower()] = bytes(size)
        if writable:
            self._writable.add(name.lower())

    def handle(self, name: str) -> int | None:
        """Return the handle of a variable, from 1; None if there is none."""
        key = name.lower()
        return self._names.index(key) + 1 if key in self._data else None

    def read(self, name: str) -> bytes:
        """Return the bytes of a variable."""
        with self._lock:
            return self._data[name.lower()]

    def write(self, name: str, data: bytes) -> None:
        """Set a variable, as the PLC program does."""
        with self._lock:
            assert len(data) == len(self._data[name.lower()])
            self._data[name.lower()] = data

    def read_handle(self, handle: int) -> bytes | int:
        """Return the bytes that a client reads, or an ADS return code."""
        if not 1 <= handle <= len(self._names):
            return self.WRONG_HANDLE
        return self.read(self._names[handle - 1])

    def write_handle(self, handle: int, data: bytes) -> int:
        """Set the bytes that a client writes; return the ADS return code, 0 for success."""
        if not 1 <= handle <= len(self._names):
            return self.WRONG_HANDLE
        name = self._names[handle - 1]
        if name not in self._writable:
            return self.NO_ACCESS
        if len(data) != len(self._data[name]):
            return self.WRONG_SIZE
        self.write(name, data)
        return 0
