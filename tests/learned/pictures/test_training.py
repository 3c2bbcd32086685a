import numpy as np
import pytest
from matplotlib.colors import to_hex
from matplotlib.image import imread

from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.pictures.style import SERIES_COLORS
from learned.learning_curve import CURVE_COLUMNS, Episode, write_curve, write_episodes
from learned.pictures.training import curve_of, learning_curves, reward_terms, smoothed


def curve(seed=0, **more):
    steps = np.arange(200, 40_001, 200)
    noise = np.random.default_rng(seed).standard_normal(len(steps))
    return {"steps": steps, "reward": -np.exp(-steps / 1e4) + 0.2 * noise} | more


def evaluated(seed=0, last=0.02):
    errors = np.geomspace(0.5, last, 5)
    return curve(seed, evaluated_steps=np.arange(5) * 1e4, median_error=errors, name=f"seed {seed}")


def test_each_term_is_drawn_against_its_variable(tmp_path):
    distance = np.linspace(0.0, 1.0, 50)
    terms = {f"r_{k}": (f"variable {k} [m]", distance, -k * distance) for k in range(5)}
    figure = reward_terms(terms, tmp_path / "terms.png")
    assert len(figure.axes) == 5
    for k, axes in enumerate(figure.axes):
        assert (axes.get_title(), axes.get_xlabel()) == (f"r_{k}", f"variable {k} [m]")
        np.testing.assert_array_equal(axes.lines[-1].get_xydata().T, [distance, -k * distance])
    assert imread(tmp_path / "terms.png").std() > 0.01  # it is no blank sheet


@pytest.mark.parametrize("count, columns", [(1, 1), (4, 2), (6, 3)])
def test_terms_fill_their_rows(tmp_path, count, columns):
    terms = {f"r_{k}": ("x [m]", [0.0, 1.0], [1.0, 0.0]) for k in range(count)}
    figure = reward_terms(terms, tmp_path / "terms.png")
    assert figure.axes[0].get_subplotspec().get_gridspec().ncols == columns


def test_smoothing_keeps_lines_and_takes_noise_away():
    noise, at = np.random.default_rng(0).standard_normal(5000), np.arange(5000.0)
    steps, flat = smoothed(at[:100], np.full(100, 3.0))
    np.testing.assert_array_equal(steps, at[:100])
    assert flat == pytest.approx(np.full(100, 3.0))
    straight = np.linspace(0.0, 1.0, 1000)
    assert smoothed(at[:1000], straight, 0.1)[1][50:-50] == pytest.approx(straight[50:-50])
    half = int(0.04 * len(noise) / 2)
    inside = smoothed(at, noise, 0.04)[1][half:-half]
    assert inside.std() == pytest.approx(1.0 / np.sqrt(2 * half + 1), rel=0.3)
    window = noise[2500 - half : 2500 + half + 1]
    assert smoothed(at, noise, 0.04)[1][2500] == pytest.approx(window.mean())
    assert smoothed(at[:3], noise[:3])[1] == pytest.approx(noise[:3])  # too few to smooth


@pytest.mark.parametrize("share", [0.001, 0.2])
def test_episodes_that_end_together_are_one_point_of_the_smoothed_line(share):
    """Whatever their order among each other is, in a window that holds all of them."""
    steps = np.repeat([100.0, 200.0, 300.0, 400.0, 500.0], 20)
    values = np.repeat([1.0, 2.0, 3.0, 4.0, 5.0], 20) + np.tile(np.linspace(-1.0, 1.0, 20), 5)
    when, mean = smoothed(steps, values, share)
    np.testing.assert_array_equal(when, [100.0, 200.0, 300.0, 400.0, 500.0])
    assert mean == pytest.approx([1.0, 2.0, 3.0, 4.0, 5.0], abs=0.03)


def test_curves_show_raw_and_smoothed_rewards_in_the_colour_of_their_seed(tmp_path):
    curves = [evaluated(0), evaluated(1), curve(2)]
    reward, error = learning_curves(curves, tmp_path / "curves.png").axes
    assert len(reward.lines) == 6 and len(error.lines) == 2
    for k, (raw, smooth) in enumerate(zip(reward.lines[::2], reward.lines[1::2], strict=True)):
        assert to_hex(raw.get_color()) == to_hex(smooth.get_color()) == SERIES_COLORS[k]
        np.testing.assert_array_equal(raw.get_ydata(), curves[k]["reward"])
        assert raw.get_alpha() < 0.5
        late = slice(-100, None)
        assert smooth.get_ydata()[late].std() < 0.5 * raw.get_ydata()[late].std()
    assert [to_hex(line.get_color()) for line in error.lines] == list(SERIES_COLORS[:2])
    labels = reward.get_legend_handles_labels()[1]
    assert labels == ["seed 0", "seed 1", "training 3"]


