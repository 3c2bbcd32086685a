"""Reinforcement learning on top of a network that learned from MPC.

In the manner of TD3 with a pull to what MPC answers (TD3+BC): the network drives plants and tries
other tensions, two critics learn what comes of these, and the network goes where they see more
reward, as far as the answers of MPC let it. Critics see the truth that no controller sees: errors,
their change and those of the estimator.

References:
    Fujimoto, Gu, A minimalist approach to offline reinforcement learning, *NeurIPS*, 2021.
"""

from __future__ import annotations

import copy
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from multiprocessing.pool import Pool
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from baselines.mpc.settings import MpcSettings
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import CarosacError, InvalidField
from carosac_toolkit.base.extras import MissingExtra
from carosac_toolkit.base.scaled import resolved
from carosac_toolkit.loop.loop import run
from carosac_toolkit.loop.values import Belief, Command, Reference
from carosac_toolkit.physics.scales import Scales
from learned.approximate_mpc.controller import PlanFollower
from learned.approximate_mpc.demonstrations import (
    CALM_TIME,
    Demonstrations,
    DemonstrationSettings,
    Lost,
    build_drive,
    draw_drive,
)
from learned.approximate_mpc.plan_inputs import PlanNumbers, input_units, usual_tension
from learned.approximate_mpc.plan_network import PLAN_FILE_NAME, PlanNetwork, write_plan_network
from learned.approximate_mpc.rounds import is_held_out, layers_of
from learned.approximate_mpc.training import HUBER, SPREAD_MIN
from learned.policy_file import open_network
from learned.policy_network import Layers

SEEN_MAX = 10.0  # spreads from the mean at which a critic reads a number
CRITIC_WIDTH = 256
TRUTH_UNIT_M = 0.01  # [m] of errors, for critics; of their change in a command a tenth


@dataclass(frozen=True, kw_only=True)
class RefinementSettings:
    """Numbers of a refinement.

    Attributes:
        drives: In which other tensions are tried.
        tried: How far these are off, one sigma, of the weight per cable.
        kept: Share of that which stays from one command to the next.
        updates: Of the critics; of the network, half as many of those after `critics_first`.
        critics_first: Updates before the first one of the network.
        discount: Of a reward a command later.
        steps: Rewards that are summed before a critic says what comes.
        slack_price: Of a cable without tension, where its least tension is missing; 1 is that of
            the mean squared error.
        trust: Weight of the critics' answer, next to that of errors from MPC's answers.
        rate: Learning rate of the network.
        critic_rate: Of the critics at the start; it falls to a tenth.
        target_rate: Share of the way that the target networks go.
        batch: Samples of an update.
    """

    drives: int = 64
    tried: float = 0.05
    kept: float = 0.9
    updates: int = 12_000
    critics_first: int = 6_000
    discount: float = 0.98
    steps: int = 15
    slack_price: float = 1.0
    trust: float = 0.3
    rate: float = 1e-5
    critic_rate: float = 1e-3
    target_rate: float = 0.005
    batch: int = 256


@dataclass(frozen=True, kw_only=True, eq=False)
class Experience:
    """Commands of a drive.

    Attributes:
        numbers: That the network reads, shape (K, m).
        tension: That the follower was asked for [N], shape (K, n).
        truth: That critics see beside it: error, ten times its change, and the error of the belief,
            shape (K, 9).
        error: Distance from the reference [m], shape (K,).
        slack: Tension that cables lack, over the least one, summed, shape (K,).
        cpu_time: [s].
    """

    numbers: Array
    tension: Array
    truth: Array
    error: Array
    slack: Array
    cpu_time: float


class Trying:
    """The controller of a drive: a network whose tensions are varied."""

    Settings: ClassVar = MpcSettings

    def __init__(
        self, network: PlanNetwork, settings: RefinementSettings, rng: np.random.Generator
    ) -> None:
        robot = network.description.robot
        self._network, self._rng, self._kept = network, rng, settings.kept
        self._sigma = settings.tried * robot.weight / robot.n
        self._follower = PlanFollower(robot, network.settings, tension_share=network.tension_share)
        self._numbers = PlanNumbers(robot, network.settings.stages)
        self.period, self.horizon = self._follower.period, self._follower.horizon
        self._limits = robot.tension_min, robot.tension_max
        self.sent: list[tuple[Array, Array]] = []

    def reset(self, belief: Belief) -> None:
        """Start at rest where the belief says."""
        self._follower.reset(belief)
        self._off = np.zeros(len(self._limits[0]))

    def command(self, belief: Belief, reference: Reference) -> Command:
        """Return the lengths for the next period."""
        inputs, reason = self._follower.look(belief, reference)
        if reason:
            raise Lost(reason)
        numbers = self._numbers.of(inputs)
        tension, excess = self._network.plan(numbers)
        fresh = self._sigma * np.sqrt(1.0 - self._kept**2)
        self._off = self._kept * self._off + fresh * self._rng.standard_normal(len(tension))
        tension = np.clip(tension + self._off, *self._limits)
        self.sent.append((numbers.astype(np.float32), tension))
        lengths = self._follower.follow(inputs, tension, excess)
        return Command(time=belief.time, unstrained_length=lengths[None])


