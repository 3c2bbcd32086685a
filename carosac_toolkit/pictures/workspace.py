"""Pictures of a workspace: slices with margin and limits, maps, and the boundary in space."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.numbers import plain
from carosac_toolkit.pictures.drawing import (
    new_figure,
    set_space,
    set_title,
)
from carosac_toolkit.pictures.point_names import dense, name_points
from carosac_toolkit.pictures.robot import box_edges, exit_labels
from carosac_toolkit.pictures.style import DOUBLE_COLUMN_INCH, SINGLE_COLUMN_INCH, styled
from carosac_toolkit.pictures.workspace_limits import (
    BOX_FACE_COLOR,
    FRAME_COLOR,
    HATCHES,
    INSIDE_COLOR,
    by_words,
    limit_legend,
    shown_limits,
)
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.workspace.grid import line_in_box
from carosac_toolkit.workspace.limits import CABLE_LIMITS
from carosac_toolkit.workspace.maps import Maps
from carosac_toolkit.workspace.region import Region

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SIDE_BY_SIDE_ASPECT_MAX = 4.0  # sum of width over height of slices up to which they fit in a row
PANEL_ROOM_RATIO = 0.03  # of the longer side of a slice, around it
PANEL_HEIGHT_MAX_INCH = 3.0  # [inch] of the drawn part of a slice
CONSTANT_RATIO = 1e-3  # of a mapped value: a map that varies less is written, not drawn
CONSTANT_SIZE_MIN = 1e-3  # in units of the map: smaller values than this times the ratio are zero
MAPPED_QUANTITIES = (
    ("margin", "margin [N]", 1.0),
    ("tilt", "tilt [deg]", 180.0 / np.pi),
    ("stiffness", "least stiffness [N/m]", 1.0),
    ("frequency", "lowest frequency [Hz]", 1.0),
    ("sag", "largest sag [mm]", 1e3),
    ("distance", "least cable distance [m]", 1.0),
)


@styled
def draw_slices(regions: Sequence[Region]) -> Figure:
    """Draw slices: the margin of the tensions, and beside it the limit that decides.

    Each slice has a scale of its own and fills its panel. Slices stand side by side, margin above
    limit, or below each other if together they are too wide for that. Where no limit excludes any
    position, only margins are drawn.

    Args:
        regions: Verdicts on planes; see `slice_grid`.
    """
    planes = [_Plane(region) for region in regions]
    shown = shown_limits(regions)
    scale = _margin_scale(regions)
    figure, margins, limits = _slice_panels(planes, len(by_words(shown)))
    for k, (region, plane) in enumerate(zip(regions, planes, strict=True)):
        image = _draw_margin(margins[k], region, plane, scale)
        margins[k].set_title(f"{plane.title}\n{region.share:.1%} inside")
    for axes, region, plane in zip(limits, regions, planes, strict=False):
        _draw_limits(axes, region, plane, shown)
    label = "margin of the tensions [N]"
    flat = not shown and not _below_each_other(planes)
    bar = figure.colorbar(
        image, ax=[*margins, *limits], label=label, fraction=0.06, pad=0.02,
        aspect=20 if flat else 40, extend="both" if shown else "neither",
    )  # fmt: skip
    if not shown:
        bar.ax.set_ylim(0.0, scale.vmax)
    exits = any(plane.shows(regions[0].robot.exit_points) for plane in planes)
    limit_legend(figure, regions[0], shown, exits=exits)
    first, second = ("left", "right") if _below_each_other(planes) else ("above", "below")
    explained = (
        f"{first}: margin of the tensions; {second}: deciding limit; black line: workspace's end"
        if shown
        else "margin of the tensions; no limit excludes any position"
    )
    set_title(figure, _title(regions[0]), explained)
    return figure


def _slice_panels(planes: Sequence[_Plane], entries: int) -> tuple[Figure, list[Any], list[Any]]:
    """Make a figure with panels for each slice, each as wide to high as its slice.

    Args:
        planes: The slices.
        entries: Number of kinds of limits in the legend; without any there are no panels for them.

    Returns:
        The figure, and the panels of margins and of limits.
    """
    aspects = [plane.aspect for plane in planes]
    below = 0.8 + 0.16 * (entries + 2 if entries else 1)  # [inch] of title and legend
    kinds = 2 if entries else 1
    if _below_each_other(planes):
        total = DOUBLE_COLUMN_INCH if entries else SINGLE_COLUMN_INCH
        width = (total - 1.0 * kinds) / kinds
        heights = [width / aspect for aspect in aspects]
        figure = new_figure(total, below + sum(heights) + 0.7 * len(planes))
        panels = figure.subplots(len(planes), kinds, squeeze=False, height_ratios=heights)
        return figure, list(panels[:, 0]), list(panels[:, 1:].ravel())
    room = DOUBLE_COLUMN_INCH - 0.9 - 0.55 * len(planes)
    height = min(room / sum(aspects), PANEL_HEIGHT_MAX_INCH)
    figure = new_figure(DOUBLE_COLUMN_INCH, below + kinds * (height + 0.5))
    panels = figure.subplots(kinds, len(planes), squeeze=False, width_ratios=aspects)
    return figure, list(panels[0]), list(panels[1:].ravel())


def _below_each_other(planes: Sequence[_Plane]) -> bool:
    """Return whether slices stand below each other, because side by side they would be flat."""
    return sum(plane.aspect for plane in planes) > SIDE_BY_SIDE_ASPECT_MAX


def _title(region: Region) -> str:
    """Return robot and model."""
    return f"{region.robot.name}, {'with sag' if region.settings.sag else 'straight cables'}"


@styled
def draw_maps(region: Region, found: Maps) -> Figure:
    """Draw margin, tilt, stiffness, frequency, sag and cable distance on one slice.

    A quantity that is the same everywhere inside is not drawn; the title has its value.

    Args:
        region: Verdicts on a plane.
        found: Their maps.
    """
    plane = _Plane(region)
    values: dict[str, Array] = {}
    for name, _, factor in MAPPED_QUANTITIES:
        record: Any = region.verdicts if name in ("margin", "distance") else found
        values[name] = np.where(region.verdicts.inside, getattr(record, name) * factor, np.nan)
    constants = {name: _constant(of_all) for name, of_all in values.items()}
    mapped = [(name, label) for name, label, _ in MAPPED_QUANTITIES if constants[name] is None]
    columns = min(2 if plane.width > 1.4 * plane.height else 3, max(1, len(mapped)))
    rows = -(-len(mapped) // columns)
    width = DOUBLE_COLUMN_INCH / max(2, columns) - 1.1  # [inch] of a panel without its labels
    height = min(width * plane.height / plane.width, PANEL_HEIGHT_MAX_INCH)
    figure = new_figure(DOUBLE_COLUMN_INCH, rows * (height + 0.65) + 0.5)
    panels = figure.subplots(rows, columns, squeeze=False).ravel() if mapped else ()
    for axes, (name, label) in zip(panels, mapped, strict=False):
        mesh = plane.fill(axes, values[name], cmap="viridis", norm=_norm(name, values[name]))
        figure.colorbar(mesh, ax=axes, shrink=0.9)
        _set_plane(axes, region, plane)
        axes.set_title(label)
    for axes in panels[len(mapped) :]:
        axes.remove()
    same = [
        label.replace(" [", f" {plain(value, 3)} ").rstrip("]")
        for name, label, _ in MAPPED_QUANTITIES
        if (value := constants[name]) is not None
    ]
    everywhere = f"the same everywhere: {', '.join(same)}" if same else ""
    set_title(figure, f"{_title(region)}, {plane.title}; white: outside", everywhere)
    return figure


def _constant(values: Array) -> float | None:
    """Return the value of a map that is the same everywhere inside; None for other maps."""
    finite = values[np.isfinite(values)]
    low, high = (float(finite.min()), float(finite.max())) if len(finite) else (0.0, 1.0)
    rounding = CONSTANT_RATIO * max(abs(low), abs(high), CONSTANT_SIZE_MIN)
    return 0.5 * (low + high) if high - low <= rounding else None


def _norm(name: str, values: Array) -> Any:
    """Return the colour scale of a map: logarithmic for stiffness."""
    from matplotlib.colors import LogNorm, Normalize

    finite = values[np.isfinite(values)]
    low, high = (float(finite.min()), float(finite.max())) if len(finite) else (0.0, 1.0)
    if name == "stiffness" and low > 0.0 and high > 10.0 * low:
        return LogNorm(low, high)
    return Normalize(low, high)


@styled
def draw_space(region: Region) -> Figure:
    """Draw the boundary of a workspace in space, coloured by the limit beyond it.

    Args:
        region: Verdicts on a grid in a box.
    """
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    entries = len(by_words(shown_limits([region])))
    figure = new_figure(DOUBLE_COLUMN_INCH, 4.0 + 0.16 * (entries + 2 if entries else 1))
    axes = figure.add_subplot(projection="3d")
    faces, keys = _boundary(region)
    shown = shown_limits([region])
    colors = [BOX_FACE_COLOR if key == (0, -1) else shown[key] for key in keys]
    if faces:
        axes.add_collection3d(
            Poly3DCollection(
                faces,
                facecolors=colors,
                edgecolors=(0, 0, 0, 0.12),
                linewidths=0.2,
                rasterized=True,
            )
        )
    robot = region.robot
    axes.scatter(*robot.exit_points.T, color=FRAME_COLOR, s=14, marker="s", depthshade=False)
    for edge in box_edges(robot):
        axes.plot(*edge.T, color=FRAME_COLOR, lw=0.8, ls="--", zorder=5)
    drawn = np.vstack([robot.exit_points, region.grid.positions])
    lower, upper = drawn.min(axis=0), drawn.max(axis=0)
    pad = 0.03 * float((upper - lower).max())
    set_space(axes, np.stack([lower - pad, upper + pad], axis=1))
    limit_legend(figure, region, shown, box=True)
    size = f"{volume_text(region.volume)}, {region.share:.1%} of the box"
    set_title(figure, f"{_title(region)}: {size}")
    names = exit_labels(robot, 0.08 * float(np.ptp(robot.exit_points, axis=0).max()))
    box = [dense(*edge) for edge in box_edges(robot)]
    name_points(axes, names, [*faces, *box, robot.exit_points])
    return figure


def volume_text(volume: float) -> str:
    """Write a volume [m³] with three digits and no exponent."""
    digits = max(0, 2 - int(np.floor(np.log10(volume)))) if volume > 0.0 else 0
    return f"{volume:.{digits}f} m³"


class _Plane:
    """Slice: the axes it spans and its picture coordinates."""

    def __init__(self, region: Region) -> None:
        """Find the axis across."""
        shape = region.grid.shape
        self.grid = region.grid
        across = 1 if region.grid.rests else int(np.argmin(shape))
        self.right, self.up = (k for k in range(3) if k != across)
        self.x, self.y = region.grid.axes[self.right], region.grid.axes[self.up]
        self.size = (shape[self.right], shape[self.up])
        self.width, self.height = (float(max(np.ptp(x), 1e-3)) for x in (self.x, self.y))
        left, right = self.ends(self.x)
        low, high = self.ends(self.y)
        self.aspect = (right - left) / (high - low)
        self.title = region.grid.title

    def ends(self, coordinates: Array) -> tuple[float, float]:
        """Return the ends of an axis that shows coordinates, with a little room."""
        room = PANEL_ROOM_RATIO * max(self.width, self.height)
        return float(coordinates[0]) - room, float(coordinates[-1]) + room

    def shows(self, points: Array) -> bool:
        """Return whether any of some points in W [m], shape (n, 3), is on an axis of the panel."""
        (left, right), (low, high) = self.ends(self.x), self.ends(self.y)
        x, y = self.grid.local(points)[:, [self.right, self.up]].T
        return bool(((x >= left) & (x <= right) & (y >= low) & (y <= high)).any())

    def box(self, robot: Robot) -> tuple[float, float, float, float]:
        """Return left, right, lower and upper side of the workspace box of the robot file [m]."""
        lower, upper = robot.workspace_min, robot.workspace_max
        left, right = float(lower[self.right]), float(upper[self.right])
        if self.grid.rests:
            left, right = line_in_box(
                self.grid.origin, self.grid.directions[:, self.right], lower, upper
            )
        return left, right, float(lower[self.up]), float(upper[self.up])

    def image(self, values: Array) -> Array:
        """Return values of all positions as an image."""
        return values.reshape(self.size).T

    def fill(self, axes: Any, values: Array, **options: Any) -> Any:
        """Draw values as coloured cells."""
        options = {"shading": "nearest", "rasterized": True, **options}
        return axes.pcolormesh(self.x, self.y, self.image(values), **options)


def _margin_scale(regions: Sequence[Region]) -> Any:
    """Return the colours of margins: zero in the middle, symmetric."""
    from matplotlib.colors import TwoSlopeNorm

    values = np.concatenate([r.verdicts.margin[r.verdicts.margin > 0.0] for r in regions])
    most = float(np.max(values)) if len(values) else 1.0
    return TwoSlopeNorm(vmin=-most, vcenter=0.0, vmax=most)


def _draw_margin(axes: Any, region: Region, plane: _Plane, scale: Any) -> Any:
    """Draw the margin and the workspace's boundary."""
    margin = np.where(np.isneginf(region.verdicts.margin), scale.vmin, region.verdicts.margin)
    image = plane.fill(axes, margin, cmap="RdYlBu", norm=scale)
    inside = region.verdicts.inside
    if inside.any() and not inside.all():
        levels = plane.image(inside.astype(float))
        axes.contour(plane.x, plane.y, levels, levels=[0.5], colors="black", linewidths=1.3)
    _set_plane(axes, region, plane)
    return image


