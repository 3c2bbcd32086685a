"""Training of one stage: checkpoints, resuming, a learning curve and the exported policy.

A folder holds all of it: ``settings.json``, ``curve.csv``, ``episodes.csv``,
``checkpoint.safetensors``, TensorBoard's events and, at the end, ``policy.onnx``. A training that
was killed goes on from its checkpoint as if it had not been, bit by bit.
"""

from __future__ import annotations

import json
import shutil
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.delayed_signals import delayed_signals
from carosac_toolkit.base.errors import CarosacError
from carosac_toolkit.base.extras import require
from carosac_toolkit.base.files import missing_folders, remove_empty
from carosac_toolkit.base.scaled import resolved
from carosac_toolkit.base.tables import counted
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.reports.page import commit_of_code
from carosac_toolkit.robot.robot import Robot
from learned.belief_drives import learn_belief_errors
from learned.checkpoint import (
    CHECKPOINT_FILE,
    packages_of,
    read_checkpoint,
    refuse_old_checkpoint,
    refusing_damage,
    write_checkpoint,
)
from learned.environment import CableEnvironment, EnvironmentSettings
from learned.learning_curve import (
    CURVE_FILE,
    EPISODES_FILE,
    Episode,
    measured,
    read_curve,
    write_curve,
    write_episodes,
)
from learned.policy_file import PolicyDescription, write_policy
from learned.presets import Stage
from learned.scores import score
from learned.target_paths import TargetPath
from learned.training_record import (
    UNKNOWN_COMMIT,
    TrainingRecord,
    check_settings,
    check_start,
    digest,
)

POLICY_FILE = "policy.onnx"
TEST_SEED = 2_000_003  # of the paths on which the learning curve is measured
TEST_PATHS = 64
TEST_SET_POINTS = 40  # of a path of set-points
CURVE_POINTS_MAX = 40  # points of the learning curve, at most
CURVE_INTERVAL_MIN = 2_000  # between two of them, at least
CHECKPOINT_INTERVAL_S = 120.0
STOP_NOTICE = (
    "stopping after this step, with a checkpoint (Ctrl-C again: at once, without a new one)"
)

Report = Callable[[dict[str, float], float], None]
Tell = Callable[[str], None]


@dataclass(frozen=True, kw_only=True)
class TrainingJob:
    """Job of training one stage.

    Attributes:
        robot: The nominal robot.
        preset: Name of the preset.
        changes: What is changed in it, in short, for this stage or those before it.
        stage_name: Name of the stage.
        stage: Its settings.
        seed: Of everything random.
        start: Checkpoint of an earlier stage whose networks to start from, or None.
        start_changes: What that one must have been trained with; None: anything.
        device: Warp device of the worlds; the networks are trained on the CPU.
    """

    robot: Robot
    preset: str
    stage_name: str
    stage: Stage
    seed: int = 0
    start: Path | None = None
    changes: str = ""
    start_changes: str | None = None
    device: str = "cpu"

    @property
    def name(self) -> str:
        """The preset, and what is changed in it."""
        return f"{self.preset}-{self.changes}" if self.changes else self.preset

    def settings(self) -> dict[str, Any]:
        """Return all settings as JSON holds them, in the numbers of this robot."""
        environment = resolved(self.stage.environment, Scales(self.robot).ratios)
        start = None if self.start is None else f"{self.start.parent.name}/{self.start.name}"
        return {
            "preset": self.preset, "changes": self.changes, "stage": self.stage_name,
            "robot": self.robot.name,
            "robot_digest": digest(getattr(self.robot, f.name) for f in fields(self.robot)),
            "seed": self.seed, "start": start, "device": self.device,
            "environment": asdict(environment), "td3": asdict(self.stage.td3),
        }  # fmt: skip

    def settings_as_json(self) -> dict[str, Any]:
        """Return all settings as they are read back from a file: without tuples."""
        settings: dict[str, Any] = json.loads(json.dumps(self.settings()))
        return settings


