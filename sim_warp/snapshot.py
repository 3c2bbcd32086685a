"""What a simulator saves and restores."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from carosac_toolkit.errors import InvalidField, MissingFile


@dataclass(frozen=True, kw_only=True, eq=False)
class Snapshot:
    """Everything in a simulator that changes.

    Attributes:
        cables: Model of the cables.
        segments: Segments of a cable.
        arrays: Copies of the device arrays, by name.
    """

    cables: str
    segments: int
    arrays: dict[str, NDArray[Any]]

    def to_npz(self, path: str | Path) -> None:
        """Write to one ``.npz`` file, readable with numpy alone."""
        target = Path(path)
        if not target.parent.is_dir():
            raise MissingFile(target.parent, "the folder must exist")
        header = json.dumps({"cables": self.cables, "segments": self.segments})
        temporary = target.with_name(target.name + ".part")
        with temporary.open("wb") as stream:
            np.savez(stream, allow_pickle=False, __header__=np.array(header), **self.arrays)
        temporary.replace(target)

    @classmethod
    def from_npz(cls, path: str | Path) -> Snapshot:
        """Read what `to_npz` wrote.

        Raises:
            MissingFile: There is no such file.
            InvalidField: The file was not written by `to_npz`.
        """
        if not Path(path).is_file():
            raise MissingFile(path)
        try:
            with np.load(path, allow_pickle=False) as data:
                header = json.loads(str(data["__header__"]))
                arrays = {k: data[k] for k in data.files if k != "__header__"}
            return cls(cables=header["cables"], segments=header["segments"], arrays=arrays)
        except (ValueError, KeyError, OSError, EOFError, BadZipFile) as error:
            raise InvalidField("path", path, "a file written by Snapshot.to_npz") from error
