"""Start of a run: how far the platform is from its reference then, faded out.

Encoders are biased, and a robot file is not exact: a platform at rest on its first lengths is some
millimetres from where the reference begins. Were that an error to be corrected at once, the first
commands would be at the limits of the winches and leave a sway.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from baselines.mpc.planner import PlanTarget
from baselines.mpc.target_reader import CHASE_DISTANCE_MAX
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.scaled import Ratios, Scaled

FADE_TIME = Scaled(1.0, "s")  # longer changes nothing; as at once, shorter ends at the limits


class SoftStart:
    """Moves targets to where the platform was at the start, by a share that fades out."""

    def __init__(self, grid: Array, ratios: Ratios) -> None:
        """Take the times of a plan from now [s], shape (N + 1,), and the robot's ratios."""
        self._grid, self._duration = grid, FADE_TIME.of(ratios)
        self._near = CHASE_DISTANCE_MAX.of(ratios)
        self.reset()

    def reset(self) -> None:
        """Forget the start: the next target is the first one."""
        self._start: float | None = None
        self._apart, self._turned = np.zeros((2, 3))

    def faded(
        self, target: PlanTarget, position: Array, rotation: Array, *, time: float
    ) -> PlanTarget:
        """Return the target, moved by what is left of the distance at the start.

        Args:
            target: Target of the plan from `time` on.
            position: Platform origin in W now [m], shape (3,); counts at the first call.
            rotation: From P to W now, shape (3, 3); counts at the first call.
            time: Now [s].
        """
        if self._start is None:
            self._start = time
            self._keep(target, position, rotation)
        passed = (time - self._start) / self._duration
        if passed >= 1.0:
            return target
        # The polynomial of least jerk from 1 to 0, and its derivative by time.
        t = np.clip(passed + self._grid / self._duration, 0.0, 1.0)[:, None]
        share = 1.0 - t**3 * (10.0 - 15.0 * t + 6.0 * t**2)
        rate = -30.0 * (t * (1.0 - t)) ** 2 / self._duration
        turned = target.rotation
        if turned is not None:
            turned = Rotation.from_rotvec(share * self._turned).as_matrix() @ turned
        return replace(
            target,
            position=target.position + share * self._apart,
            velocity=target.velocity + rate * self._apart,
            rotation=turned,
        )

    def _keep(self, target: PlanTarget, position: Array, rotation: Array) -> None:
        """Keep how far the platform is from the target, unless it is so far as to approach it."""
        apart = position - target.position[0]
        if np.linalg.norm(apart) > self._near:
            return
        self._apart = apart
        if target.rotation is not None:
            self._turned = Rotation.from_matrix(rotation @ target.rotation[0].T).as_rotvec()
