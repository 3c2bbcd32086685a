"""Picture of a sweep: what came out of each variation, seed by seed."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from carosac_toolkit.base.arrays import batch
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.pictures.drawing import new_figure, set_title
from carosac_toolkit.pictures.style import (
    DOUBLE_COLUMN_INCH,
    MEASURED_COLOR,
    SERIES_COLORS,
    styled,
)
from learned.pictures.files import save

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MM_PER_M = 1e3
LABEL_WIDTH = 36  # characters of a line
MEDIAN_HALF_HEIGHT = 0.3  # of the mark of a median, in rows
LOG_AXIS_RATIO = 8.0  # ratio of errors from which their axis is logarithmic


@styled
def sweep(errors: Mapping[str, ArrayLike], path: str | Path) -> Figure:
    """Draw the errors after training, a row for each variation.

    Args:
        errors: Median position error of each seed [m], shape (S,), by variation.
        path: Picture file.
    """
    if not errors:
        raise InvalidField("errors", "none", "at least one variation")
    lines = sum(max(1, -(-len(name) // LABEL_WIDTH)) for name in errors)
    figure = new_figure(DOUBLE_COLUMN_INCH, 1.0 + 0.06 * len(errors) + 0.18 * lines)
    axes = figure.subplots()
    groups = {name: MM_PER_M * batch(name, values, ()) for name, values in errors.items()}
    for k, values in enumerate(groups.values()):
        axes.plot(values, np.full(len(values), k), "o", color=SERIES_COLORS[0], ms=4.5, alpha=0.7,
                  mew=0.0)  # fmt: skip
        middle = float(np.median(values))
        axes.plot(
            [middle, middle],
            [k - MEDIAN_HALF_HEIGHT, k + MEDIAN_HALF_HEIGHT],
            color=MEASURED_COLOR,
            lw=1.6,
        )
    every = np.concatenate(list(groups.values()))
    if every.min() > 0.0 and every.max() > LOG_AXIS_RATIO * every.min():
        axes.set_xscale("log")
    else:
        axes.set_xlim(left=0.0)
    axes.set_yticks(range(len(groups)), [textwrap.fill(name, LABEL_WIDTH) for name in groups])
    axes.set(ylim=(len(groups) - 0.5, -0.5), xlabel="median position error after training [mm]")
    axes.grid(alpha=0.25, axis="x")
    set_title(figure, "Variations; dots: seeds, line: their median")
    return save(figure, path)
