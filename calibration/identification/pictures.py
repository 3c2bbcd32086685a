"""Pictures of an identification."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from calibration.identification.result import Identification, IdentifiedRun
from calibration.pictures import BAR_WIDTH, COLOR_AFTER, COLOR_BEFORE
from carosac_toolkit.pictures.drawing import new_figure, put_legend, set_title
from carosac_toolkit.pictures.style import (
    DOUBLE_COLUMN_INCH,
    MEASURED_COLOR,
    REST_COLOR,
    SERIES_COLORS,
    SERIES_HATCHES,
    SERIES_LINES,
    styled,
)
from carosac_toolkit.pictures.units import unit_of
from carosac_toolkit.recordings.recording import Recording
from carosac_toolkit.validation.phases import find_phases

if TYPE_CHECKING:
    from matplotlib.figure import Figure

NUMBERED_RESTS_MAX, UPRIGHT_RESTS_MAX = 20, 10  # rests up to which each has its number, upright


@styled
def draw_motion(result: Identification, run: IdentifiedRun, recording: Recording) -> Figure:
    """Draw the position errors of a run over time, before and after, and the angle after."""
    figure = new_figure(DOUBLE_COLUMN_INCH, 5.6)
    rows = figure.subplots(4, 1, sharex=True)
    time = run.measured.time
    rests = find_phases(recording.time, recording.unstrained_length).rests
    before = run.position_before - run.measured.position
    unit, factor = unit_of([before, run.errors[:, :3]])
    for i, axes in enumerate(rows):
        for k, (first, end) in enumerate(rests):
            axes.axvspan(
                recording.time[first], recording.time[end - 1], color=REST_COLOR, lw=0, zorder=0,
                label="winches at rest" if k == 0 else None,
            )  # fmt: skip
        if i < 3:
            axes.plot(
                time, factor * before[:, i], color=COLOR_BEFORE, ls=SERIES_LINES[1], label="before"
            )
            axes.plot(time, factor * run.errors[:, i], color=COLOR_AFTER, label="after")
            axes.axhline(0.0, color=MEASURED_COLOR, lw=0.6)
            axes.set_ylabel(f"error in {'xyz'[i]} [{unit}]")
        else:
            angle = np.degrees(np.linalg.norm(run.errors[:, 3:], axis=1))
            axes.plot(time, angle, color=COLOR_AFTER)
            axes.set(ylabel="angle after [deg]", ylim=(0.0, None))
        if run.train is not None and run.test is not None:
            limit = recording.time[min(run.train.stop, len(recording.time) - 1)]
            axes.axvline(
                limit, color=SERIES_COLORS[1], lw=1.5, ls=SERIES_LINES[2],
                label="from here on kept back",
            )  # fmt: skip
        axes.grid(alpha=0.25)
        axes.margins(x=0.005)
    figure.align_ylabels(rows)
    rows[-1].set_xlabel("time [s]")
    name = f" in {run.name}" if len(result.runs) > 1 else ""
    set_title(figure, f"{result.robot.name}: open-loop simulation minus measured pose{name}")
    put_legend(figure, rows[0])
    return figure


@styled
def draw_runs(result: Identification) -> Figure:
    """Draw the RMS error of each recording, before and after."""
    figure = new_figure(DOUBLE_COLUMN_INCH, 3.0)
    axes = figure.subplots()
    place = np.arange(len(result.runs))
    errors = np.array([run.rmse for run in result.runs]).T
    unit, factor = unit_of([errors])
    for values, color, marker, name in zip(
        errors, (COLOR_BEFORE, COLOR_AFTER), "os", ("before", "after"), strict=True
    ):
        axes.plot(place, factor * values, marker, color=color, label=name)
    names = [run.name + (" (kept back)" if run.train is None else "") for run in result.runs]
    axes.set_xticks(place, names, rotation=60, ha="right")
    axes.set(ylabel=f"RMS error [{unit}]", yscale="log")
    axes.grid(alpha=0.25, axis="y", which="both")
    axes.margins(y=0.15)
    set_title(figure, f"{result.robot.name}: open-loop error of each recording")
    put_legend(figure, axes)
    return figure


@styled
def draw_rests(result: Identification) -> Figure:
    """Draw the error of the equilibrium for each rest, before and after."""
    figure = new_figure(DOUBLE_COLUMN_INCH, 2.6)
    axes = figure.subplots()
    place = np.arange(len(result.rests.starts))
    unit, factor = unit_of([result.rests.before, result.rests.after])
    for side, error, color, hatch, label in (
        (-0.5, result.rests.before, COLOR_BEFORE, SERIES_HATCHES[1], "before"),
        (0.5, result.rests.after, COLOR_AFTER, SERIES_HATCHES[0], "after"),
    ):
        axes.bar(
            place + side * BAR_WIDTH, factor * error, BAR_WIDTH, color=color, hatch=hatch,
            edgecolor="white", lw=0.0, label=label,
        )  # fmt: skip
    numbered = place[:: -(-len(place) // NUMBERED_RESTS_MAX) or 1]
    axes.set_xticks(
        numbered, [str(result.rests.starts[k]) for k in numbered],
        rotation=60 if len(numbered) > UPRIGHT_RESTS_MAX else 0,
    )  # fmt: skip
    axes.set(xlabel="first sample of the rest", ylabel=f"distance [{unit}]", axisbelow=True)
    axes.grid(alpha=0.25, axis="y")
    set_title(
        figure,
        f"{result.robot.name}: distance of the mean position at rest from the equilibrium of "
        "the lengths",
    )
    put_legend(figure, axes)
    return figure
