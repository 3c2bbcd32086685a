"""Train a controller with TD3: all stages of a preset, one after the other.

Each stage goes to a folder of its own, with settings, learning curve, episodes, checkpoint and the
policy as an ONNX file. After an interruption the same command resumes from the last checkpoint as
if nothing had happened. TensorBoard shows the folder while it grows.

With --seeds or --vary it is a study: several trainings at once, on all cores or a dask cluster,
with one table and pictures of all of them. Exit status 1 means that some of them failed.

The policy runs on any driver as the controller td3: carosac compare --controllers td3
--set controller.td3.policy=FILE
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro

from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.base.numbers import check_whole
from carosac_toolkit.base.tables import counted, terminal_width, wrapped
from carosac_toolkit.cli.common import CommandResult, DefaultRobotOptions, OutputFolder
from carosac_toolkit.physics.device import check_device
from carosac_toolkit.reports.page import check_folder
from carosac_toolkit.robot.file import load_robot
from carosac_toolkit.studies.run.cluster import remote_client
from carosac_toolkit.studies.run.folder import MANIFEST_FILE
from learned.checkpoint import CHECKPOINT_FILE
from learned.commands.status_line import StatusLine
from learned.learning_curve import CURVE_FILE, read_curve
from learned.presets import Preset, PresetName, Stage, find_preset
from learned.setting_changes import check_changes, read_changes, read_variations
from learned.training import TrainingJob, train
from learned.training_record import SETTINGS_FILE
from learned.training_study import CPU_DEVICE, TrainingRun, TrainingStudy, check_stages, free_study

RESULTS_FOLDER = Path("carosac-results") / "train"


@dataclass(frozen=True, kw_only=True)
class Options(DefaultRobotOptions):
    """Options of ``carosac train``."""

    preset: PresetName = "carosac"
    """Preset of task and method."""
    stage: Annotated[tuple[str, ...], tyro.conf.arg(metavar="STAGE")] = ()
    """Only these stages, such as `no-sag` or `sag`; by default all of the preset, in order. A
    later stage starts from the one before it in the same folder."""
    steps: int | None = None
    """Environment steps of each stage, instead of the preset's: for a first look."""
    settings: Annotated[
        tuple[str, ...], tyro.conf.arg(name="set", metavar="SETTING"), tyro.conf.UseAppendAction
    ] = ()
    """Setting that replaces the preset's: td3.FIELD=VALUE or environment.FIELD=VALUE for all
    stages, with STAGE. in front for one; VALUE is JSON or text. May be given several times."""
    seeds: int | None = None
    """Number of trainings, with seeds from --seed upwards."""
    vary: Annotated[
        tuple[str, ...], tyro.conf.arg(metavar="SETTING"), tyro.conf.UseAppendAction
    ] = ()
    """Setting to vary, with a training for each value: td3.FIELD=[VALUE, VALUE, ...]. Given several
    times, all combinations are trained."""
    scheduler: str | None = None
    """With --seeds or --vary: address of a dask scheduler, such as tcp://host:8786, whose workers
    share the output folder."""
    workers: int | None = None
    """With --seeds or --vary: worker processes on this machine; 0 trains in this process; by
    default one per core."""
    device: str = CPU_DEVICE
    """Warp device of the worlds, such as cuda: a GPU pays off from hundreds of worlds, with --set
    td3.environments=NUMBER. Networks are trained on the CPU."""
    output: OutputFolder = None
    """Folder for all results; by default one in carosac-results/train. An interrupted training
    there is resumed."""


def run(options: Options) -> CommandResult:
    """Train the stages, once or many times."""
    preset = find_preset(options.preset)
    names, every = _stages(preset, options.stage), list(preset.stages)
    fixed = read_changes(options.settings, every)
    variations = read_variations(options.vary, every, fixed)
    for path in variations[0]:
        if path.split(".")[0] in set(every) - set(names):
            raise InvalidField("--vary", repr(path), "a setting of a stage that is trained")
    if options.seeds is not None:
        check_whole("--seeds", options.seeds, 1)
    check_whole("--seed", options.seed, 0)
    first = options.seed
    trainings = [
        TrainingRun(preset=preset.name, robot=options.robot, stages=tuple(names), seed=seed,
                 steps=options.steps, fixed=fixed, varied=varied, device=options.device)
        for varied in variations for seed in range(first, first + (options.seeds or 1))
    ]  # fmt: skip
    if options.scheduler is None:  # else that of the workers counts
        check_device(options.device)
    trainings[0].settings()  # wrong steps, before what comes of them
    check_changes(preset.stages, fixed, variations)
    if options.seeds is None and not options.vary:
        return _train_once(options, preset, trainings[0])
    return _train_all(options, preset, trainings)


def _stages(preset: Preset, asked: tuple[str, ...]) -> list[str]:
    """Return the names of the stages to train, in the order of the preset."""
    wanted = [name.replace("-", "_") for name in asked]
    for k, name in enumerate(wanted):
        if name not in preset.stages:
            allowed = f"one of {[x.replace('_', '-') for x in preset.stages]}"
            raise InvalidField("--stage", repr(asked[k]), allowed)
    return [name for name in preset.stages if name in wanted or not wanted]


