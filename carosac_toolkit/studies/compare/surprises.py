"""Surprises of a study in words: what a reader of its table has to know before believing it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from math import isclose
from typing import Any

from carosac_toolkit.base.numbers import plain
from carosac_toolkit.studies.compare.estimator_limits import estimator_limits
from carosac_toolkit.studies.compare.names import named_labels, robot_names
from carosac_toolkit.studies.compare.results import (
    COMPARED_COLUMNS,
    PAIR_COLUMNS,
    StudyResults,
    scored,
)
from carosac_toolkit.studies.compare.terminal_table import main_limit, percent
from carosac_toolkit.studies.run.rows import Row
from carosac_toolkit.trajectories.path_file import is_path_file

LIMITED_SHARE_MIN = 0.01  # of the commands: fewer are not worth a sentence
GRAVE_LIMITED_SHARE_MIN = 0.1  # of the commands: fewer can be seen in the table
SLACK_SHARE_MIN = 0.001  # of the time; tensions count from here on
FALLBACK_SHARE_MIN = 0.01  # of the commands
SAME_TOLERANCE = 1e-9  # relative: numbers that differ by less are the same
SAME_COLUMNS = ("tracking_rmse_norm_m", "estimation_rmse_norm_m")

ADVICE = {
    "jump": (
        "the command was too far ahead of the measured length. A winch at full speed is {reach} m "
        "behind, plus the delay of its encoder: raise driver.limits.jump_max above that (--set "
        "driver.limits.jump_max=METRES), or go slower"
    ),
    "speed": "a winch cannot wind as fast as asked: {slower}, or raise its speed_max",
    "acceleration": "a winch cannot accelerate as asked: {gentler}, or raise its acceleration_max",
    "jerk": "the acceleration of a cable changed too fast: {gentler}, lower the gains of the "
    "controller, or raise driver.limits.jerk_max",
    "length": "a cable would be shorter or longer than its winch allows: check length_min and "
    "length_max in the robot file",
    "box": "the platform would leave the workspace box of the robot file",
    "length_rate": "the feed-forward rate was above the speed of a winch: {slower}",
    "coordination": "cables were held back to stay with the others",
}
DIVERGED_MEANING = (
    "A case diverged if the platform left the workspace box, or for over half a sway period in one "
    "piece was not held, not known or far from its reference; cables that are slack for shorter "
    "pieces are scored. A mean beside (1 of 2) leaves such cases out, often the hardest: compare "
    "rows by the cases that both solved, as the report does. To keep the platform held, {slower}, "
    "or stay farther from the edge of the workspace."
)
WINCH_LIMITS = ("speed", "acceleration", "length_rate")  # which `path_feasibility` judges too
CORRECTIONS_ADVICE = (
    "the paths alone stay within the limits of the winches, so slower paths help little. What is "
    "too fast is what is added to them: the step onto the controller's own model, corrections of "
    "errors, damping of sway or noise of the estimate"
)
SLACK_SHARE_LASTING = 0.5  # of the time: slack from more than fast motion
START_SHARE_MAX = 0.2  # of the run: cables slack until then alone were slack at its start
START_ADVICE = (
    "they were slack at the start alone, so slower paths do not help. The first commands step from "
    "the lengths at which the platform rests to those of the controller's own model. Errors of "
    "encoders and of the robot file (driver.sensors, --condition) set the size of that step"
)


def surprises(results: StudyResults) -> list[str]:
    """Return a sentence for each surprise, the gravest first."""
    return [
        *_diverged(results),
        *_limited(results),
        *_tensions(results),
        *estimator_limits(results, _labels(results), suspect=True),
        *_outside(results),
        *_moved(results),
        *_fallbacks(results),
        *_identical(results),
    ]


def grave_surprises(results: StudyResults) -> list[str]:
    """Return those that the table and `headlines` do not tell, the gravest first."""
    return [
        *_diverged(results),
        *_limited(results, GRAVE_LIMITED_SHARE_MIN),
        *estimator_limits(results, _labels(results), suspect=False),
        *_outside(results),
        *_moved(results),
        *_fallbacks(results),
        *_identical(results),
    ]


def _labels(results: StudyResults) -> list[str]:
    """Return short labels of the groups."""
    return named_labels(results, short=True)


def _lines(
    results: StudyResults, shown: Callable[[dict[str, Any]], bool]
) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield label and summary of the groups that are to be named."""
    for label, line in zip(_labels(results), results.summary, strict=True):
        if shown(line):
            yield label, line


