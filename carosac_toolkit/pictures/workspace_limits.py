"""Looks of the limits of a workspace: colours, hatches and their legend."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

from carosac_toolkit.pictures.drawing import Shades, put_handles
from carosac_toolkit.workspace.limits import CABLE_LIMITS, Limit, cable_of, words_of
from carosac_toolkit.workspace.region import Region

if TYPE_CHECKING:
    from matplotlib.figure import Figure

INSIDE_COLOR = "#eef1f4"
FRAME_COLOR = "#202020"
PLAIN_COLORS = {
    Limit.NOT_CONVERGED: "#ff00ff", Limit.NO_PULL: "#9aa3ad", Limit.TOO_FLAT: "#f2b6a0",
    Limit.NO_EQUILIBRIUM: "#5b6470",
    Limit.UNSTABLE: "#c79a00", Limit.TILT: "#8a6d1f", Limit.COLLISION: "#d62728",
}  # fmt: skip
COLOR_SCALES = {
    Limit.NO_EQUILIBRIUM: "Greys",
    Limit.SLACK: "Blues", Limit.OVERLOAD: "Oranges", Limit.TOO_SHORT: "Greens",
    Limit.TOO_LONG: "Purples",
}  # fmt: skip
HATCHES = {
    Limit.NO_PULL: ".....", Limit.SLACK: "/////", Limit.OVERLOAD: "\\\\\\\\\\",
    Limit.TOO_SHORT: "-----", Limit.TOO_LONG: "|||||", Limit.COLLISION: "xxxxx",
    Limit.UNSTABLE: "+++++", Limit.TILT: "ooo",
}  # fmt: skip
BOX_FACE_COLOR = "#dfe5ea"


def shown_limits(regions: Sequence[Region]) -> dict[tuple[int, int], Any]:
    """Return a colour for each limit, and cable, that excludes positions."""
    from matplotlib import colormaps

    keys = {(limit, cable if limit in CABLE_LIMITS else -1)
            for region in regions for limit, cable, _ in region.causes()}  # fmt: skip
    n = regions[0].robot.n
    shown: dict[tuple[int, int], Any] = {}
    for limit, cable in sorted(keys):
        kind = Limit(limit)
        if kind in COLOR_SCALES and cable >= 0:
            shown[limit, cable] = colormaps[COLOR_SCALES[kind]](0.35 + 0.6 * (cable + 0.5) / n)
        else:
            shown[limit, cable] = PLAIN_COLORS[kind]
    return shown


def limit_legend(
    figure: Figure,
    region: Region,
    shown: dict[tuple[int, int], Any],
    *,
    box: bool = False,
    exits: bool = True,
) -> None:
    """Name the colours of the limits, one shade for each cable, and the other marks.

    Args:
        figure: The figure.
        region: Verdicts whose robot it is.
        shown: Colour of each limit and cable.
        box: True if faces of the box are drawn, False if positions inside are, which is so where
            any limit is shown.
        exits: True if exit points are drawn.
    """
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    first = (BOX_FACE_COLOR, "face of the box") if box else (INSIDE_COLOR, "inside")
    marks: list[tuple[Any, str]] = []
    if box or shown:
        marks.append((Patch(facecolor=first[0]), first[1]))
    for words, keys in by_words(shown).items():
        hatch = HATCHES.get(Limit(keys[0][0]))
        patches = Shades(Patch(facecolor=shown[key], hatch=hatch, lw=0) for key in keys)
        cables = [cable_of(*key, region.robot.cable_names) for key in keys]
        named = ", ".join(name for name in cables if name is not None)
        marks.append((patches, f"cable {words}: {named}" if named else words))
    if exits:
        square = Line2D([], [], color=FRAME_COLOR, marker="s", ls="", ms=4)
        marks.append((square, "exit points"))
    dashes = Line2D([], [], color=FRAME_COLOR, lw=0.8, ls="--")
    marks.append((dashes, "box of the robot file"))
    put_handles(figure, [mark for mark, _ in marks], [text for _, text in marks])


def by_words(shown: Iterable[tuple[int, int]]) -> dict[str, list[tuple[int, int]]]:
    """Return limits and cables by the words for the limit."""
    groups: dict[str, list[tuple[int, int]]] = {}
    for key in shown:
        groups.setdefault(words_of(*key), []).append(key)
    return groups
