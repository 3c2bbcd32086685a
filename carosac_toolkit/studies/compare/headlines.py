"""What a study says in at most three sentences; its report has all conclusions."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

from carosac_toolkit.studies.compare.findings import (
    ESTIMATION_QUANTITY,
    TRACKING_QUANTITY,
    blocks_of,
    extremes,
    sway_sentence,
)
from carosac_toolkit.studies.compare.results import COMPARED_COLUMNS, StudyResults
from carosac_toolkit.studies.compare.terminal_table import percent

Line = dict[str, Any]


def headlines(results: StudyResults) -> list[str]:
    """State who is best and worst, how much the platform swings, and what the tensions were.

    With several robots or conditions there is one sentence for each of the first three.
    """
    blocks = blocks_of(results)
    if len(blocks) > 1:
        firsts = ((where, next(_errors(results, members), None)) for where, members in blocks)
        return [f"{where}{text}" for where, text in firsts if text]
    _, members = blocks[0]
    sentences = [*_errors(results, members), sway_sentence(results, members), tensions(results)]
    return [text for text in sentences if text]


def _errors(results: StudyResults, members: Sequence[int]) -> Iterator[str]:
    """Compare the best and the last, by estimation where estimators differ, and by tracking."""
    if len({results.summary[k]["estimator"] for k in members}) > 1:
        yield from extremes(results, members, ESTIMATION_QUANTITY)
    yield from extremes(results, members, TRACKING_QUANTITY)


def tensions(results: StudyResults) -> str | None:
    """Say under whom cables went slack or were overloaded, and who kept them within limits."""
    known = [k for k, line in enumerate(results.summary) if line["tension_min_N"] is not None]
    limits = {_limits(results.summary[k]) for k in known}
    if len(limits) != 1:
        return None
    ((low, high),) = limits
    labels = results.labels_of(COMPARED_COLUMNS)

    def those(inside: Callable[[Line], bool]) -> list[int]:
        return [k for k in known if inside(results.summary[k])]

    good = those(lambda line: line["tension_min_N"] >= low and line["tension_max_N"] <= high)
    slack = those(lambda line: line["tension_min_N"] < low)
    over = those(lambda line: line["tension_max_N"] > high)
    parts = []
    if slack:
        slack.sort(key=lambda k: -results.summary[k]["slack_share"])
        each = [f"{labels[k]} ({percent(results.summary[k]['slack_share'])})" for k in slack]
        each[0] = each[0].replace(")", " of the time)")
        parts.append(f"A cable was slack, below {low:g} N, under {_and(each)}")
    if over:
        each = [f"{labels[k]} (up to {results.summary[k]['tension_max_N']:.0f} N)" for k in over]
        parts.append(f"a cable was overloaded, above {high:g} N, under {_and(each)}")
    if good:
        who = _and([labels[k] for k in good]) if slack or over else "all"
        parts.append(f"{who} kept within {low:g} to {high:g} N")
    text = "; ".join(parts)
    return f"{text[0].upper()}{text[1:]}." if text else None


def _limits(line: Line) -> tuple[float, float]:
    """Return the tension limits of a robot [N]."""
    return line["tension_limit_low_N"], line["tension_limit_high_N"]


def _and(names: Sequence[str]) -> str:
    """Join names."""
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
