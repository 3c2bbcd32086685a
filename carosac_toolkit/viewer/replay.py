"""Player of a recorded run with a time line, and a second run as a ghost beside it."""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence
from typing import Any

import numpy as np

from carosac_toolkit.base.arrays import Array, evenly
from carosac_toolkit.viewer.page import Page
from carosac_toolkit.viewer.publisher import Publisher
from carosac_toolkit.viewer.runs import RecordedRun
from carosac_toolkit.viewer.scene import RobotScene

NO_SELECTION = "none"
PLAYBACK_SPEEDS = ("0.1", "0.25", "0.5", "1", "2", "5", "10")
PLAYBACK_TICK_S = 0.025  # [s]
TRAIL_POINTS_MAX = 400  # points of a trail
SLIDER_INTERVAL_S = 0.2  # [s] between two moves of the slider while it plays
PLAY, PAUSE = "Play", "Pause"


class Replay:
    """Connection of a page with runs.

    Attributes:
        run: Run that is played.
        ghost: Run that is played beside it, or None.
        now: Time of the run [s].
        playing: True while time passes.
        over: True to end `play`.
    """

    def __init__(self, page: Page, runs: Sequence[RecordedRun], ghost: int | None = None) -> None:
        """Add the controls; begin with the first run, and optionally a ghost."""
        self._page = page
        self._runs = {f"{k}: {run.name}": run for k, run in enumerate(runs)}
        names = list(self._runs)
        self.run = runs[0]
        self.ghost = None if ghost is None else runs[ghost]
        self.now, self.playing, self.over, self._speed = 0.0, True, False, 1.0
        self._clock = threading.Lock()
        self._drawn = 0
        page.plots.whole = True
        page.scene.own_trails = False
        self._ghost_scene = RobotScene(
            page.server.scene, self.run.robot, "/ghost", ghost=True, plain=page.plain
        )
        self._ghost_scene.own_trails = False
        self._ghost_scene.visible = self.ghost is not None
        self._add_controls(names, NO_SELECTION if ghost is None else names[ghost])
        self._times: Publisher[float] = Publisher(self.draw, rate=page.rate, settle=self._settle)
        self._times.offer(self.now)

    @property
    def pictures(self) -> int:
        """Number of pictures drawn while it played."""
        return self._times.drawn

    def play(self, duration: float | None = None) -> None:
        """Play until interrupted, or for a given time [s]."""
        begun = last = moved = time.monotonic()
        try:
            while not self.over and (duration is None or time.monotonic() - begun < duration):
                time.sleep(PLAYBACK_TICK_S)
                passed, last = time.monotonic() - last, time.monotonic()
                if self.playing:
                    self._advance(passed)
                    if last - moved > SLIDER_INTERVAL_S:
                        moved = last
                        self._slider.value = round(min(self.now, self._slider.max), 2)
        except KeyboardInterrupt:
            pass
        finally:
            self._times.close()

    def draw(self, now: float) -> None:
        """Draw both runs at a time [s], occasionally with trails and plots."""
        with self._page.server.atomic():
            self.draw_pictures(now)
            if self._drawn % 6 == 0:
                self._draw_slowly(self.run.index(now), now)
        self._drawn += 1

    def draw_pictures(self, now: float) -> None:
        """Draw both robots at a time [s]."""
        self._page.draw(self.run.picture(self.run.index(now)))
        self._ghost_scene.visible = self.ghost is not None
        if self.ghost is not None:
            self._ghost_scene.enlarged = self._page.scene.enlarged
            self._ghost_scene.show(self.ghost.picture(self.ghost.index(now)))

    def _settle(self) -> None:
        """Draw trails and plots up to now."""
        self._draw_slowly(self.run.index(self.now), self.now)
        self._page.settle()

    def draw_whole_ways(self) -> None:
        """Draw the trails to the end."""
        self._draw_slowly(len(self.run.time) - 1, self.run.duration)
        if self.ghost is not None:
            self._ghost_scene.draw_way("platform", thinned(self.ghost.position))

    def _draw_slowly(self, k: int, now: float) -> None:
        """Draw trails and plots, which need no high rate."""
        scene, run = self._page.scene, self.run
        scene.draw_way("platform", thinned(run.position[: k + 1]))
        if run.target is not None:
            scene.draw_way("target", thinned(run.target[: k + 1]))
        if self.ghost is not None:
            self._ghost_scene.trails = scene.trails
            way = self.ghost.position[: self.ghost.index(now) + 1]
            self._ghost_scene.draw_way("platform", thinned(way))
        self._page.plots.show_run(run.time, run.tension, run.error, now)

    def _advance(self, passed: float) -> None:
        """Advance the time; at the end the run starts again."""
        with self._clock:
            self.now += passed * self._speed
            if self.now > self.run.duration:
                self.now = 0.0
        self._times.offer(self.now)

    def seek(self, now: float) -> None:
        """Go to a time [s]."""
        with self._clock:
            self.now = now
            self._drawn = 0
        self._slider.value = round(min(now, self._slider.max), 2)
        self._times.offer(now)

    def _add_controls(self, names: list[str], ghost: str) -> None:
        """Add time line, play button, speed and the choice of runs."""
        gui: Any = self._page.server.gui
        with self._page.controls:
            self._slider = gui.add_slider(
                "time [s]", min=0.0, max=max(round(self.run.duration, 2), 0.01), step=0.01,
                initial_value=0.0,
            )  # fmt: skip
            self._button = gui.add_button(PAUSE)
            speed = gui.add_dropdown("speed", PLAYBACK_SPEEDS, initial_value="1")
            which = gui.add_dropdown("run", names, initial_value=names[0])
            beside = gui.add_dropdown("ghost", [NO_SELECTION, *names], initial_value=ghost)
            self._source = gui.add_markdown(f"*{self.run.source}*")

        self._slider.on_update(self._slid)
        self._button.on_click(lambda _: self.toggle())
        speed.on_update(lambda _: setattr(self, "_speed", float(speed.value)))
        which.on_update(lambda _: self._choose(which.value))
        beside.on_update(lambda _: self._choose_ghost(beside.value))

    def _slid(self, event: Any) -> None:
        """Seek to the time that the user chose."""
        if event.client_id is not None:
            self.seek(float(self._slider.value))

    def toggle(self) -> None:
        """Play or pause."""
        self.playing = not self.playing
        self._button.label = PAUSE if self.playing else PLAY

    def _choose(self, name: str) -> None:
        """Play another run."""
        self.run = self._runs[name]
        self._slider.max = max(round(self.run.duration, 2), 0.01)
        self._source.content = f"*{self.run.source}*"
        self.seek(min(self.now, self.run.duration))

    def _choose_ghost(self, name: str) -> None:
        """Play another run, or none, beside it."""
        self.ghost = self._runs.get(name)
        self.seek(self.now)


def thinned(way: Array) -> Array:
    """Return at most `TRAIL_POINTS_MAX` points of a path, the last one included."""
    return np.asarray(way[evenly(len(way), TRAIL_POINTS_MAX)])
