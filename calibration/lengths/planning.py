"""Further poses that would teach most about the exit points."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.box_points import draw_in_box
from calibration.lengths.model import predict
from calibration.lengths.pose_path import PosesAt
from calibration.lengths.result import LengthCalibration
from calibration.lengths.settings import TYPICAL_LENGTH_NOISE_M, TYPICAL_SWAY_RAD, LengthSettings
from calibration.lengths.unknowns import LengthUnknowns, find_unknowns
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.base.rotations import from_matrix
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.robot.robot import Robot

CANDIDATE_POSES = 400
SUGGESTED_POSES_MAX = 40
SUGGESTED_TURN_MAX_RAD = 0.2  # [rad]: largest rotation that is suggested, per axis


@dataclass(frozen=True, kw_only=True, eq=False)
class SuggestedPoses:
    """Poses in the order of their worth, N of them.

    Attributes:
        position: Platform origin in W [m], shape (N, 3).
        rotation: From P to W, shape (N, 3, 3); with fewer than 6 cables that of rest there.
        sigma: Root mean square of one standard deviation of the exit points' coordinates after
            each further pose [m], shape (N + 1,); the first is that before.
        worst: The largest of them [m], shape (N + 1,).
    """

    position: Array
    rotation: Array
    sigma: Array
    worst: Array

    def data(self) -> list[dict[str, Any]]:
        """Return all numbers, ready for JSON."""
        return [
            {"position_m": p, "quaternion_wxyz": q, "exit_sigma_m": s, "exit_sigma_max_m": w}
            for p, q, s, w in zip(
                self.position.tolist(), from_matrix(self.rotation).tolist(),
                self.sigma[1:].tolist(), self.worst[1:].tolist(), strict=True,
            )
        ]  # fmt: skip


def suggest_poses(
    known_robot: LengthCalibration | Robot,
    count: int,
    *,
    settings: LengthSettings | None = None,
    rng: np.random.Generator,
) -> SuggestedPoses:
    """Choose poses of rest one after the other, each the best together with those before.

    The best is that which leaves the least sum of variances of the exit points (A-optimal).

    Args:
        known_robot: A calibration to be improved, or a robot that was not calibrated yet.
        count: How many.
        settings: Noise and priors, those of the calibration.
        rng: Source of the candidates.

    Raises:
        InvalidField: No number, or a robot that can rest nowhere in its workspace.
    """
    if not 1 <= count <= SUGGESTED_POSES_MAX:
        raise InvalidField("--suggest-poses", count, f"1 to {SUGGESTED_POSES_MAX}")
    known = settings or LengthSettings()
    if isinstance(known_robot, Robot):
        robot, noise = known_robot, (known.length_noise or TYPICAL_LENGTH_NOISE_M, TYPICAL_SWAY_RAD)
        unknowns = find_unknowns(robot, known, relative=False)
        now = unknowns.prior.covariance
    else:
        robot, unknowns, now = known_robot.robot, known_robot.unknowns, known_robot.covariance
        noise = (known_robot.length_noise, known_robot.balance_noise or TYPICAL_SWAY_RAD)
    rest = _candidates(robot, rng)
    jacobian, spread = _gains(robot, unknowns, known, rest, noise)
    exits, chosen = unknowns.exits, list[int]()
    variance = [np.diag(now)[exits]]
    for _ in range(count):
        best, now = _best(now, jacobian, spread, exits, chosen)
        chosen.append(best)
        variance.append(np.diag(now)[exits])
    return SuggestedPoses(
        position=rest.position[chosen],
        rotation=rest.rotation[chosen],
        sigma=np.sqrt(np.mean(variance, axis=1)),
        worst=np.sqrt(np.max(variance, axis=1)),
    )


def _candidates(robot: Robot, rng: np.random.Generator) -> PosesAt:
    """Draw poses of rest with tensions within the limits, half of them on the edges of the box."""
    from scipy.spatial.transform import Rotation

    where = draw_in_box(robot, rng, CANDIDATE_POSES)
    turn = Rotation.from_rotvec(
        rng.uniform(-SUGGESTED_TURN_MAX_RAD, SUGGESTED_TURN_MAX_RAD, (CANDIDATE_POSES, 3))
    ).as_matrix()
    held = turn @ robot.home_rotation if robot.n >= 6 else None
    rest = statics.inverse_kinematics(robot, where, held)
    good = rest.converged & rest.stable & ~rest.slack.any(axis=1) & rest.in_winch_range.all(axis=1)
    if good.sum() < SUGGESTED_POSES_MAX:
        allowed = "a robot that can rest in more than a tenth of its workspace box"
        raise InvalidField("robot", robot.name, allowed)
    count = int(good.sum())
    return PosesAt(
        position=rest.position[good],
        rotation=rest.rotation[good],
        twist=np.zeros((count, 6)),
        valid=np.ones(count, dtype=np.bool_),
    )


def _gains(
    robot: Robot,
    unknowns: LengthUnknowns,
    known: LengthSettings,
    rest: PosesAt,
    noise: tuple[float, float],
) -> tuple[Array, Array]:
    """Return the derivatives (C, m, k) and covariances (C, m, m) of the candidates."""
    with_balance = robot.n < 6
    predicted = predict(
        replace(robot, pose_rotation=None),
        rest,
        np.zeros((len(rest.position), robot.n)),
        with_balance=with_balance,
        anchored=unknowns.anchored,
    )
    m = predicted.value.shape[1]
    own = np.where(np.arange(m) < robot.n, *noise) ** 2
    pose = np.diag([known.position_noise**2] * 3 + [known.rotation_noise**2] * 3)
    whole = np.diag(own) + predicted.by_pose @ pose @ predicted.by_pose.swapaxes(1, 2)
    return predicted.by_all[:, :, unknowns.columns], whole


def _best(
    now: Array, jacobian: Array, noise: Array, exits: NDArray[np.int64], taken: list[int]
) -> tuple[int, Array]:
    """Return the candidate that takes most off the exit points' variance, and what it leaves."""
    moved = jacobian @ now  # (C, m, k)
    gain = np.linalg.solve(moved @ jacobian.swapaxes(1, 2) + noise, moved)
    worth = (moved[:, :, exits] * gain[:, :, exits]).sum(axis=(1, 2))
    worth[taken] = -np.inf
    best = int(np.argmax(worth))
    left = now - moved[best].T @ gain[best]
    return best, np.asarray(0.5 * (left + left.T))
