"""Training of one stage: checkpoints, resuming, a learning curve and the exported policy.

A folder holds all of it: ``settings.json``, ``curve.csv``, ``checkpoint.pt``, TensorBoard's events
and, at the end, ``policy.onnx``. A training that was killed goes on from its checkpoint as if it
had not been, bit by bit.
"""

from __future__ import annotations

import csv
import hashlib
import json
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from carosac_toolkit.arrays import Array
from carosac_toolkit.errors import InvalidField, MissingFile
from carosac_toolkit.report_page import commit_of_code
from carosac_toolkit.robot import Robot
from learned.environment import CableEnvironment, EnvironmentSettings
from learned.episodes import Path as TargetPath
from learned.policy_file import PolicyDescription, write_policy
from learned.presets import Stage
from learned.scores import score

SETTINGS, CURVE, CHECKPOINT, POLICY = "settings.json", "curve.csv", "checkpoint.pt", "policy.onnx"
COLUMNS = (
    "steps", "updates", "cpu_seconds", "reward", "median_error_m", "median_of_means_m",
    "p95_error_m", "rmse_m", "inconsistency_m",
)  # fmt: skip
TEST_SEED = 2_000_003  # of the paths on which the learning curve is measured
TEST_PATHS = 64
TEST_STEPS = 40  # of a path of set-points
REPORTS = 40  # points of the learning curve, at most
REPORT_STEPS = 2_000  # between two of them, at least
CHECKPOINT_EVERY = 120.0  # [s]

Report = Callable[[dict[str, float], float], None]


@dataclass(frozen=True, kw_only=True)
class Job:
    """What to train.

    Attributes:
        robot: The nominal robot.
        preset: Name of the preset.
        stage_name: Name of the stage.
        stage: Its settings.
        seed: Of everything random.
        start: Checkpoint of an earlier stage whose networks to start from, or None.
    """

    robot: Robot
    preset: str
    stage_name: str
    stage: Stage
    seed: int = 0
    start: Path | None = None

    def settings(self) -> dict[str, Any]:
        """All settings as JSON holds them."""
        start = None if self.start is None else f"{self.start.parent.name}/{self.start.name}"
        return {
            "preset": self.preset, "stage": self.stage_name, "robot": self.robot.name,
            "robot_digest": digest(self.robot),
            "seed": self.seed, "start": start,
            "environment": asdict(self.stage.environment), "td3": asdict(self.stage.td3),
        }  # fmt: skip


def train(
    job: Job, folder: Path, *, report: Report | None = None, stop_after: int | None = None
) -> Path | None:
    """Train, or go on with what was begun in a folder.

    Args:
        job: What to train.
        folder: For everything; made if it is not there.
        report: Called with each point of the learning curve and the seconds left.
        stop_after: End after so many environment steps, as if killed then; for tests.

    Returns:
        The exported policy, or None if stopped before the end.

    Raises:
        InvalidField: The folder holds a training with other settings.
        MissingFile: There is no checkpoint to start from.
    """
    import torch

    torch.set_num_threads(1)  # small networks: a second thread costs more than it gives
    run = _Run(job, folder, report)
    run.begin()
    if not run.go(stop_after):
        return None
    return run.export()