def try_out(
    file: Path, settings: RefinementSettings, demonstrations: DemonstrationSettings, seed: int,
    number: int,
) -> Experience | None:  # fmt: skip
    """Drive once; None: the drive was lost."""
    began = time.process_time()
    network = PlanNetwork.load(file)
    robot = network.description.robot
    ratios = Scales(robot).ratios
    chosen = resolved(demonstrations, ratios)
    rng = np.random.default_rng([seed, number, 17])
    path, plant = draw_drive(robot, chosen, rng)
    controller = Trying(network, settings, rng)
    driver, estimator = build_drive(robot, plant, chosen, path, controller.period, rng)
    duration = path.duration + CALM_TIME.of(ratios)
    try:
        log = run(driver, estimator, controller, path, duration=duration)
    except (InvalidField, MissingExtra):
        raise  # that is no matter of driving
    except CarosacError:
        return None
    assert log.position is not None and log.tension is not None
    error = (log.position - log.reference)[:, 0]
    change = np.diff(error, axis=0, prepend=error[:1])
    believed = (log.belief_position - log.position)[:, 0]
    missing = np.maximum(robot.tension_min - log.tension[:, 0], 0.0) / robot.tension_min
    numbers, tension = (np.array(values) for values in zip(*controller.sent, strict=True))
    return Experience(
        numbers=numbers[: len(error)], tension=tension[: len(error)],
        truth=np.hstack([error, 10.0 * change, believed]) / TRUTH_UNIT_M,
        error=np.linalg.norm(error, axis=1), slack=missing.sum(axis=1),
        cpu_time=time.process_time() - began,
    )  # fmt: skip


@dataclass(frozen=True, kw_only=True, eq=False)
class Samples:
    """What critics learn from, K samples.

    Attributes:
        seen: Numbers, over their spread, and the truth, shape (K, m + 9).
        tried: Tensions beyond those of the first network, over their sigma, shape (K, n).
        reward: Of the next commands, discounted, shape (K,).
        later: As `seen`, after these, shape (K, m + 9).
    """

    seen: Array
    tried: Array
    reward: Array
    later: Array


def samples_of(
    tries: Sequence[Experience], network: PlanNetwork, settings: RefinementSettings,
    middle: Array, spread: Array,
) -> Samples:  # fmt: skip
    """Return all samples; rewards are 1 - discount times those of a command."""
    robot = network.description.robot
    unit = settings.tried * robot.weight / robot.n
    typical = float(np.mean([(each.error**2).mean() for each in tries]))
    weights = settings.discount ** np.arange(settings.steps) * (1.0 - settings.discount)
    parts: list[tuple[Array, ...]] = []
    for each in tries:
        reward = -(each.error**2 / typical + settings.slack_price * each.slack)
        count = len(each.numbers) - settings.steps
        if count <= 0:
            continue
        ahead = np.lib.stride_tricks.sliding_window_view(reward[1:], settings.steps)[:count]
        seen = np.hstack([(each.numbers - middle) / spread, each.truth]).clip(-SEEN_MAX, SEEN_MAX)
        planned = np.array([network.plan(row)[0] for row in each.numbers[:count]])
        tried = (each.tension[:count] - planned) / unit
        parts.append((seen[:count], tried, ahead @ weights, seen[settings.steps :][:count]))
    seen, tried, reward, later = (np.concatenate(x) for x in zip(*parts, strict=True))
    return Samples(seen=seen, tried=tried, reward=reward, later=later)


def refine(
    file: Path,
    demonstrations: Sequence[Path],
    output: Path,
    *,
    settings: RefinementSettings,
    seed: int,
    pool: Pool,
) -> float:
    """Refine a network and write it; return the CPU time [s].

    Args:
        file: Of the network.
        demonstrations: Drives that it learned from.
        output: The new file.
        settings: Settings.
        seed: Of everything random.
        pool: Of processes that drive.
    """
    job = partial(try_out, file, settings, DemonstrationSettings(), seed)
    tries = [each for each in pool.map(job, range(settings.drives), chunksize=1) if each]
    began = time.process_time()
    network = PlanNetwork.load(file)
    answers = [
        Demonstrations.load(path) for k, path in enumerate(demonstrations) if not is_held_out(k)
    ]
    layers = _learned(file, network, answers, tries, settings, seed)
    description = network.description
    training = description.training | {"refining_drives": float(settings.drives)}
    write_plan_network(
        output, layers, replace(description, seed=seed, scores={}, training=training)
    )
    return sum(each.cpu_time for each in tries) + time.process_time() - began


