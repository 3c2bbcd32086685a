"""Conversion of a topic's messages to numbers with time stamps."""

from __future__ import annotations

import re
from array import array
from collections.abc import Sequence
from dataclasses import dataclass, fields, is_dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import InvalidField, InvalidFile
from carosac_toolkit.base.file_limits import check_recording
from carosac_toolkit.interchange.bag import Bag

Nanoseconds = NDArray[np.int64]
STAMP_SOURCES = ("header", "receive")
_LENGTH_FIELDS = {
    "std_msgs/msg/Float64MultiArray": "data", "std_msgs/msg/Float32MultiArray": "data",
    "std_msgs/msg/Float64": "data", "std_msgs/msg/Float32": "data",
    "sensor_msgs/msg/JointState": "position",
}  # fmt: skip
_TENSION_FIELDS = {"sensor_msgs/msg/JointState": "effort"}
_RATE_FIELDS = {"sensor_msgs/msg/JointState": "velocity"}
_POSE_FIELDS = {
    "geometry_msgs/msg/PoseStamped": "pose",
    "geometry_msgs/msg/PoseWithCovarianceStamped": "pose.pose",
    "nav_msgs/msg/Odometry": "pose.pose", "geometry_msgs/msg/TransformStamped": "transform",
    "geometry_msgs/msg/Pose": "", "geometry_msgs/msg/Transform": "",
}  # fmt: skip
TF_TYPES = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
IMU_TYPE = "sensor_msgs/msg/Imu"
_ATTITUDE_FIELDS = {IMU_TYPE: "orientation", "geometry_msgs/msg/QuaternionStamped": "quaternion"}
POSE_TYPES = (*_POSE_FIELDS, *TF_TYPES)
LENGTH_TYPES = tuple(_LENGTH_FIELDS)
_CHANNEL_PATTERN = re.compile(r"(?P<topic>/?[^.\[\]]+)(?:\.(?P<field>[\w.]+))?")


@dataclass(frozen=True)
class TopicSamples:
    """Numbers of a topic, in order of their stamps.

    Attributes:
        topic: Its name and field, for people.
        time: Stamps since 1970 [ns], strictly increasing, shape (K,).
        value: Shape (K, columns).
        clock: ``header`` or ``receive``.
        behind: Median of the time of receipt after the header's stamp [s]; None without headers.
        repeated: Messages left out as they have the stamp of an earlier one.
        labels: Names of the columns, where the messages have them.
    """

    topic: str
    time: Nanoseconds
    value: Array
    clock: str
    behind: float | None
    repeated: int
    labels: tuple[str, ...] = ()


def numbers(
    bag: Bag, spec: str, option: str, *, stamps: str, names: Sequence[str] = ()
) -> TopicSamples:
    """Return the numbers of a topic.

    Args:
        bag: Bag of the topic.
        spec: ``/topic`` or ``/topic.field``; the field may be a number, a list of numbers, or a
            number in each message of a list, such as ``/winches.drives.length``.
        option: Option that named it.
        stamps: Preferred clock, `header` or `receive`.
        names: Columns to take of a topic with names (JointState), in this order.

    Raises:
        InvalidField: No such topic or field, or messages that do not go together.
    """
    topic, field = split_spec(spec, option)
    kind = bag.topic(topic, option).kind
    own = {"--tension": _TENSION_FIELDS, "--rates": _RATE_FIELDS}.get(option, {})
    path = field or own.get(kind) or _LENGTH_FIELDS.get(kind)
    samples, width = _Samples(bag.name), 0
    labels: tuple[str, ...] = ()
    for time, message in bag.messages(topic):
        if path is None:
            raise InvalidField(
                option, repr(spec), f"{topic}.FIELD, FIELD one of {numeric(message)}"
            )
        row = _row(_at(message, path, spec, option), spec, option)
        chosen, labels = _named(message, row, names, labels, spec, option)
        if len(samples) and len(chosen) != width:
            got = f"{len(chosen)} numbers in message {len(samples)} of {spec!r}, {width} before"
            raise InvalidField(option, got, "as many in each message")
        width = len(chosen)
        samples.add(time, _stamp(message), chosen)
    return samples.ordered(f"{topic}.{path}", stamps, labels)


