"""Snapshots of a simulator, in memory and in files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from carosac_toolkit.base.npz import read_npz, write_npz


@dataclass(frozen=True, kw_only=True, eq=False)
class Snapshot:
    """Copy of everything in a simulator that changes.

    Attributes:
        cables: Model of the cables.
        segments: Segments of a cable.
        arrays: Copies of the device arrays, by name.
    """

    cables: str
    segments: int
    arrays: dict[str, NDArray[Any]]

    def to_npz(self, path: str | Path) -> None:
        """Write one ``.npz`` file, readable with numpy alone."""
        header = {"cables": self.cables, "segments": self.segments}
        write_npz(path, "__header__", header, self.arrays)

    @classmethod
    def from_npz(cls, path: str | Path) -> Snapshot:
        """Read a file of `to_npz`.

        Raises:
            MissingFile: There is no such file.
            InvalidField: The file was not written by `to_npz`.
        """
        return read_npz(
            path, "__header__", "Snapshot.to_npz",
            lambda header, arrays: cls(
                cables=str(header["cables"]), segments=int(header["segments"]), arrays=arrays
            ),
        )  # fmt: skip