class _Run:
    """One training in one folder."""

    def __init__(self, job: Job, folder: Path, report: Report | None) -> None:
        from learned.td3 import build_model
        from learned.vector_environment import CableVecEnv

        self.job = job
        self.folder = folder
        self.report = report
        td3, settings = job.stage.td3, job.stage.environment
        cables = CableEnvironment(job.robot, settings, size=td3.environments, seed=job.seed)
        self.model = build_model(job.stage, CableVecEnv(cables), job.seed)
        self.test = CableEnvironment(
            job.robot, curve_settings(settings), size=TEST_PATHS, seed=TEST_SEED
        )
        self.paths: list[TargetPath] = []
        self.fresh: dict[str, Any] = {}  # state of the test: the same disturbances each time
        self.rows: list[dict[str, float]] = []
        self.rewards: list[float] = []
        self.before = 0.0  # CPU seconds of earlier processes
        self.began = time.process_time()

    @property
    def spent(self) -> float:
        """CPU seconds of the training, its evaluations included [s]."""
        return self.before + time.process_time() - self.began

    def begin(self) -> None:
        """Take up what is in the folder, or begin."""
        from stable_baselines3.common.logger import configure

        self.folder.mkdir(parents=True, exist_ok=True)
        check_settings(self.job, self.folder)
        self.model.set_logger(configure(str(self.folder), ["tensorboard"]))
        self.test.reset()
        self.fresh = self.test.state()
        self.paths = self.test.first_paths(TEST_PATHS)
        total = self.job.stage.td3.steps
        _, self.callback = self.model._setup_learn(total)
        self.callback.init_callback(self.model)
        checkpoint = self.folder / CHECKPOINT
        if checkpoint.exists():
            self._restore(checkpoint)
        elif self.job.start is not None:
            self._start_from(self.job.start)

    def go(self, stop_after: int | None) -> bool:
        """Train to the end; False if stopped before."""
        from stable_baselines3.common.type_aliases import TrainFreq, TrainFrequencyUnit

        model, td3 = self.model, self.job.stage.td3
        each = TrainFreq(1, TrainFrequencyUnit.STEP)
        saved = time.monotonic()
        every = max(REPORT_STEPS, td3.steps // REPORTS)
        assert model.env is not None and model.replay_buffer is not None
        while model.num_timesteps < td3.steps:
            model.collect_rollouts(
                model.env, self.callback, each, model.replay_buffer,
                model.action_noise, learning_starts=model.learning_starts,
            )  # fmt: skip
            self._keep_rewards()
            if model.num_timesteps > model.learning_starts:
                model.train(td3.gradient_steps, td3.batch_size)
            if model.num_timesteps // every > (model.num_timesteps - td3.environments) // every:
                self._measure()
            if stop_after is not None and model.num_timesteps >= stop_after:
                self._save()
                return False
            if time.monotonic() - saved > CHECKPOINT_EVERY:
                self._save()
                saved = time.monotonic()
        if not self.rows or self.rows[-1]["steps"] < model.num_timesteps:
            self._measure()
        self._save()
        return True

    def export(self) -> Path:
        """Write the policy, with what was found last."""
        from learned.td3 import layers_of

        job, last = self.job, self.rows[-1]
        description = PolicyDescription(
            preset=job.preset, robot=job.robot, observation=job.stage.environment.observation,
            action=job.stage.environment.action, period=job.stage.environment.path.period,
            settings=job.settings(), seed=job.seed, steps=self.model.num_timesteps,
            commit=commit_of_code() or "", scores={k: v for k, v in last.items() if np.isfinite(v)},
        )  # fmt: skip
        path = self.folder / POLICY
        write_policy(path, layers_of(self.model), job.stage.td3.activation, description)
        return path

    def act(self, observation: Array) -> Array:
        """The policy without noise."""
        found, _ = self.model.predict(observation.astype(np.float32), deterministic=True)
        return found.astype(np.float64)

    def _keep_rewards(self) -> None:
        """Move the rewards of the episodes that ended to the curve."""
        buffer = self.model.ep_info_buffer
        assert buffer is not None
        self.rewards += [float(info["r"]) for info in buffer]
        buffer.clear()

    def _measure(self) -> None:
        """Add a point to the learning curve."""
        self.test.restore(self.fresh)
        found = score(self.test, self.act, self.paths).data(self.job.robot)
        row = {
            "steps": float(self.model.num_timesteps), "updates": float(self.model._n_updates),
            "cpu_seconds": self.spent,
            "reward": float(np.mean(self.rewards)) if self.rewards else float("nan"),
            "median_error_m": found["median_error_m"]["norm"],
            "median_of_means_m": found["median_of_trajectory_means_m"],
            "p95_error_m": found["p95_error_m"], "rmse_m": found["rmse_m"],
            "inconsistency_m": found["inconsistency_m"],
        }  # fmt: skip
        self.rewards = []
        self.rows.append(row)
        write_curve(self.folder / CURVE, self.rows)
        for name, value in row.items():
            self.model.logger.record(f"curve/{name}", value)
        self.model.logger.dump(self.model.num_timesteps)
        if self.report is not None:
            share = self.model.num_timesteps / self.job.stage.td3.steps
            self.report(row, self.spent * max(1.0 / share - 1.0, 0.0))

    def _save(self) -> None:
        """Write the checkpoint, as a whole or not at all."""
        import torch

        from learned.td3 import state_of

        state = state_of(self.model) | {
            "rows": self.rows, "rewards": self.rewards, "cpu_seconds": self.spent
        }  # fmt: skip
        part = self.folder / (CHECKPOINT + ".part")
        torch.save(state, part)
        part.replace(self.folder / CHECKPOINT)

    def _restore(self, checkpoint: Path) -> None:
        """Go on from a checkpoint."""
        import torch

        from learned.td3 import restore_state

        state = torch.load(checkpoint, weights_only=False)
        self.rows, self.rewards = state["rows"], state["rewards"]
        self.before = state["cpu_seconds"]
        restore_state(self.model, state)

    def _start_from(self, checkpoint: Path) -> None:
        """Take over the networks of an earlier stage; everything else starts anew."""
        import torch

        if not checkpoint.is_file():
            raise MissingFile(checkpoint, "train the earlier stage first")
        state = torch.load(checkpoint, weights_only=False)
        self.model.set_parameters(state["parameters"])


def digest(robot: Robot) -> str:
    """What stands for all numbers of a robot."""
    values = [getattr(robot, f.name) for f in fields(robot)]
    parts = [x.tobytes() if isinstance(x, np.ndarray) else repr(x).encode() for x in values]
    return hashlib.sha256(b"|".join(parts)).hexdigest()[:16]


def curve_settings(settings: EnvironmentSettings) -> EnvironmentSettings:
    """Settings of the environment in which the learning curve is measured.

    Fewer set-points, no paths but those that are measured on, and all errors count.
    """
    if settings.path.period is not None:
        return replace(settings, lost=None, path=replace(settings.path, pool=TEST_PATHS))
    return replace(settings, path=replace(settings.path, steps=TEST_STEPS, pool=TEST_PATHS))


def check_settings(job: Job, folder: Path) -> None:
    """Write the settings of a training, or make sure that they are those of the folder.

    Raises:
        InvalidField: They differ.
    """
    path = folder / SETTINGS
    mine = json.loads(json.dumps(job.settings()))
    if path.exists():
        theirs = json.loads(path.read_text(encoding="utf-8"))
        theirs.pop("commit", None)
        if theirs != mine:
            names = [name for name in mine if mine[name] != theirs.get(name)]
            allowed = f"a folder of the same settings; {', '.join(names)} differ"
            raise InvalidField("output", f"'{folder}'", allowed)
        return
    text = json.dumps(mine | {"commit": commit_of_code()}, indent=1)
    path.write_text(text + "\n", encoding="utf-8")


def write_curve(path: Path, rows: list[dict[str, float]]) -> None:
    """Write the learning curve as CSV."""
    with path.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, COLUMNS)
        writer.writeheader()
        writer.writerows({name: f"{row[name]:.6g}" for name in COLUMNS} for row in rows)


def read_curve(path: Path) -> list[dict[str, float]]:
    """Read what `write_curve` wrote."""
    with path.open(newline="", encoding="utf-8") as stream:
        return [{name: float(row[name]) for name in COLUMNS} for row in csv.DictReader(stream)]
