import re
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.colors import to_hex

from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.pictures.style import MEASURED_COLOR, SERIES_COLORS
from learned.pictures.accuracy import (
    error_histograms,
    error_violins,
    errors_over_time,
    rmse_distribution,
    sample_paths,
)
from tests.robots import simple_robot

RNG = np.random.default_rng(0)


def test_histograms_count_every_trajectory_or_say_which_they_leave_out(tmp_path):
    near = RNG.lognormal(np.log(0.02), 0.3, 500)
    far = np.append(near[:-2], [0.7, 0.9])
    figure = error_histograms(near, far, tmp_path / "histograms.png")
    for axes, values in zip(figure.axes, (near, far), strict=True):
        drawn = sum(patch.get_height() for patch in axes.patches)
        texts = [text.get_text() for text in axes.get_legend().get_texts()]
        left = [text for text in texts if text.startswith("not shown")]
        assert f"median {1e3 * np.median(values):.1f} mm" in texts
        assert f"95th percentile {1e3 * np.percentile(values, 95):.1f} mm" in texts
        assert drawn == (498 if values is far else 500)
        assert left == (["not shown: 2, up to 900 mm"] if values is far else [])
        assert axes.lines[0].get_xdata()[0] == pytest.approx(1e3 * np.median(values))
        assert "[mm]" in axes.get_xlabel()


@pytest.mark.parametrize("value", [0.0, 0.02])
def test_one_trajectory_has_a_histogram(tmp_path, value):
    figure = error_histograms([value], [value], tmp_path / "histograms.png")
    assert "1 trajectory" in figure.get_suptitle()
    assert [sum(p.get_height() for p in axes.patches) for axes in figure.axes] == [1, 1]


def test_violins_show_rmse_and_mean_of_the_signed_error(tmp_path):
    errors = RNG.standard_normal((800, 3)) * [0.02, 0.03, 0.01] - 0.01
    (axes,) = error_violins(errors, tmp_path / "violins.png", robot=simple_robot()).axes
    numbers = [float(tick.get_text()) for tick in axes.get_xticklabels()]
    assert numbers == pytest.approx(1e3 * np.sqrt((errors**2).mean(axis=0)), rel=5e-3)
    marks = [line.get_ydata()[0] for line in axes.lines if line.get_marker() in "os^"]
    assert marks == pytest.approx(1e3 * errors.mean(axis=0))
    for body, column in zip(axes.collections, errors.T, strict=True):
        drawn = body.get_paths()[0].vertices[:, 1]
        assert (drawn.min(), drawn.max()) == pytest.approx((1e3 * column.min(), 1e3 * column.max()))
    assert axes.figure.get_suptitle().startswith("simple: ")


def test_paths_lie_beside_their_references_within_the_workspace_box(tmp_path):
    robot = simple_robot()
    middle = (robot.workspace_min + robot.workspace_max) / 2
    reference = middle + 0.1 * np.cumsum(RNG.standard_normal((3, 40, 3)), axis=1)
    reached = reference + 0.02
    figure = sample_paths(reference, reached, robot, tmp_path / "paths.png")
    space, above, side = figure.axes
    factor = int(re.search(r"errors drawn (\d+) times larger", figure.get_suptitle())[1])
    assert factor > 1
    corners = np.stack([robot.workspace_min, robot.workspace_max])
    for axes, columns, edges in ((space, [0, 1, 2], 12), (above, [0, 1], 4), (side, [0, 2], 4)):
        lines = [np.array(getattr(one, "get_data_3d", one.get_data)()) for one in axes.lines]
        box = [line for one, line in zip(axes.lines, lines, strict=True) if one.get_ls() == ":"]
        assert len(box) == edges
        assert np.concatenate(box, axis=1).min(axis=1) == pytest.approx(corners[0, columns])
        assert np.concatenate(box, axis=1).max(axis=1) == pytest.approx(corners[1, columns])
        for k, color in enumerate(SERIES_COLORS[:3]):
            (own,) = (i for i, one in enumerate(axes.lines) if to_hex(one.get_color()) == color)
            drawn = reference + factor * (reached - reference)
            np.testing.assert_allclose(lines[own], drawn[k][:, columns].T)
        black = [to_hex(one.get_color()) == MEASURED_COLOR for one in axes.lines]
        dashed = [
            line
            for one, line, reference_line in zip(axes.lines, lines, black, strict=True)
            if reference_line and one.get_ls() == "--"
        ]
        np.testing.assert_allclose(dashed, reference[..., columns].swapaxes(1, 2))
    labels = {text.get_text() for text in figure.legends[0].get_texts()}
    assert labels == {"workspace box", "reference", "reached"}


