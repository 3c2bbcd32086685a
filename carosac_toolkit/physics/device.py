"""Robots and buffers on a Warp device, kept between calls so that a call costs microseconds."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
import warp as wp
from numpy.typing import NDArray

from carosac_toolkit.arrays import Array
from carosac_toolkit.physics import warp_setup
from carosac_toolkit.physics.cable_kernels import Cable
from carosac_toolkit.physics.platform_kernels import Body
from carosac_toolkit.robot import Robot

KEPT = 8  # batch sizes remembered per robot and kernel


def cable_records(robot: Robot) -> NDArray[Any]:
    """The cables of a robot as an array of `Cable` structs, shape (n,)."""
    records = np.zeros(robot.n, dtype=Cable.numpy_dtype())
    for name in (
        "exit_point", "swivel_axis", "anchor_point", "pulley_radius", "run_length",
        "weight_per_length", "axial_stiffness", "tension_min", "tension_max",
    ):  # fmt: skip
        plural = f"{name}s" if name.endswith("point") else name
        records[name] = getattr(robot, plural)
    return records


def body_record(robot: Robot) -> NDArray[Any]:
    """The platform of a robot as one `Body` struct, shape ()."""
    record = np.zeros((), dtype=Body.numpy_dtype())
    record["weight"] = robot.weight
    record["center_of_mass"] = robot.center_of_mass
    record["arm"] = lever(robot)
    chords = robot.exit_points - robot.home_position - robot.anchor_points @ robot.home_rotation.T
    record["size"] = np.linalg.norm(chords, axis=1).mean()
    return record


def lever(robot: Robot) -> float:
    """Typical lever arm that makes moments comparable with forces [m]."""
    arms = np.vstack([robot.anchor_points, robot.center_of_mass[None]])
    return float(max(np.sqrt((arms**2).sum(axis=1).max()), 1e-2))


def upload_robots(robots: Sequence[Robot], device: str) -> tuple[wp.array, wp.array]:
    """Cables (B, n) and bodies (B,) of one robot per world; one robot serves a whole batch."""
    cables = np.stack([cable_records(robot) for robot in robots])
    bodies = np.stack([body_record(robot) for robot in robots])
    return (
        wp.array(cables, dtype=Cable, device=device),
        wp.array(bodies, dtype=Body, device=device),
    )


class Buffers:
    """Named device arrays of one kernel, with its recorded launch."""

    def __init__(self, device: str, arrays: dict[str, wp.array]) -> None:
        self.device = device
        self.arrays = arrays
        self.on_host = wp.get_device(device).is_cpu
        self._views = {k: v.numpy() for k, v in arrays.items()} if self.on_host else {}
        self.launches: dict[str, Any] = {}

    def put(self, name: str, value: Array) -> None:
        """Copy numbers in."""
        if self.on_host:
            self._views[name][...] = value
        else:
            self.arrays[name].assign(value)

    def get(self, name: str) -> NDArray[Any]:
        """Copy numbers out."""
        if self.on_host:
            return self._views[name].copy()
        return self.arrays[name].numpy()  # type: ignore[no-any-return]

    def launch(self, key: str, kernel: wp.Kernel, dim: int | tuple[int, ...], *args: Any) -> None:
        """Run a kernel: recorded at its first use, replayed afterwards. `key` fixes the args."""
        if key not in self.launches:
            inputs = [self.arrays[a] if isinstance(a, str) else a for a in args]
            self.launches[key] = wp.launch(
                kernel, dim, inputs=inputs, device=self.device, record_cmd=True
            )
        self.launches[key].launch()


_robots: WeakKeyDictionary[Robot, dict[Any, Any]] = WeakKeyDictionary()


def device_robot(robot: Robot, device: str) -> tuple[wp.array, wp.array]:
    """Cables (1, n) and body (1,) of a robot on a device, uploaded once."""
    warp_setup.initialise()
    kept = _robots.setdefault(robot, {})
    key = ("robot", device)
    if key not in kept:
        kept[key] = upload_robots([robot], device)
    cables, bodies = kept[key]
    return cables, bodies


def kept_buffers(robot: Robot, key: tuple[Any, ...], make: Callable[[], Buffers]) -> Buffers:
    """Buffers for a robot and a key, made at first use; the oldest go when there are too many."""
    kept = _robots.setdefault(robot, {})
    if key not in kept:
        same = [other for other in kept if other[0] == key[0]]
        if len(same) >= KEPT:
            del kept[same[0]]
        kept[key] = make()
    buffers: Buffers = kept[key]
    return buffers
