"""In a real browser: the mouse drags the target, the platform follows, and a file opens alone."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pytest

from carosac_toolkit.robot.file import load_robot
from carosac_toolkit.viewer.colors import tension_colors
from carosac_toolkit.viewer.export import still_html
from carosac_toolkit.viewer.geometry import extent
from carosac_toolkit.viewer.gizmo import GIZMO_SIZE
from carosac_toolkit.viewer.page import Page
from carosac_toolkit.viewer.statics_page import StaticsPage
from tests.viewer.browser import (
    browser,
    canvas_of,
    drag,
    missing,
    open_page,
    picture_of,
    pixel_of,
    text_of,
    wait_for,
)

pytestmark = pytest.mark.skipif(missing() is not None, reason=f"no browser: {missing()}")
UP = 1.2  # [m]
NEAR = 60.0  # of 255 in any channel: a pixel of that colour, smoothed edges included


@pytest.fixture(scope="module")
def artifacts(tmp_path_factory) -> Path:
    """Where screenshots are kept."""
    folder = os.environ.get("CAROSAC_ARTIFACTS")
    return Path(folder) if folder else tmp_path_factory.mktemp("viewer")


@pytest.fixture(scope="module")
def window():
    with browser(860, 600, noting=True) as driver:
        yield driver


@pytest.fixture(scope="module")
def statics():
    page = Page(load_robot("scampi"), "scampi", port=8460)
    connected = StaticsPage(page)
    yield connected
    connected.close()
    page.close()


def seen(shot: np.ndarray, pixels: np.ndarray, colors: np.ndarray) -> list[bool]:
    """Whether each place of a screenshot shows a colour, within 3 pixels."""
    found = []
    for (x, y), color in zip(pixels.round().astype(int), colors, strict=True):
        patch = shot[max(0, y - 3) : y + 4, max(0, x - 3) : x + 4]
        found.append(bool((np.abs(patch - color).max(axis=-1) < NEAR).any()))
    return found


def test_the_mouse_drags_the_target_and_platform_and_cables_follow(window, statics, artifacts):
    page = statics.page
    client = open_page(window, page)
    before = wait_for(lambda: page.picture, "a first picture")
    first = picture_of(window, artifacts / "before_drag.png")
    arrow = 0.7 * GIZMO_SIZE * np.ptp(extent(page.robot), axis=0).max()
    grip = before.position + np.array([0.0, 0.0, arrow])
    drag(window, pixel_of(client, grip), pixel_of(client, grip + np.array([0.0, 0.0, UP])))
    wait_for(lambda: statics.answers and page.picture.position[2] > before.position[2] + 0.5 * UP,
             "the platform follows")  # fmt: skip
    height = wait_for(lambda: _settled_height(statics), "the platform rests")
    after = page.picture
    # The robot on the server went where the arrows are, and nowhere else.
    assert after.position == pytest.approx(np.array(statics.gizmo.position), abs=1e-9)
    assert after.position[:2] == pytest.approx(before.position[:2], abs=1e-6)
    assert height - before.position[2] == pytest.approx(UP, abs=0.25)  # some pixels of the mouse
    assert not after.held
    # The words in the page say so.
    text = f"{after.position[2]:.3f} m"
    wait_for(lambda: text in text_of(window, "carosac-status"), f"'{text}'")
    # The picture shows the cables where they are now, in their colour, and no more where they were.
    last = picture_of(window, artifacts / "after_drag.png")
    size = canvas_of(window).size
    ends = [(before, first), (after, last)]
    for k, (picture, shot) in enumerate(ends):
        places = np.array([pixel_of(client, point) for point in picture.points[:, 15]])
        inside = (places > 5).all(axis=1) & (places[:, 0] < size["width"] - 5)
        assert inside.sum() >= 2
        color = tension_colors(page.robot, picture.tension).astype(float)
        assert all(seen(shot, places[inside], color[inside]))
        assert not any(seen(ends[1 - k][1], places[inside], color[inside]))


def _settled_height(statics: StaticsPage) -> float | None:
    """Height of the platform once it is that of the arrows [m]."""
    picture = statics.page.picture
    away = np.abs(picture.position - np.array(statics.gizmo.position)).max()
    return float(picture.position[2]) if away < 1e-9 else None


def test_a_file_opens_without_server_or_network(window, statics, tmp_path, artifacts):
    file = tmp_path / "robot.html"
    file.write_text(still_html(statics.page, "scampi", "at rest"), encoding="utf-8")
    window.get_log("performance")
    window.get(file.as_uri())
    wait_for(lambda: window.find_elements("tag name", "canvas"), "a canvas")
    wait_for(lambda: _colours(picture_of(window, artifacts / "file.png")) > 0, "coloured cables")
    assert "at rest" in text_of(window, "carosac-panel")
    schemes = {url.partition(":")[0] for url in _requests(window)}
    assert schemes <= {"file", "data", "blob"}


def _colours(shot: np.ndarray) -> int:
    """Pixels right of the panel that are neither grey nor white."""
    return int((np.ptp(shot[:, 330:], axis=-1) > 40).sum())


def _requests(window) -> list[str]:
    """What the page asked for."""
    entries = [json.loads(entry["message"])["message"] for entry in window.get_log("performance")]
    return [
        entry["params"]["request"]["url"]
        for entry in entries
        if entry["method"] == "Network.requestWillBeSent"
    ]
