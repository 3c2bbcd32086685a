"""Robots and buffers on a Warp device, kept between calls so that a call costs microseconds."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Sequence
from functools import cache, wraps
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
import warp as wp
from numpy.typing import NDArray

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.physics import warp_setup
from carosac_toolkit.physics.device_kernels import Cable, StaticBody
from carosac_toolkit.physics.fleet import Fleet
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.robot.sizes import cable_size

LEVER_MIN = 5e-3  # of the length of a cable: the least lever arm that is calculated with
BUFFER_SETS_MAX = 12  # sets of buffers remembered per robot
KEPT_BATCH_MAX = 4096  # larger batches allocate anew: their solve takes far longer


@cache
def record_type(struct: Any) -> np.dtype[Any]:
    """Return the NumPy type of records of a Warp struct, which takes Warp long to find."""
    kind: np.dtype[Any] = np.dtype(struct.numpy_dtype())
    return kind


def _once(record: Callable[[Robot], NDArray[Any]]) -> Callable[[Robot], NDArray[Any]]:
    """Keep the record of each robot, read-only, as long as the robot lives."""
    known: WeakKeyDictionary[Robot, NDArray[Any]] = WeakKeyDictionary()

    @wraps(record)
    def kept(robot: Robot) -> NDArray[Any]:
        found = known.get(robot)
        if found is None:
            found = known[robot] = record(robot)
            found.flags.writeable = False
        return found

    return kept


@_once
def cable_records(robot: Robot) -> NDArray[Any]:
    """Return the cables of a robot as an array of `Cable` structs, shape (n,)."""
    records = np.zeros(robot.n, dtype=record_type(Cable))
    for name in (
        "exit_point", "swivel_axis", "anchor_point", "pulley_radius", "run_length",
        "weight_per_length", "axial_stiffness", "axial_damping", "exit_friction", "anchor_friction",
        "capstan_friction", "tension_min", "tension_max",
    ):  # fmt: skip
        records[name] = getattr(robot, f"{name}s" if name.endswith("point") else name)
    return records


@_once
def body_record(robot: Robot) -> NDArray[Any]:
    """Return the platform of a robot as one `StaticBody` struct, shape ()."""
    record = np.zeros((), dtype=record_type(StaticBody))
    record["weight"] = robot.weight
    record["center_of_mass"] = robot.center_of_mass
    record["arm"] = lever(robot)
    chords = robot.exit_points - robot.home_position - robot.anchor_points @ robot.home_rotation.T
    record["size"] = np.linalg.norm(chords, axis=1).mean()
    return record


def lever(robot: Robot) -> float:
    """Return the typical lever arm that makes moments comparable with forces [m]."""
    arms = np.vstack([robot.anchor_points, robot.center_of_mass[None]])
    return float(max(np.sqrt((arms**2).sum(axis=1).max()), LEVER_MIN * cable_size(robot)))


def upload_robots(robots: Sequence[Robot], device: str) -> tuple[wp.array, wp.array]:
    """Upload cables (B, n) and bodies (B,) of one robot per world; one robot serves a batch."""
    return (
        wp.array(stacked(cable_records, robots), dtype=Cable, device=device),
        wp.array(stacked(body_record, robots), dtype=StaticBody, device=device),
    )


def stacked(record: Callable[[Robot], NDArray[Any]], robots: Sequence[Robot]) -> NDArray[Any]:
    """Stack a record of each robot, made once where a robot occurs again."""
    different = {id(robot): robot for robot in robots}
    place = {key: row for row, key in enumerate(different)}
    records = np.stack([record(robot) for robot in different.values()])
    return np.asarray(records[[place[id(robot)] for robot in robots]])


class Buffers:
    """Named device arrays of one kernel, with its recorded launches.

    Hold `lock` from the first `put` to the last `get`: the arrays are shared by all callers.
    """

    def __init__(self, device: str, shapes: dict[str, tuple[Any, Any]]) -> None:
        """Allocate.

        Args:
            device: Warp device name.
            shapes: Shape and Warp type of each array, by name.
        """
        self.device = device
        self.lock = threading.Lock()
        self._arrays: dict[str, wp.array] = {
            name: wp.zeros(shape, dtype=kind, device=device)
            for name, (shape, kind) in shapes.items()
        }
        on_host = wp.get_device(device).is_cpu
        self._views = {k: v.numpy() for k, v in self._arrays.items()} if on_host else {}
        self._launches: dict[str, Any] = {}
        self.length_scale = 1.0  # typical cable length of the robot [m]

    def add(self, name: str, array: wp.array) -> None:
        """Add an existing array."""
        self._arrays[name] = array
        if wp.get_device(self.device).is_cpu:
            self._views[name] = array.numpy()

    def put(self, name: str, value: Array) -> None:
        """Copy numbers in."""
        if self._views:
            self._views[name][...] = value
        else:
            array = self._arrays[name]
            shape = (*array.shape, *getattr(array.dtype, "_shape_", ()))  # no copy to the host
            array.assign(np.broadcast_to(value, shape))

    def get(self, name: str) -> NDArray[Any]:
        """Copy numbers out."""
        if self._views:
            view: NDArray[Any] = self._views[name]
            return view.copy()
        copied: NDArray[Any] = self._arrays[name].numpy()
        return copied

    def launch(self, key: str, kernel: wp.Kernel, dim: int | tuple[int, ...], *args: Any) -> None:
        """Run a kernel: recorded at its first use, replayed afterwards.

        Args:
            key: Stands for kernel, size and arguments, which must not change between calls.
            kernel: The kernel.
            dim: Number of threads.
            args: Kernel arguments; a string names one of the buffers, and a type of struct is made
                of the buffers that are named as its fields, the others empty.
        """
        if key not in self._launches:
            inputs = [
                self._arrays[a] if isinstance(a, str) else self._struct(a) if callable(a) else a
                for a in args
            ]
            self._launches[key] = wp.launch(
                kernel, dim, inputs=inputs, device=self.device, record_cmd=True
            )
        self._launches[key].launch()

    def _struct(self, kind: Any) -> Any:
        """Make a struct of the buffers that are named as its fields."""
        made = kind()
        for name in self._arrays.keys() & kind.vars:
            setattr(made, name, self._arrays[name])
        return made


_uploads: WeakKeyDictionary[Robot | Fleet, dict[str, tuple[wp.array, wp.array]]] = (
    WeakKeyDictionary()
)
_buffers: WeakKeyDictionary[Robot | Fleet, OrderedDict[Any, Buffers]] = WeakKeyDictionary()
_lock = threading.Lock()


def check_call(robot: Robot | Fleet, device: str) -> None:
    """Refuse anything but a robot, and a device that does not exist.

    Raises:
        InvalidField: Names the argument.
    """
    if not isinstance(robot, Robot | Fleet):
        raise InvalidField("robot", repr(robot), "a Robot; load_robot(name or file) gives one")
    check_device(device)


def check_device(device: str) -> None:
    """Refuse a device that does not exist.

    Raises:
        InvalidField: Names those that are.
    """
    if device != "cpu":
        warp_setup.initialise()
        known = [str(one) for one in wp.get_devices()]
        if device not in [*known, "cuda"] or (device == "cuda" and len(known) < 2):
            none = "" if len(known) > 1 else "; no CUDA device was found"
            raise InvalidField("device", repr(device), f"one of {known}{none}")


def check_rows(robot: Robot | Fleet, name: str, size: int) -> None:
    """Refuse a batch of another size than the fleet.

    Raises:
        InvalidField: Names the argument whose rows they are.
    """
    if isinstance(robot, Fleet) and len(robot) not in (1, size):
        raise InvalidField(name, f"{size} rows", f"{len(robot)}, one for each robot of the fleet")


def device_robot(robot: Robot | Fleet, device: str) -> tuple[wp.array, wp.array]:
    """Return cables (R, n) and bodies (R,) on a device, uploaded once; one row for one robot."""
    warp_setup.initialise()
    with _lock:
        kept = _uploads.setdefault(robot, {})
        if device not in kept:
            kept[device] = upload_robots(robots_of(robot), device)
        return kept[device]


def robots_of(robot: Robot | Fleet) -> tuple[Robot, ...]:
    """Return the robots of a fleet, or the one robot."""
    return robot.robots if isinstance(robot, Fleet) else (robot,)


def kept_buffers(
    robot: Robot | Fleet, purpose: str, size: int, device: str, shapes: Callable[[], dict[str, Any]]
) -> Buffers:
    """Return buffers for a purpose and batch size; small ones are kept for the next call."""

    def make() -> Buffers:
        buffers = Buffers(device, shapes())
        buffers.length_scale = float(stacked(body_record, robots_of(robot))["size"].mean())
        return buffers

    if size > KEPT_BATCH_MAX:
        return make()
    with _lock:
        kept = _buffers.setdefault(robot, OrderedDict())
        key = (purpose, size, device)
        if key not in kept:
            kept[key] = make()
        kept.move_to_end(key)
        if len(kept) > BUFFER_SETS_MAX:
            kept.popitem(last=False)
        return kept[key]
