"""Names of points in a view, placed where nothing else is drawn."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import pairwise, product
from typing import TYPE_CHECKING, Any

import numpy as np

from carosac_toolkit.base.arrays import Array

if TYPE_CHECKING:
    from matplotlib.text import Annotation
    from matplotlib.transforms import Bbox

DISTANCES_POINTS = (4.0, 8.0, 14.0, 22.0)  # [points] between a point and its name, nearest first
DIRECTIONS = (  # in which a name may be, with its alignment, the first choice first
    ((0, 1), "center", "bottom"), ((1, 1), "left", "bottom"), ((-1, 1), "right", "bottom"),
    ((0, -1), "center", "top"), ((-1, -1), "right", "top"), ((1, -1), "left", "top"),
    ((1, 0), "left", "center"), ((-1, 0), "right", "center"),
)  # fmt: skip
LINE_DISTANCE_POINTS = 14.0  # [points] from which a line leads from a point to its name
ROOM_PIXELS = 2.0  # [pixels] around a name that are kept free
COVERED_TEXT_POINTS = 1000  # points of curves that are better covered than another text or edge
LABEL_ROOM_PIXELS = 6.0  # [pixels] around the label of an axis that are kept free


def name_points(axes: Any, names: Sequence[tuple[str, Array]], drawn: Iterable[Array]) -> None:
    """Write the name of each point beside it, clear of curves, ticks and other names.

    Everything else in the figure must be drawn by now. A name for which there is no free place is
    put where it covers least, on a white ground.

    Args:
        axes: View in three dimensions.
        names: Names and points in W [m], each of shape (3,).
        drawn: Points on what must not be covered [m], each of shape (K, 3), close to each other.
    """
    from mpl_toolkits.mplot3d.proj3d import proj_transform

    figure = axes.figure
    figure.draw_without_rendering()  # places of panels and ticks are known from here on
    renderer = figure.canvas.get_renderer()
    curves = [*drawn, *_axis_lines(axes)]
    obstacles = [np.array(proj_transform(*curve.T, axes.get_proj())[:2]).T for curve in curves]
    pixels = axes.transData.transform(np.vstack(obstacles))
    taken = [box for axis in (axes.xaxis, axes.yaxis, axes.zaxis) for box in _boxes(axis, renderer)]
    taken += [text.get_window_extent(renderer).padded(LABEL_ROOM_PIXELS) for text in axes.texts]
    places = [
        (text, np.array(proj_transform(*point, axes.get_proj())[:2])) for text, point in names
    ]
    _put_all(axes, places, pixels, taken, figure.bbox)


def name_points_in_plane(axes: Any, names: Sequence[tuple[str, Array]]) -> None:
    """Write the name of each point beside it, clear of lines, markers, ticks and other names.

    Everything else in the figure must be drawn by now. A name for which there is no free place is
    put where it covers least, on a white ground.

    Args:
        axes: View of a plane.
        names: Names and points in the units of the axes, each of shape (2,).
    """
    figure = axes.figure
    for _ in range(2):  # sizes of panels with equal scales settle in two steps
        figure.draw_without_rendering()
    renderer = figure.canvas.get_renderer()
    pixels = np.vstack([*(_line_pixels(line) for line in axes.lines), np.zeros((0, 2))])
    taken = [box for axis in (axes.xaxis, axes.yaxis) for box in _boxes(axis, renderer)]
    _put_all(axes, names, pixels, taken, axes.bbox)


def _line_pixels(line: Any) -> Array:
    """Return points on a line and its markers [pixels], close to each other, shape (K, 2)."""
    corners = line.get_transform().transform(np.column_stack(line.get_data(orig=False)))
    corners = corners[np.isfinite(corners).all(axis=1)]
    points = [corners]
    if line.get_linestyle() != "None":
        points += [dense(a, b) for a, b in pairwise(corners)]
    if line.get_marker() not in ("None", "", None):
        reach = 0.5 * line.get_markersize() * line.get_figure().dpi / 72.0
        points += [corners + reach * np.array(direction) for direction, _, _ in DIRECTIONS]
    return np.vstack(points)


def _put_all(
    axes: Any, names: Sequence[tuple[str, Array]], pixels: Array, taken: list[Bbox], room: Bbox
) -> None:
    """Put names at points in the data coordinates of the axes, one after the other."""
    renderer = axes.figure.canvas.get_renderer()
    for text, place in names:
        name = axes.annotate(
            text, place, xytext=(0, 0), textcoords="offset points", fontsize=7,
            arrowprops={"arrowstyle": "-", "lw": 0.4, "shrinkA": 0.0, "shrinkB": 2.0},
        )  # fmt: skip
        name.set_in_layout(False)
        taken.append(_put(name, renderer, pixels, taken, room))


def _axis_lines(axes: Any) -> list[Array]:
    """Return points on the three axes that are drawn [m], each of shape (K, 3)."""
    left, right = axes.get_xlim()
    front, back = axes.get_ylim()
    low, high = axes.get_zlim()
    near, corner = np.array([right, front, low]), np.array([right, back, low])
    return [
        dense(np.array([left, front, low]), near),
        dense(near, corner),
        dense(corner, np.array([right, back, high])),
    ]


def _boxes(axis: Any, renderer: Any) -> list[Bbox]:
    """Return the boxes of the numbers and the label of an axis [pixels]."""
    texts = [tick.label1 for tick in axis.get_major_ticks()] + [axis.label]
    return [text.get_window_extent(renderer) for text in texts if text.get_text()]


def _put(name: Annotation, renderer: Any, pixels: Array, taken: Sequence[Bbox], room: Bbox) -> Bbox:
    """Move a name to the first free place within some room, and return its box [pixels]."""
    from matplotlib.text import Text

    best = None
    assert name.arrow_patch is not None and name.axes is not None
    point = name.axes.transData.transform(name.xy)
    for distance, (direction, across, up) in product(DISTANCES_POINTS, DIRECTIONS):
        offset = tuple(distance * step for step in direction)
        name.set(position=offset, ha=across, va=up)
        name.update_positions(renderer)  # until then offsets are relative to the figure's corner
        box = Text.get_window_extent(name, renderer).padded(ROOM_PIXELS)
        covered = COVERED_TEXT_POINTS * sum(box.overlaps(other) for other in taken)
        if box.x0 < room.x0 or box.x1 > room.x1 or box.y0 < room.y0 or box.y1 > room.y1:
            covered += COVERED_TEXT_POINTS
        covered += _inside(pixels, box)
        if distance >= LINE_DISTANCE_POINTS:
            line = dense(point, 0.5 * np.add(box.min, box.max))
            covered += COVERED_TEXT_POINTS * sum(_inside(line, other) > 0 for other in taken)
        if best is None or covered < best[0]:
            best = (covered, {"position": offset, "ha": across, "va": up}, box, distance)
        if covered == 0:
            break
    assert best is not None
    name.set(**best[1])
    name.arrow_patch.set_visible(best[3] >= LINE_DISTANCE_POINTS)
    if best[0]:
        name.set_bbox({"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 0.5})
    return best[2]


def _inside(points: Array, box: Bbox) -> int:
    """Return how many points [pixels], shape (K, 2), lie in a box."""
    return int(((points > box.min) & (points < box.max)).all(axis=1).sum())


def dense(start: Array, end: Array, count: int = 60) -> Array:
    """Return points on a straight line between two points, shape (count, 3)."""
    share = np.linspace(0.0, 1.0, count)[:, None]
    points: Array = start + share * (end - start)
    return points