def poses(bag: Bag, spec: str, *, stamps: str, frames: Sequence[str] = ()) -> TopicSamples:
    """Return positions and quaternions w x y z of a topic, shape (K, 7); ROS orders them x y z w.

    Args:
        bag: Bag of the topic.
        spec: ``/topic`` or ``/topic.field``.
        stamps: Preferred clock.
        frames: Parent and child frame, for a topic of many transforms (tf).

    Raises:
        InvalidField: No such topic or field or frames.
    """
    topic, field = split_spec(spec, "--pose")
    kind = bag.topic(topic, "--pose").kind
    if frames and kind not in TF_TYPES:
        raise InvalidField("--frames", " ".join(frames), f"nothing, as {topic} holds no transforms")
    samples = _Samples(bag.name)
    seen: set[tuple[str, str]] = set()
    for time, message in bag.messages(topic):
        parts = message.transforms if kind in TF_TYPES else [message]
        for part in parts:
            if kind in TF_TYPES:
                pair = (part.header.frame_id.lstrip("/"), part.child_frame_id.lstrip("/"))
                seen.add(pair)
                if list(pair) != [frame.lstrip("/") for frame in frames]:
                    continue
            path = (
                "transform"
                if kind in TF_TYPES
                else field
                if field is not None
                else _POSE_FIELDS.get(kind)
            )
            if path is None:
                allowed = f"{topic}.FIELD with the pose, or a topic of {', '.join(POSE_TYPES)}"
                raise InvalidField("--pose", repr(spec), allowed)
            samples.add(time, _stamp(part), _pose(_at(part, path, spec, "--pose"), spec))
    if not len(samples):
        pairs = ", ".join(" ".join(pair) for pair in sorted(seen))
        got = " ".join(frames) or "nothing"
        raise InvalidField("--frames", got, f"parent and child, one of: {pairs}")
    return samples.ordered(topic, stamps)


def inertial(bag: Bag, spec: str, *, stamps: str) -> TopicSamples:
    """Return angular rate [rad/s] and specific force [m/s^2] of ``sensor_msgs/Imu``, shape (K, 6).

    Its `linear_acceleration` is what an accelerometer reads: +g upwards at rest.
    """
    topic, field = split_spec(spec, "--imu")
    kind = bag.topic(topic, "--imu").kind
    if kind != IMU_TYPE or field:
        raise InvalidField("--imu", f"{spec!r}, {kind}", f"a topic of {IMU_TYPE}")
    samples = _Samples(bag.name)
    for time, message in bag.messages(topic):
        rate, force = message.angular_velocity, message.linear_acceleration
        row = [rate.x, rate.y, rate.z, force.x, force.y, force.z]
        samples.add(time, _stamp(message), row)
    return samples.ordered(topic, stamps)


def attitudes(bag: Bag, spec: str, *, stamps: str) -> TopicSamples:
    """Return quaternions w x y z of a topic, shape (K, 4); ROS orders them x y z w.

    Args:
        bag: Bag of the topic.
        spec: ``/topic`` or ``/topic.field``; of ``sensor_msgs/Imu`` the orientation.
        stamps: Preferred clock.

    Raises:
        InvalidField: No such topic or field, or one without a quaternion.
    """
    topic, field = split_spec(spec, "--attitude")
    kind = bag.topic(topic, "--attitude").kind
    path = field or _ATTITUDE_FIELDS.get(kind)
    samples = _Samples(bag.name)
    for time, message in bag.messages(topic):
        turn: Any = None if path is None else _at(message, path, spec, "--attitude")
        if not all(hasattr(turn, axis) for axis in "wxyz"):
            allowed = f"a topic of {', '.join(_ATTITUDE_FIELDS)}, or {topic}.FIELD of a quaternion"
            raise InvalidField("--attitude", f"{spec!r}, {kind}", allowed)
        if kind == IMU_TYPE and path == _ATTITUDE_FIELDS[IMU_TYPE] and not has_orientation(message):
            got = f"{spec!r}, without orientation (orientation_covariance[0] is -1)"
            raise InvalidField("--attitude", got, "a topic of a sensor that measures orientation")
        samples.add(time, _stamp(message), [turn.w, turn.x, turn.y, turn.z])
    return samples.ordered(f"{topic}.{path}", stamps)


def has_orientation(message: Any) -> bool:
    """Return whether a ``sensor_msgs/Imu`` claims an orientation; without one it says -1."""
    return float(message.orientation_covariance[0]) != -1.0


def split_spec(spec: str, option: str) -> tuple[str, str | None]:
    """Split ``/topic.field`` into topic and field."""
    match = _CHANNEL_PATTERN.fullmatch(spec)
    if match is None:
        raise InvalidField(option, repr(spec), "/topic or /topic.field")
    return match["topic"], match["field"]


