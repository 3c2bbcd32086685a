"""One table of a study for the terminal: errors, tensions, limits, and cases without a score.

Where it does not fit, titles and limits are abbreviated first, then columns are left out, which the
report has; names are never cut.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

from carosac_toolkit.base.numbers import plain
from carosac_toolkit.base.tables import aligned, wrapped
from carosac_toolkit.studies.compare.names import robot_names, short_name
from carosac_toolkit.studies.compare.results import COLUMN_TITLES, GROUP_COLUMNS, StudyResults
from carosac_toolkit.studies.run.rows import CASE_STATUSES

Line = dict[str, Any]
WHOLE_MM_MIN = 1000.0  # from here on without a decimal
ONE_DECIMAL_MAX_N = 10.0  # below it a tension has a decimal, else none
OWN_LINE_INDENT = "  "
SHORT_TITLES = {
    "tracking": "track", "estimate": "estim.", "tension [N]": "tension", "limited": "limit",
    "cycle [ms]": "cycle",
}  # fmt: skip
SHORT_LIMITS = {"acceleration": "acc.", "coordination": "coord.", "length_rate": "rate"}


class _Column(NamedTuple):
    """Column of numbers.

    Attributes:
        title: Its title, with the unit.
        cell: Its text for a line of the summary.
        rank: Columns of the highest rank are left out first; 0: never.
        words: Its explanation.
    """

    title: str
    cell: Callable[[Line], str]
    rank: int
    words: str

    def abbreviated(self) -> _Column:
        """Return the column with a short title, and short names of limits in it."""
        cell = _limited_in_short if self.cell is limited else self.cell
        return self._replace(title=SHORT_TITLES.get(self.title, self.title), cell=cell)


def terminal_table(results: StudyResults, width: int) -> str:
    """Format one table, as wide as names need, with the notes on its rows.

    Args:
        results: Results of the study.
        width: Titles are abbreviated and columns left out until the table fits; where names leave
            no room, they stand on lines of their own.
    """
    names, columns = shown_names(results), _fitting(results, width)
    cells = [[c.cell(line) for c in columns] for line in results.summary]
    titles = [c.title for c in columns]
    labels = [title for title, _ in names]
    rows = [[texts[k] for _, texts in names] for k in range(len(cells))]
    if _width(names, results.summary, columns) <= width:
        table = aligned([*labels, *titles], [[*a, *b] for a, b in zip(rows, cells, strict=True)],
                        len(names))  # fmt: skip
    else:
        first, *others = aligned(titles, cells, 0).splitlines()
        lines = [" / ".join(labels), OWN_LINE_INDENT + first, OWN_LINE_INDENT + others[0]]
        for row, numbers in zip(rows, others[1:], strict=True):
            lines += [wrapped(" / ".join(row), width), OWN_LINE_INDENT + numbers]
        table = "\n".join(lines)
    notes = [f"[{k}] {text}" for k, text in enumerate(remarks(results), start=1)]
    return "\n".join([table, *notes])


def caption(results: StudyResults, width: int) -> str:
    """Explain the columns shown, name those left out, and estimator and sensors of all rows."""
    titles = {title for title, _ in shown_names(results)}
    shared = [
        f"{name} {_short(name, results)[0]}" for name in ("estimator", "sensors")
        if name not in titles
    ]  # fmt: skip
    explained = [c for c in _fitting(results, width) if c.words]
    words = "; ".join(f"{c.title.split(' [')[0]}: {c.words}" for c in explained)
    start = f"All rows: {', '.join(shared)}. " if shared else ""
    shown = {c.title for c in _fitting(results, width)}
    missing = [
        c.title.split(" [")[0] for c in _columns(results)
        if not {c.title, c.abbreviated().title} & shown
    ]  # fmt: skip
    rest = f" Without room here, in the report: {', '.join(missing)}." if missing else ""
    return f"{start}{words[0].upper()}{words[1:]}.{rest}"


def shown_names(results: StudyResults) -> list[tuple[str, list[str]]]:
    """Return title and texts of each name that rows do not share; always the controller's."""
    numbers = {text: k for k, text in enumerate(remarks(results), start=1)}
    shown = []
    for name in GROUP_COLUMNS:
        if name == "controller" or len({line[name] for line in results.summary}) > 1:
            texts = _short(name, results)
            if name == "controller":
                texts = [
                    text + "".join(f" [{numbers[x]}]" for x in line["remarks"])
                    for text, line in zip(texts, results.summary, strict=True)
                ]
            shown.append((COLUMN_TITLES.get(name, name), texts))
    return shown


def remarks(results: StudyResults) -> list[str]:
    """Return all different remarks of controllers, in the order of the rows."""
    return list(dict.fromkeys(text for line in results.summary for text in line["remarks"]))


def _short(name: str, results: StudyResults) -> list[str]:
    """Return the names of all rows; of a path or ``module:Class`` the end if that tells apart."""
    whole = [str(line[name]) for line in results.summary]
    if name == "robot":
        own = robot_names(results)
        return [own[text] for text in whole]
    ends = {text: short_name(text) for text in whole}
    return [ends[text] for text in whole] if len(set(ends.values())) == len(ends) else whole


def _fitting(results: StudyResults, width: int) -> list[_Column]:
    """Return the columns that fit beside the names; where none does, those beneath them."""
    names, whole = shown_names(results), _columns(results)
    short = [c.abbreviated() for c in whole]
    if _width(names, results.summary, [c for c in short if c.rank == 0]) > width:
        names, width = [], width - len(OWN_LINE_INDENT)  # names stand on lines of their own
    columns = whole if _width(names, results.summary, whole) <= width else short
    while _width(names, results.summary, columns) > width:
        last = max(c.rank for c in columns)
        if last == 0:
            break
        columns = [c for c in columns if c.rank < last]
    return columns


