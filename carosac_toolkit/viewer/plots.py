"""Plots beside the scene: tension of each cable, and distance from the target, over time."""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np

from carosac_toolkit.base.arrays import Array, evenly
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.viewer.colors import CABLE_COLORS, hex_of
from carosac_toolkit.viewer.picture import Picture

PLOT_WINDOW_S = 20.0  # [s] that live plots show
SAMPLE_INTERVAL_MIN_S = 0.08  # [s] between two samples of a live plot
PLOT_SAMPLES_MAX = 400  # samples of a plot
REFRESH_INTERVAL_S = 0.2  # [s] between two drawings
PLAIN_REFRESH_INTERVAL_S = 0.6  # [s]
PLOT_HEIGHT_PX = 170  # [pixels]
PANEL_ORDER = 30  # in the panel
AXIS_SCALES = {"x": {"time": False}, "y": {"range": (0.0, None)}}  # from zero to what is highest
ERROR_COLOR = "#c8553d"
CURSOR_COLOR = "#111111"


class Plots:
    """Two charts of a page. Call from one thread at a time.

    Attributes:
        whole: True if they show a whole run with a dot for now, and not the last seconds.
    """

    def __init__(self, gui: Any, robot: Robot, followed: str, *, plain: bool = False) -> None:
        """Add them to `viser.GuiApi`.

        Args:
            gui: `viser.GuiApi`.
            robot: The robot.
            followed: Word for the target of the platform.
            plain: True if they are drawn less often.
        """
        self._robot = robot
        self._refresh = PLAIN_REFRESH_INTERVAL_S if plain else REFRESH_INTERVAL_S
        self.whole = False
        self._samples: deque[tuple[float, Array, float]] = deque(
            maxlen=round(PLOT_WINDOW_S / SAMPLE_INTERVAL_MIN_S)
        )
        self._drawn = -np.inf
        start = np.array([0.0, 1.0])
        empty = np.zeros(2)
        lines = [
            {"label": name, "stroke": hex_of(CABLE_COLORS[i % len(CABLE_COLORS)]), "width": 1.5}
            for i, name in enumerate(robot.cable_names)
        ]
        self._tension = self._chart(
            gui, (start, *[empty] * (robot.n + 1)), lines, "tension [N]", "tension at the platform"
        )
        error = [{"label": "error", "stroke": ERROR_COLOR, "width": 1.8}]
        self._error = self._chart(
            gui, (start, empty, empty), error, "distance [mm]", f"platform to {followed}"
        )

    def hide(self) -> None:
        """Show none of them."""
        self._tension.visible = self._error.visible = False

    def _chart(
        self, gui: Any, data: tuple[Array, ...], lines: list[dict[str, Any]], label: str, title: str
    ) -> Any:
        """Add one chart; its last series is the dot for now."""
        dot = {
            "label": "now", "stroke": CURSOR_COLOR, "width": 0, "auto": False,
            "points": {"show": True, "size": 7, "fill": CURSOR_COLOR},
        }  # fmt: skip
        small = "11px sans-serif"
        axes = [
            {"label": name, "labelSize": 18, "font": small, "labelFont": small, "size": size}
            for name, size in (("time [s]", 26), (label, 44))
        ]
        return gui.add_uplot(
            data=data, series=({}, *lines, dot), title=title, height=PLOT_HEIGHT_PX,
            order=PANEL_ORDER, scales=AXIS_SCALES, axes=tuple(axes), legend={"show": False},
            cursor={"show": False}, padding=(9, 14, 0, 0),
        )  # fmt: skip

    def add(self, picture: Picture) -> None:
        """Add a picture; live plots are drawn now and then."""
        time = picture.time
        if self._samples and time < self._samples[-1][0]:
            self._samples.clear()
        if not self._samples or time - self._samples[-1][0] >= SAMPLE_INTERVAL_MIN_S:
            self._samples.append((time, picture.tension, 1e3 * picture.error))
        if abs(time - self._drawn) >= self._refresh:
            self._drawn = time
            self.settle()

    def settle(self) -> None:
        """Draw live plots up to the last sample."""
        if self.whole or len(self._samples) < 2:
            return
        times, tensions, errors = (np.array(x) for x in zip(*self._samples, strict=True))
        self._draw(times, tensions, errors, None)

    def show_run(self, time: Array, tension: Array, error: Array, now: float) -> None:
        """Show a whole run with a dot at the present.

        Args:
            time: [s], shape (T,).
            tension: [N], shape (T, n).
            error: [m], shape (T,).
            now: [s].
        """
        keep = evenly(len(time), PLOT_SAMPLES_MAX)
        here = int(np.argmin(np.abs(time[keep] - now)))
        self._draw(time[keep], tension[keep], 1e3 * error[keep], here)

    def _draw(self, time: Array, tension: Array, error: Array, here: int | None) -> None:
        """Fill both charts."""
        dots = np.full((2, len(time)), np.nan)
        if here is not None:
            highest = tension[here][np.isfinite(tension[here])]
            dots[0, here] = highest.max() if len(highest) else np.nan
            dots[1, here] = error[here]
        self._tension.data = (time, *np.ascontiguousarray(tension.T), dots[0])
        self._error.data = (time, error, dots[1])
