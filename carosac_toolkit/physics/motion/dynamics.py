r"""Dynamics of a rigid platform on cables without nodes: catenaries or straight springs.

The platform obeys Newton and Euler about its centre of mass; each cable pulls as a quasi-static
elastic catenary between its winch and the moving anchor point, with axial damping, and a third of
its mass moves with the anchor point. ``straight`` cables have neither weight nor mass. Time goes by
implicit steps of second order (`body_kernels`).

The fast model of the simulator and the dynamic estimator are this one piece of code.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import warp as wp
from numpy.typing import NDArray

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.physics import warp_setup
from carosac_toolkit.physics.cable import hanging_kernels
from carosac_toolkit.physics.cable.catenary_kernels import vec6d
from carosac_toolkit.physics.motion import dynamics_kernels, world_kernels
from carosac_toolkit.physics.motion.friction_kernels import Bristles
from carosac_toolkit.physics.rest.statics import Equilibrium

NodelessCables = Literal["catenary", "straight"]


@dataclass(frozen=True, kw_only=True, eq=False)
class Placement:
    """K poses at which worlds start, with their n cables there.

    Attributes:
        position: Platform origin in W [m], shape (K, 3).
        rotation: From P to W, shape (K, 3, 3).
        unstrained_length: [m], shape (K, n).
        tension: At the platform [N], shape (K, n).
        exit_tension: Tension vector at the exit [N], shape (K, n, 3).
        at_rest: True if these are equilibria.
        sliding: Twist along which platforms moved last, shape (K, 6); None: that of the start.
    """

    position: Array
    rotation: Array
    unstrained_length: Array
    tension: Array
    exit_tension: Array
    at_rest: bool
    sliding: Array | None = None

    @classmethod
    def of(cls, rest: Equilibrium, rows: NDArray[np.bool_] | None = None) -> Placement:
        """Return some equilibria, or all of them."""
        keep = slice(None) if rows is None else rows
        return cls(
            position=rest.position[keep],
            rotation=rest.rotation[keep],
            unstrained_length=rest.unstrained_length[keep],
            tension=rest.tension[keep],
            exit_tension=rest.exit_tension[keep],
            at_rest=True,
        )


def place_worlds(
    plants: Any,
    worlds: Any,
    which: NDArray[np.int32],
    start: Placement,
    twist: Array,
    device: str,
) -> wp.array:
    """Put worlds where they start with a twist, winches at rest.

    Args:
        plants: `Plants` struct.
        worlds: `Worlds` struct.
        which: Worlds, shape (K,).
        start: K poses.
        twist: At the platform origin in W, linear first, shape (K, 6).
        device: Warp device.

    Returns:
        `which` on the device.
    """
    warp_setup.load(world_kernels, device)
    rows = wp.array(which, dtype=int, device=device)
    inputs = [
        plants, worlds, rows,
        wp.array(start.position, dtype=wp.vec3d, device=device),
        wp.array(start.rotation, dtype=wp.mat33d, device=device),
        wp.array(twist, dtype=vec6d, device=device),
        wp.array(twist if start.sliding is None else start.sliding, dtype=vec6d, device=device),
        wp.array(start.unstrained_length, dtype=wp.float64, device=device),
        wp.array(start.tension, dtype=wp.float64, device=device),
    ]  # fmt: skip
    wp.launch(world_kernels.place, len(which), inputs=inputs, device=device)
    return rows


class Advance:
    """Launches of an ``advance`` kernel, recorded at the first use, replayed afterwards."""

    def __init__(
        self, kernel: wp.Kernel, threads: int, before: list[Any], after: list[Any], device: str
    ) -> None:
        """Prepare.

        Args:
            kernel: Its arguments are `before`, whether to follow, count, step, `after`.
            threads: Of a launch.
            before: First arguments.
            after: Last arguments.
            device: Warp device.
        """
        self._kernel, self._threads, self._device = kernel, threads, device
        self._before, self._after = before, after
        self._launches: dict[int, Any] = {}

    def __call__(self, follow: bool, count: int, h: float) -> None:
        """Advance all worlds by `count` time steps of h [s] towards the commands of `Worlds`.

        Args:
            follow: True if the lengths go straight to the command, without winches.
            count: Time steps.
            h: Size of each [s].
        """
        key = int(follow)
        if key not in self._launches:
            self._launches[key] = wp.launch(
                self._kernel, self._threads, inputs=[*self._before, key, count, h, *self._after],
                device=self._device, record_cmd=True,
            )  # fmt: skip
        launch = self._launches[key]
        launch.set_param_at_index(len(self._before) + 1, count)
        launch.set_param_at_index(len(self._before) + 2, h)
        launch.launch()


class NodelessDynamics:
    """B worlds with cables that have no nodes. See `carosac_toolkit.physics.motion.worlds`.

    Attributes:
        hung: `Hung` struct.
    """

    def __init__(
        self,
        plants: Any,
        worlds: Any,
        size: int,
        n: int,
        device: str,
        cables: NodelessCables,
    ) -> None:
        """Allocate; `place` comes before `advance`.

        Args:
            plants: `Plants` struct.
            worlds: `Worlds` struct.
            size: Number of worlds B.
            n: Cables of each.
            device: Warp device.
            cables: The model.
        """
        warp_setup.load(dynamics_kernels, device)
        self._plants = plants
        self._worlds = worlds
        self._device = device
        self._model = ("catenary", "straight").index(cables)
        hung = dynamics_kernels.Hung()
        hung.q = wp.zeros((size, n), dtype=wp.vec3d, device=device)
        hung.inverse = wp.zeros((size, n), dtype=wp.mat33d, device=device)
        hung.tension = wp.zeros((size, n), dtype=wp.float64, device=device)
        hung.bristles = wp.zeros((size, n), dtype=Bristles, device=device)
        self.hung = hung
        before = [plants, worlds, hung, self._model]
        self.advance = Advance(dynamics_kernels.advance, size, before, [], device)

    @property
    def arrays(self) -> dict[str, wp.array]:
        """Arrays that a world needs to continue, beside its `Worlds`."""
        return {"q": self.hung.q}

    def place(self, which: NDArray[np.int32], start: Placement, twist: Array) -> None:
        """Put worlds where they start with a twist; see `place_worlds`."""
        rows = place_worlds(self._plants, self._worlds, which, start, twist, self._device)
        q = wp.array(start.exit_tension, dtype=wp.vec3d, device=self._device)
        wp.launch(
            dynamics_kernels.place_hung, len(which), inputs=[rows, q, self.hung],
            device=self._device,
        )  # fmt: skip

    def points(self, segments: int) -> wp.array:
        """Return points on the cables, ends included, shape (B, n, segments + 1) of vectors."""
        shape = self._worlds.tension.shape
        points = wp.zeros((*shape, segments + 1), dtype=wp.vec3d, device=self._device)
        if self._model == 0:
            warp_setup.load(hanging_kernels, self._device)
            kernel = hanging_kernels.cable_points
            inputs = [self._plants.cables, self._worlds.unstrained_length, self.hung.q, points]
        else:
            kernel = dynamics_kernels.straight_points
            inputs = [self._plants, self._worlds, points]
        wp.launch(kernel, shape, inputs=inputs, device=self._device)
        return points
