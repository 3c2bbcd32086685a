"""Samples of a validation as one file beside its report, for later figures."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from carosac_toolkit.base.npz import npz_bytes, read_npz
from carosac_toolkit.loop.values import Pose
from carosac_toolkit.robot.hardware import Hardware
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.validation.result import ModelResult, ValidationResult
from carosac_toolkit.validation.scores import rotation_angle, score_lengths, score_poses

SAMPLES_FILE = "samples.npz"
VALIDATION_KEY = "validation"
ROBOT_KEY_PREFIX = "robot."


def samples_bytes(result: ValidationResult) -> bytes:
    """Return the file's content: poses measured and modelled, length errors, the robot."""
    record = asdict(result.robot)
    arrays = {f"{ROBOT_KEY_PREFIX}{k}": v for k, v in record.items() if isinstance(v, np.ndarray)}
    robot = {k: v for k, v in record.items() if not isinstance(v, np.ndarray)}
    models: dict[str, dict[str, Any]] = {}
    for number, (name, model) in enumerate(result.models.items()):
        models[name] = {"reason": model.reason, "moves": model.moves, "number": number}
        if model.pose is None or model.converged is None or model.length_error is None:
            continue
        arrays |= {
            f"{number}.position": model.pose.position,
            f"{number}.rotation": model.pose.rotation,
            f"{number}.converged": model.converged,
            f"{number}.length_error": model.length_error,
        }
    arrays |= {
        "index": result.index, "time": result.time, "position": result.measured.position,
        "rotation": result.measured.rotation, "resting": result.resting,
        "rests": np.array(result.rests, dtype=np.int64).reshape(-1, 2),
    }  # fmt: skip
    rest = {
        "robot": robot, "models": models, "start": result.start, "stop": result.stop,
        "seed": result.seed, "warnings": list(result.warnings), "rest_speed": result.rest_speed,
        "starts_moving": result.starts_moving,
    }  # fmt: skip
    return npz_bytes(VALIDATION_KEY, rest, arrays)


def read_samples(folder: Path) -> ValidationResult:
    """Read the result, with the scores of all samples; diagnostics are not kept.

    Raises:
        MissingFile: There is no such file.
        InvalidField: ``carosac validate`` did not write it.
    """
    return read_npz(folder / SAMPLES_FILE, VALIDATION_KEY, "carosac validate", _result)


def _result(rest: dict[str, Any], arrays: dict[str, Any]) -> ValidationResult:
    """Build the result from the content of a file."""
    measured = Pose(position=arrays["position"], rotation=arrays["rotation"])
    fields = {
        k.removeprefix(ROBOT_KEY_PREFIX): v
        for k, v in arrays.items()
        if k.startswith(ROBOT_KEY_PREFIX)
    }
    record = rest["robot"] | fields
    return ValidationResult(
        robot=Robot(**record | {"hardware": Hardware.from_record(record["hardware"])}),
        start=rest["start"],
        stop=rest["stop"],
        seed=rest["seed"],
        index=arrays["index"],
        time=arrays["time"],
        measured=measured,
        resting=arrays["resting"],
        rests=tuple((int(a), int(b)) for a, b in arrays["rests"]),
        models={k: _model(k, known, arrays, measured) for k, known in rest["models"].items()},
        starts_moving=rest.get("starts_moving", False),
        rest_speed=rest.get("rest_speed"),
        warnings=tuple(rest["warnings"]),
    )


def _model(name: str, known: dict[str, Any], arrays: dict[str, Any], measured: Pose) -> ModelResult:
    """Read one model."""
    number = known["number"]
    if f"{number}.position" not in arrays:
        return ModelResult(name=name, reason=known["reason"])
    pose = Pose(position=arrays[f"{number}.position"], rotation=arrays[f"{number}.rotation"])
    good, length_error = arrays[f"{number}.converged"], arrays[f"{number}.length_error"]
    angle = rotation_angle(measured.rotation, pose.rotation)
    error = pose.position - measured.position
    return ModelResult(
        name=name,
        pose=pose,
        moves=known["moves"],
        converged=good,
        scores=score_poses(error[good], angle[good]),
        length_error=length_error,
        length_scores=score_lengths(length_error),
    )
