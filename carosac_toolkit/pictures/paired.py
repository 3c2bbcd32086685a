"""Picture of paired comparisons: ratios to the baseline, with their intervals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from carosac_toolkit.base.tables import counted
from carosac_toolkit.pictures.drawing import new_figure, put_points, set_log, set_title
from carosac_toolkit.pictures.groups import looks_of_ways
from carosac_toolkit.pictures.style import (
    DOUBLE_COLUMN_INCH,
    MEASURED_COLOR,
    SINGLE_COLUMN_INCH,
    Series,
    styled,
)
from carosac_toolkit.studies.compare.paired import SIGNIFICANCE_LEVEL, PairedBlock
from carosac_toolkit.studies.compare.pairs import Pair
from carosac_toolkit.studies.compare.paper_tables import QUANTITY_TITLES, differing

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COMPARISON_HEIGHT_INCH = 0.22  # [inch] of height of a comparison
HEADER_HEIGHT_INCH = 1.5  # [inch] for title, axis and legend


def comparable(blocks: Sequence[PairedBlock]) -> bool:
    """Return whether there is any ratio to draw."""
    return any(_rows(block) for block in blocks)


@styled
def draw_paired(blocks: Sequence[PairedBlock]) -> Figure:
    """Draw the ratio of each error to that of the baseline, one panel for each block.

    Left of 1 is better than the baseline. Full marks: the Holm-corrected p is at most
    `SIGNIFICANCE_LEVEL`; open marks: it is above.

    Args:
        blocks: Blocks of a study; those without a ratio are left out.
    """
    shown = [block for block in blocks if _rows(block)]
    most = max(len(_rows(block)) for block in shown)
    columns = min(2, len(shown))
    lines = -(-len(shown) // columns)
    figure = new_figure(
        DOUBLE_COLUMN_INCH if columns == 2 else SINGLE_COLUMN_INCH,
        HEADER_HEIGHT_INCH + lines * (0.5 * (lines > 1) + COMPARISON_HEIGHT_INCH * (most + 1)),
    )
    panels = figure.subplots(lines, columns, squeeze=False).ravel()
    ways = {one.label: one.names for block in shown for one in block.compared}
    looks = dict(zip(ways, looks_of_ways(list(ways.values())), strict=True))
    for axes, block in zip(panels, shown, strict=False):
        _draw_block(axes, block, looks, block.robot_name)
    for axes in panels[len(shown) :]:
        axes.remove()
    set_title(figure, *_explanation([pair for block in shown for _, _, pair in _rows(block)]))
    drawn = dict.fromkeys(label for block in shown for _, label, _ in _rows(block))
    put_points(figure, {label: looks[label] for label in drawn})
    return figure


def _explanation(pairs: Sequence[Pair]) -> tuple[str, ...]:
    """Say what is drawn: intervals and full marks only where there are any."""
    ratios = [pair.ratio for pair in pairs if pair.ratio is not None]
    has_interval = any(one.low is not None for one in ratios)
    interval = "95 % interval" if has_interval else "no interval (too few seeds)"
    full = "full marks: p ≤ {:g} (Holm), open: above" if any(map(_is_sure, pairs)) else ""
    marks = full or "all marks open: no p ≤ {:g}"
    return (
        "Error over the baseline's; right: cases won",
        interval,
        marks.format(SIGNIFICANCE_LEVEL),
    )


def _is_sure(pair: Pair) -> bool:
    """Return whether a comparison is significant, which a full mark shows."""
    return pair.p_holm is not None and pair.p_holm <= SIGNIFICANCE_LEVEL


def _draw_block(axes: Any, block: PairedBlock, looks: Mapping[str, Series], robot: str) -> None:
    """Draw all comparisons of a block, one below the other."""
    rows = _rows(block)
    ticks: dict[str, list[int]] = {}
    for place, (name, label, pair) in enumerate(rows):
        assert pair.ratio is not None
        one, color, marker = pair.ratio, looks[label].color, looks[label].marker
        if one.low is not None and one.high is not None:
            axes.plot([one.low, one.high], [place, place], color=color, lw=1.6)
        face = color if _is_sure(pair) else "white"
        axes.plot(one.value, place, marker, color=color, mfc=face, ms=5)
        axes.annotate(
            f"{pair.won}/{pair.cases}", (1.0, place), xycoords=axes.get_yaxis_transform(),
            xytext=(4, 0), textcoords="offset points", va="center", fontsize=7,
        )  # fmt: skip
        ticks.setdefault(QUANTITY_TITLES[name], []).append(place)
    axes.axvline(1.0, color=MEASURED_COLOR, lw=0.9)
    axes.set(xlabel=f"ratio to {block.baseline} [-]", ylim=(len(rows) - 0.4, -0.6))
    set_log(axes, "x")
    axes.set_yticks([sum(p) / len(p) for p in ticks.values()], list(ticks))
    for places in list(ticks.values())[1:]:
        axes.axhline(places[0] - 0.5, color=MEASURED_COLOR, lw=0.3)
    axes.grid(axis="x", which="both", alpha=0.25)
    draws = f"{counted(block.seeds, 'seed')} x {counted(block.trajectories, 'path')}"
    axes.set_title(f"{robot}, {draws}")


def _rows(block: PairedBlock) -> list[tuple[str, str, Pair]]:
    """Return error, label and comparison, of each that has a ratio above zero."""
    return [
        (name, one.label, one.pairs[name])
        for name in differing(block)
        for one in block.compared
        if name in one.pairs
        and (ratio := one.pairs[name].ratio) is not None
        and 0.0 < ratio.value < float("inf")
    ]
