"""Presets: what is learned, in which stages, with which numbers."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal

from carosac_toolkit.base.errors import InvalidField, did_you_mean
from carosac_toolkit.base.numbers import check_fields, check_whole
from learned.environment import EnvironmentSettings
from learned.exploration_settings import ExplorationSettings
from learned.moving_worlds import MovingSettings
from learned.rewards import PAPER_NO_SAG, PAPER_SAG, RewardSettings
from learned.target_paths import PathSettings

PresetName = Literal["paper", "carosac", "residual"]


@dataclass(frozen=True, kw_only=True)
class Td3Settings:
    """Numbers of TD3.

    Attributes:
        steps: Environment steps in all.
        environments: That advance together.
        gradient_steps: Updates after each step of all environments.
        random_steps: Environment steps with random actions before learning starts.
        batch_size: Samples of an update.
        buffer_size: Steps that replay keeps.
        discount: Of the reward a step later.
        actor_rate: Learning rate of the actor at the start.
        critic_rate: Learning rate of the critics at the start.
        rate_end: Share of the learning rates that is left at the end; they fall linearly.
        hidden: Sizes of the hidden layers.
        activation: Of the hidden layers.
        critics: How many; the smallest value counts.
        critic: ``value``: a network of observation and action; ``metric``: a learned distance, for
            the reward ``fit`` and a discount of 0 (`learned.metric_policy`).
        relabelled: Share of replayed steps with another target; needs the same.
        target_rate: Share of the way to the networks that the target networks go in an update.
        target_noise: Standard deviation of the noise on target actions, cut at 2.5 times that.
        exploration: Noise of the actions.
        critic_first: Updates of the critics before the first one of the actor.
        quiet_start: Whether the untrained policy does next to nothing, for actions that correct
            what is good already.
    """

    steps: int = 1_000_000
    environments: int = 1
    gradient_steps: int = 1
    random_steps: int = 20_000
    batch_size: int = 256
    buffer_size: int = 1_000_000
    discount: float = 0.99
    actor_rate: float = 3e-4
    critic_rate: float = 3e-3
    rate_end: float = 1.0
    hidden: tuple[int, ...] = (400, 300)
    activation: Literal["relu", "silu"] = "relu"
    critics: int = 2
    critic: Literal["value", "metric"] = "value"
    relabelled: float = 0.0
    target_rate: float = 0.005
    target_noise: float = 0.2
    exploration: ExplorationSettings = field(default_factory=ExplorationSettings)
    critic_first: int = 0
    quiet_start: bool = False

    @property
    def begins_to_change(self) -> int:
        """Environment steps up to which the policy stays as it begins: critics learn first."""
        if self.critic_first == 0:
            return self.random_steps
        rounds = -(-self.critic_first // self.gradient_steps)
        return self.random_steps + rounds * self.environments

    def __post_init__(self) -> None:
        """Refuse numbers that make no sense."""
        whole = ("steps", "environments", "gradient_steps", "batch_size", "buffer_size", "critics")
        for name in whole:
            check_whole(name, getattr(self, name), 1)
        for k, size in enumerate(self.hidden):
            check_whole(f"hidden[{k}]", size, 1)
        if not self.hidden:
            raise InvalidField("hidden", self.hidden, "one layer or more")
        check_whole("random_steps", self.random_steps, 0, self.steps - 1)
        check_whole("critic_first", self.critic_first, 0)
        check_fields(self, positive=("actor_rate", "critic_rate"), not_negative=("target_noise",))
        for name in ("discount", "rate_end", "relabelled"):
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise InvalidField(name, getattr(self, name), "0 to 1")
        if not 0.0 < self.target_rate <= 1.0:
            raise InvalidField("target_rate", self.target_rate, "0 < target_rate <= 1")
        choices = {"activation": ("relu", "silu"), "critic": ("value", "metric")}
        for name, allowed in choices.items():
            if getattr(self, name) not in allowed:
                raise InvalidField(name, repr(getattr(self, name)), f"one of {list(allowed)}")
        if self.discount > 0.0 and self.values_one_step:
            reason = "0 with a metric critic or relabelled steps, which value one step alone"
            raise InvalidField("discount", self.discount, reason)

    @property
    def values_one_step(self) -> bool:
        """True if critic or replay know the reward ``fit`` of a single step, and nothing else."""
        return self.critic == "metric" or self.relabelled > 0.0


@dataclass(frozen=True, kw_only=True)
class Stage:
    """One stage of training.

    Attributes:
        environment: What is learned in.
        td3: How.
    """

    environment: EnvironmentSettings
    td3: Td3Settings

    def __post_init__(self) -> None:
        """Refuse a critic that does not know the reward, or that cannot see the truth."""
        if self.environment.truth and self.td3.critic != "value":
            raise InvalidField("critic", repr(self.td3.critic), "'value', as critics see the truth")
        if not self.td3.values_one_step:
            return
        environment = self.environment
        why = "with a metric critic or relabelled steps"
        if environment.reward.terms != ("fit",):
            raise InvalidField("reward.terms", environment.reward.terms, f"('fit',) {why}")
        if environment.world == "realtime":
            raise InvalidField("world", "'realtime'", f"'no_sag' or 'settle' {why}")
        moving = {"error", "preview", "target_velocity", "target_acceleration"} & set(
            environment.observation
        )
        if "target" not in environment.observation or moving:
            allowed = f"with 'target', without {sorted(moving)}, {why}"
            raise InvalidField("observation", environment.observation, allowed)


@dataclass(frozen=True, kw_only=True)
class Preset:
    """Stages in the order in which they are trained; each starts from the policy before it.

    Attributes:
        name: For the command line.
        summary: One line.
        stages: By name.
    """

    name: str
    summary: str
    stages: dict[str, Stage]

    def stage(self, name: str) -> Stage:
        """Find a stage by its name.

        Raises:
            InvalidField: There is none of that name.
        """
        if name not in self.stages:
            raise InvalidField("stage", repr(name), f"one of {list(self.stages)}")
        return self.stages[name]


def find_preset(name: str) -> Preset:
    """Find a preset by its name.

    Raises:
        InvalidField: There is none of that name.
    """
    if name not in PRESETS:
        allowed = f"one of {list(PRESETS)}{did_you_mean(name, list(PRESETS))}"
        raise InvalidField("preset", repr(name), allowed)
    return PRESETS[name]


_PAPER = Td3Settings()  # 5000 episodes of 200 steps, the first 100 at random
_PAPER_SAG = replace(_PAPER, steps=30_000, random_steps=3_000)

_FIT = Td3Settings(
    steps=600_000, environments=64, gradient_steps=8, random_steps=20_000, discount=0.0,
    actor_rate=1e-3, critic_rate=1e-3, rate_end=0.02, hidden=(128, 128, 128), activation="silu",
    critics=1, critic="metric", relabelled=0.8,
)  # fmt: skip
_FIT_SAG = replace(_FIT, steps=600_000, random_steps=0, exploration=ExplorationSettings(
    start=0.02, end=0.002))  # fmt: skip
_FIT_REWARD = RewardSettings(terms=("fit",))
_FIT_SAG_REWARD = replace(_FIT_REWARD, slack=2.0, reserve=0.1)
_DAMP = Td3Settings(
    steps=400_000, environments=256, gradient_steps=24, random_steps=0, discount=0.98,
    actor_rate=5e-4, critic_rate=1e-3, rate_end=0.05, hidden=(128, 128), activation="silu",
    critics=1, target_rate=0.02, target_noise=0.05,
    exploration=ExplorationSettings(start=0.2, end=0.01), critic_first=1000, quiet_start=True,
)  # fmt: skip

PRESETS = {
    preset.name: preset
    for preset in (
        Preset(
            name="paper",
            summary="as in the CaRoSaC paper",
            stages={
                "no_sag": Stage(
                    environment=EnvironmentSettings(
                        reward=RewardSettings(terms=PAPER_NO_SAG), path=PathSettings(pool=5000)
                    ),
                    td3=_PAPER,
                ),
                "sag": Stage(
                    environment=EnvironmentSettings(
                        world="settle",
                        reward=RewardSettings(terms=PAPER_SAG),
                        path=PathSettings(steps=30),
                    ),
                    td3=_PAPER_SAG,
                ),
            },
        ),
        Preset(
            name="carosac",
            summary="absolute lengths, learned to millimetres: metric critic and hindsight",
            stages={
                "no_sag": Stage(
                    environment=EnvironmentSettings(
                        observation=("target",),
                        reward=_FIT_REWARD,
                        path=PathSettings(kind="scatter"),
                    ),
                    td3=_FIT,
                ),
                "sag": Stage(
                    environment=EnvironmentSettings(
                        world="settle",
                        observation=("target",),
                        reward=_FIT_SAG_REWARD,
                        path=PathSettings(kind="scatter", steps=30),
                    ),
                    td3=_FIT_SAG,
                ),
            },
        ),
        Preset(
            name="residual",
            summary="corrects catenary inverse kinematics with pushes that damp the sway",
            stages={
                "realtime": Stage(
                    environment=EnvironmentSettings(
                        world="realtime",
                        observation=(
                            "error",
                            "velocity_error",
                            "tilt",
                            "turn",
                            "last_action",
                            "mean_error",
                        ),
                        action="push",
                        reach=1.5,
                        share=0.25,
                        feedforward=True,
                        correction=2.0,
                        correction_memory=6.0,
                        reward=RewardSettings(
                            terms=("tracking", "effort", "jerk"), effort=0.3, jerk=5.0
                        ),
                        moving=MovingSettings(cables="particles"),  # fast modes count, too
                        lost=0.5,
                        path=PathSettings(
                            kind="minimum_snap",
                            speed=(0.5, 2.08),
                            acceleration_max=3.0,
                            steps=400,
                            period=0.025,
                            pool=256,
                        ),
                    ),
                    td3=_DAMP,
                ),
            },
        ),
    )
}
