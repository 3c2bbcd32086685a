"""Scores of a policy on paths: errors, and whether its cables agree with each other."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.physics.cable import straight_line
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.robot.robot import Robot
from learned.environment import CableEnvironment
from learned.target_paths import TargetPath

TENSION_TOLERANCE_N = 1e-3  # inverse kinematics may choose a tension that is just at its limit

Act = Callable[[Array], Array]  # observations (B, d) to actions (B, a) in [-1, 1]


@dataclass(frozen=True, kw_only=True, eq=False)
class PolicyScores:
    """Outcome of N paths of T steps, with n cables.

    Attributes:
        target: Targets in W [m], shape (N, T, 3).
        position: Platform origin in W [m], shape (N, T, 3).
        length_error: Lengths asked for less those of inverse kinematics of the target, of the
            same cable model [m], shape (N, T, n).
        inconsistency: Largest of a cable [m], shape (N, T); see `learned.transition`.
        length: Wound [m], shape (N, T, n).
        tilt: Angle of the platform's z axis to that of rest at the target [rad], shape (N, T).
        tension: At the platform [N], shape (N, T, n); None without forces.
        failed: Steps without a solution, shape (N, T); nothing counts after the first one.
        counted: Steps up to the end of their path, shape (N, T); those after it do not count.
    """

    target: Array
    position: Array
    length_error: Array
    inconsistency: Array
    length: Array
    tilt: Array
    tension: Array | None
    failed: NDArray[np.bool_]
    counted: NDArray[np.bool_]

    @property
    def error(self) -> Array:
        """Reached less target [m], shape (N, T, 3)."""
        return self.position - self.target

    def data(self, robot: Robot) -> dict[str, Any]:
        """Return the numbers of ``carosac evaluate``; NaN where all paths failed at once.

        Args:
            robot: For its tension limits.
        """
        valid = self.counted & ~np.maximum.accumulate(self.failed, axis=1)
        error = np.abs(self.error)
        norm = np.linalg.norm(error, axis=2)
        means = [one[seen].mean() for one, seen in zip(norm, valid, strict=True) if seen.any()]
        data: dict[str, Any] = {
            "median_error_m": {
                **{axis: _median(error[valid][:, k]) for k, axis in enumerate("xyz")},
                "norm": _median(norm[valid]),
            },
            "median_of_trajectory_means_m": _median(np.array(means)),
            "p95_error_m": _percentile(norm[valid], 95),
            "rmse_m": _mean(norm[valid] ** 2) ** 0.5,
            "length_error_m": _median(np.abs(self.length_error[valid])),
            "inconsistency_m": _median(self.inconsistency[valid]),
            "p95_inconsistency_m": _percentile(self.inconsistency[valid], 95),
            "median_tilt_rad": _median(self.tilt[valid]),
            "failures": int(self.failed.any(axis=1).sum()),
            "trajectories": len(norm),
        }
        if self.tension is not None:
            seen = self.tension[valid]
            slack = seen < robot.tension_min - TENSION_TOLERANCE_N
            overload = seen > robot.tension_max + TENSION_TOLERANCE_N
            data |= {
                "slack_share": _mean(np.any(slack, axis=1)),
                "overload_share": _mean(np.any(overload, axis=1)),
                "tension_range_N": [_percentile(seen, 0), _percentile(seen, 100)],
            }
        return data


def sound_paths(scores: PolicyScores) -> NDArray[np.bool_]:
    """Return the paths on which nothing failed, shape (N,)."""
    return np.asarray(~scores.failed.any(axis=1))


def score(environment: CableEnvironment, act: Act, paths: list[TargetPath]) -> PolicyScores:
    """Follow paths to the end of the longest, as many at once as the environment has rows.

    Args:
        environment: Its size divides the number of paths.
        act: The policy.
        paths: Each at most as long as an episode of the environment.

    Raises:
        InvalidField: A longer path.
    """
    size = environment.size
    ends = np.array([len(path.position) - 1 for path in paths])
    longest = int(ends.argmax())
    steps, most = int(ends[longest]), environment.settings.path.steps
    if steps > most:
        raise InvalidField(f"paths[{longest}]", f"{steps} steps", f"{most}, those of an episode")
    parts = [
        _score_batch(environment, act, paths[k : k + size], steps)
        for k in range(0, len(paths), size)
    ]
    columns: dict[str, Any] = {
        name: None if values is None else np.concatenate([part[name] for part in parts])
        for name, values in parts[0].items()
    }
    columns["counted"] = np.arange(steps) < ends[:, None]
    columns["failed"] &= columns["counted"]
    return PolicyScores(**columns)


def _score_batch(
    environment: CableEnvironment, act: Act, paths: list[TargetPath], steps: int
) -> dict[str, Any]:
    """Follow one path in each row of the environment; all of `PolicyScores` but what counts."""
    observation = environment.reset(paths)
    names = [name for name in PolicyScores.__dataclass_fields__ if name != "counted"]
    columns: dict[str, list[Any]] = {name: [] for name in names}
    for _ in range(steps):
        result = environment.step(act(observation))
        observation = result.observation
        transition = result.transition
        wanted, tilt = _wanted(environment, transition.target, result.reached.rotation)
        columns["target"].append(transition.target)
        columns["position"].append(transition.position)
        columns["length_error"].append(transition.asked - wanted)
        columns["inconsistency"].append(np.abs(transition.inconsistency).max(axis=1))
        columns["length"].append(transition.length)
        columns["tilt"].append(tilt)
        columns["tension"].append(result.reached.tension)
        columns["failed"].append(result.failed)
    return {
        name: None if values[0] is None else np.stack(values, axis=1)
        for name, values in columns.items()
    }


def _wanted(environment: CableEnvironment, target: Array, rotation: Array) -> tuple[Array, Array]:
    """Return inverse kinematics of targets (B, n), and the tilt against rest there (B,)."""
    robot = environment.robot
    if environment.settings.world == "no_sag":
        return straight_line.inverse_kinematics(robot, target), np.zeros(len(target))
    rest = statics.inverse_kinematics(robot, target)
    cosine = np.einsum("bi,bi->b", rest.rotation[:, :, 2], rotation[:, :, 2])
    return rest.unstrained_length, np.arccos(np.clip(cosine, -1.0, 1.0))


def _mean(values: Any) -> float:
    """Return the mean; NaN of nothing, as those below."""
    return float(np.mean(values)) if np.size(values) else float("nan")


def _median(values: NDArray[Any]) -> float:
    """Return the median."""
    return _percentile(values, 50)


def _percentile(values: NDArray[Any], share: float) -> float:
    """Return a percentile."""
    return float(np.percentile(values, share)) if np.size(values) else float("nan")
