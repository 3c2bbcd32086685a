"""Variables of the emulated PLC: bytes by name, read and written as a whole."""

from __future__ import annotations

import threading

NOT_FOUND, WRONG_HANDLE, NO_ACCESS, WRONG_SIZE = 0x710, 0x703, 0x704, 0x705  # ADS return codes


class Refused(Exception):
    """A request that the PLC refuses, with its ADS return code."""

    def __init__(self, code: int) -> None:
        super().__init__(f"ADS code {code:#x}")
        self.code = code


class Symbols:
    """Named variables of fixed size; reads and writes are atomic."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._names: list[str] = []
        self._data: dict[str, bytes] = {}
        self._writable: set[str] = set()
        self._readable: set[str] = set()

    def add(self, name: str, size: int, *, writable: bool, readable: bool = True) -> None:
        """Declare a variable of zeros; names are not case-sensitive, as in a PLC.

        Args:
            name: Its name.
            size: [bytes].
            writable: Whether clients may write it.
            readable: Whether clients may read it.
        """
        self._names.append(name.lower())
        self._data[name.lower()] = bytes(size)
        if writable:
            self._writable.add(name.lower())
        if readable:
            self._readable.add(name.lower())

    def handle(self, name: str) -> int:
        """Return the handle of a variable, from 1.

        Raises:
            Refused: There is no such variable.
        """
        if name.lower() not in self._data:
            raise Refused(NOT_FOUND)
        return self._names.index(name.lower()) + 1

    def read(self, name: str) -> bytes:
        """Return the bytes of a variable."""
        with self._lock:
            return self._data[name.lower()]

    def write(self, name: str, data: bytes) -> None:
        """Set a variable, as the PLC program does."""
        with self._lock:
            assert len(data) == len(self._data[name.lower()])
            self._data[name.lower()] = data

    def read_handle(self, handle: int) -> bytes:
        """Return the bytes of a variable to a client.

        Raises:
            Refused: There is no such handle, or it is write only.
        """
        name = self._name(handle)
        if name not in self._readable:
            raise Refused(NO_ACCESS)
        return self.read(name)

    def write_handle(self, handle: int, data: bytes) -> None:
        """Set a variable for a client.

        Raises:
            Refused: There is no such handle, or it is read only, or of another size.
        """
        name = self._name(handle)
        if name not in self._writable:
            raise Refused(NO_ACCESS)
        if len(data) != len(self._data[name]):
            raise Refused(WRONG_SIZE)
        self.write(name, data)

    def _name(self, handle: int) -> str:
        """Return the name of the variable with this handle."""
        if not 1 <= handle <= len(self._names):
            raise Refused(WRONG_HANDLE)
        return self._names[handle - 1]