def test_a_long_workspace_is_turned(tmp_path):
    robot = simple_robot()
    longer = replace(robot, workspace_max=robot.workspace_max + np.array([0.0, 9.0, 0.0]))
    path = np.zeros((1, 5, 3))
    above = sample_paths(path, path, longer, tmp_path / "paths.png").axes[1]
    assert (above.get_xlabel(), above.get_ylabel()) == ("y [m]", "x [m]")


def test_distributions_have_a_step_for_every_trajectory(tmp_path):
    groups = {"policy": 0.02 + 0.002 * RNG.standard_normal((10, 3)), "KS": np.full((1, 3), 0.04)}
    figure = rmse_distribution(groups, tmp_path / "rmse.png")
    for axis, axes in enumerate(figure.axes):
        policy, solver = axes.lines
        values = np.sort(1e3 * groups["policy"][:, axis])
        np.testing.assert_allclose(policy.get_xdata()[1:], values)
        np.testing.assert_allclose(policy.get_ydata(), np.arange(11) / 10)
        np.testing.assert_allclose(solver.get_xdata(), 40.0)
        assert axes.get_xlim()[0] >= 0.0


def test_what_cannot_be_drawn_is_refused(tmp_path):
    path, robot, points = tmp_path / "picture.png", simple_robot(), np.zeros((2, 5, 3))
    with pytest.raises(InvalidField, match=r"mean_error\[0\]: got nan"):
        error_histograms([np.nan], [0.0], path)
    with pytest.raises(InvalidField, match=r"errors: got shape \(5, 2\)"):
        error_violins(np.zeros((5, 2)), path)
    with pytest.raises(InvalidField, match="reached: got 1 paths for 2"):
        sample_paths(points, points[:1], robot, path)
    with pytest.raises(InvalidField, match=r"got 9 paths for 9; .*8 at most"):
        sample_paths(np.zeros((9, 5, 3)), np.zeros((9, 5, 3)), robot, path)
    with pytest.raises(InvalidField, match=r"reference: got shape \(5, 3\)"):
        sample_paths(points[0], points[0], robot, path)
    with pytest.raises(InvalidField, match="groups: got 0"):
        rmse_distribution({}, path)
    with pytest.raises(InvalidField, match=r"KS: got shape \(3,\)"):
        rmse_distribution({"KS": [0.1, 0.1, 0.1]}, path)
    assert list(tmp_path.iterdir()) == []


def test_errors_over_time_are_signed_in_millimetres_with_rests_shaded(tmp_path):
    time = np.linspace(0.0, 4.0, 41)
    errors = {"a": RNG.normal(0.0, 0.01, (41, 3)), "b": RNG.normal(0.0, 0.02, (41, 3))}
    rests, marks = [(0.0, 1.0), (3.0, 4.0)], [2.0]
    path = tmp_path / "errors.png"
    figure = errors_over_time(time, errors, path, rests=rests, marks=marks)
    assert len(figure.axes) == 3
    for column, axes in enumerate(figure.axes):
        drawn = {line.get_label(): line for line in axes.lines}
        for name, values in errors.items():
            assert drawn[name].get_xdata() == pytest.approx(time)
            assert drawn[name].get_ydata() == pytest.approx(1e3 * values[:, column])
        spans = [(p.get_x(), p.get_x() + p.get_width()) for p in axes.patches]
        assert np.array(spans) == pytest.approx(np.array(rests))
        assert "xyz"[column] in axes.get_ylabel() and "[mm]" in axes.get_ylabel()


def test_errors_over_time_want_one_error_for_each_time(tmp_path):
    with pytest.raises(InvalidField, match=r"late: got 3 errors; allowed: 4, one for each time"):
        errors_over_time(np.arange(4.0), {"late": np.zeros((3, 3))}, tmp_path / "errors.png")
    with pytest.raises(InvalidField, match="errors: got 0"):
        errors_over_time(np.arange(4.0), {}, tmp_path / "errors.png")
