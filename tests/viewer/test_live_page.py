"""The target of a live page: what is outside the box is refused in words, and nothing moves."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from carosac_toolkit.live.hand_target import HandTarget
from carosac_toolkit.robot.file import load_robot
from carosac_toolkit.viewer.live import LivePage
from carosac_toolkit.viewer.page import Page
from carosac_toolkit.viewer.picture import take_picture
from carosac_toolkit.viewer.scene import RobotScene

X, Z = np.eye(3)[[0, 2]]


@pytest.fixture(scope="module")
def page():
    served = Page(load_robot("scampi"), "live", port=8480)
    yield served
    served.close()


@pytest.fixture
def moved() -> list:
    """Targets that the loop was told of."""
    return []


@pytest.fixture
def live(page, moved) -> LivePage:
    robot = page.robot
    target = HandTarget(robot, robot.home_position, speed_max=1.0, acceleration_max=1.0)
    return LivePage(page, target, moved.append)


def drag(live: LivePage, position, phase: str) -> None:
    """What the browser says of the arrows."""
    live.gizmo.position = tuple(position)
    live._dragged(SimpleNamespace(phase=phase))


def test_a_place_outside_is_refused_and_the_arrows_go_back(page, live, moved):
    robot = page.robot
    near = robot.home_position + 0.2 * X
    drag(live, near, "update")
    outside = robot.workspace_max + 0.5 * Z
    drag(live, outside, "update")
    assert np.array(live.gizmo.position) == pytest.approx(outside)  # the mouse has them
    assert "workspace box" in live.note.content
    drag(live, outside, "end")
    assert np.array(live.gizmo.position) == pytest.approx(near)
    assert "workspace box" in live.note.content  # still there to be read
    assert np.array(moved) == pytest.approx(near[None])


def test_a_typed_place_outside_leaves_the_numbers_of_the_target(page, live, moved):
    live.place.value = tuple(page.robot.workspace_min - 1.0)
    live._typed(SimpleNamespace(client_id=1))
    assert np.array(live.place.value) == pytest.approx(page.robot.home_position, abs=1e-4)
    assert "target" in live.note.content
    assert not moved


def test_the_note_goes_with_the_next_good_target(page, live, moved):
    live.go(page.robot.workspace_max + 1.0)
    live.go(page.robot.home_position + 0.1 * X)
    assert live.note.content == ""
    assert len(moved) == 1


def test_a_plain_page_draws_half_the_pixels_no_floor_and_labels_only_once_wanted():
    robot = load_robot("scampi")
    served = Page(robot, "plain", port=8490, plain=True)
    try:
        rest = take_picture(robot, robot.home_position, robot.home_rotation)
        served.draw(rest)
        names = set(served.server.scene._handle_from_node_name)
        assert served.url.endswith("/?fixedDpr=0.5")
        assert not any("floor" in name or "/name_" in name or "/axis_" in name for name in names)
        served.scene.labels = True
        served.scene.settle(rest)
        labels = [x for x in served.server.scene._handle_from_node_name if "/name_" in x]
        assert len(labels) == robot.n
    finally:
        served.close()


def test_a_plain_trail_has_few_points_and_both_ends(page):
    scene = RobotScene(page.server.scene, page.robot, "/plain", plain=True)
    way = np.linspace(page.robot.home_position, page.robot.workspace_max, 500)
    scene.draw_way("platform", way)
    drawn = scene._trails["platform"].points
    assert len(drawn) < 100
    assert drawn[0, 0] == pytest.approx(way[0], rel=1e-6)
    assert drawn[-1, 1] == pytest.approx(way[-1], rel=1e-6)


def test_cables_have_a_colour_a_vertex_before_their_first_picture():
    """A page that is open keeps to the kind of colours with which lines were added."""
    fresh = Page(load_robot("scampi"), "fresh", port=8484)
    try:
        assert np.shape(fresh.scene._cables.colors) == (1, 2, 3)
    finally:
        fresh.close()
