import numpy as np
import pytest
from matplotlib.colors import to_hex

from carosac_toolkit.pictures.validation import MODELS, PICTURES
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
    for name, draw in PICTURES.items():
        axes = draw(result).axes
        labels = [label for a in axes for label in (a.get_xlabel(), a.get_ylabel()) if label]
        labels += [a.get_zlabel() for a in axes if hasattr(a, "get_zlabel")]
        assert labels and all("[" in label for label in labels), name


def test_models_keep_their_colours_where_one_of_them_failed(result):
    for name, draw in PICTURES.items():
        figure = draw(result)
        names = [label for label in legend(figure) if label not in ("measured", "winches at rest")]
        assert names == ["straight_line", "kinematic_solver", FAILING], name
    lines = PICTURES["time_series"](result).axes[1].lines
    drawn = [to_hex(line.get_color()) for line in lines]
    assert drawn[:3] == [MODELS[0], MODELS[2], MODELS[3]]


def test_rests_are_shaded_in_every_panel(result):
    for axes in PICTURES["time_series"](result).axes:
        assert len(axes.patches) == len(result.rests)


def test_errors_are_drawn_in_millimetres_with_gaps_at_failures(result):
    lines = PICTURES["time_series"](result).axes[1].lines
    drawn = lines[1].get_ydata()
    model = result.models["kinematic_solver"]
    expected = (model.pose.position - result.measured.position)[:, 0] * 1e3
    assert drawn == pytest.approx(expected)
    gaps = np.isnan(lines[2].get_ydata())
    assert (gaps == ~result.models[FAILING].converged).all()


def test_paths_are_to_scale_and_inside_their_axes(result):
    space, *planes = PICTURES["paths"](result).axes
    assert all(plane.get_aspect() == 1.0 for plane in planes)
    path = result.measured.position
    for axis, (low, high) in enumerate((space.get_xlim(), space.get_ylim(), space.get_zlim())):
        assert low <= path[:, axis].min() and path[:, axis].max() <= high


@pytest.mark.parametrize("stop", [1, 2, 30])
def test_a_few_samples_at_rest_can_be_drawn(stop, tmp_path):
    result = validate(perfect(), ROBOT, ["straight_line", "kinematic_solver"], stop=stop)
    for name, draw in PICTURES.items():
        draw(result).savefig(tmp_path / f"{name}.png")
