r"""The vertical by measured tensions, where nothing else tells it.

At rest the cables carry the weight. With :math:`u_{ki}` the direction of cable i at sample k, seen
from the platform, tensions :math:`f_{ki}`, and :math:`g_i` the share by which the load cell of a
cable always reads too little,

.. math:: \sum_i (1 + g_i) f_{ki} u_{ki} = v,

where v points upwards and is as large as the weight, for all samples. Sag changes no more than its
size: what a cable weighs pulls it down at both ends. The least squares for v and g are linear.
Tensions that no such v explains are of a platform that was held, or stood somewhere, and tell
nothing.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.self_calibration.problem import MotorAngleProblem
from carosac_toolkit.base.arrays import Array

SAMPLES_MIN = 2
MISS_SIGMAS_MAX = 3.0  # by friction, RMS: a worse balance was not carried by the cables alone,
MISS_WEIGHTS_MAX = 0.1  # unless it misses by less than that: exit points are wrong as well
LOAD_NOISE_SHARE = 2e-3  # of the weight: noise of a balance beside friction
LOAD_OFF_SHARE = 0.3  # of the weight by which v may differ from that of the robot file
STEP_SIGMAS = 1e-4  # prior sigmas, for differences


@dataclass(frozen=True, kw_only=True, eq=False)
class Vertical:
    """What tensions tell of the vertical.

    Attributes:
        load: Force that the cables carry, v, in W as the solution has it [N], shape (3,).
        covariance: Of the horizontal direction of `load`, x and y over its size [rad^2], (2, 2).
        hold: Change of that direction by the shared unknowns, shape (2, m).
        reason: Why the tensions do not tell it, empty if they do.
    """

    load: Array
    covariance: Array
    hold: Array
    reason: str = ""

    @property
    def sigma(self) -> float:
        """One standard deviation of the vertical [rad], the larger one."""
        return float(np.sqrt(np.linalg.eigvalsh(self.covariance)[-1]))

    @property
    def up(self) -> Array:
        """Unit vector upwards in W as the solution has it, shape (3,)."""
        return np.asarray(self.load / np.linalg.norm(self.load))

    def known_better_than(self, covariance: Array) -> bool:
        """Return whether the tensions tell it, and better along every direction than others do.

        Args:
            covariance: By others, as `covariance` [rad^2], shape (2, 2).
        """
        return not self.reason and bool(np.linalg.eigvalsh(covariance - self.covariance)[0] > 0.0)

    def data(self) -> dict[str, Any]:
        """Return the vertical, ready for JSON; without sigma where the tensions do not tell it."""
        return {
            "sigma_rad": None if self.reason else self.sigma,
            "load_n": float(np.linalg.norm(self.load)),
            "reason": self.reason,
        }


@dataclass(frozen=True, kw_only=True, eq=False)
class _Balance:
    """Least squares of the balance.

    Attributes:
        load: v [N], shape (3,).
        covariance: Of it [N^2], shape (3, 3).
        square: What is left, whitened.
        miss: Root mean square of what is left, of an axis [N].
        free: Equations beyond the unknowns.
    """

    load: Array
    covariance: Array
    square: float
    miss: float
    free: int


def find_vertical(
    problem: MotorAngleProblem,
    shared: Array,
    position: Array,
    by_shared: Array,
    used: NDArray[np.bool_],
) -> Vertical | None:
    """Find the vertical by the tensions of a point-like platform; None where there are none.

    Args:
        problem: The samples.
        shared: Values of the shared unknowns, shape (m,).
        position: Own unknowns of the samples, shape (N, own).
        by_shared: Change of these by the shared unknowns, shape (N, own, m).
        used: Samples that count, shape (N,).
    """
    tension = problem.angles.tension
    rows = np.flatnonzero(used)
    if tension is None or problem.own != 3 or len(rows) < SAMPLES_MIN or not tension[rows].any():
        return None

    def balance(values: Array) -> _Balance:
        where = position[rows] + by_shared[rows] @ (values - shared)
        return _balance(problem, values, where, tension[rows])

    here = balance(shared)
    size = float(np.linalg.norm(here.load))
    excess = max(1.0, here.square / here.free)
    steps = STEP_SIGMAS * problem.prior.sigma
    ends = [
        [balance(shared + sign * step).load for sign in (1.0, -1.0)] for step in np.diag(steps)
    ]  # fmt: skip
    slope = np.array([(more - less) / 2.0 for more, less in ends]).T / steps
    return Vertical(
        load=here.load,
        covariance=excess * here.covariance[:2, :2] / size**2,
        hold=slope[:2] / size,
        reason=_reason(problem, here),
    )


def _balance(
    problem: MotorAngleProblem, shared: Array, position: Array, tension: Array
) -> _Balance:
    """Fit the load and the gains to tensions (N, n) at positions (N, 3)."""
    _, direction = problem.straight(shared, position)
    pull = -direction * tension[:, :, None]  # (N, n, 3)
    share = problem.settings.friction_share / np.sqrt(3.0)
    noise = share**2 * np.einsum("kix,kiy->kxy", pull, pull)
    noise += (LOAD_NOISE_SHARE * problem.robot.weight) ** 2 * np.eye(3)
    white = np.linalg.inv(np.linalg.cholesky(noise))
    count, n = tension.shape
    by_load = white.reshape(-1, 3)
    by_gain = -(white @ pull.swapaxes(1, 2)).reshape(-1, n)
    rest = np.einsum("kxy,ky->kx", white, pull.sum(axis=1)).ravel()
    before = share + LOAD_NOISE_SHARE
    slope = np.block([[by_load, by_gain], [np.zeros((n, 3)), np.eye(n) / before]])
    target = np.concatenate([rest, np.zeros(n)])
    found, *_ = np.linalg.lstsq(slope, target, rcond=None)
    left = found[:3] - np.einsum("kix,i->kx", pull, 1.0 + found[3:])
    return _Balance(
        load=found[:3],
        covariance=np.asarray(np.linalg.inv(slope.T @ slope)[:3, :3], np.float64),
        square=float(((slope @ found - target) ** 2).sum()),
        miss=float(np.sqrt((left**2).mean())),
        free=3 * count - 3,
    )


def _reason(problem: MotorAngleProblem, found: _Balance) -> str:
    """Return why tensions do not tell the vertical, empty if they do."""
    robot, size = problem.robot, float(np.linalg.norm(found.load))
    cables = robot.weight_per_length @ problem.prior.mean[problem.zeros]
    weight = robot.weight + 0.5 * float(cables)  # half of a cable hangs on each of its ends
    unlikely = found.square > found.free * MISS_SIGMAS_MAX**2
    if unlikely and found.miss > MISS_WEIGHTS_MAX * weight:
        return "they do not balance one weight at all samples, as if the platform was held"
    if abs(size - weight) > LOAD_OFF_SHARE * weight:
        return (
            f"they carry {size:.3g} N, and by the robot file platform and half of the cables weigh "
            f"{weight:.3g} N"
        )
    if found.load[2] <= 0.0:
        return "they pull downwards"
    return ""