def train(
    job: TrainingJob, folder: Path, *, report: Report | None = None, tell: Tell | None = None,
    stop_after: int | None = None,
) -> Path | None:  # fmt: skip
    """Train, or go on with what was begun in a folder.

    Args:
        job: What to train.
        folder: For everything; made if it is not there.
        report: Called with each point of the learning curve and the seconds left.
        tell: Called with what goes on, in words, many times a second.
        stop_after: End after so many environment steps, as if killed then; for tests.

    Returns:
        The exported policy, or None if stopped before the end.

    Raises:
        MissingExtra: The packages that train are not installed.
        InvalidField: The folder holds a training with other settings, or the checkpoint to start
            from is one of another robot, preset or seed.
        MissingFile: There is no checkpoint to start from.
    """
    require("training", "onnx", "safetensors", "stable_baselines3", "torch")
    import torch

    if _finished(job, folder):
        return folder / POLICY_FILE  # as the code that trained it wrote it
    torch.set_num_threads(1)  # small networks: a second thread costs more than it gives
    run = _Run(job, folder, report, tell)
    made = missing_folders(folder)
    try:
        run.begin()
    except CarosacError:
        if made:
            shutil.rmtree(folder, ignore_errors=True)
            remove_empty(made[1:])  # another training may have begun in one of them
        raise
    return run.export() if run.go(stop_after) else None


def _finished(job: TrainingJob, folder: Path) -> bool:
    """Return whether a folder holds the policy of all steps of this very training."""
    check_settings(job.settings_as_json(), folder)
    refuse_old_checkpoint(folder)
    if not all((folder / name).is_file() for name in (POLICY_FILE, CHECKPOINT_FILE, CURVE_FILE)):
        return False
    rows = read_curve(folder / CURVE_FILE)
    return bool(rows) and rows[-1]["steps"] >= job.stage.td3.steps


