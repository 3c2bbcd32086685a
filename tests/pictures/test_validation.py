from dataclasses import replace

import numpy as np
import pytest
from matplotlib.colors import to_hex

from carosac_toolkit.pictures.style import MODEL_NUMBERS, looks_by_name
from carosac_toolkit.pictures.validation import VALIDATION_PICTURES
from carosac_toolkit.validation import validate
from tests.validation.models import NAME
from tests.validation.runs import ROBOT, perfect

BROKEN, FAILING = f"{NAME}:Raising", f"{NAME}:Failing"


@pytest.fixture(scope="module")
def result():
    return validate(perfect(0.03), ROBOT, ["straight_line", BROKEN, "kinematic_solver", FAILING])


def legend(figure):
    return [text.get_text() for text in figure.legends[0].get_texts()]


def test_every_axis_has_a_unit(result):
    for name, draw in VALIDATION_PICTURES.items():
        axes = draw(result).axes
        labels = [label for a in axes for label in (a.get_xlabel(), a.get_ylabel()) if label]
        labels += [a.texts[0].get_text() for a in axes if a.name == "3d"]
        assert labels and all("[" in label for label in labels), name


def test_models_keep_their_colours_where_one_of_them_failed(result):
    for name, draw in VALIDATION_PICTURES.items():
        figure = draw(result)
        names = [label for label in legend(figure) if label not in ("measured", "winches at rest")]
        assert names == ["straight_line", "kinematic_solver", FAILING], name
    lines = VALIDATION_PICTURES["time_series"](result).axes[1].lines
    drawn = [to_hex(line.get_color()) for line in lines]
    looks = looks_by_name(list(result.models), MODEL_NUMBERS)
    assert drawn[:3] == [looks[k].color for k in (0, 2, 3)]


def test_rests_are_shaded_in_every_panel(result):
    for axes in VALIDATION_PICTURES["time_series"](result).axes:
        assert len(axes.patches) == len(result.rests)


def test_errors_are_drawn_in_millimetres_with_gaps_at_failures(result):
    lines = VALIDATION_PICTURES["time_series"](result).axes[1].lines
    drawn = lines[1].get_ydata()
    model = result.models["kinematic_solver"]
    expected = (model.pose.position - result.measured.position)[:, 0] * 1e3
    assert drawn == pytest.approx(expected)
    gaps = np.isnan(lines[2].get_ydata())
    assert (gaps == ~result.models[FAILING].converged).all()


def test_paths_are_to_scale_and_inside_their_axes(result):
    space, *planes = VALIDATION_PICTURES["paths"](result).axes
    assert all(plane.get_aspect() == 1.0 for plane in planes)
    path = result.measured.position
    for axis, (low, high) in enumerate((space.get_xlim(), space.get_ylim(), space.get_zlim())):
        assert low <= path[:, axis].min() and path[:, axis].max() <= high


@pytest.mark.parametrize("stop", [1, 2, 30])
def test_a_few_samples_at_rest_can_be_drawn(stop, tmp_path):
    result = validate(perfect(), ROBOT, ["straight_line", "kinematic_solver"], stop=stop)
    for name, draw in VALIDATION_PICTURES.items():
        draw(result).savefig(tmp_path / f"{name}.png")


def test_few_samples_are_drawn_as_dots():
    few = validate(perfect(), ROBOT, ["kinematic_solver"], stop=1)
    for name, panel in (("paths", 0), ("paths", 1), ("time_series", 0), ("time_series", 1)):
        lines = VALIDATION_PICTURES[name](few).axes[panel].lines
        assert lines[0].get_marker() == "o", name
    assert VALIDATION_PICTURES["error_violins"](few).axes[0].lines


def test_views_depend_on_the_robot_and_not_on_the_path(result):
    def labels(workspace_max):
        robot = replace(ROBOT, workspace_min=np.zeros(3), workspace_max=np.array(workspace_max))
        axes = VALIDATION_PICTURES["paths"](replace(result, robot=robot)).axes[1:]
        return [(a.get_xlabel()[0], a.get_ylabel()[0], a.get_title()) for a in axes]

    square = [("x", "y", "from above"), ("x", "z", "from the side, along y")]
    assert labels([2.0, 3.0, 3.0]) == labels([9.0, 1.0, 3.0]) == square
    turned = labels([2.0, 5.0, 3.0])
    assert [view[:2] for view in turned] == [("y", "x"), ("y", "z")]
    assert "turned" in turned[0][2]


def test_an_error_of_zero_stands_clear_of_the_axis():
    exact = validate(perfect(), ROBOT, ["kinematic_solver"])
    model = exact.models["kinematic_solver"]
    pose = replace(model.pose, position=exact.measured.position)
    exact = replace(exact, models={"ks": replace(model, pose=pose)})
    for axes in VALIDATION_PICTURES["error_violins"](exact).axes:
        assert axes.get_ylim()[0] < 0.0
        assert [label.get_text() for label in axes.get_xticklabels()] == ["0"]
