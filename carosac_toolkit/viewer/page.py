"""Web page shared by all views: scene, legend, status, plots, display settings."""

from __future__ import annotations

import contextlib
import html
import io
import socket
import threading
import time
from typing import Any

from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.base.extras import require
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.viewer.admission import Admission
from carosac_toolkit.viewer.colors import legend_html
from carosac_toolkit.viewer.geometry import camera
from carosac_toolkit.viewer.picture import Picture
from carosac_toolkit.viewer.plots import Plots
from carosac_toolkit.viewer.publisher import PUBLISH_RATE_MAX_HZ, Publisher
from carosac_toolkit.viewer.scene import RobotScene

LOOPBACK_ADDRESS = "127.0.0.1"
DEFAULT_PORT = 8080
STATUS_INTERVAL_S = 0.15  # [s] between two status lines, unless the news is bad or good again
PLAIN_STATUS_INTERVAL_S = 0.45  # [s]
SAG_FACTOR_MAX = 50.0
PLAIN_PIXEL_RATIO = 0.5  # drawn per pixel of the screen along each axis, on a plain page


class Page:
    """Server of one page. Close it.

    Attributes:
        robot: Robot to show.
        rate: Pictures a second, at most.
        plain: True if it is cheap to draw.
        server: `viser.ViserServer`.
        scene: Scene of the robot.
        plots: Beside it.
        publisher: Draws the pictures that `offer` gets.
        picture: The last one that was drawn, or None.
    """

    def __init__(
        self, robot: Robot, title: str, *, host: str = LOOPBACK_ADDRESS, port: int = DEFAULT_PORT,
        rate: float = PUBLISH_RATE_MAX_HZ, followed: str = "target", plain: bool = False,
        moves: bool = True,
    ) -> None:  # fmt: skip
        """Start the server.

        Args:
            robot: Robot to show.
            title: Title of the page.
            host: Address to listen at.
            port: To listen at; the next free one where it is taken.
            rate: Pictures a second, at most.
            followed: Word for the target of a picture.
            plain: True for a page that is cheap to draw, for a browser without a GPU.
            moves: False for pictures of a platform at rest: no controls and no plots over time.
        """
        self.robot, self.rate, self._followed, self.plain = robot, rate, followed, plain
        self._admission = Admission(host)
        self.server = start_server(host, port, title, self._admission)
        self.picture: Picture | None = None
        self._drawing = threading.Lock()
        server: Any = self.server
        place, middle = camera(robot)
        server.scene.set_up_direction("+z")
        server.initial_camera.position = place
        server.initial_camera.look_at = middle
        server.initial_camera.fov = 0.75
        self.scene = RobotScene(server.scene, robot, plain=plain)
        self._status = server.gui.add_html("", order=0)
        server.gui.add_html(legend_html(robot), order=1)
        self.controls = server.gui.add_folder("Move", order=2)
        self.plots = Plots(server.gui, robot, followed, plain=plain)
        if not moves:
            self.controls.visible = False
            self.plots.hide()
        self._add_display()
        self._said = ("", False)
        self._said_at = 0.0
        self.publisher: Publisher[Picture] = Publisher(self.draw, rate=rate, settle=self.settle)

    @property
    def url(self) -> str:
        """Address of the page, with its secret."""
        address = f"http://{self._admission.name}:{self.server.get_port()}{self._admission.path}"
        return f"{address}?fixedDpr={PLAIN_PIXEL_RATIO:g}" if self.plain else address

    def offer(self, picture: Picture) -> None:
        """Show a picture soon, unless a newer one comes first; never waits."""
        self.publisher.offer(picture)

    def redraw(self) -> None:
        """Show the last picture again, with other settings of the display."""
        if self.picture is not None:
            self.offer(self.picture)

    def say(self, text: str, *, problem: bool = False) -> None:
        """Show a status line."""
        if (text, problem) == self._said:
            return
        every = PLAIN_STATUS_INTERVAL_S if self.plain else STATUS_INTERVAL_S
        fresh = time.monotonic() - self._said_at < every
        if fresh and problem == self._said[1]:
            return
        self._said, self._said_at = (text, problem), time.monotonic()
        self._status.content = note_html(text, "status", problem=problem)

    def close(self) -> None:
        """Stop drawing and serving."""
        self.publisher.close()
        with contextlib.redirect_stdout(io.StringIO()):
            self.server.stop()

    def draw(self, picture: Picture) -> None:
        """Bring a picture to the page now; else `offer` is better."""
        with self._drawing, self.server.atomic():
            self.scene.show(picture)
            if not self.plots.whole:
                self.plots.add(picture)
            self.say(self._words(picture), problem=picture.problem)
        self.picture = picture

    def settle(self) -> None:
        """Draw what is not drawn with every picture: trails, labels and plots."""
        if self.picture is None:
            return
        with self._drawing, self.server.atomic():
            self.scene.settle(self.picture)
            self.plots.settle()
            self._said_at = 0.0
            self.say(self._words(self.picture), problem=self.picture.problem)

    def _words(self, picture: Picture) -> str:
        """Return position, distance and sag, shown below the picture's own status."""
        x, y, z = picture.position
        line = f"platform at {x:.3f}, {y:.3f}, {z:.3f} m"
        if picture.target is not None:
            line += f"; {1e3 * picture.error:.0f} mm from the {self._followed}"
        sag = f"largest sag {1e3 * picture.sag.max():.1f} mm"
        if self.scene.enlarged != 1.0:
            sag += f", drawn {self.scene.enlarged:g} times larger"
        if picture.straight.any():
            sag += f"; {picture.straight.sum()} cables of unknown shape drawn straight"
        return "\n".join(filter(None, [picture.status, line, sag]))

    def _add_display(self) -> None:
        """Add the display settings."""
        gui: Any = self.server.gui
        with gui.add_folder("Display", order=90):
            enlarged = gui.add_slider(
                "sag drawn times", min=1.0, max=SAG_FACTOR_MAX, step=1.0,
                initial_value=self.scene.enlarged,
                hint="The distance of each cable from its chord is drawn so many times larger.",
            )  # fmt: skip
            trails = gui.add_checkbox("trails", initial_value=True)
            labels = gui.add_checkbox("tensions at the exits", initial_value=not self.plain)
            forget = gui.add_button("Clear trails")
        self.enlarged = enlarged

        enlarged.on_update(lambda _: self._enlarge(float(enlarged.value)))
        for box in (trails, labels):
            box.on_update(lambda _: self._choose(trails.value, labels.value))
        forget.on_click(lambda _: self._forget())

    def _enlarge(self, factor: float) -> None:
        """Set the enlargement of the sag."""
        self.scene.enlarged = factor
        self.redraw()

    def _choose(self, trails: bool, labels: bool) -> None:
        """Show or hide trails and labels."""
        self.scene.trails, self.scene.labels = trails, labels
        self.scene.refresh()
        self.redraw()

    def _forget(self) -> None:
        """Clear the trails."""
        self.scene.forget()
        self.redraw()