def _at(message: Any, path: str, spec: str, option: str) -> Any:
    """Return the content of a field; of a list of messages, that of each."""
    content = message
    for part in filter(None, path.split(".")):
        if isinstance(content, list | tuple):
            content = [_at(entry, part, spec, option) for entry in content]
        elif hasattr(content, part) and is_dataclass(content):
            content = getattr(content, part)
        else:
            raise InvalidField(option, repr(spec), f"a field of the message: {_fields(content)}")
    return content


def _row(value: Any, spec: str, option: str) -> Array:
    """Return numbers as a row."""
    try:
        return np.atleast_1d(np.asarray(value, dtype=np.float64)).ravel()
    except (TypeError, ValueError) as error:
        got = f"{str(value)[:60]} in {spec!r}"
        raise InvalidField(option, got, "a field with a number, or with several") from error


def _fields(message: Any) -> str:
    names = [field.name for field in fields(message)] if is_dataclass(message) else []
    return ", ".join(name for name in names if not name.startswith("__")) or "it has none"


def numeric(message: Any, start: str = "") -> str:
    """List the fields of a message that hold numbers."""
    names = []
    for name in [field.name for field in fields(message)] if is_dataclass(message) else []:
        value = getattr(message, name)
        if name == "header" or name.startswith("__"):
            continue
        first = value[0] if isinstance(value, list) and value else value
        if is_dataclass(first):
            names.append(numeric(first, f"{start}{name}."))
        elif isinstance(value, int | float | np.ndarray) and not isinstance(value, bool):
            names.append(f"{start}{name}")
    return ", ".join(entry for entry in names if entry)


def _named(
    message: Any,
    row: Array,
    names: Sequence[str],
    labels: tuple[str, ...],
    spec: str,
    option: str,
) -> tuple[Array, tuple[str, ...]]:
    """Return columns by name, where the message has one for each; every message has the same."""
    own = getattr(message, "name", None)
    if not isinstance(own, list) or len(own) != len(row):
        return row, ()
    wanted = tuple(names) or labels or tuple(own)
    missing = [name for name in wanted if name not in own]
    if missing or len(set(own)) < len(own):
        got = f"{missing[0] if missing else 'a name twice'} in {spec}"
        raise InvalidField("--names" if names else option, got, f"names of it: {', '.join(own)}")
    return row[[own.index(name) for name in wanted]], wanted


def _pose(pose: Any, spec: str) -> list[float]:
    """Return position and quaternion w x y z of a Pose or Transform."""
    place = getattr(pose, "position", None) or getattr(pose, "translation", None)
    turn = getattr(pose, "orientation", None) or getattr(pose, "rotation", None)
    if place is None or turn is None:
        allowed = "a field with position and orientation, or translation and rotation"
        raise InvalidField("--pose", repr(spec), allowed)
    return [place.x, place.y, place.z, turn.w, turn.x, turn.y, turn.z]


def _stamp(message: Any) -> int | None:
    """Return the header's stamp [ns], or None if there is none or it was never set."""
    stamp = getattr(getattr(message, "header", None), "stamp", None)
    if stamp is None or (stamp.sec == 0 and stamp.nanosec == 0):
        return None
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


class _Samples:
    """Rows of numbers with their stamps, as compact as they will be."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._numbers = array("d")
        self._received = array("q")
        self._stamps = array("q")  # of the messages that have one

    def __len__(self) -> int:
        return len(self._received)

    def add(self, received: int, stamp: int | None, row: Sequence[float] | Array) -> None:
        """Add a message; refuse more numbers than a recording may have."""
        check_recording(self._name, len(self), len(row), len(self._numbers) + len(row))
        self._numbers.extend(row)
        self._received.append(received)
        if stamp is not None:
            self._stamps.append(stamp)

    def ordered(self, topic: str, stamps: str, labels: tuple[str, ...] = ()) -> TopicSamples:
        """Return samples in the order of one clock, each stamp once."""
        if not len(self._numbers):
            raise InvalidFile(self._name, [f"no numbers in the messages of {topic}"])
        received, known = np.array(self._received), np.array(self._stamps)
        complete = len(known) == len(received)
        clock = "header" if stamps == "header" and complete else "receive"
        behind = None
        if complete and len(known):
            behind = 1e-9 * float(np.median(received - known))
        time, first = np.unique(known if clock == "header" else received, return_index=True)
        rows = np.frombuffer(self._numbers).reshape(len(received), -1)
        repeated = len(received) - len(time)
        return TopicSamples(topic, time, rows[first], clock, behind, repeated, labels)
