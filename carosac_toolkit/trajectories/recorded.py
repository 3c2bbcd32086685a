"""A smooth trajectory through the poses of a recording, measured or at equilibrium."""

from __future__ import annotations

from math import factorial

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.recordings.recording import Recording
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.trajectories.curves import PiecewisePolynomial
from carosac_toolkit.trajectories.timing import LIMIT_MARGIN, check_limits
from carosac_toolkit.trajectories.trajectory import Trajectory, peak_of_order

SPLINE_DEGREE = 5
ROUGHNESS_WEIGHT = 1e-6  # weight of squared fourth differences of control points: bridges gaps only


def from_recording(
    recording: Recording,
    robot: Robot | None = None,
    *,
    knot_spacing: float = 0.5,
    speed_max: float | None = None,
    acceleration_max: float | None = None,
) -> Trajectory:
    """Follow the measured positions of a recording, smoothed, from rest to rest.

    A quintic B-spline with knots every `knot_spacing` is fitted by least squares; motion faster
    than a few knots is smoothed away. A weight of 1e-6 on the squared fourth differences of its
    control points settles it where samples are missing. Its first and last four control points
    coincide, so it starts and ends with zero velocity, acceleration and jerk. Time 0 is the
    first pose, or the first sample where no poses were measured. The recorded timing is kept,
    unless a limit would be broken: then all of it is slowed down uniformly until the limits
    hold.

    Args:
        recording: With measured poses, or any together with `robot`.
        robot: Whose poses of rest on the lengths that were sent, or else measured, are followed
            where no poses were measured.
        knot_spacing: [s], at most; the knots are equidistant.
        speed_max: [m/s], or None for no limit.
        acceleration_max: [m/s^2], or None for no limit.
    """
    if not knot_spacing > 0.0:
        raise InvalidField("knot_spacing", f"{knot_spacing} s", "knot_spacing > 0")
    if recording.poses is not None:
        time, position = recording.poses.time, recording.poses.position
    elif robot is not None:
        time, position = _at_rest(recording, robot, knot_spacing)
    else:
        raise InvalidField("poses", None, "a recording with measured poses, or a robot")
    if len(time) < 2:
        raise InvalidField("poses", f"{len(time)} pose", "at least 2 poses")
    time = time - time[0]
    no_limit = float(np.finfo(np.float64).max)
    speed = no_limit if speed_max is None else speed_max
    acceleration = no_limit if acceleration_max is None else acceleration_max
    check_limits(speed, acceleration)
    curve = _fit(time, position, knot_spacing)
    stretch = max(
        1.0, peak_of_order(curve, 1) / speed, np.sqrt(peak_of_order(curve, 2) / acceleration)
    )
    slower = stretch * (1.0 + LIMIT_MARGIN) if stretch > 1.0 else 1.0
    return Trajectory(name="from_recording", curve=curve, duration=float(curve.breaks[-1] * slower))


def _at_rest(recording: Recording, robot: Robot, knot_spacing: float) -> tuple[Array, Array]:
    """Return times [s] and positions [m] at rest, ten a knot, on the lengths sent, or measured."""
    channel = recording.command
    times, lengths = recording.time, recording.unstrained_length
    if channel is not None and len(channel.time):
        times, lengths = channel.time, channel.value
    ticks = np.floor((times - times[0]) / (0.1 * knot_spacing))
    chosen = np.unique(ticks, return_index=True)[1]
    rest = statics.forward_kinematics(robot, lengths[chosen])
    good = rest.converged
    times, position = times[chosen][good], rest.position[good]
    if len(times) and times[0] > recording.time[0]:  # before the first command it stood there
        times, position = np.append(recording.time[0], times), np.vstack([position[:1], position])
    return times, position


def _fit(time: Array, position: Array, knot_spacing: float) -> PiecewisePolynomial:
    """Fit a clamped quintic B-spline to positions (M, 3) at times from 0 (M,)."""
    from scipy import sparse
    from scipy.interpolate import BSpline

    # at least 4 + 4 control points, of which the two ends are each a single unknown
    intervals = max(int(np.ceil(time[-1] / knot_spacing)), 8 - SPLINE_DEGREE)
    inner = np.linspace(0.0, time[-1], intervals + 1)
    knots = np.concatenate([np.zeros(SPLINE_DEGREE), inner, np.full(SPLINE_DEGREE, time[-1])])
    count = intervals + SPLINE_DEGREE
    owner = np.clip(np.arange(count) - 3, 0, count - 7)  # which unknown each control point is
    merge = sparse.csr_array((np.ones(count), (np.arange(count), owner)), (count, count - 6))
    design = sparse.csr_array(BSpline.design_matrix(time, knots, SPLINE_DEGREE)) @ merge
    fourth = [1.0, -4.0, 6.0, -4.0, 1.0]
    differences = sparse.diags_array(fourth, offsets=range(5), shape=(count - 4, count)) @ merge
    normal = design.T @ design + ROUGHNESS_WEIGHT * differences.T @ differences
    unknowns = sparse.linalg.spsolve(sparse.csc_array(normal), design.T @ position)
    spline = BSpline(knots, merge @ unknowns, SPLINE_DEGREE)
    powers = range(SPLINE_DEGREE + 1)
    pieces = [spline(inner[:-1], nu=power) / factorial(power) for power in powers]
    return PiecewisePolynomial(breaks=inner, coefficients=np.stack(pieces, axis=1))