def _diverged(results: StudyResults) -> Iterator[str]:
    """Tell which groups diverged, and why the first case did."""
    for label, line in _lines(results, lambda line: line["diverged"]):
        reason = next(
            text for text in line["reasons"] if text.startswith("diverged: ")
        ).removeprefix("diverged: ")
        yield (
            f"{label} diverged in {line['diverged']} of {line['cases']} cases, which have no score "
            f"and count in no mean: {reason}."
        )
    if any(line["diverged"] for line in results.summary):
        yield DIVERGED_MEANING.format(slower=_remedies(results)["slower"])


def _limited(results: StudyResults, least: float = LIMITED_SHARE_MIN) -> Iterator[str]:
    """Tell whose commands were limited, by what, and what to do, once for each advice."""
    by_limit: dict[str, list[tuple[str, dict[str, Any]]]] = {}
    for label, line in _lines(results, lambda line: (line["limited_share"] or 0.0) > least):
        name = main_limit(line)
        if name is not None:
            by_limit.setdefault(name, []).append((label, line))
    causes: dict[str, list[str]] = {}
    for name, members in by_limit.items():
        each = ", ".join(f"{label} {percent(line['limited_share'])}" for label, line in members)
        reach = max((line["winch_reach_m"] or 0.0 for _, line in members), default=0.0)
        advice = _advice(results, name, members).format(reach=plain(reach, 2))
        causes.setdefault(advice, []).append(f"mostly by {name} ({each} of the commands)")
    if causes:
        told = "; ".join(f"{' or '.join(each)}: {advice}" for advice, each in causes.items())
        yield (
            f"Commands were changed by limits before they reached the winches, {told}. Such rows "
            "describe the limit as much as the controller."
        )


def _advice(results: StudyResults, name: str, members: Sequence[tuple[str, dict[str, Any]]]) -> str:
    """Say why a limit was met and what helps; slower paths do not where these are feasible."""
    robots = {str(line["robot"]) for _, line in members}
    judged = [one for one in results.feasibility if one.robot in robots]
    if name in WINCH_LIMITS and judged and not any(one.infeasible for one in judged):
        return CORRECTIONS_ADVICE
    advice = ADVICE.get(name, "see driver.limits")
    for key, text in _remedies(results).items():
        advice = advice.replace(f"{{{key}}}", text)
    return advice


def _remedies(results: StudyResults) -> dict[str, str]:
    """Say how paths are made slower and gentler: by options, or in their files."""
    drawn = any(not is_path_file(str(row["trajectory"])) for row in results.rows)
    return {
        "slower": "lower --speed" if drawn else "slow the path down",
        "gentler": "lower --acceleration" if drawn else "smooth or slow the path down",
    }


def _tensions(results: StudyResults) -> Iterator[str]:
    """Tell whose tensions left their limits."""
    slack = _times(results, "slack_share", SLACK_SHARE_MIN, _slack_ending)
    if slack:
        low = _limits(results, "tension_limit_low_N", "slack_share")
        yield (
            f"Cables went slack, below tension_min ({low} N): {'; '.join(slack)}. A slack cable "
            f"does not guide the platform: {_slack_advice(results)}."
        )
    over = _times(
        results, "overload_share", SLACK_SHARE_MIN,
        lambda line: f", up to {plain(line['tension_max_N'], 4)} N",
    )  # fmt: skip
    if over:
        high = _limits(results, "tension_limit_high_N", "overload_share")
        yield f"Cables were overloaded, above tension_max ({high} N): {'; '.join(over)}."


def _slack_advice(results: StudyResults) -> str:
    """Say what keeps cables taut."""
    slack = [x for x in results.summary if (x["slack_share"] or 0.0) > SLACK_SHARE_MIN]
    if all(_only_at_the_start(line) for line in slack):
        return START_ADVICE
    if any((line["slack_share"] or 0.0) > SLACK_SHARE_LASTING for line in results.summary):
        return (
            "slack for most of the time does not come from speed. See whether errors of encoders "
            "and points (driver.sensors, --condition) are large for a robot of this size, and "
            "whether carosac check finds tensions within the limits"
        )
    held = any((line["limited_share"] or 0.0) > LIMITED_SHARE_MIN for line in results.summary)
    first = "see to the limited commands first, then " if held else ""
    return f"{first}go slower, or keep farther from the edge of the workspace"