def _learned(
    file: Path, network: PlanNetwork, answers: Sequence[Demonstrations],
    tries: Sequence[Experience], settings: RefinementSettings, seed: int,
) -> Layers:  # fmt: skip
    """Return the layers of the refined network."""
    import torch
    from torch.nn.functional import smooth_l1_loss

    torch.manual_seed(seed)
    torch.set_num_threads(1)
    description = network.description
    robot = description.robot
    n, scale = robot.n, description.tension_scale
    numbers = np.concatenate([each.numbers for each in answers]).astype(np.float64)
    wanted = np.concatenate([each.tension for each in answers]) - usual_tension(robot, numbers)
    least = SPREAD_MIN * input_units(robot, network.settings.stages)
    middle, spread = numbers.mean(axis=0), np.maximum(numbers.std(axis=0), least)
    data = samples_of(tries, network, settings, middle, spread)
    seen, tried, reward, later = (
        torch.tensor(x, dtype=torch.float32)
        for x in (data.seen, data.tried, data.reward[:, None], data.later)
    )
    asked = torch.tensor((numbers - middle) / spread, dtype=torch.float32)
    goal = torch.tensor(wanted / scale, dtype=torch.float32)
    read = asked.shape[1]
    unit = settings.tried * robot.weight / (n * scale)  # of what was tried, in outputs
    weight = robot.weight / (n * scale)
    actor = _perceptron(open_network(file, PLAN_FILE_NAME).layers, middle, spread)
    first, slow = copy.deepcopy(actor), copy.deepcopy(actor)
    critics = [_critic(seen.shape[1] + n) for _ in range(2)]
    slow_critics = copy.deepcopy(critics)
    parameters = [x for critic in critics for x in critic.parameters()]
    critic_steps = torch.optim.AdamW(parameters, settings.critic_rate, weight_decay=1e-2)
    actor_steps = torch.optim.Adam(actor.parameters(), settings.rate)
    falls = torch.optim.lr_scheduler.LinearLR(critic_steps, 1.0, 0.1, settings.updates)

    def beyond(policy: Any, states: Any) -> Any:
        """Return how far a policy is from the first one, as what was tried."""
        with torch.no_grad():
            base = first(states[:, :read])[:, :n]
        return (policy(states[:, :read])[:, :n] - base) / unit

    def value(critic: Any, states: Any, actions: Any) -> Any:
        return critic(torch.cat([states, actions], 1))

    for k in range(settings.updates):
        batch = torch.randint(len(seen), (settings.batch,))
        with torch.no_grad():
            ahead = later[batch]
            actions = beyond(slow, ahead)
            best = torch.minimum(*(value(critic, ahead, actions) for critic in slow_critics))
            target = reward[batch] + settings.discount**settings.steps * best
        off = [value(critic, seen[batch], tried[batch]) - target for critic in critics]
        loss = sum((x**2).mean() for x in off)
        critic_steps.zero_grad()
        loss.backward()
        critic_steps.step()
        falls.step()
        if k % 2:
            continue
        if k >= settings.critics_first:
            rows = torch.randint(len(asked), (settings.batch,))
            told = actor(asked[rows])
            with torch.no_grad():
                before = first(asked[rows])[:, n:]
            missed = (told[:, :n] - goal[rows]) / weight
            pull = smooth_l1_loss(missed, torch.zeros_like(missed), beta=HUBER)
            kept = 100.0 * ((told[:, n:] - before) ** 2).mean()  # sag and stretch stay as they are
            gain = value(critics[0], seen[batch], beyond(actor, seen[batch])).mean()
            actor_steps.zero_grad()
            (pull + kept - settings.trust * gain).backward()
            actor_steps.step()
        with torch.no_grad():
            for moving, still in zip([slow, *slow_critics], [actor, *critics], strict=True):
                for a, b in zip(moving.parameters(), still.parameters(), strict=True):
                    a.lerp_(b, settings.target_rate)
    return layers_of(actor, middle, spread)


def _perceptron(layers: Layers, middle: Array, spread: Array) -> Any:
    """Return a network in torch that reads numbers over their spread."""
    import torch

    modules: list[Any] = []
    for k, (weight, bias) in enumerate(layers):
        module = torch.nn.Linear(weight.shape[1], weight.shape[0])
        width, start = (spread, weight @ middle) if k == 0 else (1.0, 0.0)
        module.weight.data = torch.tensor(weight * width, dtype=torch.float32)
        module.bias.data = torch.tensor(bias + start, dtype=torch.float32)
        modules += [module, torch.nn.SiLU()]
    return torch.nn.Sequential(*modules[:-1], torch.nn.Tanh())


def _critic(inputs: int) -> Any:
    import torch

    width = CRITIC_WIDTH
    return torch.nn.Sequential(
        torch.nn.Linear(inputs, width), torch.nn.SiLU(), torch.nn.Linear(width, width),
        torch.nn.SiLU(), torch.nn.Linear(width, 1),
    )  # fmt: skip
