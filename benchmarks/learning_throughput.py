"""How fast environments step and networks learn, on one core."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from importlib.util import find_spec
from typing import Any

import numpy as np
import warp as wp

import carosac_toolkit as ct
from benchmarks.results import table
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.physics.cable import straight_line
from carosac_toolkit.physics.device import check_device
from carosac_toolkit.physics.rest import statics
from learned.environment import CableEnvironment, EnvironmentSettings
from learned.presets import Stage, find_preset
from learned.target_paths import TargetPath

TITLE = "Throughput of learned control"
GPU_TITLE = "Environments on a GPU"
GPU = "cuda"
ROBOT = "carosac"
WORLDS = (1, 64, 1024)
GPU_WORLDS = (256, 1024, 4096, 16384)
PATHS = 4  # of the pool: drawn before the clock starts
REPEATS = 5
AT_LEAST = 0.5  # [s] of CPU time in a repeat
NOISE = 0.01  # of actions in [-1, 1], one sigma: about 3 cm of length, 2 mm of displacement
PAPER = {"no_sag": 4.2, "settle": 0.52}  # training steps a second; it has no real time
ESTIMATED = "realtime, estimators"
STAGES = {
    "no_sag": ("paper", "no_sag"), "settle": ("paper", "sag"), "realtime": ("residual", "realtime"),
    ESTIMATED: ("residual", "realtime"),
}  # fmt: skip
PRESETS = (("paper", "no_sag"), ("carosac", "no_sag"), ("residual", "realtime"))
FILLED = 4096  # steps in the replay before updates are timed


class Walker:
    """Environments and actions as a trained policy would choose them, with noise."""

    def __init__(self, settings: EnvironmentSettings, size: int, device: str = "cpu") -> None:
        robot = ct.load_robot(ROBOT)
        small = replace(settings, path=replace(settings.path, pool=PATHS))
        self.environment = CableEnvironment(robot, small, size=size, seed=0, device=device)
        drawn: dict[int, TargetPath] = {}
        while len(drawn) < PATHS:
            self.environment.reset()
            drawn |= {id(path): path for path in self.environment.paths}
        self._actions = {name: self._lengths(path) for name, path in drawn.items()}
        self._step = np.zeros(size, dtype=int)
        self._rng = np.random.default_rng(1)
        self.failures, self.walked = 0, 0

    def step(self) -> None:
        """Act once in all of them."""
        environment = self.environment
        ahead = zip(environment.paths, self._step, strict=True)
        action = np.stack([self._actions[id(path)][k] for path, k in ahead])
        action += NOISE * self._rng.standard_normal(action.shape)
        found = environment.step(np.clip(action, -1.0, 1.0))
        self._step += 1
        self._step[found.truncated] = 0
        self.failures += int(found.failed.sum())
        self.walked += len(action)

    def _lengths(self, path: TargetPath) -> Array:
        """The action of each step: lengths of inverse kinematics, or no push."""
        environment, targets = self.environment, path.position[1:]
        if environment.settings.action == "push":
            return np.zeros((len(targets), environment.action_size))
        if environment.settings.world == "no_sag":
            length = straight_line.inverse_kinematics(environment.robot, targets)
        else:
            length = statics.inverse_kinematics(environment.robot, targets).unstrained_length
        return environment.scales.to_action(length)


def rate(
    call: Callable[[], object], count: int = 1, clock: Callable[[], float] = time.process_time
) -> float:
    """Calls a second by a clock, each counted so many times: the median of repeats."""
    call()
    found = []
    for _ in range(REPEATS):
        calls, start = 0, clock()
        while clock() - start < AT_LEAST:
            call()
            calls += 1
        found.append(count * calls / (clock() - start))
    return float(np.median(found))


def ratio(steps: float, name: str) -> str:
    """Of steps a second to those of the paper."""
    return f"{steps / PAPER[name]:,.0f}" if name in PAPER else "-"


def settings_of(name: str) -> EnvironmentSettings:
    """Of a world."""
    preset, stage = STAGES[name]
    found = find_preset(preset).stage(stage).environment
    if name != ESTIMATED:
        return found
    return replace(found, moving=replace(found.moving, estimator="dynamic_estimator"))


def throughput() -> str:
    """Both tables."""
    steps: dict[str, dict[int, float]] = {}
    failures, walked = 0, 0
    for name in STAGES:
        settings = settings_of(name)
        steps[name] = {}
        for size in WORLDS:
            walker = Walker(settings, size)
            steps[name][size] = rate(walker.step, size)
            failures += walker.failures
            walked += walker.walked
            print(name, size, f"{steps[name][size]:.0f} steps/s", flush=True)
    rows = [
        (name, *(f"{found[size]:,.0f}" for size in WORLDS), f"{PAPER.get(name, '-')}",
         *(ratio(found[size], name) for size in (WORLDS[0], WORLDS[-1])))
        for name, found in steps.items()
    ]  # fmt: skip
    header = (
        "world", *(f"steps/s, {size} world{'s' if size > 1 else ''}" for size in WORLDS),
        "paper, training steps/s", "ratio, 1 world", f"ratio, {WORLDS[-1]} worlds",
    )  # fmt: skip
    return (
        f"Robot `{ROBOT}`, CPU time of one core, medians of {REPEATS} repeats. Actions are those "
        "of a policy that has learned: inverse kinematics of the targets (no push in real time; "
        f"`{ESTIMATED}` has the dynamic estimator in each world) and noise of {NOISE:g} of their "
        "range; paths were drawn before, "
        f"episodes begin anew in that time; {100 * failures / walked:.2f} % of the steps failed. "
        "`settle` solves for the equilibrium that the paper's simulator probably had to wait for. "
        "The paper's figures count learning, too, and are of its own computer with a GPU; it has "
        "no `realtime`.\n\n"
        f"{table(header, rows)}\n\n{learning(steps)}"
    )


def on_gpu() -> str:
    """Environment steps a second, worlds on a GPU and on one core.

    Raises:
        InvalidField: There is no GPU.
    """
    check_device(GPU)
    rows = []
    for name in STAGES:
        settings = settings_of(name)
        for size in GPU_WORLDS:
            found = [
                rate(Walker(settings, size, device).step, size, time.perf_counter)
                for device in ("cpu", GPU)
            ]
            steps = [f"{one:,.0f}" for one in found]
            rows.append((name, f"{size:,}", *steps, f"{found[1] / found[0]:.1f}"))
            print(*rows[-1], flush=True)
    header = ("world", "worlds", "one core, steps/s", "GPU, steps/s", "ratio")
    return (
        f"Robot `{ROBOT}`, {wp.get_device(GPU).name}, wall-clock time, medians of {REPEATS} "
        "repeats, actions and paths as above; what is not the worlds (targets, observations, "
        f"rewards) is done by numpy on one core in both.\n\n{table(header, rows)}"
    )


def learning(steps: dict[str, dict[int, float]]) -> str:
    """Updates of the networks, and what both together come to."""
    for package in ("torch", "stable_baselines3"):
        if find_spec(package) is None:
            return f"Gradient steps were not measured: {package} is not installed."
    import torch

    torch.set_num_threads(1)
    rows = []
    updates: dict[str, float] = {}
    for preset, stage in PRESETS:
        found = trained(find_preset(preset).stage(stage))
        updates[preset] = found["updates"]
        rows.append(
            (preset, stage, f"{found['updates']:.0f}", found["each"], f"{found['steps']:,.0f}",
             f"{PAPER.get(stage, '-')}", ratio(found["steps"], stage))
        )  # fmt: skip
        print(*rows[-1], flush=True)
    for preset in ("paper", "carosac"):
        td3 = find_preset(preset).stage("sag").td3
        # SettledWorlds cost most of a step; what is around them is left out.
        size = min(WORLDS, key=lambda k: abs(k - td3.environments))
        share = td3.gradient_steps / td3.environments
        both = 1.0 / (1.0 / steps["settle"][size] + share / updates[preset])
        rows.append(
            (preset, "sag, from both rates", f"{updates[preset]:.0f}",
             f"{td3.gradient_steps} in {td3.environments}", f"{both:,.0f}",
             f"{PAPER['settle']:g}", ratio(both, "settle"))
        )  # fmt: skip
    header = ("preset", "stage", "gradient steps/s", "of them in environment steps",
              "training steps/s", "paper", "ratio")  # fmt: skip
    return table(header, rows)


def trained(stage: Stage) -> dict[str, Any]:
    """Gradient steps a second, and environment steps a second with them."""
    from stable_baselines3.common.logger import configure
    from stable_baselines3.common.type_aliases import TrainFreq, TrainFrequencyUnit

    from learned.td3 import build_model
    from learned.vector_environment import CableVecEnv

    td3 = replace(stage.td3, buffer_size=2 * FILLED, random_steps=0)
    settings = replace(stage.environment, path=replace(stage.environment.path, pool=PATHS))
    cables = CableEnvironment(ct.load_robot(ROBOT), settings, size=td3.environments, seed=0)
    model = build_model(replace(stage, td3=td3), CableVecEnv(cables), 0)
    model.set_logger(configure(None, []))
    _, callback = model._setup_learn(td3.steps)
    callback.init_callback(model)
    each = TrainFreq(1, TrainFrequencyUnit.STEP)

    def collect() -> None:
        assert model.env is not None and model.replay_buffer is not None
        model.collect_rollouts(
            model.env, callback, each, model.replay_buffer, model.action_noise, learning_starts=0
        )

    while model.num_timesteps < FILLED:
        collect()
    seconds = 1.0 / rate(collect)
    updates = rate(lambda: model.train(td3.gradient_steps, td3.batch_size), td3.gradient_steps)
    seconds += td3.gradient_steps / updates
    return {
        "updates": updates, "each": f"{td3.gradient_steps} in {td3.environments}",
        "steps": td3.environments / seconds,
    }  # fmt: skip
