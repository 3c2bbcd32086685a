"""Several trainings on the study engine: seeds of a preset, and sweeps over its settings.

Each training is a case with a folder of its own, in which it goes on from its checkpoint if its
process dies. The rows of the study keep the last point of the learning curve of each stage.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.base.numbers import check_whole
from carosac_toolkit.physics.kernel_modules import compile_kernels
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.studies import Case, Row, run_cases
from carosac_toolkit.studies.run.cluster import default_workers
from carosac_toolkit.studies.run.folder import free_folder
from carosac_toolkit.studies.run.rows import CASE_STATUSES
from carosac_toolkit.studies.run.run_case import digest_of, robot_digest, robot_of
from learned.checkpoint import CHECKPOINT_FILE
from learned.learning_curve import CURVE_COLUMNS, CURVE_FILE, read_curve
from learned.presets import Stage, find_preset
from learned.setting_changes import changed, concerned, label_of
from learned.training import POLICY_FILE, TrainingJob, train

CASE_FUNCTION = "learned.training_study:train_case"
CPU_DEVICE = "cpu"  # of studies that do not say where
NO_PART = "none"  # of what a case of a study has and a training has not
TIME_LIMIT_S = 30 * 24 * 3600.0  # of one training
RETRIED_STATUSES = tuple(name for name in CASE_STATUSES if name != "ok")
RANDOM_STEPS_SHARE_MAX = 0.2  # of shortened trainings, at most, is random


@dataclass(frozen=True, kw_only=True)
class TrainingRun:
    """Stages of a preset, trained one after the other.

    Attributes:
        preset: Its name.
        robot: A bundled robot or a YAML file.
        stages: Names of those that are trained, in the order of the preset.
        seed: Of everything random.
        steps: Environment steps of each stage; None: those of the preset.
        fixed: What is changed in the preset, see `learned.setting_changes.Changes`.
        varied: The same, of a sweep.
        device: Warp device of the worlds.
    """

    preset: str
    robot: str
    stages: tuple[str, ...]
    seed: int = 0
    steps: int | None = None
    fixed: Mapping[str, Any] = field(default_factory=dict)
    varied: Mapping[str, Any] = field(default_factory=dict)
    device: str = CPU_DEVICE

    @property
    def name(self) -> str:
        """The preset, and what is changed in it."""
        return f"{self.fixed_name}-{self.variation}" if self.varied else self.fixed_name

    @property
    def fixed_name(self) -> str:
        """The same without what is varied."""
        return f"{self.preset}-{label_of(self.fixed)}" if self.fixed else self.preset

    @property
    def variation(self) -> str:
        """Short label of what is varied; empty without a sweep."""
        return label_of(self.varied)

    @property
    def place(self) -> Path:
        """Its folder in that of the study."""
        return Path(self.variation) / f"seed{self.seed}"

    def jobs(self, robot: Robot, folder: Path) -> list[TrainingJob]:
        """Return the jobs, stage by stage.

        Args:
            robot: As it was read.
            folder: Of all stages; each has a folder with its name in it.

        Raises:
            InvalidField: A change or a number of steps that is not allowed.
        """
        order = list(find_preset(self.preset).stages)
        changes = {**self.fixed, **self.varied}
        jobs = []
        for name, stage in self.settings().items():
            before = order[: order.index(name)]
            jobs.append(
                TrainingJob(
                    robot=robot,
                    preset=self.preset,
                    changes=label_of(concerned(name, order, changes)),
                    stage_name=name,
                    stage=stage,
                    seed=self.seed,
                    start=folder / before[-1] / CHECKPOINT_FILE if before else None,
                    start_changes=label_of(concerned(before[-1], order, changes)) if before else "",
                    device=self.device,
                )
            )
        return jobs

    def settings(self) -> dict[str, Stage]:
        """Return the settings of each stage.

        Raises:
            InvalidField: A change or a number of steps that is not allowed.
        """
        preset, stages = find_preset(self.preset), {}
        step_paths = {"td3.steps", *(f"{name}.td3.steps" for name in self.stages)}
        for path in sorted(step_paths & {**self.fixed, **self.varied}.keys()):
            if self.steps is not None:
                raise InvalidField("--steps", self.steps, f"nothing beside {path}")
        for name in self.stages:
            stage = changed(name, preset.stages[name], {**self.fixed, **self.varied})
            stages[name] = stage if self.steps is None else shortened(stage, self.steps)
        return stages

    def case(self) -> Case:
        """Return the training as a case of a study."""
        settings = {
            "preset": self.preset, "stages": list(self.stages), "steps": self.steps,
            "fixed": dict(self.fixed), "varied": dict(self.varied),
            "robot_digest": robot_digest(self.robot),
        }  # fmt: skip
        if self.device != CPU_DEVICE:
            settings["device"] = self.device
        return Case(
            robot=self.robot, controller=self.name, estimator=NO_PART, sensors=NO_PART,
            trajectory=NO_PART, perturbation=NO_PART, seed=self.seed, settings=settings,
        )  # fmt: skip

    @classmethod
    def of_case(cls, case: Case) -> TrainingRun:
        """Return the training that a case stands for."""
        values = {name: x for name, x in case.settings.items() if name != "robot_digest"}
        values["stages"] = tuple(values["stages"])
        return cls(robot=case.robot, seed=case.seed, **values)


@dataclass(frozen=True, kw_only=True)
class TrainingStudy:
    """Trainings that differ in seed and changes alone.

    Attributes:
        trainings: All different, those of one variation together.
        folder: Of the study; a second run with the same folder goes on.
    """

    trainings: tuple[TrainingRun, ...]
    folder: Path

    def run(
        self, *, workers: int | None = None, scheduler: str | None = None, progress: bool = True
    ) -> list[Row]:
        """Train what is not trained yet; what failed or crashed is tried again.

        Args:
            workers: Processes on this machine; 0 is this one; None is as many as there are cores.
            scheduler: Address of a dask scheduler whose workers see the same folder.
            progress: Whether to tell on standard error how far it is.

        Returns:
            A row per training: ``STAGE_NAME`` for each name of `CURVE_COLUMNS`,
            from the last point of the learning curve; None for what is not finite.

        Raises:
            CarosacError: As `carosac_toolkit.studies.run_cases`.
        """
        if workers is None and scheduler is None:
            workers = default_workers()
        if workers:
            for device in {training.device for training in self.trainings}:
                compile_kernels(("learned", "sim_warp"), device)
        gone = {x.case().identity for x in self.trainings if not self._has_policies(x)}
        return run_cases(
            [training.case() for training in self.trainings], CASE_FUNCTION, folder=self.folder,
            scheduler=scheduler, workers=workers, timeout=TIME_LIMIT_S, retry=RETRIED_STATUSES,
            again=gone, own_files=True, share=self.share, progress=progress,
        )  # fmt: skip

    def _has_policies(self, training: TrainingRun) -> bool:
        """Return whether all policies of a training exist; a removed one is trained again."""
        place = self.folder / training.place
        return all((place / stage / POLICY_FILE).is_file() for stage in training.stages)

    def share(self) -> float:
        """Return the share of all environment steps that is done, 0 to 1."""
        done, whole = 0.0, 0
        for training in self.trainings:
            for name, stage in training.settings().items():
                steps = stage.td3.steps
                curve = self.folder / training.place / name / CURVE_FILE
                rows = read_curve(curve) if curve.is_file() else []
                done += min(rows[-1]["steps"], steps) if rows else 0
                whole += steps
        return done / whole


def free_study(base: Path, trainings: Sequence[TrainingRun]) -> TrainingStudy:
    """Make a study in `base`, or in ``base-2``, ``base-3`` and so on where that is taken."""
    folder = free_folder(base, [training.case() for training in trainings])
    return TrainingStudy(trainings=tuple(trainings), folder=folder)


def train_case(case: Case, folder: Path) -> dict[str, Any]:
    """Train what a case stands for, or go on with it.

    Args:
        case: Of a `TrainingRun`.
        folder: Of the study.

    Returns:
        The row of `TrainingStudy.run`.
    """
    training = TrainingRun.of_case(case)
    place = folder / training.place
    row: dict[str, Any] = {}
    for job in training.jobs(robot_of(case.robot, digest_of(case)), place):
        train(job, place / job.stage_name)
        last = read_curve(place / job.stage_name / CURVE_FILE)[-1]
        values = {name: x if np.isfinite(x) else None for name, x in last.items()}
        row |= {f"{job.stage_name}_{name}": values[name] for name in CURVE_COLUMNS}
    return row


def shortened(stage: Stage, steps: int) -> Stage:
    """Return a stage of other length; its random steps are at most a fifth of it.

    Raises:
        InvalidField: No whole number of steps, or none.
    """
    check_whole("--steps", steps, 1)
    random = min(stage.td3.random_steps, int(RANDOM_STEPS_SHARE_MAX * steps))
    return replace(stage, td3=replace(stage.td3, steps=steps, random_steps=random))


def check_stages(stages: Sequence[str], preset: str) -> None:
    """Refuse a study of later stages alone: each training begins with nothing.

    Raises:
        InvalidField: A stage before one of them is missing.
    """
    order = list(find_preset(preset).stages)
    if list(stages) != order[: len(stages)]:
        first = order[0].replace("_", "-")
        allowed = f"{first} with it or alone: each training of a study begins with nothing"
        raise InvalidField("--stage", " ".join(x.replace("_", "-") for x in stages), allowed)
