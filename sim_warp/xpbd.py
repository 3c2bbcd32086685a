"""Worlds whose chains of particles are advanced by position-based dynamics, for comparison."""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.physics import warp_setup
from carosac_toolkit.physics.motion.dynamics import Advance
from carosac_toolkit.physics.rest.statics import Equilibrium
from sim_warp import xpbd_kernels
from sim_warp.particles import ParticleDynamics


class XpbdDynamics:
    """B worlds of the chains of `ParticleDynamics`, advanced by position-based dynamics."""

    def __init__(
        self,
        plants: Any,
        worlds: Any,
        size: int,
        n: int,
        device: str,
        segments: int,
        drag: float,
        iterations: int,
    ) -> None:
        """Allocate; `place` comes before `advance`.

        Args:
            plants: `Plants` struct.
            worlds: `Worlds` struct.
            size: Number of worlds B.
            n: Cables of each.
            device: Warp device.
            segments: Segments N of a cable.
            drag: Air drag of the cables per mass [1/s].
            iterations: Passes over all segments in a time step.
        """
        warp_setup.load(xpbd_kernels, device)
        self._particles = ParticleDynamics(plants, worlds, size, n, device, segments, drag)
        before = [plants, worlds, self._particles.chains, iterations]
        self.advance = Advance(xpbd_kernels.advance, size, before, [], device)
        self.arrays = self._particles.arrays

    def place(self, which: NDArray[np.int32], rest: Equilibrium, twist: Array) -> None:
        """Place worlds; see `ParticleDynamics.place`."""
        self._particles.place(which, rest, twist)

    def points(self, segments: int) -> wp.array:
        """Return points on the cables; see `ParticleDynamics.points`."""
        return self._particles.points(segments)
