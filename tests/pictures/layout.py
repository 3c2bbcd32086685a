"""Boxes of what a figure shows, to find texts that cover each other or data."""

from itertools import combinations

import numpy as np
from matplotlib.collections import PolyCollection, QuadMesh
from matplotlib.text import Text

TOUCHING_PIXELS = 1.0  # by which boxes may overlap: their letters have room inside


def texts_of(figure):
    """All texts that are seen, with their boxes [pixels]."""
    renderer = figure.canvas.get_renderer()
    unseen = {id(label) for axes in figure.axes for label in _labels_beyond(axes)}
    found = []
    for text in figure.findobj(Text):
        if not text.get_visible() or not text.get_text().strip() or id(text) in unseen:
            continue
        box = Text.get_window_extent(text, renderer)
        if box.width > 0.0 and box.height > 0.0:
            found.append((text, box.padded(-TOUCHING_PIXELS)))
    return found


def _labels_beyond(axes):
    """Labels of ticks beyond the ends of their axis, which are not drawn."""
    for axis in axes._axis_map.values():
        low, high = sorted(axis.get_view_interval())
        room = 1e-9 * (high - low)
        for tick in (*axis.get_major_ticks(), *axis.get_minor_ticks()):
            if not low - room <= tick.get_loc() <= high + room:
                yield from (tick.label1, tick.label2)


def laid_out(figure):
    """Lay a figure out as it is written."""
    for _ in range(2):
        figure.draw_without_rendering()
    return figure


def overlapping_texts(figure):
    """Pairs of texts that cover each other."""
    pairs = combinations(texts_of(figure), 2)
    return [(a.get_text(), b.get_text()) for (a, one), (b, other) in pairs
            if a is not b and one.overlaps(other)]  # fmt: skip


def cut_texts(figure):
    """Texts that reach beyond the figure."""
    low, high = figure.bbox.min, figure.bbox.max
    found = texts_of(figure)
    return [
        text.get_text() for text, box in found if (box.min < low).any() or (box.max > high).any()
    ]


def data_of(axes):
    """Points [pixels] on the lines and edges of areas that a panel shows, shape (K, 2)."""
    points = []
    for line in axes.lines:
        shown = line.get_transform().transform(np.column_stack(line.get_data(orig=False)[:2]))
        shown = shown[np.isfinite(shown).all(axis=1)]
        dense = np.linspace(0.0, 1.0, 20)[:, None, None]
        if len(shown) > 1 and line.get_linestyle() != "None":
            shown = (shown[:-1] + dense * np.diff(shown, axis=0)).reshape(-1, 2)
        points.append(shown)
    for area in axes.collections:
        if isinstance(area, PolyCollection) and not isinstance(area, QuadMesh):
            points += [area.get_transform().transform(p.vertices) for p in area.get_paths()]
    points += [patch.get_window_extent().corners() for patch in axes.patches]
    inside = np.vstack([*points, np.zeros((0, 2))])
    box = axes.bbox
    seen = (inside >= box.min) & (inside <= box.max)
    return inside[seen.all(axis=1)]


def texts_on_data(figure):
    """Texts, those of legends too, that lie on data of a panel."""
    panels = [axes for axes in figure.axes if axes.name != "3d"]
    found = []
    for text, box in texts_of(figure):
        for axes in panels:
            points = data_of(axes)
            if ((points > box.min) & (points < box.max)).all(axis=1).any():
                found.append(text.get_text())
    return found
