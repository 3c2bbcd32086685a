"""Evaluate a trained policy by the protocols of the CaRoSaC paper.

no-sag: 1000 random splines on straight cables. settle: 20 splines up to 5 m/s on sagging cables of
particles; each set-point settles. realtime: 20 minimum-snap paths up to 2.08 m/s on robots that
sway. Beside each error stands whether the cables agree with each other: inconsistency, tilt, slack
and tension. Writes pictures.

Exit status 1 means that a path failed.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro

from carosac_toolkit.cli.common import CommandResult, CommonOptions, OutputFolder, format_table
from carosac_toolkit.errors import InvalidField
from carosac_toolkit.number_checks import check_whole
from carosac_toolkit.robot import Robot
from carosac_toolkit.robot_file import load_robot
from learned.evaluation import PATHS, evaluate, trajectory_errors
from learned.policy_controller import check_robot, find_policy
from learned.policy_file import Policy, PolicyDescription
from learned.scores import Scores
from learned.settings_data import environment_settings

SAMPLES = 4  # paths that are drawn


@dataclass(frozen=True, kw_only=True)
class Options(CommonOptions):
    """Options of ``carosac evaluate``."""

    policy: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="POLICY")]
    """A bundled policy such as `carosac`, or an ONNX file that `carosac train` wrote."""
    protocol: str | None = None
    """`no-sag`, `settle` or `realtime`; by default the one in which the policy was trained."""
    trajectories: int | None = None
    """How many paths; by default as many as in the paper, 1000 or 20."""
    robot: str | None = None
    """Make sure that the policy was trained for this robot: a bundled one or a YAML file."""
    output: OutputFolder = None
    """Folder for pictures; by default one in carosac-results/evaluate."""


def run(options: Options) -> CommandResult:
    """Evaluate a policy."""
    policy = Policy.load(find_policy(options.policy))
    if options.robot is not None:
        check_robot(load_robot(options.robot), policy)
    description = policy.description
    world = environment_settings(description.settings).world.replace("_", "-")
    protocol: Any = options.protocol or world
    if protocol not in PATHS:
        raise InvalidField("--protocol", repr(protocol), f"one of {list(PATHS)}")
    count = PATHS[protocol] if options.trajectories is None else options.trajectories
    check_whole("--trajectories", count, 1)
    print(
        f"{options.policy}: preset {description.preset}, robot {description.robot.name}, "
        f"{description.steps} steps, seed {description.seed}; {protocol}, {count} paths"
    )
    scores = evaluate(policy, protocol, paths=count, seed=options.seed)
    data = scores.data(description.robot)
    print(_table(data))
    folder = options.output or _default_folder(description, protocol)
    pictures = draw(scores, description.robot, folder)
    print(f"pictures: {folder}")
    status = 1 if data["failures"] else 0
    return CommandResult(data | {"protocol": protocol, "pictures": pictures}, status=status)


def _default_folder(description: PolicyDescription, protocol: str) -> Path:
    """Where pictures go that were not sent anywhere."""
    parts = (description.preset, description.robot.name, f"seed{description.seed}", protocol)
    return Path("carosac-results") / "evaluate" / "-".join(parts)


def _table(data: dict[str, Any]) -> str:
    """The numbers, one a line."""
    median = data["median_error_m"]
    axes = " / ".join(f"{1e3 * median[axis]:.1f}" for axis in "xyz")
    rows: list[list[object]] = [
        ["median |error| x / y / z", f"{axes} mm"],
        ["median distance, all points", f"{1e3 * median['norm']:.1f} mm"],
        ["median of the paths' means", f"{1e3 * data['median_of_trajectory_means_m']:.1f} mm"],
        ["95 % of the distances below", f"{1e3 * data['p95_error_m']:.1f} mm"],
        ["median |length - IK|", f"{1e3 * data['length_error_m']:.1f} mm"],
        ["median tilt against rest", f"{np.degrees(data['median_tilt_rad']):.2f} degrees"],
    ]
    if np.isfinite(data["inconsistency_m"]):
        inconsistency = f"{1e3 * data['inconsistency_m']:.1f} mm"
        rows.append(["median inconsistency", inconsistency])
    if "slack_share" in data:
        low, high = data["tension_range_N"]
        rows += [
            ["points with a slack cable", f"{100 * data['slack_share']:.1f} %"],
            ["points with one overloaded", f"{100 * data['overload_share']:.1f} %"],
            ["tensions", f"{low:.0f} to {high:.0f} N"],
        ]
    rows.append(["paths that failed", str(data["failures"])])
    return format_table(["what", "value"], rows)


def draw(scores: Scores, robot: Robot, folder: Path) -> list[Path]:
    """The paper's pictures, of paths that did not fail."""
    from learned.pictures.accuracy import error_histograms, error_violins, sample_paths

    folder.mkdir(parents=True, exist_ok=True)
    sound = ~scores.failed.any(axis=1)
    if not sound.any():
        return []
    distance, length = trajectory_errors(scores)
    files = [folder / name for name in ("histograms.png", "violins.png", "paths.png")]
    error_histograms(distance[sound], length[sound], files[0])
    error_violins(scores.error[sound].reshape(-1, 3), files[1])
    shown = np.flatnonzero(sound)[:SAMPLES]
    sample_paths(scores.target[shown], scores.position[shown], robot, files[2])
    return files
