r"""Where the plan starts: the belief, made to agree with the cable lengths that are known.

The lengths that the winches have been sent to are known better, and sooner, than any pose: with n
cables they fix n of the six degrees of freedom (all six if n >= 6). The belief gives the others,
which is the sway, and two slow estimates that leave no steady error of the believed position:

* length offsets: sent lengths minus those of the believed pose, by a first-order filter;
* an acceleration of the free motion: what the believed twist gained beyond the prediction, summed.
  A centre of mass that is elsewhere, wind and a wrong weight end up there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from baselines.mpc.geometry import Geometry, geometry_at
from baselines.mpc.settings import MpcSettings
from carosac_toolkit.arrays import Array
from carosac_toolkit.physics.modes import mass_matrix
from carosac_toolkit.physics.structure import constrained_motion
from carosac_toolkit.robot import Robot
from carosac_toolkit.values import Belief

ACCELERATION_MAX = np.repeat([2.0, 10.0], 3)  # [m/s^2, rad/s^2]: more is no disturbance
SLACK = 0.05  # [m]: a cable that is longer than believed by more is slack


@dataclass(frozen=True, kw_only=True, eq=False)
class Start:
    """Pose and twist now.

    Attributes:
        position: Platform origin in W [m], shape (3,).
        rotation: From P to W, shape (3, 3).
        twist: Linear first, in W, at the origin, shape (6,).
        geometry: Cables there.
        distance: Largest difference of believed and predicted lengths [m].
    """

    position: Array
    rotation: Array
    twist: Array
    geometry: Geometry
    distance: float


class Observer:
    """Estimates offsets and the unknown acceleration, and says where the platform is.

    Attributes:
        offset: Of the lengths: sent minus modelled [m], shape (n,).
        disturbance: Unknown acceleration in W [m/s^2, rad/s^2], shape (6,).
        rebased: How often a belief beyond the gate was taken over, since the reset.
    """

    def __init__(self, robot: Robot, settings: MpcSettings) -> None:
        self._robot, self._settings = robot, settings

    def reset(self) -> None:
        """Forget everything."""
        self.offset = np.zeros(self._robot.n)
        self.disturbance = np.zeros(6)
        self.rebased = 0
        self._most = np.full(self._robot.n, self._settings.offset_max)
        self._predicted: Start | None = None

    @property
    def kept(self) -> Array:
        """Offset within its bounds [m], shape (n,); what is beyond them is slack."""
        return np.asarray(np.clip(self.offset, -self._most, self._most))

    def predict(self, start: Start | None) -> None:
        """Keep what the next belief should say; None where nothing was planned."""
        self._predicted = start

    def start(self, belief: Belief, length: Array, rate: Array, *, settled: bool = False) -> Start:
        """Where the platform is.

        Args:
            belief: Of one robot.
            length: Straight length that the cables were sent to, less offsets aside [m], (n,).
            rate: [m/s], shape (n,).
            settled: Whether the winches have come to rest after a failure: then what a belief
                beyond the gate differs by becomes the offset, which moves nothing by itself.

        Returns:
            The start; offsets and disturbance are updated if it is plausible.
        """
        position, rotation = belief.position[0], belief.rotation[0]
        geometry = geometry_at(self._robot, position, rotation)
        if not (geometry.valid and np.isfinite(geometry.jacobian).all()):
            return Start(position=position, rotation=rotation, twist=np.zeros(6),
                         geometry=geometry, distance=np.inf)  # fmt: skip
        settings = self._settings
        missing = length - geometry.length  # of the believed pose, before offsets
        distance = float(np.abs(missing - self.kept).max())
        if settled and distance > settings.belief_gate:
            self.offset, self.disturbance = missing, np.zeros(6)
            self._most = np.maximum(self._most, np.abs(missing))
            self._predicted, distance = None, 0.0
            self.rebased += 1
        mass = mass_matrix(self._robot, rotation[None], geometry.length[None])[0]
        motion = constrained_motion(mass, geometry.jacobian)
        twist = self._twist(belief)
        if distance <= settings.belief_gate:
            share = settings.period / settings.offset_time
            self.offset = self.offset + share * (missing - self.offset)
            self._keep_bounded(missing, share)
            self._learn(twist, np.eye(6) - motion @ geometry.jacobian)
        step = motion @ (missing - self.offset)
        twist = twist + motion @ (rate - geometry.jacobian @ twist)
        position = position + step[:3]
        rotation = Rotation.from_rotvec(step[3:]).as_matrix() @ rotation
        return Start(
            position=position, rotation=rotation, twist=twist, distance=distance,
            geometry=geometry_at(self._robot, position, rotation),
        )  # fmt: skip

    def _keep_bounded(self, missing: Array, share: float) -> None:
        """Follow what a cable is too long by at once where it is much, and lead it back.

        A slack cable is longer than its chord, and says nothing about where the platform is. Were
        that an offset, it would be sent for ever, and the cable would stay slack.
        """
        self._most = self._most + share * (self._settings.offset_max - self._most)
        self.offset = missing - np.clip(missing - self.offset, -SLACK, SLACK)
        self.offset = self.offset + share * (self.kept - self.offset)

    def _twist(self, belief: Belief) -> Array:
        """Believed twist; without one, the prediction and a share of how the pose differs."""
        if belief.twist is not None:
            return np.asarray(belief.twist[0])
        before = self._predicted
        if before is None:
            return np.zeros(6)
        turn = Rotation.from_matrix(belief.rotation[0] @ before.rotation.T).as_rotvec()
        difference = np.concatenate([belief.position[0] - before.position, turn])
        share = self._settings.twist_gain / self._settings.period
        return np.asarray(before.twist + share * difference)

    def _learn(self, twist: Array, free: Array) -> None:
        """Take a share of what the twist gained in the free directions as a disturbance."""
        if self._predicted is None:
            return
        gained = free @ (twist - self._predicted.twist)
        learned = self.disturbance + gained / self._settings.disturbance_time
        self.disturbance = np.clip(learned, -ACCELERATION_MAX, ACCELERATION_MAX)
