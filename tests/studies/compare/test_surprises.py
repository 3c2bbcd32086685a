"""The one table of the terminal, and the sentences on what is surprising in it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

from carosac_toolkit.robot.file import robot_text
from carosac_toolkit.studies.compare.feasibility import PathFeasibility
from carosac_toolkit.studies.compare.surprises import grave_surprises, surprises
from carosac_toolkit.studies.compare.tables import name_columns
from carosac_toolkit.studies.compare.tables import rows as table_rows
from carosac_toolkit.studies.compare.terminal_table import caption, terminal_table
from carosac_toolkit.studies.reference.results import read_rows
from carosac_toolkit.studies.run.limit_scores import LIMIT_COLUMNS
from tests.studies.tables import bad, case, good, study

REFERENCE = Path(__file__).parents[3] / "benchmarks" / "reference"
CALM = {
    "tension_min_N": 30.0, "tension_max_N": 90.0, "slack_share": 0.0, "overload_share": 0.0,
    "outside_share": 0.0, "limited": 0, "tension_limit_low_N": 20.0,
    "tension_limit_high_N": 500.0, "winch_reach_m": 0.5, "limited_by": "{}", "limited_first": "{}",
}  # fmt: skip
LIMITED = {
    "limited": 44, "limited_by": json.dumps({"acceleration": 44, "jump": 40}),
    "limited_first": json.dumps({"jump": 43, "jerk": 1}),
}  # fmt: skip

FEASIBLE = PathFeasibility(
    robot="carosac", robot_name="carosac", trajectory="circle", paths=2, infeasible=0, reason="",
    time_scale=1.0, speed=0.1, acceleration=0.1,
)  # fmt: skip


def rows(name="a", error=0.01, **more):
    return [good(case(name, seed), (error + 0.001 * seed, 0, 0), **CALM | more) for seed in (0, 1)]


def test_a_calm_study_has_no_surprise_and_shows_tensions_and_their_limits():
    results = study([*rows("a"), *rows("b", 0.02)])
    assert surprises(results) == []
    text = terminal_table(results, 100)
    assert "30 to 90" in text and "2 ok" in text and "0 %" in text
    assert "allowed 20 to 500 N" in caption(results, 100)


def test_limited_commands_are_told_with_the_limit_that_came_first_and_what_to_do():
    results = study([*rows("a"), *rows("b", 0.02, **LIMITED)])
    (text,) = surprises(results)
    assert "mostly by jump (b 44 % of the commands)" in text
    assert "0.5 m behind" in text and "--set driver.limits.jump_max=METRES" in text
    assert "44 % jump" in terminal_table(results, 100)


def test_robots_keep_their_own_names_while_other_names_are_shortened(tmp_path):
    runs = []
    for file, name in (("a.yaml", "Rig: v2"), ("b.yaml", "lab/rig v1.2")):
        path = tmp_path / file
        path.write_text(robot_text("carosac").replace("name: carosac", f'name: "{name}"', 1))
        runs += [
            good(case(one, robot=str(path)), (0.01, 0, 0), **CALM | LIMITED)
            for one in ("mine:First", "mine:Other")
        ]
    text = surprises(study(runs))[0]
    for name in ("Rig: v2", "lab/rig v1.2"):
        assert f"{name} / First 44 %" in text and f"{name} / Other 44 %" in text


def test_slower_paths_are_advised_only_where_the_paths_are_too_fast():
    limited = LIMITED | {"limited_first": json.dumps({"speed": 44})}
    results = study(rows("a", **limited))
    fast = replace(FEASIBLE, infeasible=1, reason="too fast", time_scale=0.5)
    (text,) = surprises(replace(results, feasibility=(fast,)))
    assert "lower --speed, or raise its speed_max" in text
    (text,) = surprises(replace(results, feasibility=(FEASIBLE,)))
    assert "lower --speed" not in text and "slower paths help little" in text
    own = [row | {"trajectory": "my.csv"} for row in rows("a", **limited)]
    (text,) = surprises(replace(study(own), feasibility=(fast,)))
    assert "slow the path down" in text and "--speed" not in text


def test_limits_with_the_same_advice_are_told_in_one_paragraph():
    speed, acceleration = (
        {"limited": 44, "limited_by": f'{{"{x}": 44}}', "limited_first": f'{{"{x}": 44}}'}
        for x in ("speed", "acceleration")
    )
    runs = [*rows("a", **speed), *rows("b", 0.02, **acceleration)]
    (both,) = surprises(replace(study(runs), feasibility=(FEASIBLE,)))
    assert "mostly by speed (a 44 % of the commands) or mostly by acceleration (b 44 %" in both
    assert both.count("so slower paths help little") == 1
    (apart,) = surprises(study(runs))
    assert "lower --speed" in apart and "lower --acceleration" in apart


def test_the_terminal_says_which_columns_have_no_room():
    runs = rows("a", residual_sway_m=0.01, latency_p95_s=1e-3)
    assert "Without room" not in caption(study(runs), 200)
    text = caption(study(runs), 60)
    assert "Without room here, in the report: " in text
    named = text.rpartition("report: ")[2].rstrip(".").split(", ")
    assert "cycle" in named
    assert not set(named) & set(terminal_table(study(runs), 60).splitlines()[0].split())


def test_slack_and_overloaded_cables_are_told_with_the_limits():
    more = {"slack_share": 0.34, "tension_min_N": 0.01, "overload_share": 0.02}
    results = study(rows("a", **more | {"tension_max_N": 700.0}))
    slack, over = surprises(results)
    assert "below tension_min (20 N): a 34 % of the time, down to 0.01 N" in slack
    assert "above tension_max (500 N): a 2 % of the time, up to 700 N" in over
    assert "go slower" in slack
    lasting, _ = surprises(study(rows("a", **more | {"slack_share": 0.99})))
    assert "does not come from speed" in lasting and "go slower" not in lasting


def test_slower_paths_are_not_advised_where_cables_are_slack_at_the_start_alone():
    first = {"slack_share": 0.04, "tension_min_N": 0.01, "slack_until_share": 0.05}
    (text,) = surprises(study(rows("a", **first)))
    assert "a 4 % of the time, at the start, down to 0.01 N" in text
    assert "slower paths do not help" in text and "go slower" not in text
    later = first | {"slack_until_share": 0.9}
    (text,) = surprises(study([*rows("a", **first), *rows("b", 0.02, **later)]))
    assert "a 4 % of the time, at the start, down" in text and "b 4 % of the time, down" in text
    assert "go slower" in text


def test_the_terminal_is_spared_what_its_table_and_headlines_tell():
    grave = {"limited": 44} | LIMITED
    few = {"limited": 5, "limited_by": '{"jump": 5}', "limited_first": '{"jump": 5}'}
    more = {"slack_share": 0.34, "tension_min_N": 0.01}
    results = study([*rows("a", **few | more), *rows("b", 0.02, **grave)])
    assert len(surprises(results)) == 2
    (text,) = grave_surprises(results)
    assert "mostly by jump (b 44 % of the commands)" in text


def test_paths_that_were_moved_to_where_the_robot_can_rest_are_told():
    (text,) = surprises(study(rows("a", path_moved_m=0.0421)))
    assert "can rest, by up to 0.0421 m" in text


def test_diverged_cases_are_counted_told_and_in_no_mean():
    wild = bad(case("b", 2), "the platform left the box", "diverged") | CALM | {"steps": 100}
    wild |= {"tracking_rmse_norm_m": 99.0, "tension_min_N": 1.0}
    results = study([*rows("a"), *rows("b"), wild])
    line = results.summary[1]
    assert line["diverged"] == line["failures"] == 1 and line["tracking_rmse_m"]["norm"] < 0.02
    assert line["tension_min_N"] == 1.0
    assert "diverged 1 of 3" in terminal_table(results, 100)
    told, meaning = surprises(results)[:2]
    assert told == (
        "b diverged in 1 of 3 cases, which have no score and count in no mean: the platform left "
        "the box."
    )
    assert "lower --speed" in meaning and "compare rows by the cases that both solved" in meaning


def test_a_mean_over_some_of_the_cases_says_over_how_many():
    lost = bad(case("b", 2), "the platform left the box", "diverged") | CALM | {"steps": 100}
    results = study([*rows("a"), *rows("b"), lost])
    whole, part = terminal_table(results, 100).splitlines()[2:4]
    assert "10.5 (2 of 3)" in part and "10.5  " in whole
    (text,) = [row[name_columns(results) + 3] for row in table_rows(results) if row[0] == "b"]
    assert text == "10.5 (2 of 3)"


def test_identical_rows_are_told_with_the_remark_of_the_controller():
    remark = "no mode is slower than 3 Hz: nothing is shaped"
    results = study([*rows("a"), *rows("b", remark=remark), *rows("c", 0.02)])
    (text,) = surprises(results)
    assert text == f"a and b have the same numbers in every case: {remark}."
    table = terminal_table(results, 100)
    assert "b [1]" in table and f"[1] {remark}" in table
    plain = surprises(study([*rows("a"), *rows("b")]))
    assert "these controllers send the same commands to this robot" in plain[0]


def test_fallbacks_are_told_with_their_reasons():
    counts = json.dumps({"belief": 15, "late": 5})
    (text,) = surprises(study(rows("mpc", fallbacks=20, fallbacks_by=counts)))
    assert (
        "could not command as it is meant to in 20 % of its cycles" in text
        and "(belief 30, late 10)" in text
    )


def test_names_stand_on_lines_of_their_own_where_they_leave_no_room():
    long = []
    for k in (0, 1):
        names = {"robot": f"/far/away/robot{k}.yaml", "sensors": "lengths+imu+pose" + "x" * k}
        long.append(good(case(f"c{k}" * 12, **names), (0.01 + k, 0, 0), **CALM))
    text = terminal_table(study(long), 80)
    assert max(map(len, text.splitlines())) <= 80
    assert f"robot1 / {'c1' * 12} / lengths+imu+posex" in text and "/far" not in text


def test_rows_of_before_are_shown_without_the_new_columns():
    new = {*LIMIT_COLUMNS, "limited_share"}
    published = [
        {name: value for name, value in row.items() if name not in new}
        for row in read_rows(REFERENCE)
        if row["part"] == "tracking"
    ]
    results = study(published)
    assert terminal_table(results, 120) and caption(results, 120)
    assert all(line["tension_min_N"] is None for line in results.summary)
    assert not [text for text in surprises(results) if "slack" in text or "diverged" in text]
