"""The controller `td3`: a trained policy on any driver, without the packages that trained it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.base.numbers import check_positive
from carosac_toolkit.loop.values import Belief, Command, Reference
from carosac_toolkit.physics.motion.cable_drag import cable_drag_of
from carosac_toolkit.robot.differences import same
from carosac_toolkit.robot.robot import Robot
from learned.bundled_files import find_bundled, list_bundled
from learned.environment import EnvironmentSettings, empty_look, lead_of, make_actions
from learned.observation import TWIST_PARTS, ObservationInputs, ObservationScales, fading, observe
from learned.policy_file import Policy
from learned.reference_rows import ReferenceRows, require_rows
from learned.settings_data import environment_settings
from learned.shaped_fallback import FAR, OUTSIDE, ShapedFallback

POLICY_FOLDER = "policies"
BOX_EXCESS_MAX = 0.02  # by how much of half an edge of the box a target may lie outside it
# What a policy learns depends on; names, calibration and sensors are free.
TRAINED_FIELDS = (
    "exit_points", "anchor_points", "pulley_radius", "swivel_axis", "run_length",
    "linear_density", "axial_stiffness", "tension_min", "tension_max", "mass", "center_of_mass",
    "inertia", "gravity", "workspace_min", "workspace_max", "home_rotation",
)  # fmt: skip
# And one that moves in real time on these, too.
TRAINED_MOTION_FIELDS = (
    "winch_lag", "speed_max", "acceleration_max", "axial_damping", "drag", "angular_drag",
    "angular_drag_axes", "cable_drag", "exit_friction", "anchor_friction", "capstan_friction",
    "length_hysteresis",
)  # fmt: skip
DEFAULT_POLICIES = {
    "carosac": "carosac-residual",
    "scampi": "scampi-residual",
}  # bundled policies by robot


@dataclass(frozen=True, kw_only=True)
class PolicySettings:
    """Settings of `PolicyController`.

    Attributes:
        policy: Name of a bundled policy, or path of an ONNX file that ``carosac train`` wrote;
            None takes the bundled one of the robot.
        period: Time between two commands [s], for policies of set-points; others bring their own.
    """

    policy: str | None = None
    period: float = 0.02

    def __post_init__(self) -> None:
        """Refuse numbers that make no sense."""
        check_positive("period", self.period, "s")


class PolicyController:
    """Observes the belief as the policy's environment observed its platform, and acts once a cycle.

    A policy of set-points gets the reference as far ahead as the winches lag; one of real time gets
    the reference at the end of the cycle, and those later that it was trained with.
    """

    Settings: ClassVar = PolicySettings
    batched: ClassVar = True

    def __init__(self, robot: Robot, policy: Policy, settings: PolicySettings) -> None:
        """Make sure that the policy was trained for this robot.

        Raises:
            InvalidField: It was trained for another one; names what differs.
        """
        check_robot(robot, policy)
        self._policy = policy
        self._environment: EnvironmentSettings = environment_settings(policy.description.settings)
        self._scales = ObservationScales.of(robot, self._environment.units)
        self._actions = make_actions(robot, self._environment, self._scales)
        self._check_sizes(robot)
        period = policy.description.period
        self._in_motion = period is not None
        self.period = settings.period if period is None else period
        lag = float(robot.winch_lag.mean()) / self.period + 0.5  # [periods], of set-points
        target = lag if period is None else 1.0
        self._target = ReferenceRows.of([target])
        self._preview = ReferenceRows.of([1.0 + k for k in self._environment.preview])
        lead = lead_of(robot, self._environment) if self._in_motion else 0.0
        self._aim = ReferenceRows.of([target + lead / self.period])
        rows = [x.last_row for x in (self._target, self._preview, self._aim)]
        self._last_row = max(rows)
        self._fallback = ShapedFallback(robot, self.period)
        self.horizon = max(self.period * float(self._last_row), self._fallback.horizon)
        self._length: Array | None = None
        self._last_action = np.zeros((1, self._actions.size))
        self._mean_error = self._lasting_error = np.zeros((1, 3))

    @classmethod
    def build(
        cls, robot: Robot, settings: PolicySettings | None = None, *, seed: int = 0
    ) -> PolicyController:
        """Load the policy; it draws no random numbers, so `seed` has no effect.

        Raises:
            InvalidField: There is no policy for this robot, or it was trained for another one.
        """
        chosen = settings or PolicySettings()
        name = policy_of(robot) if chosen.policy is None else chosen.policy
        return cls(robot, Policy.load(find_policy(name)), chosen)

    @staticmethod
    def check_settings(settings: PolicySettings) -> None:
        """Refuse a policy that is not there, or is none, before a study begins."""
        if settings.policy is not None:
            Policy.load(find_policy(settings.policy))

    @staticmethod
    def check_robot(robot: Robot) -> None:
        """Refuse a robot for which no policy is bundled; studies ask before they choose `td3`.

        Raises:
            InvalidField: There is none, or it was trained for another robot of this name.
        """
        check_robot(robot, Policy.load(find_policy(policy_of(robot))))

    def reset(self, belief: Belief) -> None:
        """Forget the last action, and past errors."""
        from carosac_toolkit.physics.cable.straight_line import straight_length

        self._length = straight_length(self._robot, belief.position, belief.rotation).length
        self._last_action = np.zeros((len(belief.position), self._actions.size))
        self._mean_error = self._lasting_error = np.zeros((len(belief.position), 3))
        self._fallback.reset(self._length)

    @property
    def fallbacks(self) -> Mapping[str, int]:
        """Commands of input shaping since the last reset, by reason."""
        return dict(self._fallback.counts)

    def command(self, belief: Belief, reference: Reference) -> Command:
        """Return the lengths that the policy asks for, or those of input shaping.

        Where the belief is further from the reference than in training, or a target lies outside
        the workspace box, input shaping commands, and `fallbacks` counts it.

        Raises:
            InvalidField: The belief lacks what the policy observes, or the reference ends before
                the horizon.
            UnreachableReference: A target lies outside the box, where the robot cannot rest.
        """
        require_rows(reference, self.horizon, self.period)
        look = self._look(belief, reference)
        reasons = untrained_rows(look, self._scales, self._environment.lost)
        self._fallback.decide(reasons, belief)
        idle = self._fallback.active
        self._mean_error, self._lasting_error = (
            np.where(idle[:, None], 0.0, mean) for mean in (look.mean_error, look.lasting_error)
        )
        seen = observe(self._environment.observation, look, self._scales)
        seen[idle] = 0.0  # nothing is known of what the network does there
        self._last_action = self._actions.applied(self._policy.act(seen), look)
        self._last_action[idle] = 0.0
        length = self._actions.lengths(self._last_action, look)
        self._length = self._fallback.command(length, belief, reference, reasons)
        return Command(time=belief.time, unstrained_length=self._length)

    def _look(self, belief: Belief, reference: Reference) -> ObservationInputs:
        """Return what can be observed."""
        wanted = TWIST_PARTS & set(self._environment.observation)
        if belief.twist is None and wanted:
            allowed = (
                "that of an estimator that gives velocities, such as dynamic_estimator; the policy "
                f"observes {', '.join(sorted(wanted))}"
            )
            raise InvalidField("belief.twist", None, allowed)
        size = len(belief.position)
        target = self._target.rows(reference.position, size)[:, 0]
        velocity = self._target.rows(reference.velocity, size)[:, 0]
        assert self._length is not None
        due, due_velocity = target, velocity
        mean_error, lasting_error = self._mean_error, self._lasting_error
        if self._in_motion:
            due, due_velocity = reference.position[:, 0], reference.velocity[:, 0]
            error, environment = belief.position - due, self._environment
            mean_error = fading(mean_error, error, self.period, environment.memory)
            lasting_error = fading(lasting_error, error, self.period, environment.correction_memory)
        return ObservationInputs(
            position=belief.position, rotation=belief.rotation,
            twist=np.zeros((size, 6)) if belief.twist is None else belief.twist,
            length=self._length, due=due, due_velocity=due_velocity,
            target=target, target_velocity=velocity,
            target_acceleration=self._target.rows(reference.acceleration, size)[:, 0],
            aimed_acceleration=self._aim.rows(reference.acceleration, size)[:, 0],
            preview=self._preview.rows(reference.position, size),
            last_action=self._last_action, mean_error=mean_error, lasting_error=lasting_error,
        )  # fmt: skip

    def _check_sizes(self, robot: Robot) -> None:
        """Make sure that observation and action fit the networks."""
        self._robot = robot
        look = empty_look(robot, len(self._environment.preview), self._actions.size)
        seen = observe(self._environment.observation, look, self._scales).shape[1]
        pairs = (
            ("observation", seen, self._policy.observation_size),
            ("action", self._actions.size, self._policy.action_size),
        )
        for name, mine, theirs in pairs:
            if mine != theirs:
                raise InvalidField(f"policy.{name}", f"{theirs} numbers", f"{mine} numbers")


def check_robot(robot: Robot, policy: Policy) -> None:
    """Refuse a robot that a policy was not trained for.

    Raises:
        InvalidField: Names the fields that differ.
    """
    trained = policy.description.robot
    if trained.n != robot.n:
        raise InvalidField("robot", f"{robot.n} cables", f"{trained.n}, as the policy's robot")
    moving = policy.description.period is not None
    names = differing_fields(trained, robot, moving=moving)
    if names:
        allowed = f"{trained.name!r}, which the policy was trained for; {', '.join(names)} differ"
        raise InvalidField("robot", repr(robot.name), f"{allowed}: train one with `carosac train`")


def differing_fields(trained: Robot, robot: Robot, *, moving: bool) -> list[str]:
    """Return the names of the fields in which robots differ that a network depends on.

    Args:
        trained: The robot that it was trained for.
        robot: Another one.
        moving: Whether it was trained in real time, and depends on what makes motion, too.
    """
    needed = TRAINED_FIELDS + TRAINED_MOTION_FIELDS if moving else TRAINED_FIELDS
    trained, robot = (replace(each, cable_drag=cable_drag_of(each)) for each in (trained, robot))
    return [name for name in needed if not same(getattr(trained, name), getattr(robot, name))]


def untrained_rows(
    look: ObservationInputs, scales: ObservationScales, lost: float | None
) -> dict[int, str]:
    """Return which rows lie outside of what a policy was trained for, and why.

    Args:
        look: What is observed.
        scales: With the workspace box.
        lost: Distance from the reference at which training cut episodes short [m]: the platform or
            the estimator is lost there, and pushing on would make both worse; None: any.
    """
    reasons = {}
    outside = ~(np.abs(scales.to_unit(look.target)).max(axis=1) <= 1.0 + BOX_EXCESS_MAX)
    squares = ((look.position - look.due) ** 2).sum(axis=1)
    far = np.zeros_like(outside) if lost is None else ~(squares <= lost**2)
    if outside.any() or far.any():
        for k in np.flatnonzero(outside | far):
            reasons[int(k)] = OUTSIDE if outside[k] else FAR
    return reasons


def list_policies() -> tuple[str, ...]:
    """Return the names of the policies that come with the toolkit, sorted."""
    return list_bundled(POLICY_FOLDER)


def policy_of(robot: Robot) -> str:
    """Return the name of the bundled policy that a robot gets by default.

    Raises:
        InvalidField: There is none.
    """
    if robot.name not in DEFAULT_POLICIES:
        allowed = (
            f"a robot with a bundled policy, of {sorted(DEFAULT_POLICIES)}, or a policy of its own"
        )
        raise InvalidField("robot", repr(robot.name), f"{allowed}: `carosac train`")
    return DEFAULT_POLICIES[robot.name]


def find_policy(name_or_path: str) -> Path:
    """Find the file of a policy, a bundled one by its name; see `find_bundled`."""
    return find_bundled(name_or_path, POLICY_FOLDER)
