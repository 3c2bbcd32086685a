"""Bags of ROS 1 and 2 and MCAP files: their topics and messages."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from carosac_toolkit.base.errors import (
    MALFORMED,
    CarosacError,
    InvalidField,
    InvalidFile,
    MissingFile,
    did_you_mean,
)
from carosac_toolkit.base.extras import require
from carosac_toolkit.interchange.bag_chunks import bound_decompression

_BAG_SUFFIXES = (".bag", ".mcap", ".db3")
_BAG_KINDS = "a .bag of ROS 1, the folder of a ROS 2 bag, or a single .mcap or .db3 file"


@dataclass(frozen=True)
class Topic:
    """Topic of a bag.

    Attributes:
        name: Such as ``/joint_states``.
        kind: Message type, such as ``sensor_msgs/msg/JointState``.
        count: Messages.
        rate: Messages per second over the whole bag [Hz], or None for fewer than two.
    """

    name: str
    kind: str
    count: int
    rate: float | None


class Bag:
    """Open bag; see `open_bag`.

    Attributes:
        paths: Its files.
        topics: By name.
        assumed: True if message types are those of ROS 2, as the bag does not define them.
    """

    def __init__(self, reader: Any, paths: Sequence[Path], assumed: bool) -> None:
        self.paths = tuple(paths)
        self.assumed = assumed
        self._reader = reader
        seconds = 1e-9 * (reader.end_time - reader.start_time) if reader.message_count else 0.0
        self.topics = {
            name: Topic(name, info.msgtype or "several types", info.msgcount, rate)
            for name, info in sorted(reader.topics.items())
            for rate in [(info.msgcount - 1) / seconds if info.msgcount > 1 and seconds else None]
        }

    @property
    def name(self) -> str:
        """Names of its files, for messages."""
        return ", ".join(path.name for path in self.paths)

    def topic(self, name: str, option: str) -> Topic:
        """Return the topic of a name.

        Raises:
            InvalidField: There is none, or it has no messages.
        """
        topic = self.topics.get(name)
        if topic is None:
            names = list(self.topics)
            allowed = f"a topic of the bag: {', '.join(names)}{did_you_mean(name, names)}"
            raise InvalidField(option, repr(name), allowed)
        if not topic.count:
            raise InvalidField(option, repr(name), "a topic with messages; this one has none")
        return topic

    def first(self, topic: str) -> Any:
        """Return the content of the first message of a topic, or None."""
        return next((message for _, message in self.messages(topic)), None)

    def messages(self, topic: str) -> Iterator[tuple[int, Any]]:
        """Yield time of receipt [ns] and content of a topic's messages, in order of receipt."""
        chosen = [c for c in self._reader.connections if c.topic == topic]
        with _our_errors(self.paths):
            for connection, time, raw in self._reader.messages(connections=chosen):
                yield time, self._reader.deserialize(raw, connection.msgtype)


@contextmanager
def open_bag(paths: Sequence[Path], *, definitions: Path | None = None) -> Iterator[Bag]:
    """Open a bag.

    Args:
        paths: One file or folder, or the parts of a ROS 1 bag.
        definitions: Folder with ``PACKAGE/msg/NAME.msg``, for bags without definitions.

    Raises:
        MissingFile: There is no such file.
        InvalidFile: No bag, or a damaged one.
        MissingExtra: The package `rosbags` is not installed.
    """
    _check(paths)
    bound_decompression()
    from rosbags.highlevel import AnyReader

    with _our_errors(paths):
        reader = AnyReader(list(paths))
        assumed = False
        try:
            reader.open()
        except Exception as error:
            if "no type definitions" not in str(error):
                raise
            assumed = True
            reader = AnyReader(list(paths), default_typestore=_known_types(definitions))
            reader.open()
        bag = Bag(reader, paths, assumed)
    try:
        yield bag
    finally:
        reader.close()


def _check(paths: Sequence[Path]) -> None:
    """Refuse a path that is no bag, before a library opens it."""
    require("reading bags", "rosbags")
    for path in paths:
        if not path.exists():
            raise MissingFile(path)
        if path.is_dir() and not (path / "metadata.yaml").exists():
            raise InvalidFile(path, [f"no metadata.yaml in this folder; allowed: {_BAG_KINDS}"])
        if path.is_file() and path.suffix.lower() not in _BAG_SUFFIXES:
            raise InvalidField("BAG", repr(str(path)), _BAG_KINDS)
    if len(paths) > 1 and any(path.suffix.lower() != ".bag" for path in paths):
        raise InvalidField("BAG", ", ".join(map(str, paths)), "one, or the parts of a ROS 1 bag")


def _known_types(definitions: Path | None) -> Any:
    """Return the message types of ROS 2, and those of a folder."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.LATEST)
    if definitions is None:
        return store
    files = sorted(definitions.glob("**/msg/*.msg")) if definitions.is_dir() else []
    if not files:
        allowed = "a folder with PACKAGE/msg/NAME.msg in it"
        raise InvalidField("--definitions", repr(str(definitions)), allowed)
    types: dict[str, Any] = {}
    for file in files:
        name = f"{file.parent.parent.name}/msg/{file.stem}"
        types.update(get_types_from_msg(file.read_text(encoding="utf-8"), name))
    store.register({name: kind for name, kind in types.items() if name not in store.fielddefs})
    return store


@contextmanager
def _our_errors(paths: Sequence[Path]) -> Iterator[None]:
    """Turn library errors on damaged files into one message."""
    import apsw
    from rosbags.highlevel import AnyReaderError
    from rosbags.rosbag1 import ReaderError as Error1
    from rosbags.rosbag2 import ReaderError as Error2
    from rosbags.serde import SerdeError
    from rosbags.typesys import TypesysError

    damaged = (
        AnyReaderError, Error1, Error2, SerdeError, TypesysError, apsw.Error, struct.error,
        OSError, EOFError, RuntimeError, AssertionError, MemoryError, *MALFORMED,
    )  # fmt: skip
    try:
        yield
    except CarosacError:
        raise
    except damaged as error:
        what = str(error) or type(error).__name__
        raise InvalidFile(", ".join(map(str, paths)), [f"not readable: {what}"]) from error
