r"""Curves through the rows of a table, which stay near these rows however few they are.

A quintic spline is the most accurate curve through rows that are dense, but swings far beyond rows
that are sparse. Where it does, velocities and accelerations at the rows are replaced by ones with
which each coordinate is monotonic from row to row. In Bernstein form a quintic is

.. math::
    b = (p_0,\; p_0 + \tfrac{h v_0}{5},\; p_0 + \tfrac{2 h v_0}{5} + \tfrac{h^2 a_0}{20},\;
         p_1 - \tfrac{2 h v_1}{5} + \tfrac{h^2 a_1}{20},\; p_1 - \tfrac{h v_1}{5},\; p_1)

and monotonic if these six numbers are. Velocities of at most 5/4 of both slopes at a row leave room
for them, and bounds of the accelerations follow.
"""

from __future__ import annotations

from math import comb, factorial

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.trajectories.curves import PiecewisePolynomial

SPLINE_DEGREE = 5
OVERSHOOT_RATIO = 0.01  # of the size of the path: what a spline may go beyond two rows between them
SLOPE_RATIO_MAX = 1.25  # of a velocity to the slopes beside it
SAMPLES = 64  # of a piece, to measure how far it goes
CHORD_CANDIDATE_RATIO = 0.2  # of the largest bound: pieces whose distance is measured
_TO_BERNSTEIN = np.array(
    [[comb(i, k) / comb(SPLINE_DEGREE, k) for k in range(SPLINE_DEGREE + 1)]
     for i in range(SPLINE_DEGREE + 1)]
)  # fmt: skip


def through_rows(time: Array, position: Array) -> PiecewisePolynomial:
    """Pass every row, with both ends at rest and continuous acceleration.

    A coordinate between two rows leaves the range of the two by at most `OVERSHOOT_RATIO` of the
    size of the path.

    Args:
        time: From 0, rising [s], shape (N,).
        position: In W [m], shape (N, 3).

    References:
        Fritsch and Butland, "A method for constructing local monotone piecewise cubic
        interpolants", SIAM J. Sci. Stat. Comput. 5(2), 1984 (velocities); Dougherty, Edelman and
        Hyman, "Nonnegativity-, monotonicity-, or convexity-preserving cubic and quintic Hermite
        interpolation", Math. Comput. 52, 1989.
    """
    velocity, acceleration = _of_spline(time, position)
    calm_velocity, calm_acceleration = _monotonic(time, position)
    allowed = OVERSHOOT_RATIO * path_size(position)
    while True:
        curve = _hermite(time, position, velocity, acceleration)
        over = _overshoot(curve, position) > allowed  # (N - 1, 3)
        sparse = np.zeros(position.shape, dtype=bool)
        sparse[:-1] |= over
        sparse[1:] |= over
        sparse &= (velocity != calm_velocity) | (acceleration != calm_acceleration)
        if not sparse.any():
            return curve
        velocity = np.where(sparse, calm_velocity, velocity)
        acceleration = np.where(sparse, calm_acceleration, acceleration)


def path_size(position: Array) -> float:
    """Return the diagonal of the box around some rows (N, 3) [m]."""
    return float(np.linalg.norm(np.ptp(position, axis=0)))


def farthest_from_chords(curve: PiecewisePolynomial) -> tuple[float, int]:
    """Return how far the curve goes from the straight lines between its breaks, and on which piece.

    Returns:
        The largest distance [m], and the index of its piece.
    """
    control = _control_points(curve)
    bound = _from_chords(control, control)
    pieces = np.flatnonzero(bound >= CHORD_CANDIDATE_RATIO * bound.max())
    share = np.linspace(0.0, 1.0, SAMPLES + 1)
    local = np.diff(curve.breaks)[pieces, None] * share
    powers = local[..., None] ** np.arange(SPLINE_DEGREE + 1)
    distance = _from_chords(control[pieces], powers @ curve.coefficients[pieces])
    k = int(np.argmax(distance))
    return float(distance[k]), int(pieces[k])


def _from_chords(control: Array, points: Array) -> Array:
    """Return the largest distances of points (S, K, 3) from the chords of their pieces, (S,)."""
    start, chord = control[:, :1], control[:, -1:] - control[:, :1]  # (S, 1, 3)
    square = np.sum(chord**2, axis=2)
    along = np.sum((points - start) * chord, axis=2) / np.where(square > 0.0, square, 1.0)
    foot = start + np.clip(along, 0.0, 1.0)[..., None] * chord
    return np.asarray(np.linalg.norm(points - foot, axis=2).max(axis=1))


