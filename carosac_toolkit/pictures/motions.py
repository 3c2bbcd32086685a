"""Motions of simulated runs as pictures need them: poses, and cables as they hang at each."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import CarosacError, InvalidField
from carosac_toolkit.base.rotations import to_matrix
from carosac_toolkit.physics.cable.shapes import hanging_cables
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.studies.run.case import CASE_COLUMNS, Case
from carosac_toolkit.studies.run.robot_copies import robot_of_row
from carosac_toolkit.studies.run.rows import Row
from carosac_toolkit.studies.run.run_case import plant_of

CABLE_SAMPLES = 24  # points of a drawn cable
SAMPLES_MIN = 2
SHARED = (*(name for name in CASE_COLUMNS if name != "controller"), "seed")
NEEDED = ("position_m", "quaternion", "tension_N", "unstrained_length_m")
Run = tuple[Row, Mapping[str, Any]]  # with its time series


@dataclass(frozen=True, kw_only=True, eq=False)
class Motion:
    """Motion of one simulated run, S samples of a robot with n cables.

    Attributes:
        controller: Name of its controller.
        estimator: Name of its estimator.
        sensors: Sensors of its driver.
        diverged: Whether its errors are too large to be a score.
        plant: Robot that moved: the one drawn from the condition, not the nominal one.
        time: From the start [s], shape (S,).
        reference: Platform origin asked for in W [m], shape (S, 3).
        position: True platform origin in W [m], shape (S, 3).
        rotation: True rotation from P to W, shape (S, 3, 3).
        tension: True tension at the platform [N], shape (S, n).
        cables: Points along each cable in W [m], shape (S, n, samples, 3), exit first.
    """

    controller: str
    estimator: str
    sensors: str
    diverged: bool
    plant: Robot
    time: Array
    reference: Array
    position: Array
    rotation: Array
    tension: Array
    cables: Array

    @property
    def error(self) -> Array:
        """Distance of the platform from its reference [m], shape (S,)."""
        return np.asarray(np.linalg.norm(self.position - self.reference, axis=1))

    def at(self, time: Array) -> Motion:
        """Return the samples at times, or just before them [s]."""
        rows = np.clip(np.searchsorted(self.time, time + 1e-9, side="right") - 1, 0, None)
        names = ("reference", "position", "rotation", "tension", "cables")
        parts = {name: getattr(self, name)[rows] for name in names}
        return replace(self, time=time, **parts)


def motions_of(folder: Path, rows: Sequence[Row], controllers: Sequence[str]) -> list[Motion]:
    """Return the motions of some controllers in the same case, whose time series was kept.

    The first of the cases that differ in the controller alone and were kept whole for all.

    Args:
        folder: Folder of the study.
        rows: Its rows.
        controllers: Names of controllers of the study.

    Raises:
        CarosacError: None of the runs of a controller was kept whole, or no such run is of the
            same case for all; or it has less than two samples.
    """
    whole = [_whole_runs(rows, name) for name in controllers]
    shared = next((key for key in whole[0] if all(key in runs for runs in whole)), None)
    if shared is None:
        raise CarosacError(
            f"{', '.join(controllers)} have no whole runs of the same {', '.join(SHARED)}"
        )
    return [_motion(folder, *runs[shared]) for runs in whole]


def _whole_runs(rows: Sequence[Row], controller: str) -> dict[tuple[str, ...], Run]:
    """Return the runs of a controller with all that a motion needs, by what must be the same."""
    runs: dict[tuple[str, ...], Run] = {}
    for row in rows:
        if row["controller"] != controller or row.get("series") is None:
            continue
        series: dict[str, Any] = json.loads(str(row["series"]))
        if all(series.get(name) is not None for name in NEEDED):
            runs.setdefault(tuple(str(row[name]) for name in SHARED), (row, series))
    if not runs:
        raise CarosacError(
            f"no run of {controller} has poses, tensions and lengths: it failed, its "
            "driver does not know them, or the study is of an earlier version"
        )
    return runs


def _motion(folder: Path, row: Row, series: Mapping[str, Any]) -> Motion:
    """Return the motion of a case from its time series."""
    time = np.array(series["time_s"])
    if len(time) < SAMPLES_MIN:
        controller, allowed = row["controller"], f"at least {SAMPLES_MIN}"
        raise InvalidField(f"samples of {controller}", str(len(time)), allowed)
    plant = plant_of(_case(row), robot_of_row(folder, row))
    quaternion = np.array(series["quaternion"])
    rotation = to_matrix(quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True))
    position = np.array(series["position_m"])
    length = np.array(series["unstrained_length_m"])
    hanging = hanging_cables(plant, position, rotation, length, samples=CABLE_SAMPLES)
    return Motion(
        controller=str(row["controller"]), estimator=str(row["estimator"]),
        sensors=str(row["sensors"]), diverged=row["status"] == "diverged", plant=plant,
        time=time - time[0], reference=np.array(series["reference_m"]), position=position,
        rotation=rotation, tension=np.array(series["tension_N"]), cables=hanging.points,
    )  # fmt: skip


def _case(row: Row) -> Case:
    """Return the case of a row."""
    names = {name: str(row[name]) for name in CASE_COLUMNS}
    settings = json.loads(str(row["settings"]))
    return Case(**names, seed=int(row["seed"] or 0), settings=settings)