def note_html(text: str, name: str = "note", *, problem: bool = True) -> str:
    """Return text on a coloured ground, with the id ``carosac-NAME``; empty for no text."""
    if not text:
        return ""
    color, ground = ("#8f1020", "#fde8ea") if problem else ("#1d4d2b", "#e9f5ec")
    lines = "<br>".join(html.escape(text).split("\n"))
    return (
        f'<div id="carosac-{name}" style="margin:0.3em 0.8em;padding:0.4em 0.6em;'
        f'border-radius:4px;font-size:0.85em;color:{color};background:{ground}">{lines}</div>'
    )


def start_server(host: str, port: int, title: str, admission: Admission) -> Any:
    """Start viser, for requests that are admitted.

    Raises:
        InvalidField: A port that is none, or an address that cannot be listened at.
        MissingExtra: viser is not installed.
    """
    if not 1 <= port <= 65535:
        raise InvalidField("--port", str(port), "1 to 65535")
    require("the viewer", "viser")
    import viser

    try:
        with socket.create_server((host, 0)):
            pass
    except OSError as error:
        allowed = f"an address of this machine ({error.strerror or error})"
        raise InvalidField("--host", repr(host), allowed) from error
    with (
        admission.installed(),
        contextlib.redirect_stdout(io.StringIO()),
    ):  # its banner; commands say where the page is
        server = viser.ViserServer(host=host, port=port, label=title, verbose=False)
    server.gui.configure_theme(show_logo=False, show_share_button=False)
    server.gui.main_panel.dock_right()
    server.scene.configure_environment_map(None)  # these cost most where WebGL is software
    server.scene.configure_default_lights(enabled=True, cast_shadow=False)
    server.scene.add_light_ambient("/light", intensity=1.2)
    return server
