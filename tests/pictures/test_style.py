"""Colours, marks and sizes that all pictures share."""

from importlib.metadata import entry_points
from itertools import combinations

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.colors import to_rgb

from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.pictures.drawing import new_figure
from carosac_toolkit.pictures.style import (
    CONTROLLER_NUMBERS,
    MEASURED_COLOR,
    MODEL_NUMBERS,
    SERIES_COLORS,
    SERIES_HATCHES,
    SERIES_LINES,
    SERIES_MARKERS,
    looks_by_name,
    series,
    styled,
    using_style,
)

# Linear RGB as persons without one kind of cones see it: Machado, Oliveira and Fernandes, "A
# Physiologically-based Model for Simulation of Color Vision Deficiency", 2009, severity 1.0.
VISION = {
    "normal": np.eye(3),
    "protanopia": np.array([[0.152286, 1.052583, -0.204868],
                            [0.114503, 0.786281, 0.099216],
                            [-0.003882, -0.048116, 1.051998]]),
    "deuteranopia": np.array([[0.367322, 0.860646, -0.227968],
                              [0.280085, 0.672501, 0.047413],
                              [-0.011820, 0.042940, 0.968881]]),
}  # fmt: skip
TO_XYZ = np.array([[0.4124564, 0.3575761, 0.1804375],
                   [0.2126729, 0.7151522, 0.0721750],
                   [0.0193339, 0.1191920, 0.9503041]])  # fmt: skip
WHITE = np.array([0.95047, 1.0, 1.08883])  # D65
JUST_NOTICEABLE = 2.3  # difference in CIELAB of 1976


def lab(colors, vision):
    """CIELAB coordinates of colours as somebody sees them, shape (K, 3)."""
    rgb = np.array([to_rgb(color) for color in colors])
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    xyz = np.clip(linear @ VISION[vision].T, 0.0, 1.0) @ TO_XYZ.T / WHITE
    f = np.where(xyz > 216 / 24389, np.cbrt(xyz), (24389 / 27 * xyz + 16) / 116)
    return np.column_stack(
        [116 * f[:, 1] - 16, 500 * (f[:, 0] - f[:, 1]), 200 * (f[:, 1] - f[:, 2])]
    )


def closest(colors, vision):
    return min(np.linalg.norm(a - b) for a, b in combinations(lab(colors, vision), 2))


@pytest.mark.parametrize("vision", VISION)
def test_series_can_be_told_apart_by_colour_whoever_looks(vision):
    assert closest((*SERIES_COLORS, MEASURED_COLOR), vision) > 8 * JUST_NOTICEABLE


def test_the_check_of_colours_finds_what_deuteranopes_confuse():
    red_and_green = ("#d62728", "#2ca02c")
    assert closest(red_and_green, "normal") > 2 * closest(red_and_green, "deuteranopia")


def test_series_stand_out_from_white_paper():
    assert lab(SERIES_COLORS, "normal")[:, 0].max() < 75.0


def test_series_differ_without_any_colour():
    for marks in (SERIES_LINES, SERIES_MARKERS, SERIES_HATCHES):
        assert len(set(marks)) == len(SERIES_COLORS)
    assert series(len(SERIES_COLORS)) == series(0)


def test_a_name_has_the_same_look_among_all_others():
    numbers = CONTROLLER_NUMBERS
    for names in (["td3", "kinematic_solver"], ["mine", "kinematic_solver", "mpc", "td3"]):
        looks = dict(zip(names, looks_by_name(names, numbers), strict=True))
        assert all(looks[name] == series(numbers[name]) for name in names if name in numbers)


def test_unknown_and_repeated_names_take_looks_that_are_free():
    names = ["mine", "td3", "td3", "yours", *"abcd"]
    colors = [look.color for look in looks_by_name(names, CONTROLLER_NUMBERS)]
    assert len(set(colors)) == len(SERIES_COLORS)
    known = {SERIES_COLORS[k] for k in CONTROLLER_NUMBERS.values()}
    assert colors[0] not in known and colors[2] not in known
    many = looks_by_name([*names, "e"], CONTROLLER_NUMBERS)
    assert many[: len(names)] == looks_by_name(names, CONTROLLER_NUMBERS)


@pytest.mark.parametrize(
    ("group", "numbers"),
    [("carosac.controllers", CONTROLLER_NUMBERS), ("carosac.estimators", MODEL_NUMBERS)],
)
def test_every_bundled_plug_in_has_a_number_of_its_own(group, numbers):
    named = {one.name for one in entry_points(group=group) if one.dist.name == "carosac-toolkit"}
    assert named == set(numbers) and len(set(numbers.values())) == len(numbers)


def test_a_style_holds_whatever_matplotlib_is_set_to_and_changes_nothing():
    @styled
    def draw():
        figure = new_figure(3.5, 2.0)
        return figure.suptitle("title").get_fontfamily(), figure.subplots().title.get_fontsize()

    with mpl.rc_context({"font.family": "monospace", "axes.titlesize": 30.0}):
        assert draw() == (["DejaVu Sans"], 8.0)
        with using_style("paper"):
            assert draw() == (["STIXGeneral", "DejaVu Serif"], 8.0)
        assert draw() == (["DejaVu Sans"], 8.0)
        assert mpl.rcParams["font.family"] == ["monospace"]


def test_an_unknown_style_is_refused():
    with pytest.raises(InvalidField, match=r"style: got 'poster'; allowed: one of"):
        using_style("poster").__enter__()
