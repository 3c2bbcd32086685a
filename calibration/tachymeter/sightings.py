r"""Sighted points of a pulley relative to its exit point, with derivatives.

The exit point :math:`e` of a cable with a pulley is the datum: the tangent point at zero wrap, on
the swivel axis :math:`k`. The wheel swivels with the cable, so its points are known only with the
direction of its plane. With :math:`u` the unit vector at right angles to the axis, from it towards
the anchor point, turned by a small unknown :math:`\delta`, groove radius :math:`r`, and
:math:`t = k \times u`,

.. math:: \text{axle} = e + r u, \qquad
          \text{rim}(\theta) = e + (r - r_s \cos\theta) u + r_s \sin\theta\, k,

both plus :math:`h t` for a point at distance h from the middle plane. The tangent point is the rim
at the wrap angle of a straight cable to the anchor point.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calibration.tachymeter.observations import Sighting
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import InvalidField


@dataclass(frozen=True, kw_only=True, eq=False)
class SightedPulley:
    """A pulley as it stood while it was sighted.

    Attributes:
        cable: Name of its cable.
        radius: To the groove [m].
        axis: Swivel axis in W, unit vector, shape (3,).
        towards: Anchor point of the cable in W [m], shape (3,).
    """

    cable: str
    radius: float
    axis: Array
    towards: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class SightedPoint:
    """A sighted point with its derivatives.

    Attributes:
        point: In W [m], shape (3,).
        by_exit: Derivative with respect to the exit point, shape (3, 3).
        by_swivel: Derivative with respect to the swivel angle [m/rad], shape (3,).
    """

    point: Array
    by_exit: Array
    by_swivel: Array


def sighted_point(
    exit_point: Array, sighting: Sighting, pulley: SightedPulley, swivel: float, side: float
) -> SightedPoint:
    """Find a sighted point of a pulley.

    Args:
        exit_point: Datum of the cable in W [m], shape (3,).
        sighting: Sighted part; not ``centre``.
        pulley: The pulley.
        swivel: Turn of its plane about the swivel axis, beyond the cable's direction [rad].
        side: On which side of the wheel the instrument stood: the sign of `elevation`.

    Returns:
        The point in W and its derivatives.

    Raises:
        InvalidField: The cable runs along the swivel axis or into its pulley.
    """
    plain, rho, along = _plane(exit_point, pulley)
    across = np.cross(pulley.axis, plain)
    u = np.cos(swivel) * plain + np.sin(swivel) * across
    t = np.cross(pulley.axis, u)
    out, up, out_slope, up_slope = _in_plane(sighting, pulley, rho, along)
    off = side * sighting.side
    turn = out * t - off * u  # derivative by the angle of the plane about the axis
    # the angle falls by across . de / rho, rho by plain . de, and `along` by axis . de
    lever = out_slope[0] * plain + out_slope[1] * pulley.axis
    rise = up_slope[0] * plain + up_slope[1] * pulley.axis
    by_exit = (
        np.eye(3) - np.outer(turn, across) / rho - np.outer(u, lever) - np.outer(pulley.axis, rise)
    )
    point = exit_point + out * u + up * pulley.axis + off * t
    return SightedPoint(point=point, by_exit=by_exit, by_swivel=turn)


def elevation(exit_point: Array, pulley: SightedPulley, station: Array) -> float:
    """Return the angle of a sight from the wheel's middle plane [rad]; 0 is edge-on."""
    plain, _, _ = _plane(exit_point, pulley)
    sight = station - exit_point
    across = float(sight @ np.cross(pulley.axis, plain))
    return float(np.arcsin(across / np.linalg.norm(sight)))


def _plane(exit_point: Array, pulley: SightedPulley) -> tuple[Array, float, float]:
    """Return direction from swivel axis to anchor, distance from the axis, and along it."""
    relative = pulley.towards - exit_point
    along = float(relative @ pulley.axis)
    outward = relative - along * pulley.axis
    rho = float(np.linalg.norm(outward))
    if rho <= 1e-3:
        allowed = "an anchor point off the swivel axis: the pulley's direction depends on it"
        raise InvalidField(f"cable {pulley.cable}: towards", pulley.towards, allowed)
    return outward / rho, rho, along


def _in_plane(
    sighting: Sighting, pulley: SightedPulley, rho: float, along: float
) -> tuple[float, float, tuple[float, float], tuple[float, float]]:
    """Return the offset from the datum along u and k [m], with derivatives by rho and `along`."""
    r = pulley.radius
    if sighting.kind == "axle":
        return r, 0.0, (0.0, 0.0), (0.0, 0.0)
    if sighting.kind == "rim":
        angle = float(sighting.rim_angle or 0.0)
        size = sighting.rim_radius or r
        return r - size * np.cos(angle), size * np.sin(angle), (0.0, 0.0), (0.0, 0.0)
    x = rho - r
    square = x * x + along * along
    free = square - r * r
    if free <= 0.0:
        allowed = f"an anchor point outside the pulley of radius {r} m"
        raise InvalidField(f"cable {pulley.cable}: towards", pulley.towards, allowed)
    s = np.sqrt(free)
    sine, cosine = (s * x + r * along) / square, (s * along - r * x) / square
    by_rho, by_along = cosine / s, -sine / s  # of the wrap angle
    return (
        r * (1.0 - cosine),
        r * sine,
        (r * sine * by_rho, r * sine * by_along),
        (r * cosine * by_rho, r * cosine * by_along),
    )
