"""Rows of made-up studies, with errors that can be checked by hand."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from carosac_toolkit.studies import Case
from carosac_toolkit.studies.compare.results import StudyResults
from carosac_toolkit.studies.run.rows import Row, make_row

SETTINGS = {"driver": "quasi_static", "speed_max": 1.0}


def case(controller: str, seed: int = 0, trajectory: str = "circle", **other: Any) -> Case:
    names = {"robot": "carosac", "estimator": "truth", "sensors": "lengths"} | other
    return Case(
        controller=controller, seed=seed, trajectory=trajectory, settings=SETTINGS,
        **{"perturbation": "none"} | names,
    )  # fmt: skip


def good(which: Case, error: tuple[float, float, float], steps: int = 100, **more: Any) -> Row:
    """A case with these RMSEs per axis [m]; half of its steps are in the centre."""
    norm = float(np.linalg.norm(error))
    values = {f"tracking_rmse_{axis}_m": e for axis, e in zip("xyz", error, strict=True)}
    values |= {f"estimation_rmse_{axis}_m": 0.5 * e for axis, e in zip("xyz", error, strict=True)}
    values |= {
        "tracking_rmse_norm_m": norm, "estimation_rmse_norm_m": 0.5 * norm, "steps": steps,
        "tracking_centre_m": norm, "tracking_boundary_m": norm, "centre_steps": steps // 2,
        "residual_sway_m": 0.01, "limited": 3, "latency_p95_s": 1e-3, "completed": True,
        "command_rmse_m": 0.0, "series": None,
    }  # fmt: skip
    return make_row(which, "ok", wall_time=1.0, values=values | more)


def bad(which: Case, reason: str, status: Any = "failed") -> Row:
    return make_row(which, status, wall_time=1.0, reason=reason)


def diverged(which: Case, scale: float) -> Row:
    """A case that ran to its end, off by so much [m] that it has no score."""
    row = good(which, (scale, scale, scale), series=series(scale))
    return row | {"status": "diverged", "reason": "it was lost"}


def series(scale: float, rest: bool = True) -> str:
    """A course of 60 s on a circle, the last fifth at rest."""
    time = np.linspace(0.0, 60.0, 250)
    angle = np.minimum(time, 48.0 if rest else 60.0) / 8.0
    reference = np.column_stack([np.cos(angle), np.sin(angle), 2.0 + 0.02 * angle])
    position = reference + scale * np.column_stack([np.sin(3 * angle), np.cos(angle), angle / 9])
    belief = position + 0.5 * scale * np.column_stack([np.sin(angle), np.cos(angle), 0.0 * angle])
    channels = {"time_s": time, "reference_m": reference, "position_m": position}
    channels["belief_m"] = belief
    return json.dumps({name: np.round(x, 6).tolist() for name, x in channels.items()})


def study(rows: list[Row], folder: Path = Path("nowhere")) -> StudyResults:
    return StudyResults(rows=tuple(rows), folder=folder)


@dataclass(frozen=True)
class ModelSettings:
    """Settings of `ModelController`."""

    model: str = "model.onnx"


class ModelController:
    """A controller with a file that is not there."""

    Settings: ClassVar = ModelSettings

    @staticmethod
    def check_settings(settings: ModelSettings) -> None:
        Path(settings.model).read_bytes()

    @classmethod
    def build(cls, robot: Any, settings: Any = None, *, seed: int = 0) -> ModelController:
        return cls()


class PlainDriver:
    """A driver without settings and without truth."""

    @classmethod
    def build(cls, robot: Any, settings: None = None, *, seed: int = 0) -> PlainDriver:
        return cls()
