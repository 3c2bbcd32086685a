"""A robot at home, drawn in three dimensions, from above and from two sides."""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.numbers import plain
from carosac_toolkit.pictures.drawing import (
    ENLARGEMENTS,
    new_figure,
    put_legend,
    set_plane,
    set_space,
    set_title,
)
from carosac_toolkit.pictures.point_names import dense, name_points
from carosac_toolkit.pictures.pulleys import CableDrawing, draw_cables
from carosac_toolkit.pictures.style import DOUBLE_COLUMN_INCH, SERIES_COLORS, styled
from carosac_toolkit.robot.robot import Robot

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from carosac_toolkit.inspection.report import RobotReport

CABLE_COLOR = SERIES_COLORS[0]
FRAME_COLOR = "#3a3a3a"
PLATFORM_COLOR = SERIES_COLORS[1]
WORKSPACE_BOX_COLOR = "#8a8a8a"
FED_CABLE_COLOR = SERIES_COLORS[2]
DRAWN_PLATFORM_RATIO_MIN = 0.05  # of the largest extent: smaller platforms are drawn larger
DRAWN_PULLEY_RADIUS_MIN = 0.012  # of the largest extent: smaller pulleys are drawn with this radius


@styled
def draw_robot(report: RobotReport) -> Figure:
    """Draw frame, cables as they hang, platform, workspace box and home position.

    A platform that would be too small to see is drawn larger, with cables that end at the drawn
    anchor points; the legend says how many times.

    Args:
        report: The robot and how it hangs at home.

    Returns:
        A figure without a window; ``savefig`` writes it.
    """
    figure = new_figure(DOUBLE_COLUMN_INCH, 4.6)
    grid = figure.add_gridspec(2, 2, width_ratios=(1.3, 1.0))
    space = figure.add_subplot(grid[:, 0], projection="3d")
    extent = _limits(report, [report.shape.reshape(-1, 3)])
    smallest = DRAWN_PULLEY_RADIUS_MIN * float((extent[:, 1] - extent[:, 0]).max())
    corners = _platform(report, platform_factor(report.robot, extent))
    cables = draw_cables(report, smallest, corners)
    limits = _limits(report, [corners, *(np.vstack([c.free, c.wheel, c.incoming]) for c in cables)])
    _draw_space(space, report, cables, limits)
    _draw_platform(space, report, corners, platform_factor(report.robot, extent))
    _draw_pulleys(space, report, cables, smallest)
    _draw_plane(figure.add_subplot(grid[0, 1]), report, cables, corners, (0, 1), limits)
    _draw_plane(figure.add_subplot(grid[1, 1]), report, cables, corners, (1, 2), limits)
    robot = report.robot
    answer = f"largest sag at home {plain(report.sag.max() * 1e3, 3)} mm"
    if not report.equilibrium.converged[0]:
        answer = "NO EQUILIBRIUM AT HOME (cables drawn straight)"
    elif not report.feasible:
        answer = "CANNOT STAY AT HOME"
    set_title(
        figure,
        f"{robot.name}: {robot.n} cables, {report.constraint}"
        f"{', suspended' if report.suspended else ''}",
        f"platform {plain(robot.mass, 3)} kg; {answer}",
    )
    put_legend(figure, space)
    span_max = float((limits[:, 1] - limits[:, 0]).max())
    curves = [curve for c in cables for curve in (c.free, c.wheel, c.incoming) if len(curve)]
    box = [dense(*edge) for edge in box_edges(robot)]
    names = exit_labels(robot, 0.08 * span_max)
    name_points(space, names, [*curves, *box, corners, robot.exit_points])
    return figure


def platform_factor(robot: Robot, limits: Array) -> int:
    """Return how many times larger a platform is drawn so that it can be seen.

    Args:
        robot: The robot.
        limits: Lower and upper end of the drawn range of each axis [m], shape (3, 2).
    """
    size = float(np.ptp(robot.anchor_points, axis=0).max())
    wanted = DRAWN_PLATFORM_RATIO_MIN * float((limits[:, 1] - limits[:, 0]).max())
    if size <= 0.0 or size >= wanted:
        return 1
    return next((k for k in ENLARGEMENTS if k * size >= wanted), ENLARGEMENTS[-1])


