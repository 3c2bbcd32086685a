"""Pictures of a training: reward terms against their variables, and learning curves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NotRequired, TypedDict

import numpy as np
from numpy.typing import ArrayLike

from carosac_toolkit.base.arrays import Array, batch
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.pictures.drawing import new_figure, put_legend, set_title
from carosac_toolkit.pictures.style import (
    DOUBLE_COLUMN_INCH,
    MEASURED_COLOR,
    SERIES_COLORS,
    Series,
    series,
    styled,
)
from learned.learning_curve import CURVE_FILE, EPISODES_FILE, read_curve, read_episodes
from learned.pictures.files import save

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MM_PER_M = 1e3
SMOOTHING_RATIO = 0.04  # of the points: the window of the smoothed line
PANEL_COLUMNS = 3
LOG_AXIS_RATIO = 8.0  # ratio of errors from which their axis is logarithmic


class LearningCurve(TypedDict):
    """Learning curve of one training, E episodes and K evaluations.

    Attributes:
        steps: Environment steps at the end of each episode, shape (E,).
        reward: Sum of rewards of each episode [-], shape (E,).
        averaged: Whether each of the rewards is a mean, of the episodes since the one before.
        evaluated_steps: Environment steps at each evaluation, shape (K,).
        median_error: Median position error at each evaluation [m], shape (K,).
        name: For the legend; without it, the number of the training.
    """

    steps: ArrayLike
    reward: ArrayLike
    averaged: NotRequired[bool]
    evaluated_steps: NotRequired[ArrayLike]
    median_error: NotRequired[ArrayLike]
    name: NotRequired[str]


def curve_of(folder: Path, name: str) -> LearningCurve | None:
    """Read the learning curve of a training for its picture.

    Args:
        folder: Of the training. Where older code left no file of episodes, their means between
            evaluations stand for them.
        name: For the legend.

    Returns:
        The curve; None before the second episode or mean.
    """
    rows, ended = read_curve(folder / CURVE_FILE), folder / EPISODES_FILE
    if ended.is_file():
        points = [(float(one.steps), one.reward) for one in read_episodes(ended)]
    else:
        points = [(row["steps"], row["reward"]) for row in rows if np.isfinite(row["reward"])]
    if len(points) < 2:
        return None
    steps, reward = np.array(points).T
    curve = LearningCurve(steps=steps, reward=reward, averaged=not ended.is_file(), name=name)
    scored = [row for row in rows if np.isfinite(row["median_error_m"])]  # not all paths failed
    if scored:
        curve["evaluated_steps"] = [row["steps"] for row in scored]
        curve["median_error"] = [row["median_error_m"] for row in scored]
    return curve


@styled
def reward_terms(terms: Mapping[str, tuple[str, ArrayLike, ArrayLike]], path: str | Path) -> Figure:
    """Draw each term of a reward against its variable.

    Args:
        terms: Label of the variable with its unit, values of it and of the term [-], both of
            shape (S,), by name of the term.
        path: Picture file.
    """
    if not terms:
        raise InvalidField("terms", "none", "at least one term")
    columns = 2 if len(terms) == 4 else min(PANEL_COLUMNS, len(terms))
    rows = -(-len(terms) // columns)
    figure = new_figure(DOUBLE_COLUMN_INCH, 0.4 + 1.6 * rows)
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    for axes, (name, (label, variable, term)) in zip(panels, terms.items(), strict=False):
        axes.axhline(0.0, color=MEASURED_COLOR, lw=0.6)
        x, y = _pair(label, variable, name, term)
        axes.plot(x, y, color=SERIES_COLORS[0], lw=1.4)
        axes.set_title(name)
        axes.set_xlabel(label)
        axes.margins(x=0.02, y=0.1)
        axes.grid(alpha=0.25)
    for k in range(0, len(terms), columns):
        panels[k].set_ylabel("reward [-]")
    for axes in panels[len(terms) :]:
        axes.remove()
    set_title(figure, "Terms of the reward of one step")
    return save(figure, path)


@styled
def learning_curves(
    curves: Sequence[LearningCurve], path: str | Path, *, marks: Mapping[str, float] | None = None
) -> Figure:
    """Draw the reward of each episode, raw and smoothed, and the error at each evaluation.

    Rewards that are means are joined as they are.

    Args:
        curves: One per seed.
        path: Picture file.
        marks: Errors to compare with [m], by name; drawn as lines.
    """
    if not curves:
        raise InvalidField("curves", "none", "at least one curve")
    evaluated = [curve for curve in curves if "median_error" in curve]
    figure = new_figure(DOUBLE_COLUMN_INCH, 5.0 if evaluated else 3.2)
    panels = figure.subplots(2 if evaluated else 1, 1, sharex=True, squeeze=False).ravel()
    for k, curve in enumerate(curves):
        _draw_reward(panels[0], curve, series(k), _name(curve, k))
        if "median_error" in curve:
            _draw_errors(panels[1], curve, series(k))
    panels[0].set_ylabel("reward of an episode [-]")
    if evaluated:
        _finish_errors(panels[1], marks or {})
    for axes in panels:
        axes.grid(alpha=0.25)
        axes.margins(x=0.01)
    panels[-1].set_xlabel("environment steps [-]")
    panels[-1].xaxis.set_major_formatter(_thousands)
    figure.align_ylabels(panels)
    set_title(figure, "Learning curves", *_legend(curves))
    put_legend(figure, panels[0])
    return save(figure, path)


def smoothed(steps: Array, values: Array, share: float = SMOOTHING_RATIO) -> tuple[Array, Array]:
    """Average over a centred window, cut off at the ends.

    Args:
        steps: Not falling, shape (E,); episodes that end together share one point.
        values: Shape (E,).
        share: Width of the window over the number of values; it holds all that end together.

    Returns:
        Each of the steps once, and the mean there, both of shape (S,).
    """
    when, first, count = np.unique(steps, return_index=True, return_counts=True)
    half, end = int(share * len(values) / 2), first + count
    low = np.maximum(np.minimum(first, (first + end - 1) // 2 - half), 0)
    high = np.minimum(np.maximum(end, (first + end) // 2 + half + 1), len(values))
    total = np.concatenate([[0.0], np.cumsum(values)])
    mean: Array = (total[high] - total[low]) / (high - low)
    return when, mean


def _draw_reward(axes: Any, curve: LearningCurve, look: Series, label: str) -> None:
    """Draw the reward of one training."""
    line = {"color": look.color, "ls": look.line, "label": label, "ms": 3.5, "zorder": 2}
    steps, reward = _pair("steps", curve["steps"], "reward", curve["reward"])
    if curve.get("averaged", False):
        axes.plot(steps, reward, marker=look.marker, **line)
        return
    axes.plot(
        steps, reward, color=look.color, ls="none", marker=".", ms=3.5, mew=0.0, alpha=0.3,
        zorder=1, rasterized=True,
    )  # fmt: skip
    when, mean = smoothed(steps, reward)
    alone = "o" if len(when) == 1 else ""
    axes.plot(when, mean, lw=1.4, marker=alone, **line)


def _legend(curves: Sequence[LearningCurve]) -> list[str]:
    """Explain the marks of the rewards."""
    averaged = {curve.get("averaged", False) for curve in curves}
    lines = []
    if False in averaged:
        share = f"{100 * SMOOTHING_RATIO:.0f} %"
        lines.append(
            f"pale: each episode; line: moving mean of {share}, or of all that end together"
        )
    if True in averaged:
        lines.append("dots on a line: mean of the episodes since the dot before")
    return lines


def _draw_errors(axes: Any, curve: LearningCurve, look: Series) -> None:
    """Draw the evaluations of one training."""
    if "evaluated_steps" not in curve:
        raise InvalidField("evaluated_steps", "none", "the steps of each median_error")
    when, what = curve["evaluated_steps"], curve["median_error"]
    steps, error = _pair("evaluated_steps", when, "median_error", what)
    line = {"color": look.color, "ls": look.line, "marker": look.marker, "ms": 3.5}
    axes.plot(steps, MM_PER_M * error, **line)


def _finish_errors(axes: Any, marks: Mapping[str, float]) -> None:
    """Scale the errors, and draw those to compare with."""
    from matplotlib.ticker import LogLocator, NullFormatter

    drawn = np.concatenate([line.get_ydata() for line in axes.lines])
    for name, mark in marks.items():
        axes.axhline(MM_PER_M * mark, color=MEASURED_COLOR, lw=1.0, ls="--")
        axes.annotate(
            f"{name}: {MM_PER_M * mark:g} mm", (0.0, MM_PER_M * mark),
            xycoords=axes.get_yaxis_transform(),
            xytext=(5, 3), textcoords="offset points", fontsize=7,
        )  # fmt: skip
    if len(drawn) and drawn.min() > 0.0 and drawn.max() > LOG_AXIS_RATIO * drawn.min():
        axes.set_yscale("log")
        axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axes.yaxis.set_major_formatter("{x:g}")
        axes.yaxis.set_minor_formatter(NullFormatter())
    else:
        axes.set_ylim(bottom=0.0)
    axes.set_ylabel("median position error [mm]")


def _pair(name: str, x: ArrayLike, other: str, y: ArrayLike) -> tuple[Array, Array]:
    """Check two arrays of one shape (S,), finite; name the one that is not."""
    first, second = batch(name, x, ()), batch(other, y, ())
    if len(first) != len(second):
        raise InvalidField(other, f"{len(second)} values", f"{len(first)} values, one per {name}")
    return first, second


def _name(curve: LearningCurve, k: int) -> str:
    return curve.get("name", f"training {k + 1}")


def _thousands(value: float, _: int) -> str:
    """Write a number of steps."""
    return f"{value:,.0f}".replace(",", "\N{NARROW NO-BREAK SPACE}")