class _Run:
    """One training in one folder."""

    def __init__(
        self, job: TrainingJob, folder: Path, report: Report | None, tell: Tell | None = None
    ) -> None:
        from learned.td3 import build_model
        from learned.vector_environment import CableVecEnv

        self.job = job
        self.folder = folder
        self.report = report
        self.tell = tell or _say_nothing
        self.tell("making the worlds")
        td3, settings = job.stage.td3, job.stage.environment
        cables = CableEnvironment(
            job.robot, settings, size=td3.environments, seed=job.seed, device=job.device
        )
        self.model = build_model(job.stage, CableVecEnv(cables), job.seed)
        self.test = CableEnvironment(
            job.robot, curve_settings(settings), size=TEST_PATHS, seed=TEST_SEED,
            device=job.device,
        )  # fmt: skip
        cables.watch_paths(partial(self._tell_of_paths, "the training"))
        self.test.watch_paths(partial(self._tell_of_paths, "the learning curve"))
        self.cables = cables
        self.paths: list[TargetPath] = []
        self.fresh: dict[str, Any] = {}  # state of the test: the same disturbances each time
        self.rows: list[dict[str, float]] = []
        self.episodes: list[Episode] = []
        self.before = 0.0  # CPU seconds of earlier processes
        self.began = time.process_time()

    def _tell_of_paths(self, where: str, count: int) -> None:
        """Tell how many paths are drawn."""
        self.tell(f"{counted(count, 'path')} of {where} drawn")

    def _tell_of_drives(self, step: int, of: int) -> None:
        """Tell how far the drives behind the estimator are."""
        self.tell(f"step {step} of {of} behind the estimator, to learn how it errs")

    @property
    def spent(self) -> float:
        """CPU seconds of the training, its evaluations included [s]."""
        return self.before + time.process_time() - self.began

    @property
    def done(self) -> bool:
        """True once all steps are made."""
        return bool(self.model.num_timesteps >= self.job.stage.td3.steps)

    def begin(self) -> None:
        """Take up what is in the folder, or begin."""
        from stable_baselines3.common.logger import configure

        settings = self.job.settings_as_json()
        known = check_settings(settings, self.folder)
        checkpoint, earlier = self.folder / CHECKPOINT_FILE, None
        if self.job.start is not None and not checkpoint.exists():
            refuse_old_checkpoint(self.job.start.parent)
            earlier = check_start(settings, self.job.start, self.job.start_changes)
        self.folder.mkdir(parents=True, exist_ok=True)
        self.model.set_logger(configure(str(self.folder), ["tensorboard"]))
        self.test.reset()
        self.fresh = self.test.state()
        self.paths = self.test.first_paths(TEST_PATHS)
        if self.cables.lacks_errors:
            self.cables.take_errors(learn_belief_errors(
                self.job.robot, self.job.stage.environment, self.job.seed, device=self.job.device,
                watch=self._tell_of_drives,
            ))  # fmt: skip
        _, self.callback = self.model._setup_learn(self.job.stage.td3.steps)
        self.callback.init_callback(self.model)
        if checkpoint.exists():
            self._restore(checkpoint)
            self.record = known or TrainingRecord(settings=settings, commits=(UNKNOWN_COMMIT,))
            if not self.done:
                self.record = self.record.resumed(commit_of_code() or UNKNOWN_COMMIT)
        else:
            started = None if earlier is None else self._start_from(earlier)
            self.record = TrainingRecord(
                settings=settings,
                commits=(commit_of_code() or UNKNOWN_COMMIT,),
                started_from=started,
            )
        self.record.write(self.folder)
        self._write_tables()

    def go(self, stop_after: int | None) -> bool:
        """Train to the end; False if stopped before. Ctrl-C ends it with a checkpoint."""
        last = np.inf if stop_after is None else stop_after
        saved = time.monotonic()
        with delayed_signals(STOP_NOTICE) as called_off:
            while not self.done:
                self._advance()
                if called_off() or self.model.num_timesteps >= last:
                    self._save()
                    return False
                if time.monotonic() - saved > CHECKPOINT_INTERVAL_S:
                    self._save()
                    saved = time.monotonic()
            if not self.rows or self.rows[-1]["steps"] < self.model.num_timesteps:
                self._measure()
            (self.folder / POLICY_FILE).unlink(missing_ok=True)  # any is another training's
            self._save()
        return True

    def _advance(self) -> None:
        """Take one step of all environments, with the updates and reports due then."""
        from stable_baselines3.common.type_aliases import TrainFreq, TrainFrequencyUnit

        model, td3 = self.model, self.job.stage.td3
        assert model.env is not None and model.replay_buffer is not None
        model.collect_rollouts(
            model.env, self.callback, TrainFreq(1, TrainFrequencyUnit.STEP), model.replay_buffer,
            model.action_noise, learning_starts=model.learning_starts,
        )  # fmt: skip
        self._keep_episodes()
        self.tell(f"step {model.num_timesteps} of {td3.steps}")
        if model.num_timesteps > model.learning_starts:
            model.train(td3.gradient_steps, td3.batch_size)
        every = max(CURVE_INTERVAL_MIN, td3.steps // CURVE_POINTS_MAX)
        if model.num_timesteps // every > (model.num_timesteps - td3.environments) // every:
            self._measure()

    def export(self) -> Path:
        """Write the policy, with what was found last."""
        from learned.td3 import layers_of

        job, last = self.job, self.rows[-1]
        description = PolicyDescription(
            preset=job.name, robot=job.robot, observation=job.stage.environment.observation,
            action=job.stage.environment.action, period=job.stage.environment.path.period,
            settings=self.record.data(), seed=job.seed, steps=self.model.num_timesteps,
            commit=self.record.commit, scores={k: v for k, v in last.items() if np.isfinite(v)},
        )  # fmt: skip
        path = self.folder / POLICY_FILE
        write_policy(path, layers_of(self.model), job.stage.td3.activation, description)
        return path

    def act(self, observation: Array) -> Array:
        """Act by the policy without noise; it reads no truth, so that any stands there."""
        count, size = observation.shape
        total = size * (2 if self.job.stage.environment.truth else 1)
        seen = np.zeros((count, total), np.float32)
        seen[:, :size] = observation
        action, _ = self.model.predict(seen, deterministic=True)
        return action.astype(np.float64)

    def _keep_episodes(self) -> None:
        """Take over the episodes that ended."""
        buffer, steps = self.model.ep_info_buffer, self.model.num_timesteps
        assert buffer is not None
        self.episodes += [Episode(steps, float(one["r"]), int(one["l"])) for one in buffer]
        buffer.clear()

    def _measure(self) -> None:
        """Add a point to the learning curve."""
        self.test.restore(self.fresh)
        scores = score(self.test, self.act, self.paths).data(self.job.robot)
        before = self.rows[-1]["steps"] if self.rows else 0.0
        rewards = [one.reward for one in self.episodes if one.steps > before]
        row = {
            "steps": float(self.model.num_timesteps),
            "updates": float(self.model._n_updates),
            "cpu_seconds": self.spent,
            "reward": float(np.mean(rewards)) if rewards else float("nan"),
            **measured(scores),
        }
        self.rows.append(row)
        self._write_tables()
        for name, value in row.items():
            self.model.logger.record(f"curve/{name}", value)
        self.model.logger.dump(self.model.num_timesteps)
        if self.report is not None:
            share = self.model.num_timesteps / self.job.stage.td3.steps
            self.report(row, self.spent * max(1.0 / share - 1.0, 0.0))

    def _write_tables(self) -> None:
        """Write learning curve and episodes as they are now."""
        write_curve(self.folder / CURVE_FILE, self.rows)
        write_episodes(self.folder / EPISODES_FILE, self.episodes)

    def _save(self) -> None:
        """Write the checkpoint, as a whole or not at all, and the tables as they are in it."""
        from learned.td3 import state_of

        state = state_of(self.model) | {
            "rows": self.rows, "cpu_seconds": self.spent,
            "ended": np.array(self.episodes, dtype=np.float64).reshape(-1, len(Episode._fields)),
        }  # fmt: skip
        write_checkpoint(self.folder / CHECKPOINT_FILE, state)
        self._write_tables()

    def _restore(self, checkpoint: Path) -> None:
        """Go on from a checkpoint."""
        from learned.td3 import restore_state, state_of

        fresh = state_of(self.model)
        names = [*fresh, "rows", "ended", "cpu_seconds"]
        state = read_checkpoint(checkpoint, names, packages_of(fresh))
        with refusing_damage(checkpoint):
            self.rows = state["rows"]
            self.episodes = [Episode(int(k), float(r), int(n)) for k, r, n in state["ended"]]
            self.before = state["cpu_seconds"]
            restore_state(self.model, state)

    def _start_from(self, earlier: TrainingRecord) -> dict[str, Any]:
        """Take over the networks of an earlier stage; everything else starts anew."""
        from learned.td3 import take_networks

        assert self.job.start is not None
        state = read_checkpoint(self.job.start, ("parameters", "steps"), ())
        with refusing_damage(self.job.start):
            networks = take_networks(self.model, state)
        return earlier.as_start(self.job.settings()["start"], state["steps"], networks)


def _say_nothing(_: str) -> None:
    """Tell nobody."""


def curve_settings(settings: EnvironmentSettings) -> EnvironmentSettings:
    """Return the settings of the environment in which the learning curve is measured.

    Fewer set-points, no paths but those that are measured on, and all errors count. In real time
    no estimators, which would take longer than the training: beliefs err by a constant.
    """
    if settings.path.period is not None:
        return replace(
            settings, lost=None, truth=False, moving=settings.moving.without_estimator(),
            path=replace(settings.path, pool=TEST_PATHS),
        )  # fmt: skip
    return replace(settings, path=replace(settings.path, steps=TEST_SET_POINTS, pool=TEST_PATHS))
