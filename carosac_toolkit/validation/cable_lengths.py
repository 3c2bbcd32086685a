r"""Cables between known poses: the length that a cable has when it pulls with a given tension.

With the tension T at the platform and the angle :math:`\varphi` at which it acts above the
horizontal, :math:`H = T\cos\varphi`, :math:`V_b = T\sin\varphi`, :math:`V_a = V_b + wL`, Irvine's
catenary spans a given horizontal and vertical distance for one pair :math:`(\varphi, L)`, which
Newton's method finds. Pulleys and the run to the winch follow from the tension at the exit.

References:
    Irvine, *Cable Structures*, MIT Press, 1981, section 1.4.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from carosac_toolkit.arrays import Array
from carosac_toolkit.robot import Robot

CLOSURE = 1e-11  # of the chord: a larger gap is no solution
_NEWTON = 60
_ROUNDS = 20  # of tangent point and catenary, each a factor radius / length nearer


@dataclass(frozen=True, kw_only=True, eq=False)
class CableLengths:
    """Cables of known tension between datum and anchor; NaN where `valid` is False.

    Attributes:
        unstrained_length: Material from datum to anchor [m], shape (B, n).
        sag: By how much the free cable is longer than its chord, as it hangs [m], shape (B, n).
        stretch: Elongation of free cable and run together [m], shape (B, n).
        valid: Whether there is such a cable, shape (B, n).
    """

    unstrained_length: Array
    sag: Array
    stretch: Array
    valid: NDArray[np.bool_]


class _Hanging(NamedTuple):
    """Free cables: horizontal tension, vertical ones at anchor and exit [N], material [m]."""

    horizontal: Array
    lower: Array
    upper: Array
    length: Array
    valid: NDArray[np.bool_]


def length_at_tension(
    robot: Robot, position: Array, rotation: Array, tension: Array
) -> CableLengths:
    """Length of each cable that reaches a pose and pulls there with a given tension.

    Args:
        robot: Robot description, n cables.
        position: Platform origin in W [m], shape (B, 3).
        rotation: Rotation from P to W, shape (B, 3, 3).
        tension: At the platform [N], shape (B, n); NaN where unknown.

    Returns:
        The lengths; a tension that is unknown or not positive has none.
    """
    anchor = position[:, None] + np.einsum("bij,nj->bni", rotation, robot.anchor_points)
    point = np.broadcast_to(robot.exit_points, anchor.shape)
    wrap = np.zeros(tension.shape)
    weight, stiffness = robot.weight_per_length, robot.axial_stiffness
    known = tension > 0.0
    pull = np.where(known, tension, 1.0)
    for _ in range(_ROUNDS):
        reach = point - anchor
        cable = _hang(reach, pull, weight, stiffness)
        moved, wrap = _tangent(robot, cable, reach)
        step = float(np.abs(np.where(known[..., None], moved - point, 0.0)).max())
        point = moved
        if step < 1e-13:
            break
    chord = np.linalg.norm(point - anchor, axis=-1)
    strain = np.hypot(cable.horizontal, cable.upper) / stiffness
    run, arc = robot.run_length * strain, robot.pulley_radius * wrap
    unstrained = cable.length + (arc - run) / (1.0 + strain)
    elongation = _elongation(cable, weight, stiffness)
    valid = known & cable.valid

    def masked(value: Array) -> Array:
        return np.where(valid, value, np.nan)

    return CableLengths(
        unstrained_length=masked(unstrained),
        sag=masked(cable.length + elongation - chord),
        stretch=masked(elongation + run / (1.0 + strain)),
        valid=valid,
    )


def _hang(reach: Array, tension: Array, weight: Array, stiffness: Array) -> _Hanging:
    """Free cables from anchor to tangent point that pull with `tension` at the anchor.

    Args:
        reach: From anchor to tangent point in W [m], shape (B, n, 3).
        tension: [N], shape (B, n).
        weight: [N/m], shape (n,).
        stiffness: EA [N], shape (n,).
    """
    span, rise = np.hypot(reach[..., 0], reach[..., 1]), reach[..., 2]
    chord = np.hypot(span, rise)
    length = chord / (1.0 + tension / stiffness)
    angle = np.arctan2(tension * rise / chord - 0.5 * weight * length, tension * span / chord)
    for _ in range(_NEWTON):
        horizontal = np.maximum(tension * np.cos(angle), 1e-12 * tension)
        lower = tension * np.sin(angle)
        upper = lower + weight * length
        t_lower, t_upper = np.hypot(horizontal, lower), np.hypot(horizontal, upper)
        bend = (np.arcsinh(upper / horizontal) - np.arcsinh(lower / horizontal)) / weight
        turn = (upper / t_upper - lower / t_lower) / weight
        cross = horizontal / weight * (1.0 / t_upper - 1.0 / t_lower)
        axial = length / stiffness
        gap_x = horizontal * (axial + bend) - span
        gap_z = (t_upper - t_lower) / weight + axial * (lower + 0.5 * weight * length) - rise
        if (np.hypot(gap_x, gap_z) <= 1e-14 * chord).all():
            break
        x_angle = -lower * (axial + bend - turn) + horizontal * cross
        z_angle = -lower * cross + horizontal * (turn + axial)
        feed = 1.0 / stiffness + 1.0 / t_upper
        x_length, z_length = horizontal * feed, upper * feed
        determinant = x_angle * z_length - z_angle * x_length
        angle = angle - np.clip((gap_x * z_length - gap_z * x_length) / determinant, -0.5, 0.5)
        change = (x_angle * gap_z - z_angle * gap_x) / determinant
        length = length - np.clip(change, -length, 0.5 * length)
    valid = np.hypot(gap_x, gap_z) <= CLOSURE * chord
    return _Hanging(horizontal, lower, upper, length, valid & (length > 0.0))


def _tangent(robot: Robot, cable: _Hanging, reach: Array) -> tuple[Array, Array]:
    """Where each cable leaves its pulley in W [m], (B, n, 3), and its wrap [rad], (B, n)."""
    span = np.maximum(np.hypot(reach[..., 0], reach[..., 1]), 1e-300)
    leaving = np.empty(reach.shape)
    leaving[..., :2] = -reach[..., :2] * (cable.horizontal / span)[..., None]
    leaving[..., 2] = -cable.upper
    leaving /= np.linalg.norm(leaving, axis=-1, keepdims=True)
    axis, radius = robot.swivel_axis, robot.pulley_radius
    cosine = np.einsum("bni,ni->bn", leaving, axis)
    across = leaving - cosine[..., None] * axis
    sine = np.linalg.norm(across, axis=-1)
    outward = across / np.maximum(sine, 1e-300)[..., None]
    offset = (1.0 - cosine)[..., None] * outward + sine[..., None] * axis
    wrap = np.where(radius > 0.0, np.arctan2(sine, cosine), 0.0)
    return robot.exit_points + radius[:, None] * offset, wrap


def _elongation(cable: _Hanging, weight: Array, stiffness: Array) -> Array:
    """Integral of tension over EA along the free cable [m], shape (B, n)."""

    def primitive(vertical: Array) -> Array:
        tension = np.hypot(cable.horizontal, vertical)
        ratio = np.arcsinh(vertical / cable.horizontal)
        return np.asarray(vertical * tension + cable.horizontal**2 * ratio)

    difference = primitive(cable.upper) - primitive(cable.lower)
    return np.asarray(difference / (2.0 * weight * stiffness))
