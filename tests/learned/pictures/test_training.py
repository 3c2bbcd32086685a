import numpy as np
import pytest
from matplotlib.colors import to_hex
from matplotlib.image import imread

from carosac_toolkit.errors import InvalidField
from carosac_toolkit.pictures.drawing import COLORS
from learned.pictures.training import learning_curves, reward_terms, smoothed


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
    noise = np.random.default_rng(0).standard_normal(5000)
    assert smoothed(np.full(100, 3.0)) == pytest.approx(np.full(100, 3.0))
    straight = np.linspace(0.0, 1.0, 1000)
    assert smoothed(straight, 0.1)[50:-50] == pytest.approx(straight[50:-50])  # no delay
    half = int(0.04 * len(noise) / 2)
    inside = smoothed(noise, 0.04)[half:-half]
    assert inside.std() == pytest.approx(1.0 / np.sqrt(2 * half + 1), rel=0.3)
    at = 2500
    window = noise[at - half : at + half + 1]
    assert smoothed(noise, 0.04)[at] == pytest.approx(window.mean())
    assert smoothed(noise[:3]) == pytest.approx(noise[:3])  # too few to smooth


def test_curves_show_raw_and_smoothed_rewards_in_the_colour_of_their_seed(tmp_path):
    curves = [evaluated(0), evaluated(1), curve(2)]
    reward, error = learning_curves(curves, tmp_path / "curves.png").axes
    assert len(reward.lines) == 6 and len(error.lines) == 2
    for k, (raw, smooth) in enumerate(zip(reward.lines[::2], reward.lines[1::2], strict=True)):
        assert to_hex(raw.get_color()) == to_hex(smooth.get_color()) == COLORS[k]
        np.testing.assert_array_equal(raw.get_ydata(), curves[k]["reward"])
        assert raw.get_alpha() < 0.5
        late = slice(-100, None)
        assert smooth.get_ydata()[late].std() < 0.5 * raw.get_ydata()[late].std()
    assert [to_hex(line.get_color()) for line in error.lines] == list(COLORS[:2])
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
