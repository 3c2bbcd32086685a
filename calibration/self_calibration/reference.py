"""The reference sample, which puts the origin where no known position does.

Lengths alone do not tell where a robot stands. Along each axis of W of which no sample has a known
coordinate, the sample at the reference, where the motor angles are 0, is taken to be at home. That
is a convention: it changes no shape, and its uncertainty is not counted. Exit points that the robot
file knows well enough tell the place themselves, and no sample is taken to be at home.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.observability import Unobservable
from calibration.prior import Prior
from calibration.self_calibration.motor_angles import MotorAngles
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.robot.robot import Robot

TIE_SIGMA_SHARE = 2e-5  # of the longest cable: so near to home is the reference put
REFERENCE_LENGTH_SHARE = 0.02  # of the longest cable: a sample farther from 0 is no reference
SURVEYED_SHARE = 0.01  # of the longest cable: exit points known that well tell where W is


@dataclass(frozen=True, kw_only=True, eq=False)
class Reference:
    """The sample that is taken to be at home.

    Attributes:
        sample: Its name.
        row: Its number.
        axes: Coordinates that are home's, shape (3,).
        sigma: How tightly they are held [m].
    """

    sample: str
    row: int
    axes: NDArray[np.bool_]
    sigma: float


def tied_to_home(
    angles: MotorAngles, robot: Robot, prior: Prior, turned: Array
) -> Reference | None:
    """Return the sample that is to be at home, and in which coordinates; None if in none.

    Args:
        angles: The samples.
        robot: With home.
        prior: Of the shared unknowns, the exit points first.
        turned: Change of the lengths since the reference [m], shape (N, n).

    Raises:
        Unobservable: No sample is at the reference.
    """
    axes = np.asarray(~angles.coordinates_known.any(axis=0))
    longest = float(prior.mean[prior.rows("length_at_zero")].max())
    if not axes.any() or _surveyed(robot, prior, longest):
        return None
    away = np.abs(turned).max(axis=1)
    row = int(np.argmin(away))
    if away[row] > REFERENCE_LENGTH_SHARE * longest:
        names = ", ".join(np.array(["x", "y", "z"])[axes])
        raise Unobservable(
            f"nothing tells where the origin is: no sample has a known {names}, and none was taken "
            f"at the reference, where all motor angles are 0; the nearest one, sample "
            f"{angles.samples[row]!r}, has a cable {away[row]:.2g} m longer or shorter. Allowed: a "
            f"sample within {REFERENCE_LENGTH_SHARE * longest:.2g} m of cable of the reference, "
            "which is then the origin; or known positions"
        )
    return Reference(
        sample=angles.samples[row], row=row, axes=axes, sigma=TIE_SIGMA_SHARE * longest
    )


def _surveyed(robot: Robot, prior: Prior, longest: float) -> bool:
    """Return whether the robot file knows the exit points well enough to tell where W is."""
    size = 3 * robot.n
    moves = np.zeros((len(prior.names), 3))
    moves[:size] = np.tile(np.eye(3), (robot.n, 1))
    spread = np.linalg.inv(moves.T @ prior.information @ moves)
    return bool(np.sqrt(np.linalg.eigvalsh(spread)[-1]) < SURVEYED_SHARE * longest)
