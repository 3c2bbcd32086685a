"""The environment: B robots that follow targets, one implementation behind all interfaces."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.base.numbers import check_fields, check_positive, check_whole
from carosac_toolkit.physics.cable import straight_line
from carosac_toolkit.physics.device import check_device
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.robot.robot import Robot
from learned.actions import Absolute, ActionMap, Push
from learned.belief_errors import BeliefErrorModel
from learned.moving_worlds import MovingSettings, MovingWorlds
from learned.observation import (
    ObservationInputs,
    ObservationScales,
    ObservationUnits,
    check_parts,
    fading,
    observe,
)
from learned.rewards import Reward, RewardSettings
from learned.target_paths import PathPool, PathSettings, TargetPath
from learned.transition import Transition
from learned.worlds import NoSagWorlds, SettledWorlds, TrainingWorlds, WorldStates

WorldName = Literal["no_sag", "settle", "realtime"]
FAILURE_REWARD = -1.0  # reward of a step without a solution; what came later is still valued


@dataclass(frozen=True, kw_only=True)
class EnvironmentSettings:
    """Settings of the environment in which a policy is trained.

    Attributes:
        world: ``no_sag``: straight cables; ``settle``: sagging ones, each set-point settles;
            ``realtime``: sagging ones on a platform that sways, with winches.
        observation: Parts, of `learned.observation.OBSERVATION_PARTS`.
        preview: How many steps ahead the later targets of the observation are.
        action: ``absolute``: lengths; ``push``: an acceleration that the cables give the platform
            beyond those of catenary inverse kinematics; see `learned.actions.Push`.
        reach: Largest push per axis [m/s^2].
        share: Of the way to the action that a push goes in a step.
        feedforward: Whether a push comes on top of the acceleration of the target.
        reward: Terms of the reward.
        path: How targets move.
        moving: Plants, winches and sensors of ``realtime``.
        units: What counts as 1 in an observation.
        memory: Time in which what `mean_error` of the observation remembers fades to 1 / e [s].
        correction: How many times what has long been off a push moves its target the other way [-],
            in real time; see `learned.actions.Push`.
        correction_memory: Time in which that fades to 1 / e [s].
        lost: Distance from the target beyond which an episode is cut short [m]; None: never.
        truth: Whether critics also see what would be observed if beliefs were true.
    """

    world: WorldName = "no_sag"
    observation: tuple[str, ...] = ("length", "position", "target")
    preview: tuple[int, ...] = ()
    action: Literal["absolute", "push"] = "absolute"
    reach: float = 3.0
    share: float = 1.0
    feedforward: bool = False
    reward: RewardSettings = field(default_factory=RewardSettings)
    path: PathSettings = field(default_factory=PathSettings)
    moving: MovingSettings = field(default_factory=MovingSettings)
    units: ObservationUnits = field(default_factory=ObservationUnits)
    memory: float = 1.0
    correction: float = 0.0
    correction_memory: float = 4.0
    lost: float | None = None
    truth: bool = False

    def __post_init__(self) -> None:
        """Refuse what does not fit together."""
        self._check_observation()
        if self.world not in ("no_sag", "settle", "realtime"):
            raise InvalidField("world", repr(self.world), "'no_sag', 'settle' or 'realtime'")
        if self.action not in ("absolute", "push"):
            raise InvalidField("action", repr(self.action), "'absolute' or 'push'")
        self._check_motion()
        if self.world == "realtime" and "fit" in self.reward.terms:
            allowed = "terms without 'fit', whose inconsistency is unknown in real time"
            raise InvalidField("reward.terms", self.reward.terms, allowed)
        if self.reward.slack > 0.0 and self.world != "settle":
            allowed = "0, but in world 'settle', whose lengths decide what cables pull with"
            raise InvalidField("reward.slack", self.reward.slack, allowed)
        for name in ("memory", "correction_memory"):
            check_positive(name, getattr(self, name), "s")
        check_fields(self, not_negative=("correction",))
        if self.correction > 0.0 and (self.world != "realtime" or self.action != "push"):
            allowed = "0, but with action 'push' in world 'realtime'"
            raise InvalidField("correction", self.correction, allowed)
        check_positive("reach", self.reach, "m/s^2")
        if not 0.0 < self.share <= 1.0:
            raise InvalidField("share", self.share, "0 < share <= 1")
        if self.lost is not None:
            check_positive("lost", self.lost, "m")

    def _check_motion(self) -> None:
        """Refuse what belongs to real time alone in other worlds."""
        if (self.world == "realtime") != (self.path.period is not None):
            allowed = "a number of seconds with world 'realtime', none with the others"
            raise InvalidField("path.period", self.path.period, allowed)
        if self.truth and self.world != "realtime":
            raise InvalidField("truth", self.truth, "False, but in world 'realtime'")
        if self.moving.estimator is not None and self.world != "realtime":
            allowed = "None, but in world 'realtime'"
            raise InvalidField("moving.estimator", repr(self.moving.estimator), allowed)

    def _check_observation(self) -> None:
        """Refuse parts that are not there."""
        check_parts(self.observation)
        for k, step in enumerate(self.preview):
            check_whole(f"preview[{k}]", step, 1)
        if ("preview" in self.observation) != bool(self.preview):
            allowed = "steps where the observation has the part 'preview', and only there"
            raise InvalidField("preview", self.preview, allowed)
        if "mean_error" in self.observation and self.world != "realtime":
            allowed = "parts without 'mean_error' where set-points settle"
            raise InvalidField("observation", self.observation, allowed)


@dataclass(frozen=True, kw_only=True, eq=False)
class StepResult:
    """Result of a step of B environments.

    Attributes:
        observation: Of the next step, after a reset where the episode ended, shape (B, d).
        final_observation: Of the state that the step ended in, shape (B, d).
        reward: Shape (B,).
        failed: Steps without a solution, shape (B,).
        truncated: Episodes that were cut short: at their last step, lost, or failed, shape (B,).
        transition: All quantities behind the reward.
        reached: Where the platforms were at the end of the step.
        final_truth: What `final_observation` would be if beliefs were true, shape (B, d); None
            where critics do not see it.
    """

    observation: Array
    final_observation: Array
    reward: Array
    failed: NDArray[np.bool_]
    truncated: NDArray[np.bool_]
    transition: Transition
    reached: WorldStates
    final_truth: Array | None


class CableEnvironment:
    """B environments that advance together; an episode that ends begins anew in the same step."""

    def __init__(
        self, robot: Robot, settings: EnvironmentSettings, *, size: int = 1, seed: int = 0,
        device: str = "cpu",
    ) -> None:  # fmt: skip
        """Make the worlds; call `reset` before `step`.

        Args:
            robot: The nominal robot.
            settings: What is learned in.
            size: B.
            seed: Of paths, plants and sensors.
            device: Warp device of the worlds: a GPU pays from hundreds of them on.

        Raises:
            InvalidField: The device is not there, or the robot has no place in the worlds.
        """
        check_device(device)
        self.robot = robot
        self.settings = settings
        self.size = size
        self._device = device
        self.scales = ObservationScales.of(robot, settings.units)
        self.worlds = _worlds(robot, settings, size, seed, device)
        self.actions = make_actions(robot, settings, self.scales, device)
        span = float(np.linalg.norm(robot.workspace_max - robot.workspace_min))
        self.reward = Reward(settings.reward, span)
        feasible = None if settings.world == "no_sag" else self._feasible
        self._pool = PathPool(robot, settings.path, seed, feasible)
        self._rng = np.random.default_rng([seed, 3])
        self._paths: list[TargetPath] = []
        self._targets = np.zeros((size, 1, 3, 3))  # of the paths, see `TargetPath.targets`
        self._step = np.zeros(size, dtype=np.int64)
        self._last_action = np.zeros((size, self.actions.size))
        self._mean_error = np.zeros((size, 3))
        self._lasting_error = np.zeros((size, 3))
        self._asked = np.zeros((size, robot.n))
        self._reached: WorldStates | None = None
        shapes = empty_look(robot, len(settings.preview), self.actions.size)
        self.observation_size = observe(settings.observation, shapes, self.scales).shape[1]

    @property
    def action_size(self) -> int:
        """Numbers of an action."""
        return self.actions.size

    @property
    def paths(self) -> tuple[TargetPath, ...]:
        """The targets of the present episodes."""
        return tuple(self._paths)

    @property
    def reached(self) -> WorldStates:
        """Where the platforms are.

        Raises:
            InvalidField: They were not put anywhere yet.
        """
        if self._reached is None:
            raise InvalidField("environment", "not reset yet", "reset before it is looked at")
        return self._reached

    def watch_paths(self, watch: Callable[[int], None] | None) -> None:
        """Call something with the number of paths after each that is drawn."""
        self._pool.watch = watch

    @property
    def lacks_errors(self) -> bool:
        """True if beliefs are to err by a model that is not there yet."""
        return isinstance(self.worlds, MovingWorlds) and self.worlds.lacks_errors

    def take_errors(self, model: BeliefErrorModel) -> None:
        """Let beliefs err by a model; before `reset`, where they are to."""
        assert isinstance(self.worlds, MovingWorlds), "others have no beliefs"
        self.worlds.take_errors(model)

    def first_paths(self, count: int) -> list[TargetPath]:
        """Return the first paths of the pool, all different."""
        return [self._pool.path(k) for k in range(count)]

    def reset(self, paths: list[TargetPath] | None = None) -> Array:
        """Begin an episode in every environment; first observations, shape (B, d).

        Args:
            paths: The targets, one path for each; None draws them.

        Raises:
            InvalidField: More or fewer paths than environments, or no model by which beliefs are to
                err.
        """
        if paths is not None and len(paths) != self.size:
            raise InvalidField("paths", f"{len(paths)} paths", f"{self.size}, one for each row")
        if self.lacks_errors:
            allowed = "those of learned.belief_drives.learn_belief_errors, by take_errors"
            raise InvalidField("environment.moving.modelled", "no model of the errors", allowed)
        self._paths = paths or [self._draw() for _ in range(self.size)]
        return self._begin(np.arange(self.size))

    def step(self, action: Array) -> StepResult:
        """Act once in every environment.

        Args:
            action: In [-1, 1], shape (B, a).
        """
        before = self._reached
        if before is None:
            raise InvalidField("environment", "not reset yet", "reset before step")
        look = self._look(before)
        applied = self.actions.applied(action, look)
        asked = self.actions.lengths(applied, look)
        reached = self.worlds.advance(asked)
        transition = self._transition(before, reached, look, asked, applied)
        reward = np.where(reached.failed, FAILURE_REWARD, self.reward(transition))
        self._step += 1
        self._last_action = np.array(applied)
        self._asked = np.array(asked)
        self._reached = reached
        final = self._observe(np.arange(self.size))
        final_truth = self.truth
        over = (self._step >= self.settings.path.steps) | self._is_lost(transition)
        truncated = over | reached.failed
        ended = np.flatnonzero(truncated)
        observation = final
        if len(ended):
            for row in ended:
                self._paths[row] = self._draw()
            observation = self._begin(ended)
        return StepResult(
            observation=observation, final_observation=final, reward=reward,
            failed=reached.failed, truncated=truncated, transition=transition,
            reached=reached, final_truth=final_truth,
        )  # fmt: skip

    @property
    def truth(self) -> Array | None:
        """What the last observation would be if beliefs were true, shape (B, d).

        None where critics do not see it. Means of errors are those of the belief.
        """
        if not self.settings.truth:
            return None
        look = self._look(replace(self.reached, belief=None))
        return observe(self.settings.observation, look, self.scales)

    def _is_lost(self, transition: Transition) -> NDArray[np.bool_]:
        """Return where the platform is too far from the target to learn anything from."""
        limit = np.inf if self.settings.lost is None else self.settings.lost
        return np.asarray(transition.distance > limit)

    def state(self) -> dict[str, Any]:
        """Return everything that changes; `restore` continues from there, bit for bit."""
        return {
            "worlds": self.worlds.state(), "paths": list(self._paths), "step": self._step.copy(),
            "last_action": self._last_action.copy(), "mean_error": self._mean_error.copy(),
            "lasting_error": self._lasting_error.copy(), "asked": self._asked.copy(),
            "reached": self._reached, "rng": self._rng.bit_generator.state,
        }  # fmt: skip

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from a state of an environment of the same settings and size."""
        self.worlds.restore(state["worlds"])
        self._paths = list(state["paths"])
        self._take_targets(np.arange(len(self._paths)))
        self._step = state["step"].copy()
        self._last_action = state["last_action"].copy()
        self._mean_error = state["mean_error"].copy()
        self._lasting_error = state["lasting_error"].copy()
        self._asked = state["asked"].copy()
        self._reached = state["reached"]
        self._rng.bit_generator.state = state["rng"]

    def _draw(self) -> TargetPath:
        """Draw the path of an episode."""
        return self._pool.path(int(self._rng.integers(self.settings.path.pool)))

    def _feasible(self, position: Array) -> NDArray[np.bool_]:
        """Return where the nominal robot can rest."""
        rest = statics.inverse_kinematics(self.robot, position, device=self._device)
        return rest.converged & rest.stable

    def _begin(self, rows: NDArray[Any]) -> Array:
        """Put environments at the start of their paths; observations of all."""
        self._take_targets(rows)
        start = np.stack([self._paths[row].position[0] for row in rows])
        self._reached = self.worlds.reset(rows, start)
        self._step[rows] = 0
        self._last_action[rows] = 0.0
        self._asked[rows] = self._reached.length[rows]
        self._mean_error[rows] = 0.0
        self._lasting_error[rows] = 0.0
        return self._observe(rows)

    def _observe(self, rows: NDArray[Any]) -> Array:
        """Observe before the next step; add the errors of some rows to their means first."""
        assert self._reached is not None
        look, period = self._look(self._reached), self.settings.path.period
        if period is not None:
            error = look.position - look.due
            for mean, memory in (
                (self._mean_error, self.settings.memory),
                (self._lasting_error, self.settings.correction_memory),
            ):
                mean[rows] = fading(mean, error, period, memory)[rows]  # the look shows the arrays
        return observe(self.settings.observation, look, self.scales)

    def _look(self, reached: WorldStates) -> ObservationInputs:
        """Return what can be observed before the next step."""
        ahead = [self._path_rows(step) for step in (1, *(1 + k for k in self.settings.preview))]
        due, aimed = ahead[0], ahead[0][2]
        if self.settings.path.period is not None:
            due, aimed = self._path_rows(0), self._aimed_acceleration(self.settings.path.period)
        seen = reached if reached.belief is None else reached.belief
        assert seen.twist is not None
        return ObservationInputs(
            position=seen.position, rotation=seen.rotation, twist=seen.twist,
            length=self._asked, due=due[0], due_velocity=due[1], target=ahead[0][0],
            target_velocity=ahead[0][1], target_acceleration=ahead[0][2],
            aimed_acceleration=aimed,
            preview=np.stack([rows[0] for rows in ahead[1:]], axis=1)
            if len(ahead) > 1 else np.zeros((self.size, 0, 3)),
            last_action=self._last_action, mean_error=self._mean_error,
            lasting_error=self._lasting_error,
        )  # fmt: skip

    def _aimed_acceleration(self, period: float) -> Array:
        """Return the target's acceleration when lengths asked for now have arrived, (B, 3)."""
        steps = 1.0 + lead_of(self.robot, self.settings) / period
        whole, share = int(steps), steps % 1.0
        aimed: Array = (1.0 - share) * self._path_rows(whole)[2]
        return aimed + share * self._path_rows(whole + 1)[2] if share > 0.0 else aimed

    def _path_rows(self, ahead: int) -> Array:
        """Return position, velocity and acceleration of targets some steps ahead, (3, B, 3)."""
        last = self._targets.shape[1] - 1
        rows = self._targets[np.arange(self.size), np.minimum(self._step + ahead, last)]
        return rows.transpose(1, 0, 2)

    def _take_targets(self, rows: NDArray[Any]) -> None:
        """Keep the targets of the paths of some environments where all are looked up at once."""
        for row in rows:
            targets = self._paths[row].targets()
            if (more := len(targets) - self._targets.shape[1]) > 0:
                self._targets = np.pad(self._targets, ((0, 0), (0, more), (0, 0), (0, 0)), "edge")
            self._targets[row, : len(targets)] = targets
            self._targets[row, len(targets) :] = targets[-1]

    def _transition(
        self,
        before: WorldStates,
        reached: WorldStates,
        look: ObservationInputs,
        asked: Array,
        applied: Array,
    ) -> Transition:
        moving = self.settings.world == "realtime"
        return Transition(
            robot=self.robot, target=look.target, position_before=before.position,
            position=reached.position, length_before=before.length, length=reached.length,
            asked=asked, inconsistency=reached.inconsistency, tension=reached.tension,
            velocity=reached.twist[:, :3] - look.target_velocity
            if moving else np.zeros((self.size, 3)),
            effort=self.actions.effort(applied),
            jerk=self.actions.effort(applied - self._last_action), failed=reached.failed,
        )  # fmt: skip


