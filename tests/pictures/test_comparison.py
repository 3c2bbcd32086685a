import re

import numpy as np
import pytest
from matplotlib.colors import to_hex

from carosac_toolkit.pictures.comparison import COMPARISON_PICTURES
from carosac_toolkit.pictures.drawing import SERIES_COLORS
from carosac_toolkit.reports.study import write_report
from tests.studies.tables import bad, case, good, series, study

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
    assert drawn == {*COMPARISON_PICTURES, "paired"} - {"rmse_gaussians"}


def colours(axes):
    return {to_hex(line.get_color()) for line in axes.lines}


def test_every_axis_has_a_unit(results):
    for name, draw in COMPARISON_PICTURES.items():
        axes = draw(results).axes
        labels = [label for a in axes for label in (a.get_xlabel(), a.get_ylabel()) if label]
        assert labels and all("[" in label for label in labels), name


def test_colours_belong_to_the_row_of_the_table_whatever_failed(results):
    for axes in COMPARISON_PICTURES["error_over_time"](results).axes:
        assert colours(axes) == {SERIES_COLORS[0], SERIES_COLORS[2]}
    for name, draw in COMPARISON_PICTURES.items():
        names = [text.get_text() for text in draw(results).legends[0].get_texts()]
        assert [x for x in names if x in SCALES] == list(SCALES), name


def test_errors_over_time_are_absolute_and_in_millimetres_with_rests_shaded(results):
    panels = COMPARISON_PICTURES["error_over_time"](results).axes
    first = panels[0].lines[0].get_ydata()
    assert first.min() >= 0.0 and first.max() == pytest.approx(50.0, rel=0.01)
    for axes in panels:
        assert len(axes.patches) == 1
        start = axes.patches[0].get_x()
        assert start == pytest.approx(48.0, abs=0.5)


def test_gaussians_show_every_case_and_its_mean_and_deviation(results):
    panel = COMPARISON_PICTURES["rmse_gaussians"](results).axes[2]
    assert [len(line.get_xdata()) for line in panel.lines][:2] == [6, 6]
    values = 1e3 * 0.2 * 0.05 * np.array([1, 2, 3] * 2)
    assert f"{values.mean():.1f} ± {values.std(ddof=1):.1f}" in [t.get_text() for t in panel.texts]


def test_bars_are_as_high_as_the_table_says(results):
    centre = COMPARISON_PICTURES["regions_and_estimates"](results).axes[0]
    heights = [patch.get_height() for patch in centre.patches]
    expected = 1e3 * results.summary[0]["tracking_centre_m"]
    assert heights[0] == pytest.approx(expected)


def test_the_reference_is_drawn_once_beside_the_paths(results):
    space, *planes = COMPARISON_PICTURES["paths"](results).axes
    assert len(space.lines) == 3 and all(len(plane.lines) == 3 for plane in planes)
    assert "carosac, waypoints, seed 0" in COMPARISON_PICTURES["paths"](results).get_suptitle()


def test_more_rows_than_colours_are_said_to_be_left_out():
    rows = [good(case(f"c{k}", seed), (0.01, 0.01, 0.01), series=series(0.01))
            for k in range(len(SERIES_COLORS) + 2) for seed in (0, 1)]  # fmt: skip
    many = study(rows)
    title = COMPARISON_PICTURES["rmse_gaussians"](many).get_suptitle()
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
    assert not re.findall(r'(?:src|href)="(?!data:)', text)
    for part in ("a &lt; b", "&lt;no&gt; luck", "carosac &#x27;x y&#x27;", "3/3", "quasi_static"):
        assert part in text


def test_without_any_tracking_the_report_still_says_why(tmp_path):
    files = write_report(study([bad(case("a"), "no luck")], tmp_path), [], ["carosac"])
    assert files[-1].name == "report.html" and not any(x.suffix == ".png" for x in files)
    assert "no luck" in files[-1].read_text()
