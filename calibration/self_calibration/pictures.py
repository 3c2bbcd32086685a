"""Pictures of a self-calibration: where everything is, and what the known positions say."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from calibration.pictures import COLOR_AFTER, COLOR_BEFORE, COLOR_OUTLIER
from calibration.self_calibration.result import SelfCalibration
from carosac_toolkit.pictures.drawing import new_figure
from carosac_toolkit.pictures.style import SERIES_COLORS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLOR_KNOWN = SERIES_COLORS[0]


def draw_layout(result: SelfCalibration) -> Figure:
    """Draw exit points before and after, and all positions, from above and from the side."""
    figure = new_figure(12.0, 6.0)
    above, side = figure.subplots(1, 2)
    for axes, plane, title in ((above, (0, 1), "from above"), (side, (0, 2), "from the side")):
        _draw_plane(axes, result, list(plane))
        axes.set(xlabel=f"{'xyz'[plane[0]]} [m]", ylabel=f"{'xyz'[plane[1]]} [m]")
        axes.set_title(title, fontsize=10)
        axes.set_aspect("equal", adjustable="datalim")
        axes.grid(alpha=0.25)
    handles, labels = above.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=6, frameon=False)
    count = len(result.samples)
    figure.suptitle(f"{result.before.name}: exit points and positions of {count} samples")
    return figure


def _draw_plane(axes: Any, result: SelfCalibration, rows: list[int]) -> None:
    """Draw everything in one plane."""
    before = result.before.exit_points
    after, _ = result.exit_points_of(result.before.cable_names)
    for i, name in enumerate(result.before.cable_names):
        axes.plot(*np.array([before[i], after[i]])[:, rows].T, "-", color=COLOR_BEFORE, lw=0.8)
        axes.annotate(name, after[i][rows], xytext=(5, 5), textcoords="offset points")
    axes.plot(*before[:, rows].T, "^", color=COLOR_BEFORE, ms=7, ls="", label="exit points before")
    axes.plot(*after[:, rows].T, "^", color=COLOR_AFTER, ms=7, ls="", label="exit points after")
    used = result.used
    axes.plot(*result.position[used][:, rows].T, ".", color="#404850", ms=5, label="positions")
    known = result.is_known
    axes.plot(
        *result.known_position[known][:, rows].T, "s", mfc="none", color=COLOR_KNOWN, ms=7, ls="",
        label="known positions",
    )  # fmt: skip
    if not used.all():
        axes.plot(
            *result.position[~used][:, rows].T,
            "x",
            color=COLOR_OUTLIER,
            ms=7,
            ls="",
            label="blunders",
        )


def draw_left_out(result: SelfCalibration) -> Figure:
    """Draw how far each known position is from the one predicted by everything else."""
    figure = new_figure(9.0, 4.2)
    axes = figure.subplots()
    place = np.arange(len(result.left_out), dtype=np.float64)
    for axis, shift in enumerate((-0.22, 0.0, 0.22)):
        error = 1e3 * np.array([one.error[axis] for one in result.left_out])
        sigma = 1e3 * np.array([one.sigma[axis] for one in result.left_out])
        axes.errorbar(
            place + shift, error, yerr=sigma, fmt="o", color=SERIES_COLORS[axis], capsize=3,
            label="xyz"[axis],
        )  # fmt: skip
    axes.axhline(0.0, color="#808080", lw=0.8)
    axes.set_xticks(place, [one.sample for one in result.left_out])
    axes.set(xlabel="sample", ylabel="predicted minus known position [mm]")
    axes.grid(alpha=0.25, axis="y")
    axes.legend(ncols=3, frameon=False)
    axes.set_title("Known positions left out one at a time; bars: 1 sigma", fontsize=11)
    return figure
