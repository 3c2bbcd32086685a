"""Report of several trainings: a table for each stage, and pictures."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from carosac_toolkit.base.tables import Rows, fit, terminal_width, wrapped
from carosac_toolkit.studies import Row
from learned.learning_curve import CURVE_COLUMNS, CURVE_FILE
from learned.pictures.sweep import sweep
from learned.pictures.training import curve_of, learning_curves
from learned.training import POLICY_FILE
from learned.training_study import TrainingRun, TrainingStudy

LABEL_WIDTH = 60  # characters of a variation
SHOWN_COLUMNS = (  # column, title, factor to its unit
    ("median_error_m", "median [mm]", 1e3), ("median_of_means_m", "of means [mm]", 1e3),
    ("p95_error_m", "p95 [mm]", 1e3), ("inconsistency_m", "incons. [mm]", 1e3),
    ("failed_paths", "failed paths", 1.0), ("cpu_seconds", "CPU [s]", 1.0),
)  # fmt: skip


def report(study: TrainingStudy, rows: Sequence[Row]) -> dict[str, Any]:
    """Print tables, draw pictures, and return all numbers.

    Args:
        study: The trainings.
        rows: What `TrainingStudy.run` returned.

    Returns:
        ``trainings``, each with its last scores by stage, and ``pictures``.
    """
    pairs = list(zip(study.trainings, rows, strict=True))
    groups: dict[str, list[tuple[TrainingRun, Row]]] = {}
    for training, row in pairs:
        groups.setdefault(training.variation, []).append((training, row))
    pictures: list[Path] = []
    for stage in study.trainings[0].stages:
        print("\n" + _table(stage, groups))
        pictures += _pictures(study, stage, groups)
    for training, row in pairs:
        if row["status"] != "ok":
            line = f"{training.place}: {row['status']}: {row['reason']}"
            print(wrapped(line, terminal_width()))
    print(f"\npolicies: {study.folder / _pattern(study)}")
    for picture in pictures:
        print(f"picture: {picture}")
    return {
        "trainings": [_data(study, training, row) for training, row in pairs],
        "pictures": pictures,
    }


def _table(stage: str, groups: dict[str, list[tuple[TrainingRun, Row]]]) -> str:
    """Format the scores of a stage: of each seed, or over the seeds of each variation."""
    if len(groups) == 1:
        (members,) = groups.values()
        lines = [(f"seed {training.seed}", [row]) for training, row in members]
        if len(members) > 1:
            lines.append(("over the seeds", [row for _, row in members]))
    else:
        lines = [(name, [row for _, row in members]) for name, members in groups.items()]
    header = (stage.replace("_", "-"), "trained", *(title for _, title, _ in SHOWN_COLUMNS))
    cells: Rows = []
    for name, of_line in lines:
        good = [row for row in of_line if row["status"] == "ok"]
        numbers = [_range(good, f"{stage}_{column}", factor) for column, _, factor in SHOWN_COLUMNS]
        cells.append((name, f"{len(good)} of {len(of_line)}", *numbers))
    return fit(
        header, cells, (1, *[1] * (len(SHOWN_COLUMNS) + 1)), terminal_width(), shown=LABEL_WIDTH
    )


def _range(rows: Sequence[Row], column: str, factor: float) -> str:
    """Format the median of a column over trainings, with its range; - without any."""
    values = [factor * float(row[column] or 0.0) for row in rows if row.get(column) is not None]
    if not values:
        return "-"
    middle = f"{np.median(values):.1f}"
    return middle if len(values) == 1 else f"{middle} ({min(values):.1f} to {max(values):.1f})"


def _pictures(
    study: TrainingStudy, stage: str, groups: dict[str, list[tuple[TrainingRun, Row]]]
) -> list[Path]:
    """Draw the curves of the seeds of each variation, and the variations side by side."""
    made: list[Path] = []
    name = stage.replace("_", "-")
    for members in groups.values():
        places = {training.seed: study.folder / training.place for training, _ in members}
        folders = {seed: place / stage for seed, place in places.items()}
        curves = []
        for seed, folder in folders.items():
            curve = curve_of(folder, f"seed {seed}") if (folder / CURVE_FILE).is_file() else None
            if curve is not None:
                curves.append(curve)
                learning_curves([curve], folder / "curve.png")
        if curves:
            made.append(next(iter(places.values())).parent / f"curves-{name}.png")
            learning_curves(curves, made[-1])
    errors = {
        label: [float(row[f"{stage}_median_error_m"]) for _, row in members  # type: ignore[arg-type]
                if row.get(f"{stage}_median_error_m") is not None]
        for label, members in groups.items()
    }  # fmt: skip
    if len(groups) > 1 and any(errors.values()):
        made.append(study.folder / f"sweep-{name}.png")
        sweep({label: values for label, values in errors.items() if values}, made[-1])
    return made


def _data(study: TrainingStudy, training: TrainingRun, row: Row) -> dict[str, Any]:
    """Return one training as data."""
    place = study.folder / training.place
    stages = {
        stage: {"policy": place / stage / POLICY_FILE, "folder": place / stage}
        | {name: row[f"{stage}_{name}"] for name in CURVE_COLUMNS}
        for stage in training.stages
        if row["status"] == "ok"
    }
    return {
        "seed": training.seed, "varied": dict(training.varied), "status": row["status"],
        "reason": row["reason"], "wall_time_s": row["wall_time_s"], "folder": place,
        "stages": stages,
    }  # fmt: skip


def _pattern(study: TrainingStudy) -> Path:
    """Return the place of the policies, with a name in capitals for what differs."""
    first = study.trainings[0]
    above = Path("VARIATION") if first.varied else Path()
    return above / "seedN" / first.stages[-1] / POLICY_FILE
