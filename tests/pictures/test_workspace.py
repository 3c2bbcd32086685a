"""Pictures of a workspace: filled panels, limits told apart, and names beside their points."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.text import Annotation
from scipy.spatial.transform import Rotation

from carosac_toolkit.pictures.style import DOUBLE_COLUMN_INCH, SINGLE_COLUMN_INCH
from carosac_toolkit.pictures.workspace import draw_maps, draw_slices, draw_space, volume_text
from carosac_toolkit.pictures.workspace_limits import COLOR_SCALES, HATCHES
from carosac_toolkit.robot.file import load_robot
from carosac_toolkit.workspace import box_grid, box_of, compute, maps, search_grid, slice_grid
from tests.pictures.layout import cut_texts, laid_out, overlapping_texts
from tests.robots import hanging

CASES = [("carosac", "frame"), ("stadium", "workspace")]


def regions_of(name, box):
    robot = load_robot(name)
    lower, upper = box_of(robot, box)
    middle = 0.5 * (lower + upper)
    slices = [slice_grid(lower, upper, axis, middle[k], 300) for k, axis in enumerate("xyz")]
    return compute(robot, box_grid(lower, upper, 300)), [compute(robot, one) for one in slices]


@pytest.fixture(scope="module", params=CASES, ids=lambda case: case[0])
def drawn(request):
    whole, slices = regions_of(*request.param)
    found = maps(slices[0].robot, slices[0].verdicts, settings=slices[0].settings)
    figures = {"slices": draw_slices(slices), "space": draw_space(whole)}
    figures["maps"] = draw_maps(slices[0], found)
    return {name: laid_out(figure) for name, figure in figures.items()}


def test_no_text_is_covered_or_cut_off(drawn):
    for name, figure in drawn.items():
        assert overlapping_texts(figure) == [] == cut_texts(figure), name
        assert figure.get_size_inches()[0] in (SINGLE_COLUMN_INCH, DOUBLE_COLUMN_INCH)


def test_slices_fill_their_panels_and_panels_their_rows(drawn):
    figure = drawn["slices"]
    panels = [axes for axes in figure.axes if axes.get_xlabel()]
    for axes in panels:
        x, y = np.ptp(axes.collections[0].get_coordinates().reshape(-1, 2), axis=0)
        assert x * y > 0.8 * np.ptp(axes.get_xlim()) * np.ptp(axes.get_ylim())
    sizes = np.array([axes.get_window_extent().size for axes in panels])
    spread = np.ptp(sizes, axis=0) / sizes.max(axis=0)
    assert spread.min() < 0.03  # side by side all are as high, below each other all as wide


def test_slices_without_a_limit_show_margins_alone():
    _, slices = regions_of("stadium", "workspace")
    assert all(region.verdicts.inside.all() for region in slices)
    figure = draw_slices(slices)
    panels = [axes for axes in figure.axes if axes.get_xlabel()]
    bar = figure.axes[-1]
    assert len(panels) == len(slices)
    assert bar.get_ylim()[0] == 0.0  # no colour of a margin that nothing has
    assert "no limit excludes any position" in figure.get_suptitle().replace("\n", " ")
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["box of the robot file"]


def test_a_quantity_that_is_the_same_everywhere_is_written_and_not_drawn():
    _, slices = regions_of("cogiro", "workspace")  # its orientation is held
    region = slices[2]
    found = maps(region.robot, region.verdicts, settings=region.settings)
    distance = np.full_like(region.verdicts.distance, 0.25)
    verdicts = replace(region.verdicts, distance=distance)
    figure = draw_maps(replace(region, verdicts=verdicts), found)
    titles = {axes.get_title() for axes in figure.axes} - {""}
    assert titles == {
        "margin [N]", "least stiffness [N/m]", "lowest frequency [Hz]", "largest sag [mm]",
    }  # fmt: skip
    assert "tilt 0 deg, least cable distance 0.25 m" in figure.get_suptitle()


def test_names_of_exit_points_are_beside_their_marks(drawn):
    figure = drawn["space"]
    axes, renderer = figure.axes[0], figure.canvas.get_renderer()
    upright, *names = [text for text in axes.texts if isinstance(text, Annotation)]
    assert upright.get_text() == "z [m]" and len(names) == 4
    marks = axes.transData.transform([name.xy for name in names])
    for name in names:
        box = super(Annotation, name).get_window_extent(renderer)
        assert not ((marks > box.min) & (marks < box.max)).all(axis=1).any()


def test_kinds_of_limits_differ_without_colour():
    assert len(set(HATCHES.values())) == len(HATCHES)
    assert len(set(COLOR_SCALES) - set(HATCHES)) <= 1  # one of them is plain


@pytest.mark.parametrize(
    ("volume", "text"),
    [(8640.0, "8640 m³"), (338.2, "338 m³"), (51.23, "51.2 m³"), (0.01234, "0.0123 m³"),
     (0.0, "0 m³")],
)  # fmt: skip
def test_volumes_have_no_exponent(volume, text):
    assert volume_text(volume) == text


def test_a_plane_of_rest_is_drawn_with_its_box_and_exit_points():
    robot = hanging(2)
    turn = Rotation.from_rotvec([0.0, 0.0, 0.2]).as_matrix()
    robot = replace(robot, exit_points=robot.exit_points @ turn.T)
    region = compute(robot, search_grid(robot, *box_of(robot, "frame"), 300))
    figure = laid_out(draw_slices([region]))
    assert overlapping_texts(figure) == [] == cut_texts(figure)
    panel = figure.axes[0]
    box, exits = panel.lines[0], panel.lines[1]
    wide = robot.workspace_max[0] / np.cos(0.2)  # along the plane, to the faces of the box
    assert np.abs(box.get_xdata()).max() == pytest.approx(wide)
    apart = np.linalg.norm(np.diff(robot.exit_points[:, :2], axis=0))
    assert np.ptp(exits.get_xdata()) == pytest.approx(apart)
