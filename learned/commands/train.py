"""Train a controller with TD3: all stages of a preset, one after the other.

Each stage goes to a folder of its own, with settings, learning curve, episodes, checkpoint and the
policy as an ONNX file. Interrupted or killed, the same command goes on from the last checkpoint as
if nothing had happened. TensorBoard shows the folder while it grows.

The policy runs on any driver as the controller td3: carosac compare --controllers td3
--set controller.td3.policy=FILE
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import tyro

from carosac_toolkit.cli.common import CommandResult, CommonOptions, OutputFolder
from carosac_toolkit.errors import InvalidField
from carosac_toolkit.number_checks import check_whole
from carosac_toolkit.robot import Robot
from carosac_toolkit.robot_file import load_robot
from carosac_toolkit.text_tables import terminal_width, wrapped
from learned.curve import CURVE, read_curve
from learned.presets import Preset, Stage, find_preset
from learned.training import CHECKPOINT, Job, train

RANDOM_SHARE = 0.2  # of shortened trainings, at most, is random


@dataclass(frozen=True, kw_only=True)
class Options(CommonOptions):
    """Options of ``carosac train``."""

    preset: str = "carosac"
    """What is learned, and how: `paper`, `carosac` or `residual`."""
    robot: str = "carosac"
    """A bundled robot or a YAML file."""
    stage: Annotated[tuple[str, ...], tyro.conf.arg(metavar="STAGE")] = ()
    """Only these stages, such as `no-sag` or `sag`; by default all of the preset, in their order. A
    later stage starts from the one before it in the same folder."""
    steps: int | None = None
    """Environment steps of each stage, instead of those of the preset: for a first look."""
    output: OutputFolder = None
    """Folder for all stages; by default one in carosac-results/train. What is there is gone on
    with."""


def run(options: Options) -> CommandResult:
    """Train the stages."""
    preset = find_preset(options.preset)
    robot = load_robot(options.robot)
    names = _stages(preset, options.stage)
    folder = options.output or _default_folder(options, robot)
    print(wrapped(f"{preset.name}: {preset.summary}; robot {robot.name}, seed {options.seed}",
                  terminal_width()))  # fmt: skip
    data: dict[str, Any] = {"preset": preset.name, "robot": robot.name, "folder": folder}
    stages: dict[str, Any] = {}
    for name in names:
        job = _job(options, preset, robot, name, folder)
        stages[name] = _train(job, folder / name)
    return CommandResult(data | {"stages": stages})


def _stages(preset: Preset, asked: tuple[str, ...]) -> list[str]:
    """Names of the stages to train, in the order of the preset."""
    wanted = [name.replace("-", "_") for name in asked]
    for k, name in enumerate(wanted):
        if name not in preset.stages:
            allowed = f"one of {[x.replace('_', '-') for x in preset.stages]}"
            raise InvalidField("--stage", repr(asked[k]), allowed)
    return [name for name in preset.stages if name in wanted or not wanted]


def _job(options: Options, preset: Preset, robot: Robot, name: str, folder: Path) -> Job:
    """A stage, with what it starts from."""
    earlier = list(preset.stages)[: list(preset.stages).index(name)]
    start = folder / earlier[-1] / CHECKPOINT if earlier else None
    stage = preset.stages[name]
    if options.steps is not None:
        check_whole("--steps", options.steps, 1)
        stage = shortened(stage, options.steps)
    return Job(
        robot=robot, preset=preset.name, stage_name=name, stage=stage, seed=options.seed,
        start=start,
    )  # fmt: skip


def shortened(stage: Stage, steps: int) -> Stage:
    """A stage of other length; its random steps are at most a fifth of it."""
    random = min(stage.td3.random_steps, int(RANDOM_SHARE * steps))
    return replace(stage, td3=replace(stage.td3, steps=steps, random_steps=random))


def _train(job: Job, folder: Path) -> dict[str, Any]:
    """Train a stage and draw its curve."""
    from learned.pictures.training import curve_of, learning_curves

    print(f"\n{job.stage_name}: {job.stage.td3.steps} steps to {folder}")
    print("     steps  updates  CPU [s]  median [mm]  of means [mm]  p95 [mm]  incons. [mm]  left")
    policy = train(job, folder, report=_report)
    assert policy is not None
    rows = read_curve(folder / CURVE)
    curve = curve_of(folder, f"seed {job.seed}")
    if curve is not None:
        learning_curves([curve], folder / "curve.png")
    print(f"policy: {policy}")
    return {"policy": policy, "folder": folder, **rows[-1]}


def _report(row: dict[str, float], left: float) -> None:
    """Print a point of the learning curve; its errors are those before a path fails."""
    millimetres = [
        1e3 * row[name]
        for name in ("median_error_m", "median_of_means_m", "p95_error_m", "inconsistency_m")
    ]
    minutes, seconds = divmod(round(left), 60)
    failed = f"  {row['failed_paths']:.0f} paths failed" if row["failed_paths"] else ""
    print(
        f"{row['steps']:10.0f} {row['updates']:8.0f} {row['cpu_seconds']:8.0f} "
        f"{millimetres[0]:12.1f} {millimetres[1]:14.1f} {millimetres[2]:9.1f} "
        f"{millimetres[3]:13.1f}  {minutes:2d}:{seconds:02d}{failed}",
        flush=True,
    )


def _default_folder(options: Options, robot: Robot) -> Path:
    """Where a training goes that was not sent anywhere; short ones apart from full ones."""
    parts = [options.preset, robot.name, f"seed{options.seed}"]
    if options.steps is not None:
        parts.append(f"{options.steps}steps")
    return Path("carosac-results") / "train" / "-".join(parts)
