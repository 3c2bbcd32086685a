"""The screenshots of ``docs/viewer.md``, made in headless Chromium.

``python -m tests.viewer.make_pictures [FOLDER]``; by default docs/images.
"""

from __future__ import annotations

import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

import carosac_toolkit as ct
from carosac_toolkit.live.hand_target import HandTarget
from carosac_toolkit.loop import plugins
from carosac_toolkit.viewer.geometry import extent
from carosac_toolkit.viewer.gizmo import GIZMO_SIZE
from carosac_toolkit.viewer.live import LivePage, drawing, follow
from carosac_toolkit.viewer.page import Page
from carosac_toolkit.viewer.replay import Replay
from carosac_toolkit.viewer.runs import RecordedRun, load_runs
from carosac_toolkit.viewer.statics_page import LENGTHS_MODE, StaticsPage
from tests.viewer.browser import browser, drag, open_page, picture_of, pixel_of, wait_for

IMAGES = Path(__file__).resolve().parents[2] / "docs" / "images"
WIDTH, HEIGHT = 1180, 700
PORT = 8560


@contextmanager
def page_of(name: str, title: str, sag: float = 1.0, **more: str) -> Iterator[Page]:
    page = Page(ct.load_robot(name), title, port=PORT, **more)
    page.enlarged.value = sag
    try:
        yield page
    finally:
        page.close()


def shoot(window: Any, folder: Path, name: str) -> None:
    time.sleep(3.0)
    picture_of(window, folder / f"viewer_{name}.png")
    print(f"viewer_{name}.png", flush=True)


def drag_target(window: Any, client: Any, page: Page, way: np.ndarray) -> None:
    """Drag the vertical arrow of a page by so much [m]."""
    position = page.picture.position
    arrow = 0.7 * GIZMO_SIZE * np.ptp(extent(page.robot), axis=0).max()
    grip = position + np.array([0.0, 0.0, arrow])
    drag(window, pixel_of(client, grip), pixel_of(client, grip + way))


def statics(window: Any, folder: Path) -> None:
    with page_of("scampi", "scampi at rest", 10.0) as page:
        connected = StaticsPage(page)
        client = open_page(window, page)
        wait_for(lambda: page.picture, "a picture")
        drag_target(window, client, page, np.array([0.0, 0.0, 1.6]))
        shoot(window, folder, "statics")
        drag_target(window, client, page, np.array([0.0, 0.0, 5.4]))
        shoot(window, folder, "infeasible")
        connected.close()


def lengths(window: Any, folder: Path) -> None:
    with page_of("cogiro", "cogiro at rest") as page:
        connected = StaticsPage(page)
        open_page(window, page)
        connected.mode.value = LENGTHS_MODE
        longer = connected.resting.rest.unstrained_length[0].copy()
        longer[[0, 3]] += 0.25
        for slider, value in zip(connected.lengths, longer, strict=True):
            slider.value = float(round(value, 3))
        page.offer(connected.resting.follow_lengths(longer))
        shoot(window, folder, "lengths")
        connected.close()


def live(window: Any, folder: Path) -> None:
    robot = ct.load_robot("scampi")
    driver_class = plugins.load("drivers", "simulator")
    controller_class = plugins.load("controllers", "kinematic_solver")
    controller = controller_class.build(robot, controller_class.Settings(period=0.02))
    estimator = plugins.load("estimators", "kinematic_solver").build(robot)
    driver = driver_class.build(
        robot, driver_class.Settings(period=0.02, real_time=True, cables="catenary")
    )
    target = HandTarget(robot, robot.home_position, speed_max=1.2, acceleration_max=1.5)
    title = "scampi: kinematic_solver with kinematic_solver"
    with page_of("scampi", title, 10.0, followed="reference") as page:
        connected = LivePage(page, target)
        loop = threading.Thread(
            target=follow, args=(drawing(page), driver, estimator, controller, target),
            kwargs={"duration": 60.0},
        )  # fmt: skip
        loop.start()
        open_page(window, page)
        time.sleep(1.0)
        for x, y, z in ((1.2, -4.0, 3.0), (1.2, 0.4, 4.5), (-0.4, 0.4, 2.0), (1.2, -3.5, 3.0)):
            connected.go(np.array([x, y, z]))
            time.sleep(3.2)
        shoot(window, folder, "live")
        driver.stop("enough")
        loop.join()


def replay(window: Any, folder: Path) -> None:
    with tempfile.TemporaryDirectory() as results:
        ct.Study(
            robots=("carosac",), controllers=("kinematic_solver", "input_shaping"),
            estimators=("kinematic_solver",), trajectories=("line",), seeds=1,
            speed_max=2.0, acceleration_max=4.0, output=results,
        ).run(progress=False)  # fmt: skip
        runs = load_runs(results)
    with page_of("carosac", runs[0].name, 10.0) as page:
        k = int(np.argmax(apart(*runs)))
        moment, near = float(runs[0].time[k]), runs[0].position[k]
        page.server.initial_camera.look_at = near
        page.server.initial_camera.position = near + np.array([2.6, -1.6, 0.7])
        played = Replay(page, runs, 1)
        played.toggle()
        thread = threading.Thread(target=played.play)
        thread.start()
        open_page(window, page)
        played.seek(moment)
        wait_for(lambda: abs(page.picture.time - moment) < 0.05, "the moment")
        shoot(window, folder, "replay")
        played.over = True
        thread.join()


def apart(one: RecordedRun, other: RecordedRun) -> np.ndarray:
    """Distance of the platforms of two runs at the times of the first [m]."""
    there = [np.interp(one.time, other.time, other.position[:, k]) for k in range(3)]
    return np.linalg.norm(one.position - np.stack(there, axis=1), axis=1)


def main() -> None:
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else IMAGES
    wanted = sys.argv[2:] or ["statics", "lengths", "live", "replay"]
    for make in (statics, lengths, live, replay):
        if make.__name__ in wanted:
            with browser(WIDTH, HEIGHT) as window:
                make(window, folder)


if __name__ == "__main__":
    main()
