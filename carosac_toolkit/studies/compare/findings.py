"""Conclusions of a study, in sentences computed from its numbers."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from carosac_toolkit.base.numbers import plain
from carosac_toolkit.base.tables import counted
from carosac_toolkit.studies.compare.names import robot_names
from carosac_toolkit.studies.compare.paired import SIGNIFICANCE_LEVEL
from carosac_toolkit.studies.compare.pairs import compare
from carosac_toolkit.studies.compare.results import (
    COMPARED_COLUMNS,
    StudyResults,
    estimated,
    pooled,
    shared_cases,
    steps,
    tracked,
)
from carosac_toolkit.studies.run.case import TRUTH
from carosac_toolkit.studies.run.rows import Row
from carosac_toolkit.validation.quantities import say_length

SWAY_MIN_M = 1e-3  # [m]: a smaller swing is not worth a sentence
CLOSE_RATIO_MAX = 1.2  # ratio below which two digits do not tell what is between
COVARIANCE_SEEDS_MIN = 3  # seeds that can show that a covariance is right
EQUAL_RATIO_MAX = 1.01  # ratio of two errors below which they are not told apart
BLOCKS_MAX = 3  # robots and perturbations that get sentences


@dataclass(frozen=True)
class _ComparedError:
    """Error by which groups are compared."""

    error: str
    verb: str
    column: str
    summary: str
    rows: Callable[[Sequence[Row]], list[Row]]

    def errors(self, results: StudyResults, members: Sequence[int]) -> dict[int, float]:
        """Return the RMSE in norm of the groups that have one [m]."""
        by_group = {k: results.summary[k][self.summary]["norm"] for k in members}
        return {k: error for k, error in by_group.items() if error is not None}


TRACKING_QUANTITY = _ComparedError(
    "tracking", "track", "tracking_rmse_norm_m", "tracking_rmse_m", tracked
)
ESTIMATION_QUANTITY = _ComparedError(
    "estimation", "estimate", "estimation_rmse_norm_m", "estimation_rmse_m", estimated
)


def conclusions(results: StudyResults) -> list[str]:
    """State who estimates and tracks best and by how much, over shared cases."""
    sentences = [
        where + text
        for where, members in blocks_of(results)
        for text in _of_block(results, members)
    ]
    return sentences + _notes(results)


def blocks_of(results: StudyResults) -> list[tuple[str, list[int]]]:
    """Return the groups of the first robots and conditions, each with what to say before it."""
    blocks: dict[tuple[str, str], list[int]] = {}
    for k, line in enumerate(results.summary):
        blocks.setdefault((line["robot"], line["perturbation"]), []).append(k)
    several, names = len(blocks) > 1, robot_names(results)
    return [
        (f"On {names[robot]}, condition {condition}: " if several else "", members)
        for (robot, condition), members in list(blocks.items())[:BLOCKS_MAX]
    ]


def _of_block(results: StudyResults, members: list[int]) -> Iterator[str]:
    """Compare the groups of one robot and perturbation."""
    yield from _compared(results, estimators_of(results, members), ESTIMATION_QUANTITY)
    yield from (text for k in members if (text := _consistency(results, k)))
    yield from _compared(results, members, TRACKING_QUANTITY)
    errors = TRACKING_QUANTITY.errors(results, members)
    ranked = sorted(errors, key=lambda k: errors[k])
    if len(ranked) < 2 or errors[ranked[-1]] <= EQUAL_RATIO_MAX * errors[ranked[0]]:
        return
    labels = results.labels_of(COMPARED_COLUMNS)
    spread = [
        f"{say_length(results.summary[k]['tracking_std_m'])} for {labels[k]}"
        for k in (ranked[0], ranked[-1])
        if results.summary[k]["tracking_std_m"] is not None
    ]
    if len(spread) == 2:
        yield (f"From case to case the RMSE has a standard deviation of {spread[0]}, {spread[1]}.")
    sway = sway_sentence(results, members)
    if sway:
        yield sway


def estimators_of(results: StudyResults, members: Sequence[int]) -> list[int]:
    """Return the groups whose estimators are worth a comparison: none if there is only one.

    `truth` does not estimate.
    """
    estimating = [k for k in members if results.summary[k]["estimator"] != TRUTH]
    several = len({results.summary[k]["estimator"] for k in estimating}) > 1
    return estimating if several else []


def sway_sentence(results: StudyResults, members: Sequence[int]) -> str | None:
    """Say how much the platform swings after the end under the best and the last controller."""
    errors = TRACKING_QUANTITY.errors(results, members)
    ranked = sorted(errors, key=lambda k: errors[k])
    if len(ranked) < 2 or errors[ranked[-1]] <= EQUAL_RATIO_MAX * errors[ranked[0]]:
        return None
    labels = results.labels_of(COMPARED_COLUMNS)
    sway = {k: results.summary[k]["residual_sway_m"] for k in (ranked[0], ranked[-1])}
    if any(size is None or size <= SWAY_MIN_M for size in sway.values()):
        return None
    swings = " and ".join(f"{say_length(size)} after {labels[k]}" for k, size in sway.items())
    return f"At the end the platform still swings: by {swings} (RMS)."


def extremes(results: StudyResults, members: Sequence[int], what: _ComparedError) -> Iterator[str]:
    """Compare the best group with the last one, without those between."""
    errors = what.errors(results, members)
    ranked = sorted(errors, key=lambda k: errors[k])
    if ranked:
        yield from _compared(results, [ranked[0], ranked[-1]][: len(ranked)], what)


def _compared(results: StudyResults, members: Sequence[int], what: _ComparedError) -> Iterator[str]:
    """Compare the best group with the second and with the last one."""
    errors = what.errors(results, members)
    ranked = sorted(errors, key=lambda k: errors[k])
    if len(ranked) == 1:
        label = results.labels_of(COMPARED_COLUMNS)[ranked[0]]
        yield f"{label} {what.verb}s with {say_length(errors[ranked[0]])} RMSE."
    if len(ranked) > 2 and errors[ranked[-1]] <= EQUAL_RATIO_MAX * errors[ranked[0]]:
        names = ", ".join(results.labels_of(COMPARED_COLUMNS)[k] for k in ranked)
        size = f"{say_length(errors[ranked[0]])} to {say_length(errors[ranked[-1]])}"
        yield f"All {what.verb} alike: {size} RMSE ({names})."
    elif len(ranked) > 1:
        for other in dict.fromkeys((ranked[1], ranked[-1])):
            yield _pair(results, ranked[0], other, what)


def _pair(results: StudyResults, one: int, two: int, what: _ComparedError) -> str:
    """Compare two groups over the cases in which both have an error."""
    rows = shared_cases(what.rows(results.groups[one]), what.rows(results.groups[two]))
    size = [pooled(part, what.column, steps(part)) for part in rows]
    labels = results.labels_of(COMPARED_COLUMNS)
    names = [labels[one], labels[two]]
    if size[0] is None or size[1] is None:
        return f"{names[0]} and {names[1]} share no successful case: no comparison."
    if size[0] > size[1]:  # the ranking is over all cases, this is over those they share
        rows, size, names = (rows[1], rows[0]), size[::-1], names[::-1]
    low, high = float(size[0] or 0.0), float(size[1] or 0.0)
    cases = len(rows[0])
    single = cases == 1
    over = "RMSE in the one case of both" if single else f"RMSE over the same {cases} cases"
    if high <= EQUAL_RATIO_MAX * low:
        texts = f"{say_length(low)} and {say_length(high)}"
        return f"{names[0]} and {names[1]} {what.verb} alike: {texts} {over}."
    worse = sum(
        float(b[what.column] or 0.0) > float(a[what.column] or 0.0)
        for a, b in zip(*rows, strict=True)
    )
    ratio = high / low if low > 0.0 else None
    factor = (
        "larger than" if ratio is None else f"{ratio:.{3 if ratio < CLOSE_RATIO_MAX else 2}g} times"
    )
    often = f", larger in {worse} of them{_doubt(*rows, column=what.column)}" if not single else ""
    return (
        f"The {what.error} error of {names[1]} is {factor} that of {names[0]}: "
        f"{say_length(high)} against {say_length(low)} {over}{often}."
    )


def _doubt(better: Sequence[Row], worse: Sequence[Row], *, column: str) -> str:
    """Note that a difference may be chance, unless the seeds rule it out."""
    pair = compare(better, worse, column)
    if pair.p is None or pair.p <= SIGNIFICANCE_LEVEL:
        return ""
    return f"; with {counted(pair.seeds, 'seed')} this may be chance (p = {pair.p:.2g})"


def _consistency(results: StudyResults, group: int) -> str | None:
    """Judge whether an estimator's covariance matches its errors."""
    line, label = results.summary[group], _believer(results, group)
    square = line["nees_pose"]
    if line["covariance_faults"]:
        cycles = counted(line["covariance_faults"], "cycle")
        return (
            f"In {cycles} the covariance of {label} was not positive definite: its NEES leaves "
            "them out."
        )
    if square is None:
        return None
    mean, (low, high) = square["mean"], square["band"]
    band = f"95 % band {low:.2f} to {high:.2f} of {counted(square['seeds'], 'seed')}"
    if low <= mean <= high and square["seeds"] < COVARIANCE_SEEDS_MIN:
        return f"Nothing contradicts {label}: NEES of the pose {mean:.2f}, in the {band}."
    if low <= mean <= high:
        return f"{label} is consistent: NEES of the pose {mean:.2f}, in the {band}."
    verdict = "overconfident" if mean > high else "underconfident"
    return f"{label} is {verdict}: NEES of the pose {plain(mean, 3)}, outside the {band}."


def _believer(results: StudyResults, group: int) -> str:
    """Name the estimator of a group, and how it differs from the other groups."""
    line = results.summary[group]
    label = str(line["estimator"])
    for name, word in (("controller", "under"), ("sensors", "with")):
        if len({other[name] for other in results.summary}) > 1:
            label += f" {word} {line[name]}"
    return label


def _notes(results: StudyResults) -> list[str]:
    """Return notes that the reader needs to interpret the numbers."""
    notes = []
    failed = sum(line["failures"] for line in results.summary)
    if failed:
        notes.append(
            f"{failed} of {counted(len(results.rows), 'case')} without a score: the errors of "
            "a row are over its other cases, comparisons over the cases that both solved."
        )
    short = sum(line["incomplete"] for line in results.summary)
    if short:
        notes.append(f"In {counted(short, 'case')} the driver ended before the trajectory did.")
    drivers = {str(row["settings"]) for row in results.rows}
    if all('"driver":"quasi_static"' in text for text in drivers):
        notes.append("The driver quasi_static has no inertia: the platform cannot sway in it.")
    return notes
