"""What a study says in at most three sentences; its report has all conclusions."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from carosac_toolkit.studies.compare.findings import (
    ESTIMATION_QUANTITY,
    TRACKING_QUANTITY,
    blocks_of,
    estimators_of,
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
    yield from extremes(results, estimators_of(results, members), ESTIMATION_QUANTITY)
    yield from extremes(results, members, TRACKING_QUANTITY)


def tensions(results: StudyResults) -> str | None:
    """Say under whom cables were slack or overloaded most, and under whom least or never."""
    known = [k for k, line in enumerate(results.summary) if line["tension_min_N"] is not None]
    limits = {_limits(results.summary[k]) for k in known}
    if len(limits) != 1:
        return None
    ((low, high),) = limits
    labels = results.labels_of(COMPARED_COLUMNS)

    def sorted_by(name: str) -> list[int]:
        return sorted(known, key=lambda k: results.summary[k][name])

    slack, top = sorted_by("slack_share"), sorted_by("tension_max_N")[-1]
    least, worst = (results.summary[k] for k in (slack[0], slack[-1]))
    highest = results.summary[top]["tension_max_N"]
    parts = []
    if worst["slack_share"] > 0.0:
        never = [labels[k] for k in slack if results.summary[k]["slack_share"] == 0.0]
        text = f"for {percent(worst['slack_share'])} of the time under {labels[slack[-1]]}"
        if never:
            text += f", never under {_and(never)}"
        elif len(slack) > 1:
            text += f" and {percent(least['slack_share'])} under {labels[slack[0]]}"
        parts.append(f"A cable was slack, below {low:g} N, {text}")
    if highest > high:
        parts.append(f"the highest tension was {highest:.0f} N, under {labels[top]}")
    if not parts:
        return f"All tensions were within {low:g} to {high:g} N."
    text = "; ".join(parts)
    return f"{text[0].upper()}{text[1:]}."


def _limits(line: Line) -> tuple[float, float]:
    """Return the tension limits of a robot [N]."""
    return line["tension_limit_low_N"], line["tension_limit_high_N"]


def _and(names: Sequence[str]) -> str:
    """Join names."""
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
