"""Style of all pictures: column widths, fonts, colours, and the marks that tell series apart."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from functools import wraps
from typing import Any, Literal, ParamSpec, TypeVar, get_args

from carosac_toolkit.base.errors import InvalidField

SINGLE_COLUMN_INCH, DOUBLE_COLUMN_INCH = 3.5, 7.16  # [inch] of the columns of IEEE journals
MEASURED_COLOR = "#202020"
REST_COLOR = "#d9dde2"
SERIES_COLORS = (  # differ for protanopes and deuteranopes too; tests/pictures/test_style.py
    "#0072b2",
    "#d55e00",
    "#44aa99",
    "#7f3b08",
    "#77aadd",
    "#ee8866",
    "#00425a",
    "#01665e",
)
SERIES_LINES = (
    "-",
    (0, (5.0, 1.5)),
    (0, (1.2, 1.0)),
    (0, (5.0, 1.2, 1.2, 1.2)),
    (0, (9.0, 2.0)),
    (0, (2.5, 1.0)),
    (0, (5.0, 1.2, 1.2, 1.2, 1.2, 1.2)),
    (0, (9.0, 1.2, 1.2, 1.2)),
)
SERIES_MARKERS = ("o", "s", "^", "D", "v", "P", "X", "*")
SERIES_HATCHES = ("", "/////", ".....", "xxxxx", "\\\\\\\\\\", "|||||", "-----", "+++++")
CONTROLLER_NUMBERS = {
    "mpc": 0, "kinematic_solver": 1, "td3": 2, "input_shaping": 3, "straight_line": 4,
    "approximate_mpc": 5,
}  # fmt: skip
MODEL_NUMBERS = {  # of estimators and of models that are compared with recordings
    "simulator": 0, "kinematic_solver": 1, "dynamic_estimator": 2, "ks_ekf": 3, "straight_line": 4,
}  # fmt: skip
StyleName = Literal["screen", "paper"]
_SHARED: Mapping[str, Any] = {
    "font.size": 8.0,
    "axes.titlesize": 8.0,
    "axes.labelsize": 8.0,
    "figure.titlesize": 9.0,
    "xtick.labelsize": 7.0,
    "ytick.labelsize": 7.0,
    "legend.fontsize": 7.5,
    "legend.frameon": False,
    "legend.handlelength": 2.6,
    "lines.linewidth": 1.1,
    "lines.markersize": 3.5,
    "axes.linewidth": 0.6,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "xtick.minor.width": 0.4,
    "ytick.minor.width": 0.4,
    "hatch.linewidth": 0.4,
    "grid.linewidth": 0.5,
    "axes.formatter.limits": (-4, 5),
}
STYLES: Mapping[StyleName, Mapping[str, Any]] = {
    "screen": {**_SHARED, "font.family": ["DejaVu Sans"]},
    "paper": {
        **_SHARED,
        "font.family": ["STIXGeneral", "DejaVu Serif"],
        "mathtext.fontset": "stix",
        "figure.titlesize": 8.0,
        "xtick.labelsize": 8.0,
        "ytick.labelsize": 8.0,
        "legend.fontsize": 8.0,
    },
}
P = ParamSpec("P")
R = TypeVar("R")
_current: ContextVar[StyleName] = ContextVar("style", default="screen")


@dataclass(frozen=True, kw_only=True)
class Series:
    """Look of one series: distinct in colour, and without colour in line, marker and hatch.

    Attributes:
        color: Colour of everything.
        line: Dashes of its lines.
        marker: Marker of its points.
        hatch: Hatch of its areas.
    """

    color: str
    line: Any
    marker: str
    hatch: str


def series(number: int) -> Series:
    """Return the look of a series by its number, from 0; looks repeat after the last one."""
    k = number % len(SERIES_COLORS)
    return Series(
        color=SERIES_COLORS[k],
        line=SERIES_LINES[k],
        marker=SERIES_MARKERS[k],
        hatch=SERIES_HATCHES[k],
    )


def looks_by_name(names: Sequence[str], numbers: Mapping[str, int]) -> list[Series]:
    """Return a look for each of some names: the same in all pictures, as long as looks last.

    A known name has its own number. Unknown ones, and those that stand there again, take the free
    numbers in their order, first those that no known name has.

    Args:
        names: Names of controllers, estimators or models, which may stand there several times.
        numbers: Numbers of known names: `CONTROLLER_NUMBERS` or `MODEL_NUMBERS`.
    """
    own = {names.index(name): number for name, number in numbers.items() if name in names}
    free = [k for k in range(len(SERIES_COLORS)) if k not in own.values()]
    free.sort(key=lambda k: k in numbers.values())
    others = iter(free)
    return [
        series(own[place] if place in own else next(others, place)) for place in range(len(names))
    ]


@contextmanager
def using_style(name: str) -> Iterator[None]:
    """Draw in a style as long as this lasts.

    Args:
        name: One of `STYLES`.

    Raises:
        InvalidField: There is no such style.
    """
    if name not in STYLES:
        raise InvalidField("style", repr(name), f"one of {list(get_args(StyleName))}")
    token = _current.set(name)  # type: ignore[arg-type]
    try:
        yield
    finally:
        _current.reset(token)


def styled(draw: Callable[P, R]) -> Callable[P, R]:
    """Make a function that draws do so in the style in use, whatever matplotlib is set to."""

    @wraps(draw)
    def drawn(*args: P.args, **kwargs: P.kwargs) -> R:
        from matplotlib import rc_context, rcParamsDefault

        settings: dict[Any, Any] = dict(rcParamsDefault)
        settings.update(STYLES[_current.get()])
        with rc_context({k: v for k, v in settings.items() if not k.startswith("backend")}):
            return draw(*args, **kwargs)

    return drawn
