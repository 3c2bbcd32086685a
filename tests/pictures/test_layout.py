"""Every picture of a study, held against the same list."""

import numpy as np
import pytest

from carosac_toolkit.inspection.report import report_robot
from carosac_toolkit.pictures.comparison import COMPARISON_PICTURES
from carosac_toolkit.pictures.drawing import new_figure
from carosac_toolkit.pictures.paired import draw_paired
from carosac_toolkit.pictures.paper import draw_gaussians
from carosac_toolkit.pictures.robot import draw_robot
from carosac_toolkit.pictures.style import (
    DOUBLE_COLUMN_INCH,
    SINGLE_COLUMN_INCH,
    STYLES,
    using_style,
)
from carosac_toolkit.pictures.validation import VALIDATION_PICTURES
from carosac_toolkit.robot.file import load_robot
from carosac_toolkit.studies.compare.paired import paired_blocks
from carosac_toolkit.validation import validate
from tests.pictures.layout import cut_texts, laid_out, overlapping_texts, texts_on_data
from tests.studies.tables import case, diverged, good, series, study
from tests.validation.runs import ROBOT, perfect

NAMES = ("kinematic_solver", "input_shaping", "mpc")
ESTIMATORS = ("kinematic_solver", "dynamic_estimator")
ROWS = [
    good(
        case(name, seed, path, estimator=estimator),
        (scale * (1 + seed), 0.1 * scale, 0.3 * scale),
        series=series(scale) if seed == 0 else None, nees_pose=0.4 + seed,
    )
    for name, scale in zip(NAMES, (0.4, 0.05, 0.006), strict=True)
    for estimator in ESTIMATORS
    for path in ("waypoints", "spiral")
    for seed in range(4)
]  # fmt: skip
LOST = [diverged(case("td3", seed, estimator=ESTIMATORS[1]), 4.0) for seed in range(2)]
RESULTS = study([*ROWS, *LOST])


@pytest.fixture(scope="module", params=STYLES)
def figures(request):
    """Pictures of one study, one validation and three robots, by name."""
    validation = validate(perfect(0.03), ROBOT, ["straight_line", "kinematic_solver"])
    with using_style(request.param):
        drawn = {name: draw(RESULTS) for name, draw in COMPARISON_PICTURES.items()}
        drawn["paired"] = draw_paired(paired_blocks(RESULTS))
        drawn["gaussians"] = draw_gaussians(RESULTS)
        drawn |= {f"validation {k}": draw(validation) for k, draw in VALIDATION_PICTURES.items()}
        for name in ("carosac", "stadium", "cogiro"):
            drawn[f"check {name}"] = draw_robot(report_robot(load_robot(name)))
        return {name: laid_out(figure) for name, figure in drawn.items()}


def test_no_text_covers_another_text(figures):
    assert {k: found for k, f in figures.items() if (found := overlapping_texts(f))} == {}


def test_no_text_covers_data(figures):
    assert {k: found for k, f in figures.items() if (found := texts_on_data(f))} == {}


def test_no_text_is_cut_off(figures):
    assert {k: found for k, f in figures.items() if (found := cut_texts(f))} == {}


def test_no_legend_touches_the_edge_of_its_figure(figures):
    for name, figure in figures.items():
        for legend in figure.legends:
            box, whole = legend.get_window_extent(), figure.bbox
            room = min(box.x0 - whole.x0, whole.x1 - box.x1)
            assert room > 0.02 * whole.width, name


def test_every_picture_is_as_wide_as_one_or_two_columns(figures):
    widths = {name: figure.get_size_inches()[0] for name, figure in figures.items()}
    assert set(widths.values()) <= {SINGLE_COLUMN_INCH, DOUBLE_COLUMN_INCH}
    assert all(figure.get_size_inches()[1] <= 9.0 for figure in figures.values())


def test_every_title_has_the_name_of_the_robot(figures):
    for name, figure in figures.items():
        titles = [figure.get_suptitle(), *(axes.get_title() for axes in figure.axes)]
        robot = name.removeprefix("check ") if name.startswith("check") else "carosac"
        robot = ROBOT.name if name.startswith("validation") else robot
        assert any(robot in title for title in titles), name
        assert not any(".yaml" in title for title in titles), name


def test_every_letter_is_large_enough_to_be_printed(figures):
    from matplotlib.text import Text

    for name, figure in figures.items():
        sizes = [text.get_fontsize() for text in figure.findobj(Text) if text.get_text()]
        assert min(sizes) >= 6.9, name


def test_the_search_for_covered_texts_finds_them():
    figure = new_figure(3.5, 2.0)
    axes = figure.subplots()
    axes.plot([0.0, 1.0], [0.0, 1.0])
    axes.text(0.5, 0.5, "on the line", ha="center", va="center")
    axes.text(0.5, 0.5, "on the text", ha="center", va="center")
    axes.text(0.0, 1.0, "free")
    axes.text(0.95, 0.1, "beyond the edge of the figure", in_layout=False)
    laid_out(figure)
    assert ("on the line", "on the text") in overlapping_texts(figure)
    assert set(texts_on_data(figure)) == {"on the line", "on the text"}
    assert cut_texts(figure) == ["beyond the edge of the figure"]


@pytest.mark.parametrize(("name", "factor"), [("stadium", 10), ("cogiro", 1)])
def test_a_platform_too_small_to_see_is_drawn_larger_and_the_legend_says_so(name, factor):
    robot = load_robot(name)
    figure = draw_robot(report_robot(robot))
    stated = [
        text.get_text() for text in figure.legends[0].get_texts() if "times" in text.get_text()
    ]
    assert stated == ([f"anchor points, platform drawn {factor} times larger"] * (factor > 1))
    above = figure.axes[1]
    anchors = next(line.get_xydata() for line in above.lines
                   if len(line.get_xydata()) == robot.n and line.get_marker() == ".")  # fmt: skip
    true = np.ptp(robot.anchor_points[:, :2], axis=0)
    assert np.ptp(anchors, axis=0) == pytest.approx(factor * true, rel=0.05)
    span = np.ptp(above.get_xlim())
    assert np.ptp(anchors, axis=0).max() > 0.04 * span
