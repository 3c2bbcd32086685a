r"""Start of the plan: the belief, made to agree with the cable lengths that are known.

The lengths that the winches have been sent to are known better, and sooner, than any pose: with n
cables they fix n of the six degrees of freedom (all six if n >= 6). The belief gives the others,
which is the sway, and two estimates that leave no steady error of the believed position:

* length offsets: sent lengths minus those of the believed pose, by a first-order filter;
* an unknown acceleration of the free motion, from what the believed twist gained beyond the
  prediction, and the centre of mass, unless the belief tells it (`unknown_load`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from baselines.mpc.geometry import Geometry, geometry_at
from baselines.mpc.length_offsets import LengthOffsets
from baselines.mpc.settings import MpcSettings
from baselines.mpc.unknown_load import PlannedMotion, UnknownLoad
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.scaled import Scaled
from carosac_toolkit.loop.values import Belief
from carosac_toolkit.physics.rest.modes import mass_matrix
from carosac_toolkit.physics.rest.structure import constrained_motion
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.robot.robot import Robot

NEWTON_STEPS_MAX = 5
LENGTH_TOLERANCE = Scaled(1e-6, "m")  # of Newton's method
# From lengths sent to believed ones: beyond it, cables must be slack.
BELIEF_GATE = Scaled(0.2, "m")
TWIST_GAIN = 0.2  # share of a position difference that becomes velocity, for beliefs without twist


@dataclass(frozen=True, kw_only=True, eq=False)
class PlanStart:
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
    """Estimates offsets and the unknown load, and says where the platform is.

    Attributes:
        lengths: What those sent differ by from modelled ones.
        load: Centre of mass and acceleration that the model does not know.
        gate: Distance of lengths sent to believed ones beyond which cables are slack [m].
        rebased: How often a belief that disagreed was taken over, since the reset.
    """

    def __init__(self, robot: Robot, settings: MpcSettings) -> None:
        self._robot, self._settings, ratios = robot, settings, Scales(robot).ratios
        self._tolerance, self.gate = LENGTH_TOLERANCE.of(ratios), BELIEF_GATE.of(ratios)
        self.lengths = LengthOffsets(robot.n, period=settings.period, ratios=ratios)
        self.load = UnknownLoad(
            robot, period=settings.period, center_of_mass=settings.center_of_mass,
            disturbance_time=settings.disturbance_time,
        )  # fmt: skip

    def reset(self) -> None:
        """Forget everything."""
        self.lengths.reset()
        self.rebased = 0
        self.forget()

    def forget(self) -> None:
        """Drop the prediction, and what was learned of the load, which may be wrong."""
        self.load.reset()
        self._predicted: PlanStart | None = None
        self._planned: PlannedMotion | None = None

    def predict(self, start: PlanStart, planned: PlannedMotion | None = None) -> None:
        """Keep what the next belief should say, and the motion to it if it was planned just now."""
        self._predicted, self._planned = start, planned

    def start(
        self, belief: Belief, length: Array, rate: Array, *, within: float | None = None,
        stuck: bool = False,
    ) -> PlanStart:  # fmt: skip
        """Return where the platform is, and learn offsets and load on the way.

        Args:
            belief: Of one robot.
            length: Straight length that the cables were sent to, less offsets aside [m], (n,).
            rate: [m/s], shape (n,).
            within: Distance up to which something is learned [m]; None: the gate.
            stuck: Whether the belief has disagreed for long while the winches rest: then what it
                differs by becomes the offset, which moves nothing by itself.

        Returns:
            The start; offsets and the load are updated if it is plausible.
        """
        position, rotation = belief.position[0], belief.rotation[0]
        geometry = geometry_at(self._robot, position, rotation)
        if not _sound(geometry):
            return _nowhere(position, rotation, geometry)
        allowed = self.gate if within is None else within
        missing = length - geometry.length  # of the believed pose, before offsets
        distance = float(np.abs(missing - self.lengths.kept).max())
        if stuck and distance > allowed:
            self._rebase(missing)
            distance = 0.0
        twist = self._twist(belief)
        if distance > allowed:
            return PlanStart(position=position, rotation=rotation, twist=twist, geometry=geometry,
                         distance=distance)  # fmt: skip
        self.lengths.learn(missing)
        if not self.lengths.slack.any():
            self._learn(belief, twist, geometry, rotation)
        position, rotation, geometry = self._onto(
            length - self.lengths.surplus, position, rotation, geometry
        )
        if not _sound(geometry):
            return _nowhere(position, rotation, geometry)
        motion = self._motion(geometry, rotation)
        twist = twist + motion @ (rate - geometry.jacobian @ twist)
        return PlanStart(position=position, rotation=rotation, twist=twist, geometry=geometry,
                     distance=distance)  # fmt: skip

    def _rebase(self, missing: Array) -> None:
        """Take what lengths differ by as offset, whatever it is."""
        self.lengths.rebase(missing)
        self.forget()
        self.rebased += 1

    def _motion(self, geometry: Geometry, rotation: Array) -> Array:
        """Return the motion of least energy per length of the cables, shape (6, n)."""
        return constrained_motion(self._mass(geometry, rotation), geometry.jacobian)

    def _mass(self, geometry: Geometry, rotation: Array) -> Array:
        """Return the mass matrix, shape (6, 6)."""
        return np.asarray(mass_matrix(self.load.robot, rotation[None], geometry.length[None])[0])

    def _onto(
        self, length: Array, position: Array, rotation: Array, geometry: Geometry
    ) -> tuple[Array, Array, Geometry]:
        """Find the nearest pose at which the cables have given lengths, by Newton's method.

        One step is not enough: a tenth of a millimetre that is left over at every command is paid
        out as speed that no plan has asked for.

        Args:
            length: Wanted straight lengths [m], shape (n,).
            position: Where to begin [m], shape (3,).
            rotation: Shape (3, 3).
            geometry: There.

        Returns:
            Position, rotation and geometry there.
        """
        for _ in range(NEWTON_STEPS_MAX):
            step = self._motion(geometry, rotation) @ (length - geometry.length)
            if np.abs(geometry.jacobian @ step).max() < self._tolerance:
                break
            position = position + step[:3]
            rotation = Rotation.from_rotvec(step[3:]).as_matrix() @ rotation
            geometry = geometry_at(self._robot, position, rotation)
            if not _sound(geometry):
                break
        return position, rotation, geometry

    def _twist(self, belief: Belief) -> Array:
        """Return the believed twist; without one, the prediction corrected by the pose."""
        if belief.twist is not None:
            return np.asarray(belief.twist[0])
        if self._predicted is None:
            return np.zeros(6)
        before = self._predicted
        return twist_by_pose(
            belief, before.position, before.rotation, before.twist, self._settings.period
        )

    def _learn(self, belief: Belief, twist: Array, geometry: Geometry, rotation: Array) -> None:
        """Take in what the twist gained in the free directions; six cables leave none."""
        told = belief.center_of_mass
        news = self.load.tell(None if told is None else told[0])
        if news or self._predicted is None or self._planned is None or self._robot.n >= 6:
            return
        mass = self._mass(geometry, rotation)
        free = np.eye(6) - constrained_motion(mass, geometry.jacobian) @ geometry.jacobian
        gained = free @ (twist - self._predicted.twist)
        self.load.learn(gained, free, mass, self._planned, turning=belief.twist is not None)


def twist_by_pose(
    belief: Belief, position: Array, rotation: Array, twist: Array, period: float
) -> Array:
    """Return a predicted twist (6,), corrected by what the believed pose differs by.

    Args:
        belief: Of one robot.
        position: Predicted, in W [m], shape (3,).
        rotation: The same from P to W, shape (3, 3).
        twist: The same, shape (6,).
        period: Between two commands [s].
    """
    turn = Rotation.from_matrix(belief.rotation[0] @ rotation.T).as_rotvec()
    difference = np.concatenate([belief.position[0] - position, turn])
    return np.asarray(twist + TWIST_GAIN / period * difference)


def _sound(geometry: Geometry) -> bool:
    """Return whether all cables exist."""
    return geometry.valid and bool(np.isfinite(geometry.jacobian).all())


def _nowhere(position: Array, rotation: Array, geometry: Geometry) -> PlanStart:
    """Return a start that no plan can begin at."""
    return PlanStart(
        position=position, rotation=rotation, twist=np.zeros(6), geometry=geometry, distance=np.inf
    )
