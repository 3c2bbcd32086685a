"""Worlds whose cables are chains of particles: arrays and launches of their kernels."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.physics import warp_setup
from carosac_toolkit.physics.motion.dynamics import Advance, Placement, place_worlds
from carosac_toolkit.physics.motion.friction_kernels import Bristles
from sim_warp import chain_start_kernels, particle_kernels, xpbd_kernels

CHAIN_GAP_MAX = 1e-9  # of the shortest cable: a larger gap to an anchor point is no closed chain


class ParticleDynamics:
    """B worlds of cables with N segments each, advanced by implicit steps or by XPBD."""

    def __init__(
        self,
        plants: Any,
        worlds: Any,
        size: int,
        n: int,
        device: str,
        segments: int,
        xpbd_iterations: int | None = None,
    ) -> None:
        """Allocate; `place` comes before `advance`.

        Args:
            plants: `Plants` struct.
            worlds: `Worlds` struct.
            size: Number of worlds B.
            n: Cables of each.
            device: Warp device.
            segments: Segments N of a cable.
            xpbd_iterations: Passes over all segments in a time step of position-based dynamics;
                None takes implicit steps (`particle_kernels`).
        """
        warp_setup.load(particle_kernels, device)
        self._plants = plants
        self._worlds = worlds
        self._device = device
        self.chains = self._allocate(size, n, segments)
        before = [plants, worlds, self.chains]
        if xpbd_iterations is not None:
            warp_setup.load(xpbd_kernels, device)
            before.append(xpbd_iterations)
            self.advance = Advance(xpbd_kernels.advance, size, before, [], device)
            return
        # On a GPU each cable has a thread of its own, in powers of two that make up a warp.
        lanes = 1 if wp.get_device(device).is_cpu else min(32, 1 << (n - 1).bit_length())
        self.advance = Advance(particle_kernels.advance, size * lanes, before, [lanes], device)

    def _allocate(self, size: int, n: int, segments: int) -> Any:
        """Allocate the `Chains` struct; worlds that are computed in turn share their scratch."""
        rows = 1 if wp.get_device(self._device).is_cpu else size
        out = particle_kernels.Chains()
        nodes, scratch = (size, n, segments - 1), (rows, n, segments)
        for name, shape, kind in (
            ("position", nodes, wp.vec3d), ("velocity", nodes, wp.vec3d),
            ("rate", nodes, wp.vec3d), ("predicted", (size, n, segments), wp.float64),
            ("slack", (size, n, segments), wp.uint8),
            ("arc", (size, n), wp.float64), ("trial", scratch, wp.vec3d),
            ("coupling", scratch, wp.mat33d), ("shift", scratch, wp.vec3d),
            ("tension_gradient", scratch, wp.vec3d), ("trial_tension", scratch, wp.float64),
            ("end_load", (rows, n), wp.vec3d), ("end_unit", (rows, n), wp.vec3d),
            ("bristles", (rows, n), Bristles),
        ):  # fmt: skip
            setattr(out, name, wp.zeros(shape, dtype=kind, device=self._device))
        out.segments = segments
        return out

    @property
    def arrays(self) -> dict[str, wp.array]:
        """State of the chains by name, beside that in `Worlds`."""
        names = ("position", "velocity", "rate", "predicted", "slack", "arc")
        return {name: getattr(self.chains, name) for name in names}

    def place(self, which: NDArray[np.int32], start: Placement, twist: Array) -> None:
        """Place worlds in the equilibrium of their chains that is next to a continuous one.

        Worlds that do not start at rest keep their pose; their chains hang as if it stood still.

        Raises:
            InvalidField: A chain that does not start at rest does not reach its anchor point.
        """
        warp_setup.load(chain_start_kernels, self._device)
        device = self._device
        rows = wp.array(which, dtype=int, device=device)
        position = wp.array(start.position, dtype=wp.vec3d, device=device)
        rotation = wp.array(start.rotation, dtype=wp.mat33d, device=device)
        q = wp.array(start.exit_tension, dtype=wp.vec3d, device=device)
        tension = wp.array(start.tension, dtype=wp.float64, device=device)
        gap = wp.zeros(len(which), dtype=wp.float64, device=device)
        length = wp.array(start.unstrained_length, dtype=wp.float64, device=device)
        wp.launch(
            chain_start_kernels.settle_chains, len(which),
            inputs=[self._plants, self.chains, rows, position, rotation, length, q, tension,
                    int(start.at_rest), gap],
            device=device,
        )  # fmt: skip
        open_rows = np.flatnonzero(~(gap.numpy() <= CHAIN_GAP_MAX * start.unstrained_length.min(1)))
        if len(open_rows) and not start.at_rest:
            k = int(open_rows[0])
            allowed = "lengths at which its cables hang between exit and anchor points"
            raise InvalidField(f"unstrained_length[{k}]", start.unstrained_length[k], allowed)
        settled = replace(
            start, position=position.numpy(), rotation=rotation.numpy(), tension=tension.numpy()
        )
        place_worlds(self._plants, self._worlds, which, settled, twist, device)
        wp.launch(
            chain_start_kernels.place_chains, len(which),
            inputs=[self._plants, self._worlds, self.chains, rows, q], device=device,
        )  # fmt: skip

    def points(self, segments: int) -> wp.array:
        """Return points on the cables, ends included, shape (B, n, segments + 1) of vectors."""
        warp_setup.load(chain_start_kernels, self._device)
        shape = self._worlds.tension.shape
        points = wp.zeros((*shape, segments + 1), dtype=wp.vec3d, device=self._device)
        wp.launch(
            chain_start_kernels.chain_points, shape,
            inputs=[self._plants, self._worlds, self.chains, points], device=self._device,
        )  # fmt: skip
        return points
