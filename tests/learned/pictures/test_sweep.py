import numpy as np
import pytest
from matplotlib.image import imread

from carosac_toolkit.base.errors import InvalidField
from learned.pictures.sweep import sweep


def test_each_seed_is_a_dot_and_the_median_a_line(tmp_path):
    errors = {"rate=0.01": [0.020, 0.024, 0.021], "rate=0.1": [0.030]}
    figure = sweep(errors, tmp_path / "sweep.png")
    (axes,) = figure.axes
    dots, middle, *_ = axes.lines
    np.testing.assert_allclose(dots.get_xdata(), [20.0, 24.0, 21.0])
    np.testing.assert_allclose(middle.get_xdata(), [21.0, 21.0])
    assert [label.get_text() for label in axes.get_yticklabels()] == list(errors)
    assert axes.get_xscale() == "linear" and axes.get_xlim()[0] == 0.0
    assert imread(tmp_path / "sweep.png").std() > 0.01


def test_errors_far_apart_are_on_a_logarithmic_axis(tmp_path):
    figure = sweep({"a": [0.001], "b": [0.1]}, tmp_path / "sweep.png")
    assert figure.axes[0].get_xscale() == "log"


@pytest.mark.parametrize("errors", [{}, {"a": []}, {"a": [np.nan]}])
def test_no_errors_are_refused(errors, tmp_path):
    with pytest.raises(InvalidField):
        sweep(errors, tmp_path / "sweep.png")
    assert not list(tmp_path.iterdir())
