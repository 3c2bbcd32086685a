"""Motion from any state through any lengths: the dynamics as filters need them.

The dynamics of `carosac_toolkit.physics.motion.dynamics` for many states of one robot at once.
Nothing is remembered from call to call: the same arguments give the same motion. What dry friction
remembers is handed on with a motion.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.scaled import Scaled
from carosac_toolkit.physics import warp_setup
from carosac_toolkit.physics.cable.catenary_kernels import vec6d
from carosac_toolkit.physics.device import Buffers
from carosac_toolkit.physics.fleet import Fleet
from carosac_toolkit.physics.motion import dynamics_kernels
from carosac_toolkit.physics.motion.dynamics import NodelessDynamics
from carosac_toolkit.physics.motion.friction_kernels import Bristles
from carosac_toolkit.physics.motion.winch import WinchSettings
from carosac_toolkit.physics.motion.worlds import allocate_worlds, rigid_body_record, upload_plants
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.robot.robot import Robot

PROPAGATION_STEP = Scaled(0.01, "s")
INSTANT = Scaled(1e-6, "s")  # in which nothing moves


@dataclass(frozen=True, kw_only=True, eq=False)
class Motions:
    """B motions, where they begin or where they end.

    Attributes:
        position: Platform origin in W [m], shape (B, 3).
        rotation: Rotation from P to W, shape (B, 3, 3).
        twist: Linear [m/s], then angular velocity [rad/s] of the origin in W, shape (B, 6).
        force: On the centre of mass in W, held all the time [N], shape (B, 3).
        exit_tension: Tension vectors at the exits, from which the shapes of the cables are looked
            for [N], shape (B, n, 3); None: from a guess, which takes several times as long.
        bristles: Bend of the bristles of dry friction (`friction_kernels.Bristles`) from an earlier
            motion, shape (B, n); None: as if the platform had been sliding at this twist, and no
            cable over its pulley.
    """

    position: Array
    rotation: Array
    twist: Array
    force: Array
    exit_tension: Array | None = None
    bristles: NDArray[Any] | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class Arrived(Motions):
    """B motions at their end, with acceleration and tension there.

    Attributes:
        acceleration: Of the origin in W, linear [m/s^2], then angular [rad/s^2], shape (B, 6).
        tension: At the platform [N], shape (B, n).
        failed: True if a time step had no finite solution, shape (B,).
    """

    acceleration: Array
    tension: Array
    failed: NDArray[np.bool_]


class Propagation:
    """B platforms on quasi-static catenaries, let go from any state.

    Attributes:
        size: B.
        n: Cables of each.
        time_step: Longest time step [s].
    """

    def __init__(
        self,
        robot: Robot,
        size: int,
        *,
        time_step: float | None = None,
        cable_drag: float | None = None,
        device: str = "cpu",
    ) -> None:
        """Allocate.

        Args:
            robot: Robot description; bodies may be changed later, one for each motion.
            size: Number of motions B.
            time_step: Longest time step [s]; None: 10 ms on ``carosac``, scales with the robot.
            cable_drag: Air drag of the cables per mass [1/s]; None: that of the robot.
            device: Warp device.
        """
        warp_setup.load(dynamics_kernels, device)
        if cable_drag is not None:
            robot = replace(robot, cable_drag=cable_drag)
        self.size, self.n = size, robot.n
        usual = PROPAGATION_STEP.of(Scales(robot).ratios)
        self.time_step = usual if time_step is None else time_step
        self._device = device
        self._plants = upload_plants(Fleet([robot] * size), device, WinchSettings(), 0.0, 1.0)
        self._bodies = np.repeat(rigid_body_record(robot)[None], size)
        self._worlds = allocate_worlds(size, robot.n, device, np.zeros(size, dtype=np.int32))
        self._dynamics = NodelessDynamics(
            self._plants, self._worlds, size, robot.n, device, "catenary"
        )
        self._freed = _allocate(size, robot.n, device)
        self._buffers = Buffers(device, {})
        for name in (
            "position", "rotation", "twist", "force", "unstrained_length", "rate", "bristles",
            "bent",
        ):  # fmt: skip
            self._buffers.add(name, getattr(self._freed, name))
        for name in ("position", "rotation", "twist", "bristles"):
            self._buffers.add(f"end_{name}", getattr(self._worlds, name))
        self._buffers.add("exit_tension", self._dynamics.hung.q)
        for name in ("command", "acceleration", "tension", "failed"):
            self._buffers.add(name, getattr(self._worlds, name))
        self._instant = INSTANT.of(Scales(robot).ratios)
        self._release: Any = None

    def load(self, mass: ArrayLike, center_of_mass: ArrayLike) -> None:
        """Change mass and centre of the platforms; the inertia about the centre of mass stays.

        Args:
            mass: [kg], shape (B,).
            center_of_mass: In P [m], shape (B, 3).
        """
        self._bodies["mass"] = mass
        self._bodies["center_of_mass"] = center_of_mass
        self._plants.bodies.assign(self._bodies)

    def run(
        self, start: Motions, unstrained_length: Array, end_length: Array, duration: float
    ) -> Arrived:
        """Release all platforms while the lengths move linearly to their end values.

        Args:
            start: B motions.
            unstrained_length: At the start [m], shape (B, n).
            end_length: At the end [m], shape (B, n).
            duration: [s], > 0.
        """
        count = max(1, int(np.ceil(duration / self.time_step - 1e-6)))
        h = duration / count
        put, get = self._buffers.put, self._buffers.get
        with self._buffers.lock:
            for name in ("position", "rotation", "twist", "force"):
                put(name, getattr(start, name))
            put("unstrained_length", unstrained_length)
            put("rate", (end_length - unstrained_length) / duration)
            put("command", end_length)
            put("exit_tension", np.zeros(3) if start.exit_tension is None else start.exit_tension)
            put("bent", np.array(start.bristles is not None, dtype=np.int32))
            if start.bristles is not None:
                put("bristles", start.bristles)
            self._let_go(h)
            self._dynamics.advance(True, count, h)
            return Arrived(
                position=get("end_position"),
                rotation=get("end_rotation"),
                twist=get("end_twist"),
                force=start.force,
                exit_tension=get("exit_tension"),
                bristles=get("end_bristles"),
                acceleration=get("acceleration"),
                tension=get("tension"),
                failed=get("failed") > 0,
            )

    def _let_go(self, h: float) -> None:
        """Launch `release`, recorded at the first use."""
        if self._release is None:
            self._release = wp.launch(
                dynamics_kernels.release, self.size,
                inputs=[
                    self._plants, self._worlds, self._dynamics.hung, self._freed, 0, h,
                    self._instant,
                ],
                device=self._device, record_cmd=True,
            )  # fmt: skip
        self._release.set_param_at_index(5, h)
        self._release.launch()


def _allocate(size: int, n: int, device: str) -> Any:
    """Allocate the `Freed` struct of B worlds of n cables."""
    out = dynamics_kernels.Freed()
    out.position = wp.zeros(size, dtype=wp.vec3d, device=device)
    out.rotation = wp.zeros(size, dtype=wp.mat33d, device=device)
    out.twist = wp.zeros(size, dtype=vec6d, device=device)
    out.force = wp.zeros(size, dtype=wp.vec3d, device=device)
    out.unstrained_length = wp.zeros((size, n), dtype=wp.float64, device=device)
    out.rate = wp.zeros((size, n), dtype=wp.float64, device=device)
    out.bristles = wp.zeros((size, n), dtype=Bristles, device=device)
    out.bent = wp.zeros(size, dtype=wp.int32, device=device)
    return out