def test_errors_are_in_millimetres_beside_what_they_are_compared_with(tmp_path):
    figure = learning_curves([evaluated()], tmp_path / "curves.png", marks={"paper": 0.027})
    axes = figure.axes[1]
    assert axes.lines[0].get_ydata()[[0, -1]] == pytest.approx([500.0, 20.0])
    assert axes.lines[1].get_ydata() == pytest.approx([27.0, 27.0])
    assert [text.get_text() for text in axes.texts] == ["paper: 27 mm"]
    assert axes.get_yscale() == "log" and "[mm]" in axes.get_ylabel()
    little = learning_curves([evaluated(last=0.3)], tmp_path / "curves.png").axes[1]
    assert little.get_yscale() == "linear" and little.get_ylim()[0] == 0.0


def trained(folder, errors=(0.3, 0.2, 0.1)):
    """What a training leaves: three evaluations and seven episodes."""
    rows = [dict.fromkeys(CURVE_COLUMNS, 0.0) for _ in errors]
    for k, (row, error) in enumerate(zip(rows, errors, strict=True)):
        row |= {"steps": 100.0 * (k + 1), "reward": -5.0 + k, "median_error_m": error}
    write_curve(folder / "curve.csv", rows)
    write_episodes(folder / "episodes.csv", [Episode(40 * k, -1.0 / k, 40) for k in range(1, 8)])
    return folder


def test_the_curve_of_a_training_has_each_of_its_episodes(tmp_path):
    found = curve_of(trained(tmp_path), "seed 0")
    np.testing.assert_array_equal(found["steps"], 40.0 * np.arange(1, 8))
    np.testing.assert_allclose(found["reward"], -1.0 / np.arange(1, 8), rtol=1e-5)
    figure = learning_curves([found], tmp_path / "curves.png")
    reward, error = figure.axes
    raw, smooth = reward.lines
    assert raw.get_linestyle() == "None" and len(raw.get_xdata()) == 7
    assert smooth.get_linestyle() == "-"
    assert "pale: each episode; line: moving mean of 4 %" in figure.get_suptitle()
    assert "dot before" not in figure.get_suptitle()
    np.testing.assert_allclose(error.lines[0].get_xydata().T, [[100, 200, 300], [300, 200, 100]])


def test_an_older_training_has_means_alone_and_the_picture_says_so(tmp_path):
    (trained(tmp_path) / "episodes.csv").unlink()
    found = curve_of(tmp_path, "seed 0")
    figure = learning_curves([found], tmp_path / "curves.png")
    (means,) = figure.axes[0].lines
    np.testing.assert_array_equal(means.get_xydata().T, [[100, 200, 300], [-5, -4, -3]])
    said = "mean of the episodes since the dot before"
    assert said in figure.get_suptitle() and "each episode" not in figure.get_suptitle()
    both = learning_curves([found, curve()], tmp_path / "curves.png").get_suptitle()
    assert said in both and "each episode" in both


def test_an_evaluation_in_which_all_paths_failed_has_no_error_to_draw(tmp_path):
    found = curve_of(trained(tmp_path, (np.nan, 0.2, 0.1)), "seed 0")
    assert found["evaluated_steps"] == [200.0, 300.0]
    lost = curve_of(trained(tmp_path, (np.nan, np.nan)), "seed 0")
    assert len(learning_curves([lost], tmp_path / "curves.png").axes) == 1
    write_episodes(tmp_path / "episodes.csv", [Episode(40, -1.0, 40)])
    assert curve_of(tmp_path, "seed 0") is None  # too little to draw


def test_without_evaluations_there_is_one_panel(tmp_path):
    assert len(learning_curves([curve()], tmp_path / "curves.svg").axes) == 1


def test_what_cannot_be_drawn_is_refused(tmp_path):
    path = tmp_path / "picture.png"
    with pytest.raises(InvalidField, match="terms: got none"):
        reward_terms({}, path)
    with pytest.raises(InvalidField, match=r"r_dist: got 2 values; allowed: 3 values"):
        reward_terms({"r_dist": ("d [m]", [0.0, 1.0, 2.0], [0.0, 1.0])}, path)
    with pytest.raises(InvalidField, match="curves: got none"):
        learning_curves([], path)
    with pytest.raises(InvalidField, match=r"reward\[3\]: got nan"):
        learning_curves([curve(reward=[0.0, 0.0, 0.0, np.nan])], path)
    with pytest.raises(InvalidField, match="reward: got 2 values; allowed: 200 values"):
        learning_curves([curve(reward=[0.0, 1.0])], path)
    with pytest.raises(InvalidField, match="evaluated_steps: got none"):
        learning_curves([curve(median_error=[0.1])], path)
    with pytest.raises(InvalidField, match=r"ending in \.png or \.svg or \.pdf"):
        learning_curves([curve()], tmp_path / "curves.txt")
    assert list(tmp_path.iterdir()) == []