def _slack_ending(line: dict[str, Any]) -> str:
    """Tell the least tension of a group, and if its cables were slack at the start alone."""
    at_the_start = ", at the start" if _only_at_the_start(line) else ""
    return f"{at_the_start}, down to {plain(line['tension_min_N'], 2)} N"


def _only_at_the_start(line: dict[str, Any]) -> bool:
    """Return whether no cable of a group was slack after the start of its runs."""
    until = line["slack_until_share"]
    return until is not None and until <= START_SHARE_MAX


def _times(
    results: StudyResults, share: str, least: float,
    ending: Callable[[dict[str, Any]], str] = lambda line: "",
) -> list[str]:  # fmt: skip
    """Tell for which part of the time each group was in a state, where it is more than `least`."""
    return [
        f"{label} {percent(line[share])} of the time{ending(line)}"
        for label, line in _lines(results, lambda line: (line[share] or 0.0) > least)
    ]


def _limits(results: StudyResults, name: str, share: str) -> str:
    """Return the tension limits of the robots that are told of [N]."""
    known = {
        f"{line[name]:g}"
        for line in results.summary
        if line[name] is not None and (line[share] or 0.0) > SLACK_SHARE_MIN
    }
    return " or ".join(sorted(known, key=float))


def _outside(results: StudyResults) -> Iterator[str]:
    """Tell who left the workspace box."""
    out = _times(results, "outside_share", LIMITED_SHARE_MIN)
    if out:
        yield f"The platform was outside the workspace box: {'; '.join(out)}."


def _moved(results: StudyResults) -> Iterator[str]:
    """Tell which robots could not rest on the paths that were asked."""
    most: dict[str, float] = {}
    for row in results.rows:
        name, moved = str(row["robot"]), float(row.get("path_moved_m") or 0.0)
        most[name] = max(most.get(name, 0.0), moved)
    names = robot_names(results)
    for name, moved in most.items():
        if moved > 0.0:
            yield (
                f"Paths were moved onto positions at which {names[name]} can rest, by up to "
                f"{plain(moved, 3)} m; errors count from there."
            )


def _fallbacks(results: StudyResults) -> Iterator[str]:
    """Tell who fell back from what it had planned."""
    for label, line in _lines(
        results, lambda line: (line["fallback_share"] or 0.0) > FALLBACK_SHARE_MIN
    ):
        causes = ", ".join(f"{name} {number}" for name, number in line["fallbacks_by"].items())
        yield (
            f"{label} could not command as it is meant to in {percent(line['fallback_share'])} of "
            f"its cycles and fell back on something else ({causes})."
        )


def _identical(results: StudyResults) -> Iterator[str]:
    """Tell which groups have the same numbers in all cases, and why that may be."""
    labels = _labels(results)
    told: set[int] = set()
    for k, group in enumerate(results.groups):
        same = [
            j
            for j in range(k + 1, len(labels))
            if j not in told and _same(group, results.groups[j])
        ]
        if k in told or not same:
            continue
        told |= {k, *same}
        members = [k, *same]
        texts = [text for j in members for text in results.summary[j]["remarks"]]
        names = ", ".join(labels[j] for j in members[:-1]) + f" and {labels[members[-1]]}"
        why = texts[0] if texts else _possible_reason(results, members)
        yield f"{names} have the same numbers in every case: {why}."


def _possible_reason(results: StudyResults, members: Sequence[int]) -> str:
    """Say what may make groups identical that differ by name."""
    varies = [
        name for name in COMPARED_COLUMNS if len({results.summary[j][name] for j in members}) > 1
    ]
    if varies == ["sensors"]:
        return "neither controller nor estimator uses the sensors that differ"
    if varies == ["estimator"]:
        return "these estimators do the same for this robot and these sensors"
    return "these controllers send the same commands to this robot"


def _same(rows: Sequence[Row], others: Sequence[Row]) -> bool:
    """Return whether two groups have the same errors in the same cases."""
    if any(rows[0][name] != others[0][name] for name in ("robot", "perturbation")):
        return False
    one, other = (
        {tuple(row[name] for name in PAIR_COLUMNS): row for row in scored(group)}
        for group in (rows, others)
    )
    if not one or one.keys() != other.keys():
        return False
    return all(
        _equal(one[key].get(name), other[key].get(name)) for key in one for name in SAME_COLUMNS
    )


def _equal(one: Any, other: Any) -> bool:
    """Compare two values of a column."""
    if one is None or other is None:
        return one is other
    return isclose(float(one), float(other), rel_tol=SAME_TOLERANCE)
