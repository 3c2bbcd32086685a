"""The controller `approximate_mpc`: a network tells what MPC would plan next.

All that a plan is made from, and what follows from its first tensions, is as in `baselines.mpc`:
the lengths that were sent say where the cables end, offsets and an unknown acceleration are learned
beside, the tensions are put into the same equations of motion, and the winches are led by their
lag. Only the quadratic program is missing; a network that has seen many of them says which tensions
it would find, and which sag and stretch belong to these.

References:
    Hertneck, Köhler, Trimpe, Allgöwer, Learning an approximate model predictive controller with
    guarantees, *IEEE Control Systems Letters* 2, 2018.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from baselines.mpc import model
from baselines.mpc.excess_filter import ExcessFilter
from baselines.mpc.geometry import Geometry, first_excess, geometry_at, start_geometry
from baselines.mpc.length_offsets import OFFSET_TIME, LengthOffsets
from baselines.mpc.observer import BELIEF_GATE, twist_by_pose
from baselines.mpc.plan_times import settings_for, stage_durations, times_of
from baselines.mpc.planner import PlanTarget
from baselines.mpc.settings import Compiled, MpcSettings
from baselines.mpc.soft_start import SoftStart
from baselines.mpc.target_reader import CHASE_DISTANCE_MAX, TargetReader
from baselines.mpc.unknown_load import (
    CENTER_STEP_MIN,
    DISTURBANCE_MAX,
    AccelerationGain,
    equal_energy,
)
from baselines.mpc.winch_reference import WinchReference
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.base.extras import require
from carosac_toolkit.loop.values import Belief, Command, Reference
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.robot.robot import RigidBody, Robot, combine_bodies
from learned.approximate_mpc.bounce_guard import BOUNCE_MAX, BounceGuard
from learned.approximate_mpc.family_network import FamilyNetwork
from learned.approximate_mpc.motion import FastMotion
from learned.approximate_mpc.networks import load_network, network_for
from learned.approximate_mpc.plan_inputs import PlanCallback, PlanInputs, UnreadableInputs
from learned.approximate_mpc.plan_network import PlanNetwork
from learned.approximate_mpc.resting_attitude import RestingAttitude
from learned.approximate_mpc.taut_cables import TautCables
from learned.policy_controller import BOX_EXCESS_MAX
from learned.reference_rows import ReferenceRows, require_rows
from learned.shaped_fallback import BOUNCING, FAR, OUTSIDE, ShapedFallback

APART = "lengths apart from the belief"
UNREADABLE = "a state that no network can read"
# Of the longest cable, by which lengths change before the part of it that rides along is renewed.
RIDING_SHARE = 0.03
NO_TURN = np.zeros(3)  # of a state about the believed rotation
CABLES_MAX = 5  # more leave no sway, and hold the attitude, which is no input


@dataclass(frozen=True, kw_only=True)
class ApproximateMpcSettings:
    """Settings of `ApproximateMpc`.

    Attributes:
        policy: Name of a bundled network, or path of a file that ``carosac distill`` wrote; None
            takes the bundled one of the robot, or of its family.
    """

    policy: str | None = None


class PlanFollower:
    """MPC without its planner: what a plan is made from, and what follows from its tensions.

    Attributes:
        period: Time between two commands [s].
        horizon: How far ahead the reference must reach [s].
        bounce: Energy with which the platform bounces, as `BounceGuard` has it.
    """

    def __init__(
        self,
        robot: Robot,
        settings: MpcSettings,
        *,
        tension_share: float = 1.0,
        turns_back: bool = False,
        compiled: Compiled = "never",
    ) -> None:
        """Prepare for a robot of three to five cables.

        Args:
            robot: The nominal robot.
            settings: Of MPC.
            tension_share: Of the way to new tensions, in a command. Beliefs tremble as cables
                vibrate; what trembles less is sent back less, and later.
            turns_back: Whether a platform that errors of plans have turned is turned back, as
                `RestingAttitude` has it; three cables hold it in one attitude. Training drives do
                without, so that networks learn from their own errors.
            compiled: Whether what a command does is compiled for the robot, which takes seconds the
                first time; as in `MpcSettings`.

        Raises:
            InvalidField: It has fewer, or more.
        """
        require("approximate model predictive control", "casadi")
        check_cables(robot)
        self.settings, _ = settings_for(robot, settings)
        scales = Scales(robot)
        self.robot, self.ratios = robot, scales.ratios
        self.period = self.settings.period
        self.grid = times_of(stage_durations(self.settings))
        self._rows = ReferenceRows.of(self.grid / self.period)
        self.horizon = self.period * float(self._rows.last_row)
        self._offsets = LengthOffsets(robot.n, period=self.period, ratios=self.ratios)
        self._excess = ExcessFilter(robot, self.period)
        jerk_max = self.settings.jerk_max or scales.jerk(self.period)
        self._winches = WinchReference(robot, period=self.period, jerk_max=jerk_max)
        self._motion = FastMotion(
            robot, period=self.period, jerk_max=jerk_max,
            offsets=self._offsets, excess=self._excess, compiled=compiled,
        )  # fmt: skip
        self._guard = BounceGuard(robot, self.period)
        self._taut = TautCables(robot)
        self._soft_start = SoftStart(self.grid, self.ratios)
        self.habit_share = self.period / OFFSET_TIME.of(self.ratios)
        self._gain = AccelerationGain(
            robot, period=self.period, disturbance_time=self.settings.disturbance_time
        )
        self._acceleration_max = DISTURBANCE_MAX.of(self.ratios) * equal_energy(robot)
        self._center_step = CENTER_STEP_MIN.of(self.ratios)
        self._gate = BELIEF_GATE.of(self.ratios)
        self._chase = CHASE_DISTANCE_MAX.of(self.ratios)
        self._blocks = model.parameter_rows(robot.n)
        self._targets = TargetReader(robot, self.grid, self.settings.distribution)
        self._attitude = (
            RestingAttitude(
                robot, self._targets.rest_at, self._taut.wanted, self.habit_share, self.grid,
                self.period,
            ) if turns_back and robot.n > 3 else None
        )  # fmt: skip
        self._usual_place: Array | None = None
        self._usual_tension: Array = np.zeros(robot.n)
        self._tension_share = tension_share
        self._pull: Array | None = None  # tensions of the last command
        self._planned: Array | None = None  # what the winches could do of these
        self._after: tuple[Array, Array] | None = None  # predicted state, and its R_0
        self._acceleration: Array = np.zeros(6)
        self._state: Array = np.zeros(model.STATE_SIZE)
        self._base: Array = np.eye(3)
        middle = 0.5 * (robot.workspace_max + robot.workspace_min)
        reach = (0.5 + 0.5 * BOX_EXCESS_MAX) * (robot.workspace_max - robot.workspace_min)
        self._box = bounds(middle - reach, middle + reach)
        self._turns = bool((robot.pulley_radius > 0.0).any())

    def reset(self, belief: Belief) -> None:
        """Start at rest where the belief says.

        Raises:
            InvalidField: A batch of several robots.
            NoStart: No cables can reach there.
        """
        if len(belief.position) != 1:
            raise InvalidField("belief", f"{len(belief.position)} robots", "one")
        position, rotation = belief.position[0], belief.rotation[0]
        geometry = start_geometry(self.robot, position, rotation, name="approximate_mpc")
        self._targets.reset()
        rest = self._targets.at(position)
        self._excess.reset(first_excess(self.robot, belief, geometry, rest))
        self._offsets.reset()
        self._winches.reset(geometry.length + self._excess.value)
        self._soft_start.reset()
        self._center = self.robot.center_of_mass
        self._free = geometry.free
        self._place(geometry)
        self._guard.reset()
        self._forget()

    def look(self, belief: Belief, reference: Reference) -> tuple[PlanInputs, str]:
        """Return what the next plan depends on, and why there must be none, or nothing."""
        position, rotation, twist = belief.position[0], belief.rotation[0], self._twist(belief)
        if self._turns or not within(self._free, self._rides):
            self._place(geometry_at(self.robot, position, rotation))
        told = belief.center_of_mass
        if told is not None and np.abs(told[0] - self._center).max() > self._center_step:
            self._center = told[0]
            self._load()
        parameters = self._motion.parameters
        parameters[self._blocks["rotation"]] = rotation.T.ravel()
        parameters[self._blocks["disturbance"]] = self._acceleration
        state = self._state = np.concatenate([position, NO_TURN, twist])
        self._base = rotation
        predicted = twist if self._after is None else self._after[0][6:]
        target = self._target(reference, position, rotation, float(belief.time[0]))
        if self._usual_place is None:
            self._usual_place = target.position[0]
            self._usual_tension = self._targets.at(target.position[0])
        seen = self._motion.look(
            state, predicted, self._offsets,
            sent=self._winches.length - self._excess.value - self._wrapped,
            rate=self._winches.rate,
        )  # fmt: skip
        self._free = seen.free
        self.bounce = self._guard.bounce(
            seen.motion_energy, seen.free, None if belief.tension is None else belief.tension[0],
            self._usual_tension if self._planned is None else self._planned, self._usual_tension,
        )  # fmt: skip
        reason = self._reason(float(np.abs(seen.apart).max()), target.position[0], position)
        if not reason:
            self._offsets.take(*seen.offset)
            if not self._offsets.slack.any():
                self._learn(seen.innovation, told=told is not None)
            self._state, rotation = seen.state, seen.rotation
            parameters[self._blocks["disturbance"]] = self._acceleration
            position, twist = seen.state[:3], seen.state[6:]
        inputs = PlanInputs(
            position=position,
            rotation=rotation,
            twist=twist,
            target=target.position,
            target_velocity=target.velocity,
            center=self._center - self.robot.center_of_mass,
            acceleration=self._acceleration.copy(),
            usual_tension=self._usual_tension,
            usual_place=self._usual_place - target.position[0],
        )
        return inputs, reason

    def follow(self, inputs: PlanInputs, tension: Array, excess: Array) -> Array:
        """Return the command (n,) [m] for the first tensions of a plan, and their sag less stretch.

        Weak cables pull more than planned, as `TautCables` has it, and so do those that turn the
        platform back, as `RestingAttitude` has it.

        Args:
            inputs: As `look` returned them.
            tension: Along the chords [N], shape (n,).
            excess: Sag less stretch at the end of the period [m], shape (n,); where it is NaN, as
                no cable hangs so, what is sent comes to rest.
        """
        if self._attitude is not None:
            tension, excess = self._attitude.pull(inputs, tension, excess)
        tension = np.minimum(np.maximum(tension, self.robot.tension_min), self.robot.tension_max)
        tension, excess = self._taut.pull(inputs, tension, excess)
        if self._pull is not None:
            tension = self._pull + self._tension_share * (tension - self._pull)
        self._pull = tension
        ahead = self._motion.advance(
            self._state, tension, self._excess.reachable(excess), self._excess,
            self._wrapped + self._offsets.surplus, self._winches.state,
        )  # fmt: skip
        self._excess.take(*ahead.excess)
        self._winches.take(ahead.winches, held=ahead.held)
        self._after, self._planned = (ahead.state, self._base), ahead.tension
        share = self.habit_share
        self._usual_tension = self._usual_tension + share * (ahead.tension - self._usual_tension)
        assert self._usual_place is not None
        self._usual_place = self._usual_place - share * inputs.usual_place
        return np.asarray(ahead.winches.sent)

    def instead(self, sent: Array) -> None:
        """Take note of a command [m] (n,) that was sent in place of the last one of `follow`."""
        self._winches.instead(sent)

    def note(self, sent: Array) -> None:
        """Take note of a command [m] (n,) of someone else, where there was no plan."""
        self._winches.note(sent)
        self._forget()

    @property
    def braked(self) -> Array:
        """The next command if the winches are to rest as soon as they can [m], shape (n,)."""
        return self._winches.braked

    @property
    def surplus(self) -> Array:
        """What lengths sent exceed straight ones by [m], shape (n,)."""
        return np.asarray(self._excess.value + self._offsets.surplus)

    def _forget(self) -> None:
        """Drop the prediction, and what was learned of the load, which may be wrong."""
        self._after = self._pull = self._planned = None
        self._acceleration = np.zeros(6)
        self._gain.reset()
        self._usual_place = None
        if self._attitude is not None:
            self._attitude.reset()

    def _twist(self, belief: Belief) -> Array:
        """Return the believed twist; without one, the prediction corrected by the pose."""
        if belief.twist is not None:
            return np.asarray(belief.twist[0])
        if self._after is None:
            return np.zeros(6)
        state, base = self._after
        rotation = model.rotation_of(state[3:6]) @ base
        return twist_by_pose(belief, state[:3], rotation, state[6:], self.period)

    def _place(self, geometry: Geometry) -> None:
        """Bring the parameters of the model up to date."""
        self._geometry = geometry
        ridden = RIDING_SHARE * geometry.free.max()
        self._rides = bounds(geometry.free - ridden, geometry.free + ridden)
        self._wrapped = geometry.length - geometry.free
        self._motion.parameters[:] = model.parameters(
            self.robot, rotation=np.eye(3), length=geometry.free, exits=geometry.exits,
            disturbance=np.zeros(6),
        )  # fmt: skip
        self._riding = combine_bodies(model.riding_bodies(self.robot, geometry.free))
        self._load()

    def _load(self) -> None:
        """Bring the centre of mass in the parameters up to date."""
        platform = RigidBody(self.robot.mass, self._center, self.robot.inertia)
        body, blocks = combine_bodies([platform, self._riding]), self._blocks
        parameters = self._motion.parameters
        parameters[blocks["center"]] = body.center_of_mass
        parameters[blocks["inertia"]] = body.inertia.ravel()
        parameters[blocks["inverse_inertia"]] = np.linalg.inv(body.inertia).ravel()
        parameters[blocks["hang"]] = self._center

    def _target(
        self, reference: Reference, position: Array, rotation: Array, now: float
    ) -> PlanTarget:
        """Return the reference at the times of a plan, led on from where the platform started."""
        target = PlanTarget(
            position=self._rows.rows(reference.position, 1)[0],
            velocity=self._rows.rows(reference.velocity, 1)[0],
            rotation=None,
            tension=self._usual_tension,
        )
        return self._soft_start.faded(target, position, rotation, time=now)

    def _reason(self, distance: float, target: Array, position: Array) -> str:
        """Return why nothing must be planned from here, or nothing."""
        if not distance <= self._gate:
            return APART
        if not within(target, self._box):
            return OUTSIDE
        return "" if math.dist(position, target) <= self._chase else FAR

    def _learn(self, innovation: Array, *, told: bool) -> None:
        """Take in what the twist has beyond its prediction, in the free ways (6,)."""
        most = self._acceleration_max
        found = self._acceleration + self._gain.next(told=told) * innovation
        self._acceleration = np.minimum(np.maximum(found, -most), most)


def bounds(low: Array, high: Array) -> list[tuple[float, float]]:
    """Return bounds (k,) for `within`."""
    return list(zip(low.tolist(), high.tolist(), strict=True))


def within(values: Array, allowed: list[tuple[float, float]]) -> bool:
    """Return whether all values (k,) are within bounds; of a few, NumPy takes longer."""
    return all(
        low <= value <= high for value, (low, high) in zip(values.tolist(), allowed, strict=True)
    )


def check_cables(robot: Robot) -> None:
    """Refuse a robot of fewer than three cables, or of so many that it does not sway.

    Raises:
        InvalidField: It is one.
    """
    if not 3 <= robot.n <= CABLES_MAX:
        allowed = f"3 to {CABLES_MAX}, which let the platform sway: use mpc"
        raise InvalidField("robot", f"{robot.n} cables", allowed)


class ApproximateMpc:
    """What `Mpc` would do, as a network has learned it.

    Outside the box, far from the reference, where the belief and the lengths sent do not agree, or
    where the platform bounces so that cables go slack, input shaping commands, and `fallbacks`
    counts it.

    Attributes:
        period: Time between two commands [s].
        horizon: How far ahead the reference must reach [s].
    """

    Settings: ClassVar = ApproximateMpcSettings

    def __init__(self, robot: Robot, network: PlanNetwork | FamilyNetwork) -> None:
        """Make sure that the network was trained for this robot, or its family.

        Raises:
            InvalidField: It was trained for others; names what differs.
        """
        network.check(robot)
        self._network = network
        settings = network.settings_of(robot)
        self._follower = PlanFollower(
            robot, settings, tension_share=network.tension_share,
            turns_back=network.turns_back, compiled=settings.compiled,
        )  # fmt: skip
        self.period = self._follower.period
        self._fallback = ShapedFallback(robot, self.period, continues=True)
        self.horizon = max(self._follower.horizon, self._fallback.horizon)
        network.planner(robot)  # compiled here, not in the first cycle
        self._plan: PlanCallback | None = None

    @classmethod
    def build(
        cls, robot: Robot, settings: ApproximateMpcSettings | None = None, *, seed: int = 0
    ) -> Self:
        """Load the network; it draws no random numbers, so `seed` has no effect.

        Raises:
            InvalidField: There is no network for this robot, or it was trained for others.
        """
        chosen = settings or ApproximateMpcSettings()
        own = network_for(robot) if chosen.policy is None else load_network(chosen.policy)
        return cls(robot, own)

    @staticmethod
    def check_settings(settings: ApproximateMpcSettings) -> None:
        """Refuse a network that is not there, or is none, before a study begins."""
        if settings.policy is not None:
            load_network(settings.policy)

    @staticmethod
    def check_robot(robot: Robot) -> None:
        """Refuse a robot for which none is bundled; studies ask before they choose it.

        Raises:
            InvalidField: There is none for it or its family.
        """
        network_for(robot)

    def reset(self, belief: Belief) -> None:
        """Start at rest where the belief says.

        Raises:
            InvalidField: A batch of several robots.
        """
        self._follower.reset(belief)
        self._fallback.reset(self._follower.braked[None])
        self._plan = self._network.planner(self._follower.robot)

    @property
    def fallbacks(self) -> Mapping[str, int]:
        """Commands of input shaping since the last reset, by reason."""
        return dict(self._fallback.counts)

    def command(self, belief: Belief, reference: Reference) -> Command:
        """Return the lengths for the next period.

        Raises:
            InvalidField: No reset before, or a reference that ends before the horizon.
        """
        if self._plan is None:
            raise InvalidField("approximate_mpc", "no belief to start from", "a call of reset()")
        require_rows(reference, self.horizon, self.period)
        inputs, reason = self._follower.look(belief, reference)
        if not reason and self._follower.bounce > BOUNCE_MAX:  # training drives go on, to learn
            reason = BOUNCING
        planned = None
        if not reason:
            try:
                planned = self._plan(inputs)
            except UnreadableInputs:
                reason = UNREADABLE
        reasons = {0: reason} if reason else {}
        self._fallback.decide(reasons, belief)
        idle = planned is None or bool(self._fallback.active[0])
        if planned is None or idle:
            length = self._follower.braked
        else:
            length = self._follower.follow(inputs, *planned)
        sent = self._fallback.command(length[None], belief, reference, reasons)
        if idle:
            self._follower.note(sent[0])
        elif not np.array_equal(sent[0], length):
            self._follower.instead(sent[0])
        return Command(time=belief.time, unstrained_length=sent)
