r"""Consistency of an estimator with its stated covariance: NEES, NIS and their confidence bands.

With the error e of a belief whose covariance P says how large it should be, the normalised
estimation error squared is e^T P^-1 e, which is chi-squared with as many degrees of freedom as e
has entries. The normalised innovation squared is the same for what a filter did not expect of a
measurement. Here both are divided by their degrees of freedom: 1 is right, more is too sure of
itself, less is too modest.

References:
    Bar-Shalom, Li, Kirubarajan, *Estimation with Applications to Tracking and Navigation*, 2001,
    section 5.4.
"""

from __future__ import annotations

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.loop.values import Belief, State

STATE_SIZE = 12  # of a belief's covariance: position, rotation, velocity, angular velocity
POSE_SIZE = 6


def state_error(truth: State, belief: Belief) -> Array:
    """Return the error of a belief, in the order of its covariance: truth minus belief.

    Args:
        truth: With a twist, or only the pose is compared.
        belief: Of the same B robots.

    Returns:
        [dp; log(R R_hat^T); dv; dw] in W, shape (B, 12); shape (B, 6) where one of the two has no
        twist.
    """
    from scipy.spatial.transform import Rotation

    turn = Rotation.from_matrix(truth.rotation @ belief.rotation.swapaxes(1, 2)).as_rotvec()
    pose = np.concatenate([truth.position - belief.position, turn], axis=1)
    if truth.twist is None or belief.twist is None:
        return pose
    return np.concatenate([pose, truth.twist - belief.twist], axis=1)


def normalised_square(error: Array, covariance: Array) -> Array:
    """Return the square e^T P^-1 e over its degrees of freedom.

    Args:
        error: Shape (..., k).
        covariance: Shape (..., k, k).

    Returns:
        Shape (...).

    Raises:
        InvalidField: A covariance that is not positive definite.
    """
    try:
        root = np.linalg.cholesky(covariance)
    except np.linalg.LinAlgError as wrong:
        raise InvalidField("covariance", "not positive definite", "positive definite") from wrong
    white = np.linalg.solve(root, error[..., None])[..., 0]
    return np.asarray((white**2).mean(axis=-1))


def band(dof: float, count: float = 1.0, *, level: float = 0.95) -> tuple[float, float]:
    """Return the interval that holds the mean of independent normalised squares.

    Args:
        dof: Degrees of freedom of each, > 0.
        count: How many independent ones are averaged, > 0.
        level: The probability.

    Returns:
        Lower and upper bound, about 1.
    """
    from scipy.stats import chi2

    total = dof * count
    tail = 0.5 * (1.0 - level)
    return float(chi2.ppf(tail, total) / total), float(chi2.ppf(1.0 - tail, total) / total)
