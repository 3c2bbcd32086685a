import re

import numpy as np
import pytest
from matplotlib.colors import to_hex

from carosac_toolkit.pictures.comparison import COMPARISON_PICTURES, in_both_regions
from carosac_toolkit.pictures.paired import draw_paired
from carosac_toolkit.pictures.style import (
    CONTROLLER_NUMBERS,
    MEASURED_COLOR,
    SERIES_COLORS,
    looks_by_name,
)
from carosac_toolkit.reports.study import write_report
from carosac_toolkit.studies.compare.example_cases import examples_of
from carosac_toolkit.studies.compare.paired import paired_blocks
from tests.pictures.layout import cut_texts, laid_out, overlapping_texts
from tests.studies.tables import bad, case, diverged, good, series, study

SCALES = {"first": 0.05, "second": 0.01}


@pytest.fixture(scope="module")
def results():
    """Two controllers that work, and between them one that does not."""
    rows = [bad(case("broken", seed), "ValueError: <no> luck") for seed in range(3)]
    for name, scale in SCALES.items():
        rows += [
            good(
                case(name, seed, trajectory), (scale, 0.1 * scale, 0.2 * scale * (1 + seed)),
                series=series(scale) if seed == 0 else None,
            )
            for trajectory in ("waypoints", "circle")
            for seed in range(3)
        ]  # fmt: skip
    order = ["first", "broken", "second"]
    return study(sorted(rows, key=lambda row: order.index(row["controller"])))


def test_one_case_has_no_scatter_to_draw(tmp_path):
    rows = [good(case(name), (size, 0, 0), series=series(size)) for name, size in SCALES.items()]
    files = write_report(study(rows, tmp_path / "out"), [], ["carosac", "compare"])
    drawn = {file.stem for file in files if file.suffix == ".png"}
    assert drawn == {*COMPARISON_PICTURES, "paired"} - {"rmse_distribution"}


def colours(axes):
    return {to_hex(line.get_color()) for line in axes.lines} - {MEASURED_COLOR}


def legend(figure):
    return [text.get_text() for text in figure.legends[0].get_texts()]


def test_every_axis_has_a_unit(results):
    for name, draw in COMPARISON_PICTURES.items():
        axes = draw(results).axes
        labels = [label for a in axes for label in (a.get_xlabel(), a.get_ylabel()) if label]
        assert labels and all("[" in label for label in labels), name


def test_colours_belong_to_the_row_of_the_table_whatever_failed(results):
    names = [line["controller"] for line in results.summary]
    looks = looks_by_name(names, CONTROLLER_NUMBERS)
    for axes in COMPARISON_PICTURES["error_over_time"](results).axes:
        assert colours(axes) == {looks[0].color, looks[2].color}
    for name in set(COMPARISON_PICTURES) - {"estimation"}:
        names = legend(COMPARISON_PICTURES[name](results))
        assert [x for x in names if x in SCALES] == list(SCALES), name


def test_errors_over_time_are_signed_and_in_millimetres_with_rests_shaded(results):
    panels = COMPARISON_PICTURES["error_over_time"](results).axes
    drawn = panels[0].lines[0].get_ydata()
    assert drawn.min() == pytest.approx(-50.0, rel=0.01)
    assert drawn.max() == pytest.approx(50.0, rel=0.01)
    for axes in panels:
        assert axes.get_ylim()[0] < 0.0
        assert len(axes.patches) == 1
        start = axes.patches[0].get_x()
        assert start == pytest.approx(48.0, abs=0.5)


@pytest.mark.parametrize("name", ["error_violins", "estimation"])
def test_distributions_of_errors_reach_below_zero_where_the_errors_do(results, name):
    x_panel, *_, norm_panel = COMPARISON_PICTURES[name](results).axes[:4]
    lowest = {k: a.collections[0].get_paths()[0].vertices[:, 1].min()
              for k, a in (("x", x_panel), ("norm", norm_panel))}  # fmt: skip
    assert lowest["x"] < -10.0 and lowest["norm"] > -1e-9


def test_the_rmse_below_a_violin_is_that_of_its_samples(results):
    x_panel = COMPARISON_PICTURES["error_violins"](results).axes[0]
    error = np.concatenate([example.error[:, 0] for example in examples_of(results.groups[0])])
    number = float(x_panel.get_xticklabels()[0].get_text())
    assert number == pytest.approx(1e3 * np.sqrt((error**2).mean()), rel=5e-3)