def _draw_limits(axes: Any, region: Region, plane: _Plane, shown: dict[Any, Any]) -> None:
    """Draw the limit that excludes each position."""
    from matplotlib.colors import to_rgb

    out = region.verdicts
    colors = np.tile(to_rgb(INSIDE_COLOR), (len(out.limit), 1))
    for key, color in shown.items():
        colors[_matches(out, key)] = to_rgb(color)
    picture = colors.reshape(*plane.size, 3).swapaxes(0, 1)
    axes.pcolormesh(plane.x, plane.y, picture, shading="nearest", rasterized=True)
    for kind, hatch in HATCHES.items():
        mask = plane.image((out.limit == kind).astype(float))
        if mask.any() and min(mask.shape) > 1:
            axes.contourf(plane.x, plane.y, mask, levels=[0.5, 1.5], colors="none", hatches=[hatch])
    _set_plane(axes, region, plane)


def _matches(out: Any, key: tuple[int, int]) -> NDArray[np.bool_]:
    """Return positions that a limit, and its cable if it has one, excludes."""
    matches: NDArray[np.bool_] = out.limit == key[0]
    return matches & (out.cable == key[1]) if key[0] in CABLE_LIMITS else matches


def _set_plane(axes: Any, region: Region, plane: _Plane) -> None:
    """Set limits, labels, exit points and the workspace box of a plane.

    The panel ends a little beyond the slice; exit points that are farther away are not shown.
    """
    grid = plane.grid
    names = [grid.axis_name(axis) for axis in (plane.right, plane.up)]
    axes.set(xlabel=f"{names[0]} [m]", ylabel=f"{names[1]} [m]", aspect="equal")
    axes.set(xlim=plane.ends(plane.x), ylim=plane.ends(plane.y))
    left, right, low, high = plane.box(region.robot)
    axes.plot(
        [left, right, right, left, left], [low, low, high, high, low], color=FRAME_COLOR, lw=0.8,
        ls="--",
    )  # fmt: skip
    exits = grid.local(region.robot.exit_points)[:, [plane.right, plane.up]]
    axes.plot(*exits.T, "s", color=FRAME_COLOR, ms=3)


