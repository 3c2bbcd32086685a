"""Pictures of a self-calibration: where everything is, and what the known positions say."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from calibration.pictures import COLOR_AFTER, COLOR_BEFORE, COLOR_OUTLIER
from calibration.self_calibration.result import SelfCalibration
from carosac_toolkit.pictures.drawing import (
    STANDARD_VIEWS,
    new_figure,
    put_legend,
    set_plane,
    set_title,
)
from carosac_toolkit.pictures.point_names import name_points_in_plane
from carosac_toolkit.pictures.style import DOUBLE_COLUMN_INCH, MEASURED_COLOR, series, styled

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLOR_KNOWN = COLOR_OUTLIER
AXIS_DISTANCE = 0.22  # between the axes of one sample, in distances between samples


@styled
def draw_layout(result: SelfCalibration) -> Figure:
    """Draw exit points before and after, and all positions, from above and from the side."""
    figure = new_figure(DOUBLE_COLUMN_INCH, 4.0)
    panels = figure.subplots(1, len(STANDARD_VIEWS))
    for axes, (plane, title) in zip(panels, STANDARD_VIEWS, strict=True):
        _draw_plane(axes, result, list(plane))
        set_plane(axes, plane, title)
        axes.set_aspect("equal", adjustable="datalim")
        axes.margins(0.1)
    count = len(result.samples)
    set_title(figure, f"{result.before.name}: exit points and positions of {count} samples")
    put_legend(figure, panels[0])
    names = result.before.cable_names
    after, _ = result.exit_points_of(names)
    for axes, (plane, _) in zip(panels, STANDARD_VIEWS, strict=True):
        name_points_in_plane(axes, list(zip(names, after[:, list(plane)], strict=True)))
    return figure


def _draw_plane(axes: Any, result: SelfCalibration, rows: list[int]) -> None:
    """Draw everything in one plane."""
    before = result.before.exit_points
    after, _ = result.exit_points_of(result.before.cable_names)
    for ends in np.stack([before, after], axis=1)[:, :, rows]:
        axes.plot(*ends.T, "-", color=COLOR_BEFORE, lw=0.8)
    used, known = result.used, result.is_known
    for points, look, label in (
        (before, {"marker": "v", "color": COLOR_BEFORE, "ms": 5}, "exit points before"),
        (after, {"marker": "^", "color": COLOR_AFTER, "ms": 5}, "exit points after"),
        (result.position[used], {"marker": ".", "color": MEASURED_COLOR, "ms": 3}, "positions"),
        (
            np.where(result.known_axes, result.known_position, result.position)[known],
            {"marker": "s", "mfc": "none", "color": COLOR_KNOWN, "ms": 5},
            "known positions",
        ),
        (result.position[~used], {"marker": "x", "color": COLOR_OUTLIER, "ms": 5}, "blunders"),
    ):
        if len(points):
            axes.plot(*points[:, rows].T, ls="", label=label, **look)


@styled
def draw_left_out(result: SelfCalibration) -> Figure:
    """Draw how far each known position is from the one predicted by everything else."""
    figure = new_figure(DOUBLE_COLUMN_INCH, 3.0)
    axes = figure.subplots()
    place = np.arange(len(result.left_out), dtype=np.float64)
    for axis, name in enumerate("xyz"):
        error = 1e3 * np.array([one.error[axis] for one in result.left_out])
        sigma = 1e3 * np.array([one.sigma[axis] for one in result.left_out])
        look = series(axis)
        axes.errorbar(
            place + (axis - 1) * AXIS_DISTANCE, error, yerr=sigma, fmt=look.marker,
            color=look.color, capsize=2, label=name,
        )  # fmt: skip
    axes.axhline(0.0, color=MEASURED_COLOR, lw=0.6)
    axes.set_xticks(place, [one.sample for one in result.left_out])
    axes.set(xlabel="sample", ylabel="predicted minus known position [mm]")
    axes.grid(alpha=0.25, axis="y")
    set_title(
        figure,
        f"{result.before.name}: known positions left out one at a time; bars: 1 sigma",
    )
    put_legend(figure, axes)
    return figure
