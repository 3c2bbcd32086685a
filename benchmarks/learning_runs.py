"""Trainings that ``carosac train --output RUNS/NAME-SEED`` left behind: curves and bars."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.results import table
from learned.evaluation import (
    evaluate,
    evaluate_inverse_kinematics,
    rmse_ratio,
    slack_at_rest,
)
from learned.learning_curve import CURVE_FILE, read_curve
from learned.pictures.training import curve_of, learning_curves
from learned.policy_file import Policy
from learned.scores import PolicyScores
from learned.training import POLICY_FILE
from learned.training_record import SETTINGS_FILE

FOLDER = Path(__file__).parent
MM = 1e3
SEED = 999  # of paths that no training has seen
PAPER_NO_SAG = 0.027  # [m]
PAPER_SAG = (0.013, 0.014, 0.012)  # [m], median |error| of each axis
LIMIT_MEDIAN, LIMIT_P95, LIMIT_MINUTES = 0.015, 0.040, 20.0  # of `carosac` without sag
LIMIT_INCONSISTENCY = 0.03  # [m]
LIMIT_SAG_MINUTES = 60.0
LIMIT_RATIO = 0.6  # of catenary inverse kinematics
PATHS = {"no-sag": 1000, "settle": 20, "realtime": 20}


@dataclass(frozen=True, kw_only=True)
class Training:
    """One stage of one training.

    Attributes:
        name: Its folder, without the stage.
        folder: Of the stage.
        settings: As they were written.
        rows: Of the learning curve.
    """

    name: str
    folder: Path
    settings: dict[str, Any]
    rows: list[dict[str, float]]

    @property
    def key(self) -> tuple[str, str, str]:
        """Robot, preset, stage."""
        return (self.settings["robot"], self.settings["preset"], self.settings["stage"])

    @property
    def world(self) -> str:
        """In which it was trained."""
        return str(self.settings["environment"]["world"])

    @property
    def finished(self) -> bool:
        """Whether there is a policy."""
        return (self.folder / POLICY_FILE).is_file()

    @property
    def minutes(self) -> float:
        """CPU time of this stage so far [min]."""
        return self.rows[-1]["cpu_seconds"] / 60.0


def find_trainings(runs: Sequence[Path]) -> list[Training]:
    """All stages in folders of trainings, by robot, preset, stage and seed."""
    found = []
    for path in (path for folder in runs for path in sorted(folder.glob(f"*/*/{CURVE_FILE}"))):
        rows = read_curve(path)
        if rows:
            settings = json.loads((path.parent / SETTINGS_FILE).read_text(encoding="utf-8"))
            found.append(Training(name=path.parent.parent.name, folder=path.parent,
                                  settings=settings, rows=rows))  # fmt: skip
    return sorted(found, key=lambda t: (*t.key, t.settings["seed"], t.name))


def groups(trainings: Sequence[Training]) -> dict[tuple[str, str, str], list[Training]]:
    """Trainings that differ in their seed alone."""
    found: dict[tuple[str, str, str], list[Training]] = {}
    for training in trainings:
        found.setdefault(training.key, []).append(training)
    return found


def curves(trainings: Sequence[Training]) -> str:
    """A picture for each preset and stage, and where each training ended."""
    rows, pictures = [], []
    for (robot, preset, stage), group in groups(trainings).items():
        name = f"learning_{preset}_{stage}{'' if robot == 'carosac' else f'_{robot}'}.png"
        found = [curve_of(t.folder, f"seed {t.settings['seed']}") for t in group]
        drawn = [curve for curve in found if curve is not None]
        if drawn:
            as_paper = group[0].settings["environment"]["path"]["kind"] == "spline"
            marks = {"paper": PAPER_NO_SAG} if stage == "no_sag" and as_paper else {}
            learning_curves(drawn, FOLDER / name, marks=marks)
            pictures.append(f"![{robot}, {preset}, {stage}]({name})")
        rows += [end_of(t) for t in group]
    header = (
        "robot", "preset", "stage", "seed", "steps", "CPU [min]", "median [mm]",
        "median of the paths' means [mm]", "p95 [mm]", "inconsistency [mm]", "paths that failed",
    )  # fmt: skip
    return (
        "Each training's last point of its learning curve: the policy without noise on 64 paths "
        "that no training follows, of 40 set-points each or a whole episode in `realtime`. Those "
        "of `carosac` are scattered points, dense at the faces of the box, where errors are larger "
        "than on the splines of `paper` and of the bars. CPU "
        "time is that of the stage alone, learning curve included. Errors are those before a path "
        "fails; older trainings did not count these paths (-). Rewards are those of training, with "
        "the noise of exploration.\n\n"
        f"{table(header, rows)}\n\n" + "\n\n".join(pictures)
    )


def end_of(training: Training) -> tuple[str, ...]:
    """A row of the table."""
    last, wanted = training.rows[-1], training.settings["td3"]["steps"]
    steps = f"{last['steps']:,.0f}"
    if not training.finished:
        steps += f" of {wanted:,}, not finished"
    names = ("median_error_m", "median_of_means_m", "p95_error_m", "inconsistency_m")
    values = [MM * last[name] for name in names]
    cells = [f"{value:.1f}" if np.isfinite(value) else "-" for value in values]
    failed = last["failed_paths"]
    cells.append(f"{failed:.0f}" if np.isfinite(failed) else "-")
    return (*training.key, str(training.settings["seed"]), steps, f"{training.minutes:.1f}", *cells)


def bars(trainings: Sequence[Training]) -> str:
    """All policies by the protocols of `learned.evaluation`."""
    done = [t for t in trainings if t.finished]
    parts = {"no_sag": without_sag, "settle": settled, "realtime": real_time}
    texts = []
    for world, part in parts.items():
        mine = [t for t in done if t.world == world]
        if mine:
            texts.append(part(mine, trainings))
    waiting = [f"{t.name}/{t.key[2]}" for t in trainings if not t.finished]
    if waiting:
        texts.append(f"Not finished, so not here: {', '.join(waiting)}.")
    return "\n\n".join(texts)


def names_of(training: Training) -> tuple[str, str, str]:
    """The first cells of a row."""
    robot, preset, _ = training.key
    return (robot, preset, str(training.settings["seed"]))


def verdict(*good: bool) -> str:
    """Of a bar."""
    return "passed" if all(good) else "**missed**"


def distinct(scores: PolicyScores) -> int:
    """How many of the paths differ."""
    return len(np.unique(scores.target[:, :2].reshape(len(scores.target), -1), axis=0))


def scored(training: Training, protocol: Any) -> tuple[dict[str, Any], PolicyScores]:
    """The numbers of one policy, and what is behind them."""
    policy = Policy.load(training.folder / POLICY_FILE)
    scores = evaluate(policy, protocol, paths=PATHS[protocol], seed=SEED)
    print(training.name, protocol, flush=True)
    return scores.data(policy.description.robot), scores


def without_sag(mine: Sequence[Training], _: Sequence[Training]) -> str:
    """1000 paths on straight cables."""
    rows, paths = [], 0
    for training in mine:
        data, scores = scored(training, "no-sag")
        paths = distinct(scores)
        both = (data["median_error_m"]["norm"], data["median_of_trajectory_means_m"])
        agree = data["inconsistency_m"] <= LIMIT_INCONSISTENCY and data["failures"] == 0
        fine = (data["p95_error_m"] < LIMIT_P95, training.minutes <= LIMIT_MINUTES)
        rows.append((
            *names_of(training), *(f"{MM * value:.1f}" for value in both),
            f"{MM * data['p95_error_m']:.1f}", f"{MM * data['inconsistency_m']:.1f}",
            f"{MM * data['p95_inconsistency_m']:.1f}", str(data["failures"]),
            f"{training.minutes:.1f}", verdict(max(both) < PAPER_NO_SAG, agree),
            verdict(max(both) < LIMIT_MEDIAN, agree, *fine),
        ))  # fmt: skip
    header = (
        "robot", "preset", "seed", "median, all points [mm]", "median of the paths' means [mm]",
        "p95 [mm]", "inconsistency [mm]", "its p95 [mm]", "paths that failed", "CPU [min]",
        "27 mm in both medians", "15 mm in both, p95 40 mm, 20 min",
    )  # fmt: skip
    return (
        f"No sag, {PATHS['no-sag']} paths ({paths} of them different) that no training has seen, "
        f"seed {SEED}. Both bars want a median inconsistency of at most "
        f"{MM * LIMIT_INCONSISTENCY:.0f} mm, too; the second one is the bar of `carosac`.\n\n"
        + table(header, rows)
    )


def settled(mine: Sequence[Training], trainings: Sequence[Training]) -> str:
    """20 paths as set-points of sagging cables."""
    rows = []
    for training in mine:
        data, scores = scored(training, "settle")
        axes = [data["median_error_m"][axis] for axis in "xyz"]
        before = [t for t in trainings if t.name == training.name and t.world == "no_sag"
                  and t.folder.parent == training.folder.parent]  # fmt: skip
        minutes = training.minutes + sum(t.minutes for t in before)
        assert scores.tension is not None
        low, high = data["tension_range_N"]
        fine = (
            data["inconsistency_m"] <= LIMIT_INCONSISTENCY, data["failures"] == 0,
            data["slack_share"] == 0.0, data["overload_share"] == 0.0,
            minutes <= LIMIT_SAG_MINUTES,
        )  # fmt: skip
        near = all(a < b for a, b in zip(axes, PAPER_SAG, strict=True))
        rows.append((
            *names_of(training), " / ".join(f"{MM * value:.1f}" for value in axes),
            f"{MM * data['p95_error_m']:.1f}", f"{MM * data['inconsistency_m']:.1f}",
            f"{np.degrees(data['median_tilt_rad']):.2f}", f"{100 * data['slack_share']:.2f}",
            f"{100 * data['overload_share']:.2f}", f"{low:.1f} to {high:.1f}",
            str(data["failures"]), f"{minutes:.1f}", verdict(near), verdict(near, *fine),
        ))  # fmt: skip
    header = (
        "robot", "preset", "seed", "median \\|error\\| x / y / z [mm]", "p95 of the distance [mm]",
        "inconsistency [mm]", "tilt against rest, median [deg]", "points with a slack cable [%]",
        "with one overloaded [%]", "tensions [N]", "paths that failed",
        "CPU [min], both stages", "13 / 14 / 12 mm", "and nothing else wrong",
    )  # fmt: skip
    return (
        f"Sag, set-points that settle, {PATHS['settle']} splines of up to 5 m/s with 100 points "
        f"each, cables of particles, seed {SEED}. Nothing else wrong: an inconsistency of at most "
        f"{MM * LIMIT_INCONSISTENCY:.0f} mm, no slack and no overloaded cable, no failure, an hour "
        "of training.\n\n" + table(header, rows)
    )


def real_time(mine: Sequence[Training], _: Sequence[Training]) -> str:
    """Paths in time on robots that sway, beside inverse kinematics with and without feedforward."""
    rows = []
    known: dict[str, tuple[PolicyScores, PolicyScores]] = {}
    resting: dict[str, float] = {}
    for training in mine:
        data, scores = scored(training, "realtime")
        policy = Policy.load(training.folder / POLICY_FILE)
        key = json.dumps([training.key, training.settings["environment"]], sort_keys=True)
        if key not in known:  # it does not depend on the seed of the training
            plain, fed = (
                evaluate_inverse_kinematics(
                    policy, "realtime", paths=PATHS["realtime"], seed=SEED, feedforward=x
                )
                for x in (False, True)
            )
            known[key] = plain, fed
            resting[key] = slack_at_rest(policy, paths=PATHS["realtime"], seed=SEED)
        others = [one.data(policy.description.robot) for one in known[key]]
        three = (data, others[1], others[0])
        ratio = rmse_ratio(scores, known[key][0])
        rows.append((
            *names_of(training), " / ".join(f"{MM * one['rmse_m']:.1f}" for one in three),
            f"{ratio:.2f}", f"{rmse_ratio(scores, known[key][1]):.2f}",
            " / ".join(f"{MM * one['median_error_m']['norm']:.1f}" for one in three),
            " / ".join(f"{MM * one['p95_error_m']:.1f}" for one in three),
            " / ".join(f"{100 * one['slack_share']:.2f}" for one in three),
            f"{100 * resting[key]:.2f}",
            " / ".join(f"{100 * one['overload_share']:.2f}" for one in three),
            " / ".join(str(one["failures"]) for one in three), f"{training.minutes:.1f}",
            verdict(ratio <= LIMIT_RATIO, data["failures"] <= others[0]["failures"]),
        ))  # fmt: skip
    header = (
        "robot", "preset", "seed", "RMSE [mm]", "ratio to inverse kinematics",
        "to it with feedforward", "median [mm]", "p95 [mm]", "points with a slack cable [%]",
        "at rest [%]", "with one overloaded [%]", "paths that failed", "CPU [min]", "0.6",
    )  # fmt: skip
    return (
        f"Real time, {PATHS['realtime']} whole minimum-snap paths of up to 2.08 m/s and 2 m/s^2, "
        f"and a second of rest, cables of particles, plants and wind of `nominal-1`, seed {SEED}. "
        "Three numbers are of the policy, of inverse kinematics that also pushes for the "
        "acceleration of the reference (where `residual` starts, but for its correction) and of "
        "catenary inverse kinematics, on the same plants, paths, wind and errors of the belief. At "
        "rest: plants that hang still on the lengths of catenary inverse kinematics at each point "
        "have a cable below its least tension so often, by the errors of robot file and encoders "
        "alone.\n\n" + table(header, rows)
    )