def _boundary(region: Region) -> tuple[list[Array], list[tuple[int, int]]]:
    """Return faces between cells inside and outside, with the limit beyond; (0, -1) at the box."""
    shape = region.grid.shape
    inside = region.verdicts.inside.reshape(shape)
    limit, cable = (x.reshape(shape) for x in (region.verdicts.limit, region.verdicts.cable))
    edges = [_edges(axis) for axis in region.grid.axes]
    faces: list[Array] = []
    keys: list[tuple[int, int]] = []
    for axis in range(3):
        for way in (-1, 1):
            for cell in np.argwhere(inside):
                beyond = cell.copy()
                beyond[axis] += way
                key = (0, -1)
                if 0 <= beyond[axis] < shape[axis]:
                    place = tuple(beyond)
                    if inside[place]:
                        continue
                    kind = int(limit[place])
                    key = (kind, int(cable[place]) if kind in CABLE_LIMITS else -1)
                faces.append(_face(edges, cell, axis, way))
                keys.append(key)
    return faces, keys


def _edges(axis: Array) -> Array:
    """Return the edges of the cells around coordinates."""
    step = axis[1] - axis[0] if len(axis) > 1 else 0.1
    return np.append(axis - 0.5 * step, axis[-1] + 0.5 * step)


def _face(edges: list[Array], cell: NDArray[np.intp], axis: int, way: int) -> Array:
    """Return the corners of one face of a cell, (4, 3)."""
    a, b = (k for k in range(3) if k != axis)
    corners = np.empty((4, 3))
    corners[:, axis] = edges[axis][cell[axis] + (way > 0)]
    corners[:, a] = edges[a][cell[a] + np.array([0, 1, 1, 0])]
    corners[:, b] = edges[b][cell[b] + np.array([0, 0, 1, 1])]
    return corners
