"""The paper's own training without sag, with one setting changed: does it get nearer to its figure?

Each training differs from preset `paper` in the settings of its row alone; its reward is the
published one in all of them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.results import table
from learned.learning_curve import CURVE_FILE, read_curve
from learned.training_study import TrainingRun, TrainingStudy

TITLE = "The paper's training, changed"
STAGE, ROBOT = "no_sag", "carosac"
STEPS, LONGER = 60_000, 100_000  # of a training; the first fifth is random
LAST_POINTS = 5  # of a curve
MM = 1e3
COLUMNS = ("median_error_m", "median_of_means_m", "p95_error_m", "inconsistency_m")
VARIATIONS: dict[str, Mapping[str, Any]] = {
    "as published": {},
    "discount 0": {"td3.discount": 0.0},
    "discount 0.9": {"td3.discount": 0.9},
    "target actions without much noise": {"td3.target_noise": 0.02},
    "critics learn as slowly as the actor": {"td3.critic_rate": 3e-4},
    "learning rates fall to 2 %": {"td3.rate_end": 0.02},
    "less exploration": {"td3.exploration.start": 0.05},
    "an episode ends 1 m off": {"environment.lost": 1.0},
    "scattered targets": {"environment.path.kind": "scatter"},
}
TOGETHER: dict[str, Mapping[str, Any]] = {
    "discount 0, rates that fall": {"td3.discount": 0.0, "td3.rate_end": 0.02},
}


def ablation(folder: Path, processes: int | None) -> str:
    """Train what is not trained yet, on the study engine, and make the section."""
    lines = []
    for variations, steps in ((VARIATIONS, STEPS), (TOGETHER, LONGER)):
        base = TrainingRun(preset="paper", robot=ROBOT, stages=(STAGE,), steps=steps)
        runs = [replace(base, varied=dict(changes)) for changes in variations.values()]
        study = TrainingStudy(trainings=tuple(runs), folder=folder / f"{steps}-steps")
        study.run(workers=processes)
        places = [study.folder / run.place / STAGE / CURVE_FILE for run in runs]
        lines += [
            line_of(name, steps, read_curve(place))
            for name, place in zip(variations, places, strict=True)
        ]
    header = (
        "preset `paper`", "steps", "CPU [min]", "median [mm]",
        f"the same of the last {LAST_POINTS} points of the curve", "the least of the curve",
        "median of the paths' means [mm]", "p95 [mm]", "inconsistency [mm]",
    )  # fmt: skip
    return (
        f"Robot `{ROBOT}`, stage `{STAGE}`, seed 0, the published reward; each row changes preset "
        "`paper` as it says. Last point of the learning curve: the policy without noise on 64 "
        "paths that no training follows, of 40 set-points each; scattered targets and episodes "
        "that end are tested as they are trained. The least of a curve is chosen on those paths. "
        "With fewer steps exploration falls sooner, and rates that fall do.\n\n"
        + table(header, lines)
    )


def line_of(name: str, steps: int, curve: Sequence[Mapping[str, float]]) -> list[str]:
    """Return the line of a training with some points of its learning curve."""
    last = curve[-1]
    medians = [MM * point["median_error_m"] for point in curve]
    minutes = f"{last['cpu_seconds'] / 60.0:.1f}"
    first, *others = [f"{MM * last[column]:.0f}" for column in COLUMNS]
    recent = f"{np.median(medians[-LAST_POINTS:]):.0f}"
    return [name, f"{steps:,}", minutes, first, recent, f"{min(medians):.0f}", *others]