def empty_look(robot: Robot, previews: int, actions: int) -> ObservationInputs:
    """Return what a robot observes at rest at home, where it is to stay."""
    home, nothing = robot.home_position[None], np.zeros((1, 3))
    return ObservationInputs(
        position=home, rotation=robot.home_rotation[None], twist=np.zeros((1, 6)),
        length=straight_line.inverse_kinematics(robot, home), due=home, due_velocity=nothing,
        target=home, target_velocity=nothing, target_acceleration=nothing,
        aimed_acceleration=nothing, preview=np.repeat(home[:, None], previews, axis=1),
        last_action=np.zeros((1, actions)), mean_error=nothing, lasting_error=nothing,
    )  # fmt: skip


def make_actions(
    robot: Robot, settings: EnvironmentSettings, scales: ObservationScales, device: str = "cpu"
) -> ActionMap:
    """Make the map from actions to lengths; that of pushes is fitted on a Warp device."""
    if settings.action == "absolute":
        return Absolute(scales)
    return Push(
        robot,
        settings.reach,
        lead=lead_of(robot, settings),
        share=settings.share,
        feedforward=settings.feedforward,
        correction=settings.correction,
        device=device,
    )


def lead_of(robot: Robot, settings: EnvironmentSettings) -> float:
    """Return how far ahead of the target lengths are aimed [s]: the lag, less half a step."""
    return max(0.0, float(robot.winch_lag.mean()) - 0.5 * (settings.path.period or 0.0))


def _worlds(
    robot: Robot, settings: EnvironmentSettings, size: int, seed: int, device: str
) -> TrainingWorlds:
    """Make the worlds of some settings."""
    if settings.world == "no_sag":
        return NoSagWorlds(robot, size, device)
    if settings.world == "settle":
        return SettledWorlds(robot, size, device)
    period = settings.path.period
    assert period is not None
    return MovingWorlds(robot, settings.moving, period, size, seed, device)
