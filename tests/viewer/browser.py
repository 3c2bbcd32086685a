"""Headless Chromium for tests and pictures of the viewer, and where things are in its window."""

from __future__ import annotations

import shutil
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from carosac_toolkit.base.rotations import to_matrix

PROGRAMS = ("chromium", "chromium-browser", "google-chrome")
DRIVERS = ("chromedriver",)
FLAGS = (
    "--headless=new", "--no-sandbox", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
    "--disable-dev-shm-usage", "--hide-scrollbars",
    "--enable-unsafe-swiftshader",  # WebGL without a GPU
)  # fmt: skip
PATIENCE = 60.0  # [s]


def missing() -> str | None:
    """Why there is no browser here, or None where there is one."""
    try:
        import selenium  # noqa: F401
    except ImportError:
        return "selenium is not installed"
    if not any(map(shutil.which, PROGRAMS)):
        return f"none of {', '.join(PROGRAMS)} is installed"
    if not any(map(shutil.which, DRIVERS)):
        return f"{DRIVERS[0]} is not installed"
    return None


@contextmanager
def browser(width: int, height: int, *, noting: bool = False) -> Iterator[Any]:
    """A window of this size [pixels]; a Selenium driver.

    Args:
        width: [pixels].
        height: [pixels].
        noting: Whether all that goes over the network is noted, which takes time.
    """
    from selenium import webdriver

    options = webdriver.ChromeOptions()
    options.binary_location = next(filter(None, map(shutil.which, PROGRAMS)))
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        for flag in (*FLAGS, f"--user-data-dir={profile}"):
            options.add_argument(flag)
        service = webdriver.ChromeService(shutil.which(DRIVERS[0]))
        if noting:
            options.set_capability("goog:loggingPrefs", {"performance": "ALL"})
        driver = webdriver.Chrome(options=options, service=service)
        try:
            driver.execute_cdp_cmd(
                "Emulation.setDeviceMetricsOverride",
                {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False},
            )
            yield driver
        finally:
            driver.quit()


def wait_for(condition: Callable[[], Any], what: str, patience: float = PATIENCE) -> Any:
    """Poll until something is true, and return it."""
    end = time.monotonic() + patience
    while time.monotonic() < end:
        found = condition()
        if found:
            return found
        time.sleep(0.05)
    raise AssertionError(f"after {patience:g} s still not: {what}")


def open_page(driver: Any, page: Any) -> Any:
    """Open a page of the viewer; its `viser` client, once it has told its camera."""
    driver.get(page.url)

    def client() -> Any:
        for found in page.server.get_clients().values():
            if found.camera.image_height:  # raises until the first message of the camera
                return found
        return None

    def ready() -> Any:
        try:
            return client()
        except (AssertionError, AttributeError):
            return None

    found = wait_for(ready, "a client with a camera")
    wait_for(lambda: driver.find_elements("id", "carosac-status"), "the status line")
    hide_notices(driver)
    return found


def hide_notices(driver: Any) -> None:
    """Take away the note that WebGL runs in software: it covers the scene."""
    driver.execute_script(
        "const s=document.createElement('style');"
        "s.textContent='.mantine-Notifications-root{display:none!important}';"
        "document.head.appendChild(s)"
    )


def pixel_of(client: Any, point: np.ndarray) -> np.ndarray:
    """Where a point in W [m] is in the canvas, from its upper left corner [pixels]."""
    camera = client.camera
    turn = to_matrix(np.asarray(camera.wxyz, dtype=float)[None])[0]
    x, y, depth = turn.T @ (np.asarray(point) - camera.position)  # x right, y down, z ahead
    focal = 0.5 * camera.image_height / np.tan(0.5 * camera.fov)
    middle = 0.5 * np.array([camera.image_width, camera.image_height])
    return middle + focal * np.array([x, y]) / depth


def text_of(driver: Any, name: str) -> str:
    """What an element of the page says now; the page makes elements anew while it is read."""
    script = "return (document.getElementById(arguments[0]) || {innerText: ''}).innerText"
    return str(driver.execute_script(script, name))


def canvas_of(driver: Any) -> Any:
    """The canvas of the scene: the largest one, plots have their own."""
    canvases = driver.find_elements("tag name", "canvas")
    return max(canvases, key=lambda each: each.size["width"] * each.size["height"])


def drag(driver: Any, start: np.ndarray, end: np.ndarray, steps: int = 6) -> None:
    """Drag with the mouse between two places of the canvas [pixels]; real events."""
    from selenium.webdriver.common.action_chains import ActionChains

    box = canvas_of(driver).rect
    corner = np.array([box["x"], box["y"]])
    way = [corner + start + (end - start) * k / steps for k in range(steps + 1)]
    actions = ActionChains(driver, duration=80)
    first, *rest = [(round(x), round(y)) for x, y in way]
    mouse = actions.w3c_actions.pointer_action
    mouse.move_to_location(*first)
    actions.pause(0.4)
    mouse.pointer_down()
    for x, y in rest:
        mouse.move_to_location(x, y)
        actions.pause(0.05)
    mouse.pointer_up()
    actions.perform()


def picture_of(driver: Any, path: Path | None = None) -> np.ndarray:
    """A screenshot as an array (height, width, 3) of 0 to 255; kept in a PNG file."""
    import io

    from matplotlib.image import imread

    data = driver.get_screenshot_as_png()
    if path is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
    return np.asarray(255.0 * imread(io.BytesIO(data), format="png")[..., :3])
