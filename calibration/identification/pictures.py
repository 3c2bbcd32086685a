"""Pictures of an identification."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from calibration.identification.result import Identification, IdentifiedRun
from calibration.pictures import COLOR_AFTER, COLOR_BEFORE
from carosac_toolkit.pictures.drawing import new_figure
from carosac_toolkit.pictures.style import REST_COLOR, SERIES_COLORS
from carosac_toolkit.recordings.recording import Recording
from carosac_toolkit.validation.phases import find_phases

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def draw_motion(result: Identification, run: IdentifiedRun, recording: Recording) -> Figure:
    """Draw the position errors of a run over time, before and after, and the angle after."""
    figure = new_figure(12.0, 8.5)
    rows = figure.subplots(4, 1, sharex=True)
    time = run.measured.time
    rests = find_phases(recording.time, recording.unstrained_length).rests
    kept_back = run.train is not None and run.test is not None
    last = len(recording.time) - 1
    limit = recording.time[last if run.train is None else min(run.train.stop, last)]
    for i, axes in enumerate(rows):
        for first, end in rests:
            axes.axvspan(recording.time[first], recording.time[end - 1], color=REST_COLOR, lw=0)
        if i < 3:
            before = (run.position_before - run.measured.position)[:, i] * 1e3
            axes.plot(time, before, color=COLOR_BEFORE, lw=0.9, label="before")
            axes.plot(time, run.errors[:, i] * 1e3, color=COLOR_AFTER, lw=1.1, label="after")
            axes.set_ylabel(f"error in {'xyz'[i]} [mm]")
        else:
            angle = np.degrees(np.linalg.norm(run.errors[:, 3:], axis=1))
            axes.plot(time, angle, color=COLOR_AFTER, lw=1.0)
            axes.set_ylabel("angle after [deg]")
        if kept_back:
            axes.axvline(limit, color=SERIES_COLORS[0], lw=1.5)
        axes.grid(alpha=0.25)
    if kept_back:
        rows[0].annotate(
            "kept back from here on", (limit, 0.97), xycoords=("data", "axes fraction"),
            xytext=(6, 0), textcoords="offset points", va="top", fontsize=9, color=SERIES_COLORS[0],
        )  # fmt: skip
    rows[0].legend(fontsize=9, loc="upper left", ncols=2)
    rows[-1].set_xlabel("time [s]")
    name = f", {run.name}" if len(result.runs) > 1 else ""
    figure.suptitle(f"{result.robot.name}{name}: open-loop simulation minus measured")
    return figure


def draw_runs(result: Identification) -> Figure:
    """Draw the RMS error of each recording, before and after."""
    figure = new_figure(10.0, 3.8)
    axes = figure.subplots()
    place = np.arange(len(result.runs))
    before, after = np.array([run.rmse for run in result.runs]).T * 1e3
    axes.bar(place - 0.2, before, 0.4, color=COLOR_BEFORE, label="before")
    axes.bar(place + 0.2, after, 0.4, color=COLOR_AFTER, label="after")
    kept = [run.train is None for run in result.runs]
    names = [
        run.name + (" (kept back)" if out else "")
        for run, out in zip(result.runs, kept, strict=True)
    ]
    axes.set_xticks(place, names, fontsize=8, rotation=60, ha="right")
    axes.set(ylabel="RMS error [mm]", yscale="log")
    axes.grid(alpha=0.25, axis="y")
    axes.legend(fontsize=9)
    figure.suptitle(f"{result.robot.name}: open-loop error of each recording")
    return figure


def draw_rests(result: Identification) -> Figure:
    """Draw the error of the equilibrium for each rest, before and after."""
    figure = new_figure(10.0, 3.8)
    axes = figure.subplots()
    place = np.arange(len(result.rests.starts))
    axes.bar(place - 0.2, result.rests.before * 1e3, 0.4, color=COLOR_BEFORE, label="before")
    axes.bar(place + 0.2, result.rests.after * 1e3, 0.4, color=COLOR_AFTER, label="after")
    axes.set_xticks(place, [str(start) for start in result.rests.starts], fontsize=8, rotation=60)
    axes.set(xlabel="first sample of the rest", ylabel="distance [mm]")
    axes.grid(alpha=0.25, axis="y")
    axes.legend(fontsize=9)
    figure.suptitle("Mean position at rest against the equilibrium of the lengths")
    return figure