def _platform(report: RobotReport, factor: int) -> Array:
    """Return the drawn anchor points at home in W [m], shape (n, 3)."""
    anchors = _anchors(report)
    center = anchors.mean(axis=0)
    enlarged: Array = center + factor * (anchors - center)
    return enlarged


def _limits(report: RobotReport, drawn: list[Array]) -> Array:
    """Return lower and upper end of the drawn range of each axis [m], shape (3, 2)."""
    robot = report.robot
    points = np.vstack(
        [robot.exit_points, robot.workspace_min, robot.workspace_max, _anchors(report), *drawn]
    )
    lower, upper = points.min(axis=0), points.max(axis=0)
    lower[2] = min(lower[2], 0.0)
    margin = 0.06 * float((upper - lower).max())
    on_floor = points[:, 2].min() < lower[2] + 0.5 * margin
    below = margin * np.array([1.0, 1.0, 0.5 if on_floor else 0.0])
    return np.stack([lower - below, upper + margin], axis=1)


def _draw_space(axes: Any, report: RobotReport, cables: list[CableDrawing], limits: Array) -> None:
    """Draw the view in three dimensions."""
    robot = report.robot
    for k, edge in enumerate(box_edges(robot)):
        axes.plot(
            *edge.T,
            color=WORKSPACE_BOX_COLOR,
            lw=0.7,
            ls="--",
            label=None if k else "workspace box",
        )
    for point in robot.exit_points:
        post = np.array([[*point[:2], limits[2, 0]], point])
        axes.plot(*post.T, color=FRAME_COLOR, lw=0.6, alpha=0.25)
    for k, cable in enumerate(cables):
        axes.plot(*cable.free.T, color=CABLE_COLOR, lw=1.1, label=None if k else "cables at home")
    size = 6 if (robot.pulley_radius > 0.0).any() else 14  # beside a pulley it is its datum
    axes.scatter(
        *robot.exit_points.T,
        color=FRAME_COLOR,
        s=size,
        marker="s",
        label="exit points",
        depthshade=False,
    )
    set_space(axes, limits, elev=20.0, azim=-52.0)


def _draw_pulleys(
    axes: Any, report: RobotReport, cables: list[CableDrawing], smallest: float
) -> None:
    """Draw pulleys as discs in their swivel planes, and the cables that come to them."""
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    wheels = [cable for cable in cables if len(cable.wheel)]
    if not wheels:
        return
    faces = [cable.wheel for cable in wheels]
    axes.add_collection3d(
        Poly3DCollection(faces, facecolor=FRAME_COLOR, edgecolor=FRAME_COLOR, alpha=0.3)
    )
    radius = report.robot.pulley_radius
    enlarged = ((radius > 0.0) & (radius < smallest)).any()
    scale = f"drawn with {smallest * 1e3:.0f} mm radius or more" if enlarged else "to scale"
    for k, cable in enumerate(wheels):
        axes.plot(
            *cable.wheel.T, color=FRAME_COLOR, lw=0.7, label=None if k else f"pulleys, {scale}"
        )
        label = None if k else "cable from the winch"
        axes.plot(*cable.incoming.T, color=FED_CABLE_COLOR, lw=1.1, label=label)


def exit_labels(robot: Robot, near: float) -> list[tuple[str, Array]]:
    """Return cable names and their positions [m]; exit points nearer than `near` share a label."""
    groups: list[list[int]] = []
    for i, point in enumerate(robot.exit_points):
        for group in groups:
            if np.linalg.norm(robot.exit_points[group[0]] - point) < near:
                group.append(i)
                break
        else:
            groups.append([i])
    return [
        (", ".join(robot.cable_names[i] for i in group), robot.exit_points[group].mean(axis=0))
        for group in groups
    ]


