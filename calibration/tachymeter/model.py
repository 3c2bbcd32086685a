r"""Readings of a levelled set-up, with analytic derivatives.

A set-up has a position :math:`o`, a heading :math:`h` (counter-clockwise turn of its frame against
W, seen from above) and a small tilt :math:`\tau` left by the compensator. Its frame has z up, y
where Hz is 0 and x to the right of it, so that Hz is clockwise:

.. math:: w = R_z(-h)(s - o), \quad q = w - \tau \times w, \quad
          Hz = \operatorname{atan2}(q_x, q_y), \; V = \operatorname{atan2}(\rho, q_z), \; d = |q|,

for a sighted point :math:`s`. Terms of second order in the tilt are under 1e-9 m and are left out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calibration.tachymeter.observations import polar
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.rotations import cross_matrix

STATION_SIZE = 6  # position, heading, tilt about x, tilt about y
_AXIS_DISTANCE_MIN_M = 1e-9  # [m] from the vertical axis, where Hz has no derivative


@dataclass(frozen=True, kw_only=True, eq=False)
class PredictedShots:
    """Predicted readings of one set-up, B of them.

    Attributes:
        reading: Hz [rad], V [rad], distance [m], shape (B, 3).
        by_station: Derivative with respect to position, heading, tilt, shape (B, 3, 6).
        by_point: Derivative with respect to the sighted point, shape (B, 3, 3).
    """

    reading: Array
    by_station: Array
    by_point: Array


def predict(station: Array, points: Array) -> PredictedShots:
    """Predict the readings of a set-up.

    Args:
        station: x, y, z in W [m], heading [rad], tilt about the set-up's x and y [rad], shape (6,).
        points: Sighted points in W [m], shape (B, 3).

    Returns:
        Readings and derivatives.
    """
    cosine, sine = np.cos(station[3]), np.sin(station[3])
    turn = np.array([[cosine, sine, 0.0], [-sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    tilt = np.array([station[4], station[5], 0.0])
    level = np.eye(3) - cross_matrix(tilt)
    flat = (points - station[:3]) @ turn.T  # w, (B, 3)
    local = flat @ level.T  # q, (B, 3)
    by_local = _polar_slope(local)  # (B, 3, 3)
    by_point = by_local @ (level @ turn)
    turning = np.stack([flat[:, 1], -flat[:, 0], np.zeros(len(flat))], axis=1)  # dw/dh
    by_heading = np.einsum("bij,bj->bi", by_local, turning @ level.T)
    by_tilt = (by_local @ cross_matrix(flat))[:, :, :2]
    by_station = np.concatenate([-by_point, by_heading[:, :, None], by_tilt], axis=2)
    return PredictedShots(reading=polar(local), by_station=by_station, by_point=by_point)


def difference(reading: Array, predicted: Array) -> Array:
    """Return the measured less predicted readings, with Hz brought to (-pi, pi], shapes (B, 3)."""
    error = reading - predicted
    error[:, 0] = (error[:, 0] + np.pi) % (2.0 * np.pi) - np.pi
    return error


def _polar_slope(local: Array) -> Array:
    """Return the derivative of Hz, V, distance by a point of the set-up's frame, (B, 3, 3)."""
    x, y, z = local.T
    rho = np.maximum(np.hypot(x, y), _AXIS_DISTANCE_MIN_M)
    distance = np.hypot(rho, z)
    square = distance**2
    hz = np.stack([y / rho**2, -x / rho**2, np.zeros_like(x)], axis=1)
    v = np.stack([x * z / (rho * square), y * z / (rho * square), -rho / square], axis=1)
    return np.stack([hz, v, local / distance[:, None]], axis=1)