def _train_once(options: Options, preset: Preset, training: TrainingRun) -> CommandResult:
    """Train once, in this process."""
    for name in ("workers", "scheduler"):
        if getattr(options, name) is not None:
            allowed = "nothing without --seeds or --vary"
            raise InvalidField(f"--{name}", getattr(options, name), allowed)
    robot = load_robot(options.robot)
    place = _name(options, training, robot.name, f"seed{options.seed}")
    folder = options.output or RESULTS_FOLDER / place
    if (folder / MANIFEST_FILE).exists():
        raise InvalidField("--output", f"'{folder}'", "a folder without a study in it")
    jobs = training.jobs(robot, folder)
    print(wrapped(f"{training.name}: {preset.summary}; robot {robot.name}, seed {options.seed}",
                  terminal_width()))  # fmt: skip
    data: dict[str, Any] = {"preset": training.name, "robot": robot.name, "folder": folder}
    stages = {job.stage_name: _train(job, folder / job.stage_name) for job in jobs}
    return CommandResult(data | {"stages": stages})


def _train_all(options: Options, preset: Preset, trainings: list[TrainingRun]) -> CommandResult:
    """Train many times, on the study engine."""
    from learned.commands.training_report import report

    check_stages(trainings[0].stages, preset.name)
    robot = load_robot(options.robot)
    if options.output is None:
        base = RESULTS_FOLDER / _name(options, trainings[0], robot.name, "study")
        study = free_study(base, trainings)
        if study.folder != base:
            print(wrapped(f"{base} holds other trainings, so these go elsewhere", terminal_width()))
    else:
        study = TrainingStudy(trainings=tuple(trainings), folder=options.output)
    check_folder("--output", study.folder)
    for name in trainings[0].stages:
        if (study.folder / name / SETTINGS_FILE).exists():
            allowed = "a folder without a single training in it"
            raise InvalidField("--output", f"'{study.folder}'", allowed)
    if options.scheduler is not None:
        with remote_client(options.scheduler):
            pass  # it answers, or nothing is written
    seeds = sorted({training.seed for training in trainings})
    which = f"seed {seeds[0]}" if len(seeds) == 1 else f"seeds {seeds[0]} to {seeds[-1]}"
    line = (
        f"{trainings[0].fixed_name}: {preset.summary}; robot {robot.name}, {which}: "
        f"{counted(len(trainings), 'training')} to {study.folder}"
    )
    print(wrapped(line, terminal_width()), flush=True)
    for job in trainings[0].jobs(robot, study.folder):
        _say_when_it_begins(job.stage)
    rows = study.run(workers=options.workers, scheduler=options.scheduler)
    data = {"preset": trainings[0].fixed_name, "robot": robot.name, "folder": study.folder}
    results = report(study, rows)
    complete = all(row["status"] == "ok" for row in rows)
    return CommandResult(data | results, status=0 if complete else 1)


def _train(job: TrainingJob, folder: Path) -> dict[str, Any]:
    """Train a stage and draw its curve."""
    from learned.pictures.training import curve_of, learning_curves

    print(f"\n{job.stage_name}: {job.stage.td3.steps} steps to {folder}")
    _say_when_it_begins(job.stage)
    print("     steps  updates  CPU [s]  median [mm]  of means [mm]  p95 [mm]  incons. [mm]  left")
    status = StatusLine()

    def report(row: dict[str, float], left: float) -> None:
        status.clear()
        _report(row, left)

    try:
        policy = train(job, folder, report=report, tell=status.tell)
    except KeyboardInterrupt:
        if (folder / CHECKPOINT_FILE).exists():
            print("stopped; the same command goes on from the last checkpoint", flush=True)
        raise
    finally:
        status.clear()
    assert policy is not None
    rows = read_curve(folder / CURVE_FILE)
    curve = curve_of(folder, f"seed {job.seed}")
    if curve is not None:
        learning_curves([curve], folder / "curve.png")
    print(f"policy: {policy}")
    return {"policy": policy, "folder": folder, **rows[-1]}


def _say_when_it_begins(stage: Stage) -> None:
    """Print from when on the policy changes, where its critics learn alone for a while."""
    if stage.td3.critic_first:
        begins = stage.td3.begins_to_change
        ends = "; these steps end before that" if stage.td3.steps <= begins else ""
        line = f"the policy stays as it begins up to step {begins}: critics learn first{ends}"
        print(wrapped(line, terminal_width()), flush=True)


def _report(row: dict[str, float], left: float) -> None:
    """Print a point of the learning curve; its errors are those before a path fails."""
    millimetres = [
        "-" if np.isnan(row[name]) else f"{1e3 * row[name]:.1f}"
        for name in ("median_error_m", "median_of_means_m", "p95_error_m", "inconsistency_m")
    ]
    minutes, seconds = divmod(round(left), 60)
    failed = f"  {row['failed_paths']:.0f} paths failed" if row["failed_paths"] else ""
    print(
        f"{row['steps']:10.0f} {row['updates']:8.0f} {row['cpu_seconds']:8.0f} "
        f"{millimetres[0]:>12} {millimetres[1]:>14} {millimetres[2]:>9} "
        f"{millimetres[3]:>13}  {minutes:2d}:{seconds:02d}{failed}",
        flush=True,
    )


def _name(options: Options, training: TrainingRun, robot: str, last: str) -> str:
    """Return the name of the default folder, with what differs from usual trainings."""
    parts = [training.fixed_name, robot, last]
    if options.device != CPU_DEVICE:
        parts.append(options.device.replace(":", ""))
    if options.steps is not None:
        parts.append(f"{options.steps}steps")
    return "-".join(parts)
