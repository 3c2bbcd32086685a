"""Bags for tests, written with the writers of rosbags; numbers are exact in float64."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

START = 1_700_000_000_123_456_789  # [ns] since 1970
KINDS = ("ros1", "sqlite3", "mcap")
WINCHES = "std_msgs/Header header\nDrive[] drives\nfloat64 supply\n"
TRANSFORMS = "geometry_msgs/TransformStamped[] transforms\n"
DRIVE = "string label\nfloat64 length\nfloat64 force\n"
Message = tuple[str, str, int, Any]  # topic, type, receipt [ns], message


class Bags:
    """Makes messages and writes them as one kind of bag."""

    def __init__(self, kind: str) -> None:
        self.kind = kind
        store = Stores.ROS1_NOETIC if kind == "ros1" else Stores.ROS2_HUMBLE
        self.store = get_typestore(store)
        own = get_types_from_msg(WINCHES, "lab_msgs/msg/Winches")
        own.update(get_types_from_msg(DRIVE, "lab_msgs/msg/Drive"))
        if kind == "ros1":
            own.update(get_types_from_msg(TRANSFORMS, "tf2_msgs/msg/TFMessage"))
        self.store.register(own)

    def make(self, kind: str, **values: Any) -> Any:
        return self.store.types[kind](**values)

    def header(self, time: int, frame: str = "world") -> Any:
        seconds, rest = divmod(time, 10**9)
        stamp = self.make("builtin_interfaces/msg/Time", sec=seconds, nanosec=rest)
        extra = {"seq": 0} if self.kind == "ros1" else {}
        return self.make("std_msgs/msg/Header", stamp=stamp, frame_id=frame, **extra)

    def joints(self, time: int, names: Sequence[str], position: Sequence[float]) -> Any:
        zero = np.zeros(len(names))
        return self.make(
            "sensor_msgs/msg/JointState", header=self.header(time), name=list(names),
            position=np.array(position), velocity=zero + 0.25, effort=zero + 50.0,
        )  # fmt: skip

    def array(self, values: Sequence[float]) -> Any:
        layout = self.make("std_msgs/msg/MultiArrayLayout", dim=[], data_offset=0)
        return self.make("std_msgs/msg/Float64MultiArray", layout=layout, data=np.array(values))

    def number(self, value: float) -> Any:
        return self.make("std_msgs/msg/Float64", data=value)

    def vector(self, values: Sequence[float], kind: str = "Vector3") -> Any:
        return self.make(f"geometry_msgs/msg/{kind}", **dict(zip("xyz", values, strict=True)))

    def quaternion(self, wxyz: Sequence[float]) -> Any:
        return self.make("geometry_msgs/msg/Quaternion", **dict(zip("wxyz", wxyz, strict=True)))

    def pose(self, time: int, position: Sequence[float], wxyz: Sequence[float]) -> Any:
        inner = self.make(
            "geometry_msgs/msg/Pose",
            position=self.vector(position, "Point"), orientation=self.quaternion(wxyz),
        )  # fmt: skip
        return self.make("geometry_msgs/msg/PoseStamped", header=self.header(time), pose=inner)

    def transforms(
        self, time: int, frames: Sequence[tuple[str, str]], position: Any, wxyz: Any
    ) -> Any:
        made = [
            self.make(
                "geometry_msgs/msg/TransformStamped",
                header=self.header(time, parent), child_frame_id=child,
                transform=self.make(
                    "geometry_msgs/msg/Transform", translation=self.vector(position),
                    rotation=self.quaternion(wxyz),
                ),
            )
            for parent, child in frames
        ]  # fmt: skip
        return self.make("tf2_msgs/msg/TFMessage", transforms=made)

    def imu(
        self, time: int, rate: Sequence[float], force: Sequence[float], *, oriented: bool = True
    ) -> Any:
        nothing = np.zeros(9)
        spread = nothing if oriented else np.append(-1.0, nothing[1:])
        return self.make(
            "sensor_msgs/msg/Imu", header=self.header(time),
            orientation=self.quaternion([1, 0, 0, 0]), orientation_covariance=spread,
            angular_velocity=self.vector(rate),
            angular_velocity_covariance=nothing, linear_acceleration=self.vector(force),
            linear_acceleration_covariance=nothing,
        )  # fmt: skip

    def winches(self, time: int, lengths: Sequence[float]) -> Any:
        drives = [
            self.make("lab_msgs/msg/Drive", label=f"d{i}", length=length, force=100.0 + i)
            for i, length in enumerate(lengths)
        ]
        return self.make(
            "lab_msgs/msg/Winches", header=self.header(time), drives=drives, supply=48.0
        )

    def write(self, folder: Path, messages: Sequence[Message]) -> Path:
        """Write a bag; returns what a user would name."""
        if self.kind == "ros1":
            path = folder / "run.bag"
            writer: Any = Writer1(path)
        else:
            path = folder / f"run_{self.kind}"
            plugin = StoragePlugin.MCAP if self.kind == "mcap" else StoragePlugin.SQLITE3
            writer = Writer2(path, version=9, storage_plugin=plugin)
        with writer:
            kinds = {topic: kind for topic, kind, _, _ in messages}
            links = {
                topic: writer.add_connection(topic, kind, typestore=self.store)
                for topic, kind in kinds.items()
            }
            for topic, kind, time, message in messages:
                pack = (
                    self.store.serialize_ros1 if self.kind == "ros1" else self.store.serialize_cdr
                )
                writer.write(links[topic], time, pack(message, kind))
        return path
