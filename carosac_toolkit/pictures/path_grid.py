"""Paths that are too many for one view, each in panels of its own."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from typing import TYPE_CHECKING

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.pictures.drawing import STANDARD_VIEWS, Path, new_figure, put_legend, set_plane
from carosac_toolkit.pictures.style import DOUBLE_COLUMN_INCH

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLUMNS_MAX = 4
PANEL_HEIGHT_MAX_INCH = 1.7  # [inch] of the drawn part of a panel
TITLE_CHARACTERS_PER_INCH = 16.0  # of the title of a panel per inch


def draw_path_grid(paths: Mapping[str, Path], reference: Path, limits: Array) -> Figure:
    """Draw each path in two planes, from above and below that from the side.

    All panels have the same scale and show the reference too.

    Args:
        paths: Points in W [m], shape (K, 3), and style, by label; one or more.
        reference: Points and style of the reference, whose style has a label.
        limits: Lower and upper end of each axis [m], shape (3, 2).
    """
    columns = min(COLUMNS_MAX, -(-len(paths) // 2))
    blocks = -(-len(paths) // columns)
    spans = limits[:, 1] - limits[:, 0]
    width = (DOUBLE_COLUMN_INCH - 0.7) / columns - 0.1  # [inch] of a panel
    scale = min([width / spans[0], *PANEL_HEIGHT_MAX_INCH / spans[1:]])  # [inch/m]
    heights = scale * spans[1:]
    figure = new_figure(DOUBLE_COLUMN_INCH, 0.8 + blocks * (0.75 + float(heights.sum())))
    rows = len(STANDARD_VIEWS)
    grid = figure.subplots(rows * blocks, columns, height_ratios=[*heights] * blocks)
    for k, (label, path) in enumerate(paths.items()):
        block, column = divmod(k, columns)
        panels = grid[rows * block : rows * (block + 1), column]
        for axes, (pair, _) in zip(panels, STANDARD_VIEWS, strict=True):
            for points, style in (reference, path):
                axes.plot(*points[:, list(pair)].T, **style)
            set_plane(axes, pair, "", xlim=limits[pair[0]], ylim=limits[pair[1]])
            if column > 0:
                axes.set_ylabel("")
            axes.tick_params(labelleft=column == 0, labelbottom=axes is panels[-1])
        panels[0].set_xlabel("")
        panels[0].set_title(textwrap.fill(label, int(TITLE_CHARACTERS_PER_INCH * width)))
    for k in range(len(paths), blocks * columns):
        for axes in grid[rows * (k // columns) : rows * (k // columns + 1), k % columns]:
            axes.remove()
    put_legend(figure, grid[0, 0])
    return figure