def _draw_platform(axes: Any, report: RobotReport, corners: Array, factor: int) -> None:
    """Draw the platform as the hull of its anchor points, and the home position."""
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    patch = Poly3DCollection(
        _faces(corners), facecolor=PLATFORM_COLOR, edgecolor=PLATFORM_COLOR, alpha=0.35, lw=0.8
    )
    axes.add_collection3d(patch)
    larger = f", platform drawn {factor} times larger" if factor > 1 else ""
    axes.scatter(
        *corners.T, color=PLATFORM_COLOR, s=7, label=f"anchor points{larger}", depthshade=False
    )
    home = report.robot.home_position[:, None]
    axes.scatter(*home, color="black", s=30, marker="+", label="home position", depthshade=False)


def _draw_plane(
    axes: Any,
    report: RobotReport,
    cables: list[CableDrawing],
    corners: Array,
    pair: tuple[int, int],
    limits: Array,
) -> None:
    """Draw one projection, axes to scale."""
    robot = report.robot
    pulleys = (robot.pulley_radius > 0.0).any()
    columns = list(pair)
    for edge in box_edges(robot):
        axes.plot(*edge[:, columns].T, color=WORKSPACE_BOX_COLOR, lw=0.7, ls="--")
    for cable in cables:
        axes.fill(
            *cable.wheel[:, columns].T,
            facecolor=FRAME_COLOR,
            edgecolor=FRAME_COLOR,
            alpha=0.3,
            lw=0.8,
        )
        axes.plot(*cable.incoming[:, columns].T, color=FED_CABLE_COLOR, lw=1.0)
        axes.plot(*cable.free[:, columns].T, color=CABLE_COLOR, lw=1.0)
    anchors = corners[:, columns]
    axes.fill(*_hull(anchors).T, facecolor=PLATFORM_COLOR, edgecolor=PLATFORM_COLOR, alpha=0.35)
    axes.plot(*anchors.T, ".", color=PLATFORM_COLOR, ms=3)
    axes.plot(*robot.exit_points[:, columns].T, "s", color=FRAME_COLOR, ms=2.0 if pulleys else 3)
    axes.plot(*robot.home_position[columns], "+", color="black", ms=6)
    title = "from above" if pair == (0, 1) else "from the side, along -x"
    set_plane(axes, pair, title, xlim=limits[pair[0]], ylim=limits[pair[1]])


def _anchors(report: RobotReport) -> Array:
    """Return the anchor points at home in W [m], shape (n, 3)."""
    home = report.equilibrium
    place = home.position[0] if home.converged[0] else report.robot.home_position
    return place + report.robot.anchor_points @ report.rotation.T


def box_edges(robot: Robot) -> list[Array]:
    """Return the twelve edges of the workspace box [m], each of shape (2, 3)."""
    corners = np.stack([robot.workspace_min, robot.workspace_max])
    edges = []
    for axis in range(3):
        others = [k for k in range(3) if k != axis]
        for picks in product((0, 1), repeat=2):
            edge = corners.copy()
            for other, pick in zip(others, picks, strict=True):
                edge[:, other] = corners[pick, other]
            edges.append(edge)
    return edges


def _hull(points: Array) -> Array:
    """Return the convex hull of points in a plane, in order, (m, 2); all points if collinear."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        corners: Array = points[ConvexHull(points).vertices]
    except (QhullError, ValueError):
        return points
    return corners


def _faces(points: Array) -> list[Array]:
    """Return the faces of the convex hull of points; one polygon if they are coplanar."""
    from scipy.spatial import ConvexHull, QhullError

    centered = points - points.mean(axis=0)
    _, spread, axes = np.linalg.svd(centered, full_matrices=False)
    if len(points) < 4 or spread[-1] < 1e-6 * spread[0]:
        flat = centered @ axes[:2].T
        return [points.mean(axis=0) + _hull(flat) @ axes[:2]]
    try:
        hull = ConvexHull(points)
    except (QhullError, ValueError):
        return [points]
    return [points[simplex] for simplex in hull.simplices]
