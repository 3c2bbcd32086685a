"""Blocks of paired comparisons, who is best beyond doubt, and tables for a paper."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.studies.compare.paired import paired_blocks, ways_of
from carosac_toolkit.studies.compare.paper_tables import (
    explanation,
    latex,
    markdown,
    sheets,
    text_tables,
)
from carosac_toolkit.studies.compare.results import StudyResults
from carosac_toolkit.studies.compare.tables import units

SEEDS, PATHS = 8, 3


def study(errors, *, failed=(), seeds=SEEDS):
    """Results with one controller for each scale of errors."""
    rng = np.random.default_rng(2)
    plant = rng.uniform(0.05, 0.2, size=(seeds, PATHS))
    rows = []
    for name, scale in errors.items():
        noise = rng.uniform(0.97, 1.03, size=plant.shape)
        for (seed, path), value in np.ndenumerate(scale * plant * noise):
            ok = name not in failed
            errors_of = {f"tracking_rmse_{a}_m": value if ok else None for a in ("x", "y", "z")}
            rows.append({
                "robot": "r", "controller": name, "estimator": "e", "sensors": "s",
                "perturbation": "p", "trajectory": f"t{path}", "seed": seed, "settings": "{}",
                "status": "ok" if ok else "failed", "reason": None if ok else "why",
                "tracking_rmse_norm_m": value if ok else None, "steps": 10, "centre_steps": 5,
                "latency_median_s": 1e-3, "latency_p95_s": 2e-3, "latency_p99_s": 3e-3, **errors_of,
            })  # fmt: skip
    return StudyResults(rows=tuple(rows), folder=Path("nowhere"))


def test_the_best_is_so_beyond_doubt_or_nobody_is():
    clear = paired_blocks(study({"a": 1.0, "b_b": 0.5, "c": 0.8}))[0]
    assert [sorted(one.best) for one in clear.compared] == [[], ["tracking"], []]
    close = paired_blocks(study({"a": 1.0, "b_b": 0.5, "c": 0.501}))[0]
    assert not any(one.best for one in close.compared)
    few = paired_blocks(study({"a": 1.0, "b_b": 0.5, "c": 0.8}, seeds=4))[0]
    assert not any(one.best for one in few.compared)  # p cannot be below 1/8
    assert "nothing can be significant" in explanation([few])


@pytest.mark.parametrize(("seeds", "enough"), [(7, False), (8, True)])
def test_tables_say_where_no_p_can_be_small_enough_after_holm(seeds, enough):
    scales = {name: 1.0 - 0.15 * k for k, name in enumerate("abcdef")}
    block = paired_blocks(study(scales, seeds=seeds))[0]
    p_values = [one.pairs["tracking"].p_holm for one in block.compared[1:]]
    assert (min(p_values) <= 0.05) is enough
    assert ("nothing can be significant" not in explanation([block])) is enough


def test_sway_is_explained_by_the_time_that_the_robots_were_watched():
    results = study({"a": 1.0, "b_b": 0.5})
    assert "RMS swing after the end." in explanation(paired_blocks(results))  # of older rows
    short, long = (
        replace(results, rows=tuple(row | {"final_rest_s": time} for row in results.rows))
        for time in (0.7134, 3.0)
    )
    assert "swing in the 0.71 s after the end." in explanation(paired_blocks(short))
    assert "sway: RMS in the 0.71 s after the end;" in units(short)
    both = [*paired_blocks(short), *paired_blocks(long)]
    assert "swing in the 0.71 to 3 s after the end." in explanation(both)
    assert both[0].data()["final_rest_s"] == 0.7134


def test_the_baseline_is_the_first_or_the_one_asked_for():
    results = study({"a": 1.0, "b_b": 0.5, "c": 0.8})
    first, asked = paired_blocks(results)[0], paired_blocks(results, "c")[0]
    assert (first.baseline, asked.baseline) == ("a", "c")
    assert not first.compared[0].pairs and not asked.compared[2].pairs
    there = first.compared[2].pairs["tracking"].difference.value
    assert asked.compared[0].pairs["tracking"].difference.value == pytest.approx(-there)
    with pytest.raises(InvalidField, match=r"baseline: got 'd'; allowed: one of \['a', 'b_b'"):
        paired_blocks(results, "d")


def test_labels_before_and_after_a_study_agree():
    results = study({"a": 1.0, "b_b": 0.5})
    assert ways_of(["a", "b_b"], ["e"], ["s"]) == [
        x.label for x in paired_blocks(results)[0].compared
    ]
    assert ways_of(["a"], ["e", "f"], ["s"]) == ["e", "f"]
    assert ways_of(["a"], ["e", "f"], ["s", "t"])[1] == "e / t"


def test_p_is_adjusted_for_the_comparisons_with_the_baseline():
    block = paired_blocks(study({"a": 1.0, "b_b": 0.5, "c": 0.8}))[0]
    raw = 2 / 2**SEEDS
    for one in block.compared[1:]:
        assert one.pairs["tracking"].p == pytest.approx(raw)
        assert one.pairs["tracking"].p_holm == pytest.approx(2 * raw)


def test_tables_hold_the_same_numbers_in_all_forms():
    blocks = paired_blocks(study({"a": 1.0, "b_b": 0.5, "c": 0.8}, failed=("c",)))
    typical, differences = sheets(blocks)
    assert typical.header[:2] == ("controller", "tracking [mm]")
    value, low, high = (float(x) for x in re.findall(r"\d+\.\d", typical.rows[0][1]))
    assert low <= value <= high
    assert value == pytest.approx(1e3 * blocks[0].compared[0].typical["tracking"].value, abs=0.05)
    assert typical.rows[2][1:3] == ("-", "24/24")
    assert differences.rows[1][2:] == ("-", "-", "0/24", "0.016", "24, 0")
    text, tex = markdown(blocks, "origin"), latex(blocks, "one\ntwo")
    for cell in (typical.rows[0][1], typical.rows[1][1], "24/24"):
        assert cell in text and cell in tex
    assert f"**{typical.rows[1][1]}**" in text and f"\\textbf{{{typical.rows[1][1]}}}" in tex
    assert "b\\_b" in tex and "b_b" not in tex.replace("b\\_b", "")
    assert tex.count("\\begin{table}") == tex.count("\\bottomrule") == 2
    assert text.endswith("origin\n") and "% one\n% two\n" in tex
    numbers = tex.split("midrule")[-1]  # a hyphen is no minus sign in LaTeX
    assert "$-" in numbers and re.search(r"(?<!\$)-\d", numbers) is None
    shown = text_tables(blocks, 80)
    assert max(map(len, shown.splitlines())) <= 80 and "b_b" in shown


def test_a_column_has_as_many_decimals_everywhere():
    sheet = sheets(paired_blocks(study({"a": 1.0, "b": 0.01})))[0]
    places = {len(number.partition(".")[2]) for row in sheet.rows
              for number in re.findall(r"\d+\.\d+", row[1])}  # fmt: skip
    assert places == {2}