def _control_points(curve: PiecewisePolynomial) -> Array:
    """Return the Bernstein coefficients of each quintic [m], shape (S, 6, 3)."""
    step = np.diff(curve.breaks)[:, None, None]
    scaled = curve.coefficients * step ** np.arange(SPLINE_DEGREE + 1)[:, None]
    return np.asarray(_TO_BERNSTEIN @ scaled)


def _overshoot(curve: PiecewisePolynomial, position: Array) -> Array:
    """Bound how far each piece leaves the range of the rows at its ends [m], shape (N - 1, 3)."""
    control = _control_points(curve)
    low, high = np.minimum(position[:-1], position[1:]), np.maximum(position[:-1], position[1:])
    return np.asarray(np.maximum(control.max(axis=1) - high, low - control.min(axis=1)))


def _of_spline(time: Array, position: Array) -> tuple[Array, Array]:
    """Return velocities and accelerations at the rows of the spline that rests at both ends."""
    from scipy.interpolate import make_interp_spline

    still = [(order, np.zeros(3)) for order in (1, 2)]
    spline = make_interp_spline(time, position, k=SPLINE_DEGREE, bc_type=(still, still))
    derivatives = [np.array(spline(time, nu=order)) for order in (1, 2)]
    for values in derivatives:
        values[[0, -1]] = 0.0
    return derivatives[0], derivatives[1]


def _monotonic(time: Array, position: Array) -> tuple[Array, Array]:
    """Return velocities and accelerations at the rows with which no coordinate overshoots."""
    from scipy.interpolate import PchipInterpolator

    step = np.diff(time)[:, None]
    slope = np.diff(position, axis=0) / step
    least = np.minimum(np.abs(slope[:-1]), np.abs(slope[1:]))
    cubic = PchipInterpolator(time, position)
    velocity, acceleration = np.zeros(position.shape), np.zeros(position.shape)
    wanted = cubic(time[1:-1], nu=1)
    velocity[1:-1] = np.clip(wanted, -SLOPE_RATIO_MAX * least, SLOPE_RATIO_MAX * least)
    # Second control point between the first and the middle of the first and the last, and likewise
    # from the end; in the direction of the slope.
    direction = np.sign(slope)
    first, last = np.abs(velocity[:-1]) / step, np.abs(velocity[1:]) / step
    rise = np.abs(slope) / step
    start_low, start_high = -4.0 * first, 10.0 * rise - 6.0 * first - 2.0 * last
    end_low, end_high = -10.0 * rise + 2.0 * first + 6.0 * last, 4.0 * last
    ahead = np.sort(np.stack([direction * start_low, direction * start_high]), axis=0)[:, 1:]
    behind = np.sort(np.stack([direction * end_low, direction * end_high]), axis=0)[:, :-1]
    low, high = np.maximum(ahead[0], behind[0]), np.minimum(ahead[1], behind[1])
    wish = 2.0 * (slope[1:] - slope[:-1]) / (step[1:] + step[:-1])
    acceleration[1:-1] = np.clip(wish, np.minimum(low, 0.0), np.maximum(high, 0.0))
    return velocity, acceleration


def _hermite(
    time: Array, position: Array, velocity: Array, acceleration: Array
) -> PiecewisePolynomial:
    """Return the quintics with given position, velocity and acceleration at the rows."""
    h = np.diff(time)[:, None]
    way = np.diff(position, axis=0)
    v0, v1 = velocity[:-1] * h, velocity[1:] * h
    a0, a1 = acceleration[:-1] * h**2, acceleration[1:] * h**2
    scaled = [
        position[:-1],
        v0,
        a0 / factorial(2),
        10.0 * way - 6.0 * v0 - 4.0 * v1 - 1.5 * a0 + 0.5 * a1,
        -15.0 * way + 8.0 * v0 + 7.0 * v1 + 1.5 * a0 - a1,
        6.0 * way - 3.0 * (v0 + v1) - 0.5 * (a0 - a1),
    ]
    pieces = [values / h**power for power, values in enumerate(scaled)]
    return PiecewisePolynomial(breaks=time, coefficients=np.stack(pieces, axis=1))
