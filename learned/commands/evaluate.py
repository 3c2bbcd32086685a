"""Evaluate a trained policy by the protocols of the CaRoSaC paper.

no-sag: 1000 random splines on straight cables. settle: 20 splines up to 5 m/s on sagging cables of
particles; each set-point settles. realtime: 20 whole minimum-snap paths up to 2.08 m/s on robots
that sway. Beside each error stands whether the cables agree with each other: inconsistency, tilt,
slack and tension; with sag, catenary inverse kinematics on the same paths and plants, too. Writes
pictures.

Exit status 1 means that a path failed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro

from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.base.numbers import check_whole
from carosac_toolkit.base.tables import format_table
from carosac_toolkit.cli.common import CommandResult, CommonOptions, OutputFolder
from carosac_toolkit.robot.file import load_robot
from carosac_toolkit.robot.robot import Robot
from learned.evaluation import (
    PROTOCOL_PATHS,
    Protocol,
    evaluate,
    evaluate_inverse_kinematics,
    rmse_ratio,
    slack_at_rest,
    trajectory_rmse,
)
from learned.policy_controller import check_robot, find_policy
from learned.policy_file import Policy, PolicyDescription
from learned.saved_scores import SCORES_FILE, SavedScores
from learned.scores import PolicyScores, sound_paths
from learned.settings_data import environment_settings

SOLVER_COLUMN, FEEDFORWARD_COLUMN = "catenary IK", "with feedforward"  # columns beside the policy
ZERO_BY_DEFINITION = (  # none, for inverse kinematics of set-points
    "length_error_m", "inconsistency_m", "p95_inconsistency_m", "median_tilt_rad"
)  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Options(CommonOptions):
    """Options of ``carosac evaluate``."""

    policy: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="POLICY")]
    """A bundled policy such as `carosac-settle`, or an ONNX file that `carosac train` wrote."""
    protocol: str | None = None
    """`no-sag`, `settle` or `realtime`; by default the one in which the policy was trained."""
    trajectories: int | None = None
    """Number of paths; by default as many as in the paper, 1000 or 20."""
    robot: str | None = None
    """Check that the policy was trained for this robot: a bundled one or a YAML file."""
    output: OutputFolder = None
    """Folder for pictures; by default one in carosac-results/evaluate."""


def run(options: Options) -> CommandResult:
    """Evaluate a policy."""
    policy = Policy.load(find_policy(options.policy))
    if options.robot is not None:
        check_robot(load_robot(options.robot), policy)
    description = policy.description
    trained = environment_settings(description.settings)
    protocol: Any = options.protocol or trained.world.replace("_", "-")
    if protocol not in PROTOCOL_PATHS:
        raise InvalidField("--protocol", repr(protocol), f"one of {list(PROTOCOL_PATHS)}")
    count = PROTOCOL_PATHS[protocol] if options.trajectories is None else options.trajectories
    check_whole("--trajectories", count, 1)
    print(
        f"{options.policy}: preset {description.preset}, robot {description.robot.name}, "
        f"{description.steps} steps, seed {description.seed}; {protocol}, {count} paths"
    )
    robot = description.robot
    arguments: dict[str, Any] = {"paths": count, "seed": options.seed}
    scores = {"policy": evaluate(policy, protocol, **arguments)}
    data = scores["policy"].data(robot) | {"protocol": protocol}
    if protocol != "no-sag":
        scores[SOLVER_COLUMN] = evaluate_inverse_kinematics(policy, protocol, **arguments)
        data["inverse_kinematics"] = scores[SOLVER_COLUMN].data(robot)
    if protocol == "settle":
        for name in ZERO_BY_DEFINITION:
            del data["inverse_kinematics"][name]
    if protocol == "realtime":
        data["rmse_ratio"] = rmse_ratio(scores["policy"], scores[SOLVER_COLUMN])
        data["slack_share_at_rest"] = slack_at_rest(policy, **arguments)
    if protocol == "realtime" and trained.action == "push" and trained.feedforward:
        pushed = evaluate_inverse_kinematics(policy, protocol, feedforward=True, **arguments)
        scores[FEEDFORWARD_COLUMN] = pushed
        data["feedforward"] = pushed.data(robot) | {
            "rmse_ratio": rmse_ratio(pushed, scores[SOLVER_COLUMN])
        }
    print(_table(data))
    for line in _legend(data):
        print(line)
    folder = options.output or _default_folder(description, protocol, count, options.seed)
    data["pictures"] = draw(scores["policy"], robot, folder)
    SavedScores(policy=options.policy, protocol=protocol, robot=robot, scores=scores).write(folder)
    if protocol == "realtime":
        data["pictures"] += draw_rmse(scores, robot, folder)
    print(f"pictures, and the scores of all points ({SCORES_FILE}): {folder}")
    return CommandResult(data, status=1 if data["failures"] else 0)


def _default_folder(
    description: PolicyDescription, protocol: Protocol, count: int, seed: int
) -> Path:
    """Return the default folder for pictures; unusual numbers of paths are in its name."""
    trained = f"seed{description.seed}-{description.steps}steps"
    parts = [description.preset, description.robot.name, trained, protocol]
    if count != PROTOCOL_PATHS[protocol]:
        parts.append(f"{count}paths")
    if seed != 0:
        parts.append(f"of-seed{seed}")
    return Path("carosac-results") / "evaluate" / "-".join(parts)


def _table(data: dict[str, Any]) -> str:
    """Format the numbers, one a line, beside those of inverse kinematics."""
    columns = {"policy": data}
    for name, key in ((SOLVER_COLUMN, "inverse_kinematics"), (FEEDFORWARD_COLUMN, "feedforward")):
        if key in data:
            columns[name] = data[key]
    rows: list[list[object]] = []
    for name, key, text_of in TABLE_ROWS:
        if key in data and not (isinstance(data[key], float) and np.isnan(data[key])):
            rows.append(
                [name, *(text_of(one[key]) if key in one else "-" for one in columns.values())]
            )
    return format_table(["what", *columns], rows)


def _legend(data: dict[str, Any]) -> list[str]:
    """Explain the rows and columns of a table."""
    lines = []
    if "slack_share" in data:
        lines.append("slack: below the least tension that the robot file allows, in some cable")
    if "slack_share_at_rest" in data:
        lines.append(
            f"at rest: plants that hang still on the lengths of {SOLVER_COLUMN}, without any motion"
        )
    if "feedforward" in data:
        lines.append(
            f"{FEEDFORWARD_COLUMN}: {SOLVER_COLUMN} that also pushes for the acceleration of the "
            "target, as the policy does before it acts"
        )
    if data.get("rmse_ratio", 0.0) > 1.0:
        lines.append(
            f"the policy is worse than {SOLVER_COLUMN}: it has not learned yet, or not this"
        )
    return lines


def _millimetres(value: float) -> str:
    return f"{1e3 * value:.1f} mm"


def _percent(value: float) -> str:
    return f"{100 * value:.1f} %"


TABLE_ROWS: tuple[tuple[str, str, Callable[[Any], str]], ...] = (
    (
        "median |error| x / y / z",
        "median_error_m",
        lambda error: " / ".join(f"{1e3 * error[axis]:.1f}" for axis in "xyz") + " mm",
    ),
    ("median distance, all points", "median_error_m", lambda error: _millimetres(error["norm"])),
    ("median of the paths' means", "median_of_trajectory_means_m", _millimetres),
    ("95 % of the distances below", "p95_error_m", _millimetres),
    ("RMSE of the distance", "rmse_m", _millimetres),
    (f"RMSE over that of {SOLVER_COLUMN}", "rmse_ratio", lambda ratio: f"{ratio:.2f}"),
    ("median |length - IK|", "length_error_m", _millimetres),
    ("median tilt against rest", "median_tilt_rad", lambda x: f"{np.degrees(x):.2f} degrees"),
    ("median inconsistency", "inconsistency_m", _millimetres),
    ("points with a slack cable", "slack_share", _percent),
    ("slack at rest, on IK's lengths", "slack_share_at_rest", _percent),
    ("points with one overloaded", "overload_share", _percent),
    ("tensions", "tension_range_N", lambda ends: f"{ends[0]:.0f} to {ends[1]:.0f} N"),
    ("paths that failed", "failures", str),
)


def draw(scores: PolicyScores, robot: Robot, folder: Path) -> list[Path]:
    """Draw the paper's pictures, of paths that did not fail."""
    from carosac_toolkit.pictures.saving import picture_paths
    from learned.pictures.evaluation import draw_histograms, draw_paths, draw_violins

    folder.mkdir(parents=True, exist_ok=True)
    if not sound_paths(scores).any():
        return []
    figures = {"histograms": draw_histograms, "violins": draw_violins, "paths": draw_paths}
    for name, function in figures.items():
        function(scores, robot, folder / name)
    return [file for name in figures for file in picture_paths(folder / name)]


def draw_rmse(scores: dict[str, PolicyScores], robot: Robot, folder: Path) -> list[Path]:
    """Draw the distribution of the RMSE of a path, over paths on which nothing failed."""
    from carosac_toolkit.pictures.saving import picture_paths
    from learned.pictures.accuracy import rmse_distribution

    sound = np.all([sound_paths(one) for one in scores.values()], axis=0)
    if not sound.any():
        return []
    groups = {name: trajectory_rmse(one)[sound] for name, one in scores.items()}
    rmse_distribution(groups, folder / "rmse", robot=robot)
    return picture_paths(folder / "rmse")
