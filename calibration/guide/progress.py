"""Progress of a guided calibration, as lines for a terminal."""

from __future__ import annotations

import numpy as np

from calibration.guide.fit import Surprise, exit_distances
from calibration.guide.guide import Progress
from calibration.self_calibration.knowledge import Knowledge
from carosac_toolkit.base.arrays import Array

BAR_WIDTH = 20
BAR_MAX_M = 1.0  # of exit points: 1 sigma at which the bar is full
BAR_MIN_M = 1e-3  # the same, at which it is empty


def header() -> str:
    """Return the two lines above the samples."""
    return (
        f"{'sample':>8}  {'position [m]':^22}  {'spread':>7}  {'predicted to':>12}  "
        f"{'was off by':>10}  {'exit points, 1 sigma [mm]':>25}  {'':{BAR_WIDTH}}tensions\n"
        f"{'':>8}  {'x':>6} {'y':>7} {'z':>7}  {'[mm]':>7}  {'[mm]':>12}  {'[mm]':>10}  "
        f"{'mean':>8} {'largest':>8} {'median':>7}"
    )


def line(progress: Progress) -> str:
    """Return the line of one sample; spread and prediction are of line, the bar is of the mean."""
    distance = exit_distances(progress.fit.known)
    largest, median = 1e3 * float(distance.max()), 1e3 * float(np.median(distance))
    mean = float(distance.mean())
    tension = ""
    if progress.tension is not None:
        low, high = progress.tension.min(), progress.tension.max()
        tension = f"  {low:.3g} to {high:.3g} N"
    remark = f"; {progress.remark}" if progress.remark else ""
    return (
        f"{progress.name:>8}  {_place(progress.position)}  {1e3 * progress.fit.spread:7.2f}  "
        f"{_surprise(progress.surprise)}  {1e3 * mean:8.1f} {largest:8.1f} {median:7.1f} "
        f"{_bar(mean)}{tension}{remark}"
    )


def before(known: Knowledge, count: int) -> str:
    """Return what is known at the start."""
    return (
        f"{count} samples are there already; exit points are known to "
        f"{1e3 * known.exit_distance:.3g} mm on average"
    )


def request(position: Array, home: Array, last: Array) -> str:
    """Return what a person is asked to do."""
    way, step = position - home, position - last
    words = ", ".join(
        f"{abs(x):.2f} m {side}"
        for x, side in zip(step, _sides(step), strict=True)
        if abs(x) >= 5e-3
    )
    return (
        f"put the platform to ({', '.join(f'{x:+.2f}' for x in way)}) m from home"
        + (f": {words} from here" if words else "")
        + ". Enter when it rests "
    )


def _sides(step: Array) -> list[str]:
    """Return the directions of a step in W."""
    names = ("+x", "-x"), ("+y", "-y"), ("up", "down")
    return [pair[0] if x >= 0.0 else pair[1] for x, pair in zip(step, names, strict=True)]


def _place(position: Array) -> str:
    return f"{position[0]:6.2f} {position[1]:7.2f} {position[2]:7.2f}"


def _surprise(ahead: Surprise | None) -> str:
    if ahead is None:
        return f"{'':>12}  {'':>10}"
    return f"{1e3 * ahead.sigma:12.2f}  {1e3 * ahead.rms:10.2f}"


def _bar(sigma: float) -> str:
    """Return a bar as long as the digits that are still to be found."""
    share = np.log10(sigma / BAR_MIN_M) / np.log10(BAR_MAX_M / BAR_MIN_M)
    full = int(np.clip(round(BAR_WIDTH * share), 0, BAR_WIDTH))
    return "#" * full + "." * (BAR_WIDTH - full)