def _width(
    names: Sequence[tuple[str, list[str]]], lines: list[Line], columns: list[_Column]
) -> int:
    """Return the width of a table."""
    widths = [max(len(text) for text in [title, *texts]) for title, texts in names]
    widths += [max(len(text) for text in [c.title, *map(c.cell, lines)]) for c in columns]
    return sum(widths) + 2 * (len(widths) - 1)


def _columns(results: StudyResults) -> list[_Column]:
    """Return all columns; those of which no row has a number are left out."""
    limits = {(line["tension_limit_low_N"], line["tension_limit_high_N"])
              for line in results.summary}  # fmt: skip
    low, high = next(iter(limits)) if len(limits) == 1 else (None, None)
    allowed = " [N]" if low is None else f", allowed {low:g} to {high:g} N"
    lost = "diverged or failed ones have no score" if any(map(_lost, results.summary)) else ""
    several = len({line["estimator"] for line in results.summary}) > 1
    columns = [
        _Column("tracking", mean_tracking, 0, "RMSE [mm]"),
        _Column("sway", lambda x: millimetres(x["residual_sway_m"]), 2 if several else 1,
                "RMS after the end [mm]"),
        _Column("estimate", lambda x: millimetres(x["estimation_rmse_m"]["norm"]),
                0 if several else 2, "RMSE of the estimate [mm]"),
        _Column("NEES", _nees, 3, "consistency of the covariance, 1 is right, + overconfident"),
        _Column("tension [N]", tension_range, 0, f"of any cable{allowed}"),
        _Column("slack", lambda x: percent(x["slack_share"]), 0,
                "below tension_min"),
        _Column("limited", limited, 1 if several else 0, "commands changed"),
        _Column("cases", cases, 0, lost),
        _Column("cycle [ms]", _cycle, 4, "95th percentile of the latency [ms]"),
    ]  # fmt: skip
    kept = {"tracking", "cases"}
    return [c for c in columns if c.title in kept or any(c.cell(x) != "-" for x in results.summary)]


def _nees(line: Line) -> str:
    """Format the normalised square of the pose, marked if it is outside its band."""
    value = line["nees_pose"]
    if value is None:
        return "-"
    low, high = value["band"]
    mark = "+" if value["mean"] > high else "-" if value["mean"] < low else ""
    return f"{plain(value['mean'], 3)}{mark}"


def _lost(line: Line) -> bool:
    """Return whether a row has cases without a score."""
    return bool(line["failures"])


def _cycle(line: Line) -> str:
    return "-" if line["latency_p95_s"] is None else f"{line['latency_p95_s'] * 1e3:.2f}"


def mean_tracking(line: Line) -> str:
    """Format the tracking error [mm], with the cases that it is over where some have no score."""
    text, lost = millimetres(line["tracking_rmse_m"]["norm"]), line["failures"]
    return f"{text} ({line['cases'] - lost} of {line['cases']})" if lost and text != "-" else text


def after_the_end(times: Iterable[float | None]) -> str:
    """Say over which times after the trajectory sway is taken, as far as they are known [s]."""
    known = sorted({time for time in times if time is not None})
    if not known:
        return "after the end"
    words = dict.fromkeys(plain(time, 2) for time in (known[0], known[-1]))
    return f"in the {' to '.join(words)} s after the end"


def tension_range(line: Line) -> str:
    """Format least and largest tension [N]."""
    if line["tension_min_N"] is None:
        return "-"
    return f"{_newtons(line['tension_min_N'])} to {_newtons(line['tension_max_N'])}"


def _newtons(tension: float) -> str:
    """Format a tension: with a decimal where it is small."""
    return f"{tension:.1f}" if tension < ONE_DECIMAL_MAX_N else f"{tension:.0f}"


def limited(line: Line) -> str:
    """Format the share of limited commands, with the limit that most of them met."""
    share, name = line["limited_share"], main_limit(line)
    return percent(share) + (f" {name}" if name and percent(share) not in ("-", "0 %") else "")


def _limited_in_short(line: Line) -> str:
    """Format the share of limited commands with an abbreviated limit."""
    share, space, name = limited(line).rpartition(" ")
    return f"{share}{space}{SHORT_LIMITS.get(name, name)}"


def main_limit(line: Line) -> str | None:
    """Return the limit that began most of the limited commands; see `limit_scores`."""
    counts: dict[str, int] = line["limited_first"] or line["limited_by"]
    return next(iter(counts), None)


def cases(line: Line) -> str:
    """Format how many cases have a score, and what became of the others."""
    total, lost = line["cases"], line["failures"]
    if not lost:
        return f"{total} ok"
    parts = [
        f"{status.replace('_', ' ')} {line['statuses'][status]}"
        for status in CASE_STATUSES if status != "ok" and line["statuses"].get(status)
    ]  # fmt: skip
    return f"{', '.join(parts)} of {total}"


def percent(share: float | None) -> str:
    """Format a share; a small one is not nothing."""
    if share is None:
        return "-"
    if 0.0 < share < 0.005:
        return "<1 %"
    return f"{100.0 * share:.0f} %"


def millimetres(metres: float | None) -> str:
    """Format a length in mm."""
    if metres is None:
        return "-"
    value = metres * 1e3
    return f"{value:.0f}" if value >= WHOLE_MM_MIN else f"{value:.1f}"
