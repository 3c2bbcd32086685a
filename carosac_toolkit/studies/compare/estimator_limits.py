"""Sentences on controllers that the estimator limits."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from carosac_toolkit.studies.compare.results import (
    GROUP_COLUMNS,
    StudyResults,
    pooled,
    shared_cases,
    steps,
    tracked,
)
from carosac_toolkit.studies.run.case import TRUTH
from carosac_toolkit.validation.quantities import say_length

TRUTH_RATIO_MIN = 1.5  # of tracking errors, with the estimate and with the true state
ESTIMATE_SHARE_MIN = 0.7  # of the tracking error: from here on half of its square or more


def estimator_limits(
    results: StudyResults, labels: Sequence[str], *, suspect: bool
) -> Iterator[str]:
    """Tell which controllers the estimator limits.

    Rows with the estimator `truth` beside them show it. Without any, it can be suspected of the
    controller that tracks best, unless that has no feedback, where its estimation error is most
    of its tracking error.

    Args:
        results: Results of the study.
        labels: Name of each group.
        suspect: True to tell suspicions too.
    """
    shown = [text for k in range(len(labels)) if (text := _beside_truth(results, labels, k))]
    if shown:
        yield (
            "The estimator limits tracking: with the true state in place of the estimate, the RMSE "
            f"falls {'; '.join(shown)}."
        )
    if not suspect or any(line["estimator"] == TRUTH for line in results.summary):
        return
    blocks: dict[tuple[str, str], list[int]] = {}
    for k, line in enumerate(results.summary):
        if line["tracking_rmse_m"]["norm"] is not None:
            blocks.setdefault((line["robot"], line["perturbation"]), []).append(k)
    for members in blocks.values():
        best = min(members, key=lambda k: results.summary[k]["tracking_rmse_m"]["norm"])
        line = results.summary[best]
        tracking, estimation = (line[f"{x}_rmse_m"]["norm"] for x in ("tracking", "estimation"))
        if line["feedback"] is False or estimation is None:
            continue
        if estimation >= ESTIMATE_SHARE_MIN * tracking > 0.0:
            yield (
                f"{labels[best]} tracks with {say_length(tracking)} RMSE, and the position that it "
                f"is given is off by {say_length(estimation)}. With feedback, a controller can "
                "hardly track better than that: improve estimator, sensors or calibration first. "
                "A row with the estimator truth (--estimators) shows by how much they can help."
            )


def _beside_truth(results: StudyResults, labels: Sequence[str], group: int) -> str | None:
    """Compare a group with the same controller given the true state, if that is much better."""
    line = results.summary[group]
    same = {name: line[name] for name in GROUP_COLUMNS} | {"estimator": TRUTH}
    twin = next((k for k, other in enumerate(results.summary) if same.items() <= other.items()), -1)
    if twin in (-1, group):
        return None
    rows = shared_cases(tracked(results.groups[group]), tracked(results.groups[twin]))
    known, true = (pooled(part, "tracking_rmse_norm_m", steps(part)) for part in rows)
    if known is None or true is None or known < TRUTH_RATIO_MIN * true:
        return None
    return f"from {say_length(known)} to {say_length(true)} for {labels[group]}"
