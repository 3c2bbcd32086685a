"""Pulleys of a robot at home as curves to draw: wheels, and the cables that go round them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from carosac_toolkit.base.arrays import Array

if TYPE_CHECKING:
    from carosac_toolkit.inspection.report import RobotReport

CIRCLE_POINTS = 73  # points of a circle
STUB_LENGTH_RADII = 3.0  # radii of cable drawn before the pulley


@dataclass(frozen=True, kw_only=True, eq=False)
class CableDrawing:
    """Cable and its pulley, as curves.

    Attributes:
        wheel: The pulley's circle in W [m], shape (points, 3); empty with a fixed eyelet.
        incoming: The end of the run from the winch, and the arc on the pulley, up to the tangent
            point [m], shape (points, 3); empty with a fixed eyelet.
        free: From there to the anchor point as it hangs [m], shape (points, 3).
    """

    wheel: Array
    incoming: Array
    free: Array


def draw_cables(report: RobotReport, smallest: float, ends: Array) -> list[CableDrawing]:
    """Compute the curves of each cable and its pulley.

    Args:
        report: The robot at home.
        smallest: Smaller pulleys are drawn with this radius [m], so that they can be seen. Their
            datum stays, and cables still leave at a tangent.
        ends: Drawn anchor points, at which the drawn cables end, in W [m], shape (n, 3).

    Returns:
        One drawing per cable.
    """
    from carosac_toolkit.physics.cable.straight_line import straight_length

    robot = report.robot
    pulley = robot.pulley_radius > 0.0
    radius = np.where(pulley, np.maximum(robot.pulley_radius, smallest), 0.0)
    position = report.equilibrium.position if report.equilibrium.converged[0] else None
    place = robot.home_position[None] if position is None else position
    anchors = (ends - place) @ report.rotation
    drawn = replace(robot, pulley_radius=radius, anchor_points=anchors)
    wrap = straight_length(drawn, place, report.rotation[None]).wrap[0]
    same = (radius == robot.pulley_radius) & np.isclose(ends, report.shape[:, -1]).all(axis=1)
    angle = np.where(same, report.wrap, wrap)
    share = np.linspace(0.0, 1.0, report.shape.shape[1])[:, None]
    hanging = report.shape + share * (ends - report.shape[:, -1])[:, None]
    return [
        _drawing(report, i, hanging[i], float(radius[i]), float(angle[i]))
        if pulley[i]
        else CableDrawing(wheel=np.empty((0, 3)), incoming=np.empty((0, 3)), free=hanging[i])
        for i in range(robot.n)
    ]


def _drawing(report: RobotReport, i: int, free: Array, radius: float, wrap: float) -> CableDrawing:
    """Draw one pulley with a radius; the cable is moved to the tangent point on it."""
    robot = report.robot
    datum, axis = robot.exit_points[i], robot.swivel_axis[i]
    relative = free[-1] - datum
    outward = relative - (relative @ axis) * axis
    length = float(np.linalg.norm(outward))
    outward = outward / length if length > 0.0 else np.linalg.svd(axis[None])[2][1]
    center = datum + radius * outward

    def around(angle: Array) -> Array:
        cosine, sine = np.cos(angle)[:, None], np.sin(angle)[:, None]
        points: Array = center + radius * (sine * axis - cosine * outward)
        return points

    arc = around(np.linspace(0.0, wrap, CIRCLE_POINTS))
    share = np.linspace(1.0, 0.0, len(free))[:, None]
    return CableDrawing(
        wheel=around(np.linspace(0.0, 2.0 * np.pi, CIRCLE_POINTS)),
        incoming=np.vstack([datum - STUB_LENGTH_RADII * radius * axis, arc]),
        free=free + share * (arc[-1] - free[0]),
    )
