"""The state of a simulator: views of its device arrays, and copies of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from carosac_toolkit.base.arrays import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class SimulatorState:
    """Copies of the state of B worlds of n cables.

    Attributes:
        time: Since the last reset of that world [s], shape (B,).
        position: Platform origin in W [m], shape (B, 3).
        rotation: Rotation from P to W, shape (B, 3, 3).
        twist: Linear [m/s], then angular velocity [rad/s] of the platform origin in W, (B, 6).
        acceleration: Linear [m/s^2], then angular acceleration [rad/s^2] of it, in W, (B, 6).
        unstrained_length: Wound, datum to anchor, at zero tension [m], shape (B, n).
        wound_length: What the drums have turned for [m], shape (B, n): the same, but for the
            hysteresis of the winches.
        tension: At the platform [N], shape (B, n).
        particles: Nodes of the cables from the first below the exit to the last above the
            platform in W [m], shape (B, n, segments - 1, 3); None for cables without nodes.
        iterations: Most Newton steps that a time step of the last call took, shape (B,).
        capped: Time steps of the last call that ended at the limit of Newton steps, shape (B,).
        residual: Largest last Newton step of the platform in the last call [m], shape (B,): its
            translation plus its rotation times a typical arm.
        failed: True for worlds that stand still since a time step had no finite solution, until
            `reset`, shape (B,).
    """

    time: Array
    position: Array
    rotation: Array
    twist: Array
    acceleration: Array
    unstrained_length: Array
    wound_length: Array
    tension: Array
    particles: Array | None
    iterations: NDArray[np.int32]
    capped: NDArray[np.int32]
    residual: Array
    failed: NDArray[np.bool_]


class StateViews:
    """Device arrays of a simulator, which change as it steps; names as in `SimulatorState`.

    Warp arrays of vectors and matrices: ``position`` has shape (B,) of ``wp.vec3d``, and so on.
    Read-only by convention: `Simulator.reset` and `Simulator.restore` write them.
    """

    time: wp.array
    position: wp.array
    rotation: wp.array
    twist: wp.array
    acceleration: wp.array
    unstrained_length: wp.array
    wound_length: wp.array
    tension: wp.array
    particles: wp.array | None
    iterations: wp.array
    capped: wp.array
    residual: wp.array
    failed: wp.array

    def __init__(self, worlds: Any, particles: wp.array | None) -> None:
        """View the arrays of a `Worlds` struct."""
        self._cached: dict[str, NDArray[Any]] | None = None
        for name in SimulatorState.__dataclass_fields__:
            if name != "particles":
                setattr(self, name, getattr(worlds, name))
        self.particles = particles

    def numpy(self) -> SimulatorState:
        """Copy the state to numpy arrays."""
        host = self._host_arrays()
        values: dict[str, Any] = {name: np.array(view) for name, view in host.items()}
        values["failed"] = values["failed"] != 0
        values.setdefault("particles", None)
        return SimulatorState(**values)

    def _host_arrays(self) -> dict[str, NDArray[Any]]:
        """Return the arrays by name in numpy; on the CPU these share the memory and are cached."""
        if self._cached is not None:
            return self._cached
        arrays = {name: getattr(self, name) for name in SimulatorState.__dataclass_fields__}
        host = {name: array.numpy() for name, array in arrays.items() if array is not None}
        if self.time.device.is_cpu:
            self._cached = host
        return host
