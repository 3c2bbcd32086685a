"""Metadata of a recording."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields

from carosac_toolkit.base.errors import InvalidField, did_you_mean

LENGTH_KINDS = ("unstrained", "relative")
FRAMES_TEXT = (
    "positions are of the platform frame's origin, in world frame W (z up); "
    "quaternions rotate from platform frame P to W; IMU channels are in the sensor's own frame"
)


@dataclass(frozen=True, kw_only=True)
class RecordingMetadata:
    """Provenance and conventions of a recording.

    Attributes:
        robot: Name of a bundled robot or path to a robot file, or None where it is unknown.
        description: Text for readers.
        source: Origin: rig, data set, file.
        licence: Terms of use.
        citation: Publication to cite.
        created_by: Program and version that wrote it.
        frames: The frames of all channels, in words.
        quaternion_order: Always ``wxyz``.
        length_kind: ``unstrained``: material from the datum to the anchor point [m];
            ``relative``: the same up to an unknown constant per cable.
        clock_offsets: Offsets of clocks that were removed from the stamps, in words; empty: none.
    """

    robot: str | None = None
    description: str = ""
    source: str = ""
    licence: str = ""
    citation: str = ""
    created_by: str = ""
    frames: str = FRAMES_TEXT
    quaternion_order: str = "wxyz"
    length_kind: str = "unstrained"
    clock_offsets: str = ""

    def __post_init__(self) -> None:
        """Refuse anything but text, and unknown conventions."""
        for field in fields(self):
            value = getattr(self, field.name)
            if not isinstance(value, str) and not (field.name == "robot" and value is None):
                raise InvalidField(f"metadata.{field.name}", repr(value), "text")
        if self.quaternion_order != "wxyz":
            raise InvalidField("metadata.quaternion_order", repr(self.quaternion_order), "'wxyz'")
        if self.length_kind not in LENGTH_KINDS:
            allowed = f"one of {list(LENGTH_KINDS)}"
            raise InvalidField("metadata.length_kind", repr(self.length_kind), allowed)

    def to_dict(self) -> dict[str, str | None]:
        """Return all fields, ready for JSON."""
        return asdict(self)

    @classmethod
    def from_dict(cls, record: object) -> RecordingMetadata:
        """Read what `to_dict` gave.

        Raises:
            InvalidField: No mapping, an unknown key or a value that is not allowed.
        """
        if not isinstance(record, Mapping):
            raise InvalidField("metadata", repr(record), "a mapping of names to text")
        names = [field.name for field in fields(cls)]
        for key in record:
            if key not in names:
                hint = did_you_mean(key, names)
                raise InvalidField(f"metadata.{key}", "an unknown key", f"one of {names}{hint}")
        return cls(**record)