def test_the_distribution_of_the_rmse_has_a_step_for_every_case(results):
    panel = COMPARISON_PICTURES["rmse_distribution"](results).axes[2]
    first, broken = panel.lines[:2]
    values = 1e3 * 0.2 * 0.05 * np.array([1, 2, 3] * 2)
    assert first.get_xdata()[1:] == pytest.approx(np.sort(values))
    assert first.get_ydata() == pytest.approx(np.arange(7) / 6)
    assert len(broken.get_xdata()) == 0
    assert panel.get_xlim()[0] >= 0.0 and first.get_drawstyle() == "steps-post"


def test_a_distribution_ends_below_one_where_cases_diverged():
    rows = [good(case("a", seed), (0.01 * (1 + seed), 0.01, 0.01)) for seed in range(3)]
    rows.append(diverged(case("a", 3), 0.5))
    figure = COMPARISON_PICTURES["rmse_distribution"](study(rows))
    assert figure.axes[0].lines[0].get_ydata().max() == pytest.approx(0.75)
    assert legend(figure) == ["a (1 of 4 diverged)"]


def test_marks_of_regions_are_as_high_as_the_table_says(results):
    axes = COMPARISON_PICTURES["regions"](results).axes[0]
    drawn = axes.lines[0].get_ydata()
    line = results.summary[0]
    expected = [1e3 * line["tracking_centre_m"], 1e3 * line["tracking_boundary_m"]]
    assert drawn == pytest.approx(expected)


def test_one_region_alone_is_not_drawn_and_no_mark_is_cut(results, tmp_path):
    rows = [good(case(name, seed), (scale, scale, scale)) for name, scale in SCALES.items()
            for seed in range(2)]  # fmt: skip
    assert in_both_regions(study(rows))
    for row in rows:
        row["tracking_boundary_m"], row["centre_steps"] = None, row["steps"]
    alone = study(rows, tmp_path)
    assert not in_both_regions(alone)
    assert "regions" not in {file.stem for file in write_report(alone, [], ["carosac"])}
    figure = laid_out(COMPARISON_PICTURES["regions"](results))
    axes = figure.axes[0]
    assert [label.get_text() for label in axes.get_xticklabels()] == ["centre", "boundary"]
    for line in axes.lines[: len(results.summary)]:
        known = line.get_xydata()[np.isfinite(line.get_ydata().astype(float))]
        mark = line.get_transform().transform(known)
        half = line.get_markersize() / 72.0 * figure.dpi / 2.0
        assert (mark[:, 1] + half < axes.bbox.y1).all() and (mark[:, 1] > axes.bbox.y0).all()


def test_many_paths_have_panels_of_their_own():
    rows = [
        good(case(f"controller_{k}"), (0.01, 0.01, 0.01), series=series(0.001 * (1 + k)))
        for k in range(8)
    ]
    figure = laid_out(COMPARISON_PICTURES["paths"](study(rows)))
    titles = [axes.get_title() for axes in figure.axes if axes.get_title()]
    assert titles == [f"controller_{k}" for k in range(8)]
    assert len(figure.axes) == 16
    for axes in figure.axes:
        assert len(axes.lines) == 2  # the reference and one path
    assert overlapping_texts(figure) == [] == cut_texts(figure)


def test_estimation_names_estimators_without_counting_failures_of_controllers():
    rows = [good(case("first"), (0.01, 0.01, 0.01), series=series(0.02))]
    rows.append(diverged(case("second"), 4.0))
    assert not any(
        "diverged" in name for name in legend(COMPARISON_PICTURES["estimation"](study(rows)))
    )


@pytest.mark.parametrize(("seeds", "said"), [(2, "no interval"), (8, "95 % interval")])
def test_the_title_promises_intervals_only_where_there_are_any(seeds, said):
    rows = [good(case(name, seed), (scale * (1 + 0.1 * seed),) * 3)
            for name, scale in SCALES.items() for seed in range(seeds)]  # fmt: skip
    results = study(rows)
    figure = draw_paired(paired_blocks(results))
    assert said in figure.get_suptitle() and "open" in figure.get_suptitle()
    intervals = [line for axes in figure.axes for line in axes.lines if line.get_linewidth() == 1.6]
    assert bool(intervals) == (said == "95 % interval")


def test_estimation_compares_estimators_and_not_controllers():
    rows = [
        good(case(name, seed, estimator=estimator), (0.01, 0.01, 0.01),
             series=series(0.02) if seed == 0 else None)
        for name in ("first", "second") for estimator in ("one", "other") for seed in (0, 1)
    ]  # fmt: skip
    figure = COMPARISON_PICTURES["estimation"](study(rows))
    assert legend(figure) == ["one", "other"]
    assert "under 2 controllers" in figure.get_suptitle()


def test_a_controller_that_diverged_has_a_curve_that_is_marked_and_scales_nothing():
    rows = [good(case("fine"), (0.01, 0.01, 0.01), series=series(0.01)),
            diverged(case("lost"), 5.0)]  # fmt: skip
    both = study(rows)
    time = COMPARISON_PICTURES["error_over_time"](both)
    assert legend(time)[:2] == ["fine", "lost (diverged)"]
    _, lost = looks_by_name(["fine", "lost"], CONTROLLER_NUMBERS)
    for axes in time.axes:
        assert max(map(abs, axes.get_ylim())) < 20.0  # mm, of the one that is fine
        crosses = [line for line in axes.lines if line.get_marker() == "x"]
        assert len(crosses) == 1 and to_hex(crosses[0].get_color()) == lost.color
        assert axes.get_ylim()[0] <= crosses[0].get_ydata()[0] <= axes.get_ylim()[1]
    paths = COMPARISON_PICTURES["paths"](both)
    assert "lost (diverged)" in legend(paths)
    assert np.ptp(paths.axes[0].get_xlim()) < 3.0


def test_a_study_in_which_all_diverged_still_shows_their_curves(tmp_path):
    rows = [diverged(case(name), 5.0) for name in SCALES]
    files = write_report(study(rows, tmp_path), [], ["carosac"])
    assert {file.stem for file in files if file.suffix == ".svg"} == {"paths", "error_over_time"}


@pytest.mark.parametrize(("scale", "factor"), [(1.0, 1), (0.04, 5), (1e-4, 1000)])
def test_errors_of_paths_are_enlarged_by_a_factor_that_the_title_states(scale, factor):
    alone = study([good(case("a"), (scale, scale, scale), series=series(scale))])
    figure = COMPARISON_PICTURES["paths"](alone)
    stated = f"errors drawn {factor} times larger" if factor > 1 else "to scale"
    assert figure.get_suptitle().endswith(stated)
    example = examples_of(alone.rows)[0]
    above = figure.axes[1].lines[0].get_xydata()
    drawn = example.reference + factor * (example.position - example.reference)
    assert above == pytest.approx(drawn[:, :2])


def test_the_reference_is_drawn_once_beside_the_paths(results):
    space, *planes = COMPARISON_PICTURES["paths"](results).axes
    assert len(space.lines) == 3 and all(len(plane.lines) == 3 for plane in planes)
    assert "(waypoints, seed 0)" in COMPARISON_PICTURES["paths"](results).get_suptitle()


def test_more_rows_than_colours_are_said_to_be_left_out():
    rows = [good(case(f"c{k}", seed), (0.01, 0.01, 0.01), series=series(0.01))
            for k in range(len(SERIES_COLORS) + 2) for seed in (0, 1)]  # fmt: skip
    many = study(rows)
    title = COMPARISON_PICTURES["rmse_distribution"](many).get_suptitle()
    assert f"the first {len(SERIES_COLORS)} of {len(SERIES_COLORS) + 2} rows" in title
    for draw in COMPARISON_PICTURES.values():
        draw(many)


def test_one_case_and_no_course_can_be_drawn(tmp_path):
    for text in (None, series(0.01, rest=False)):
        alone = study([good(case("a"), (0.01, 0.01, 0.01), series=text)])
        for draw in COMPARISON_PICTURES.values():
            draw(alone).savefig(tmp_path / "x.png")


def test_the_report_stands_alone_and_escapes_what_it_quotes(results, tmp_path):
    files = write_report(study(list(results.rows), tmp_path / "out"), ["a < b"], ["carosac", "x y"])
    assert {file.stem for file in files if file.suffix == ".png"} == {
        *COMPARISON_PICTURES,
        "paired",
    }
    assert {file.name for file in files} >= {"tables.md", "tables.tex", "statistics.json"}
    text = files[-1].read_text()
    assert len(re.findall('src="data:image/png;base64,', text)) == len(COMPARISON_PICTURES) + 1
    assert not re.findall(r'src="(?!data:)', text)
    links = re.findall(r'href="([^"]*)"', text)
    assert sorted(links) == sorted(
        f"{name}.{end}" for name in (*COMPARISON_PICTURES, "paired") for end in ("svg", "pdf")
    )
    assert all((tmp_path / "out" / link).stat().st_size > 1000 for link in links)
    for part in ("a &lt; b", "&lt;no&gt; luck", "carosac &#x27;x y&#x27;", "3/3", "quasi_static"):
        assert part in text


def test_without_any_tracking_the_report_still_says_why(tmp_path):
    files = write_report(study([bad(case("a"), "no luck")], tmp_path), [], ["carosac"])
    assert files[-1].name == "report.html" and not any(x.suffix == ".png" for x in files)
    assert "no luck" in files[-1].read_text()
