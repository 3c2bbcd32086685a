"""Page of a robot at rest: drag its target, or move its cable lengths."""

from __future__ import annotations

import threading
import time
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.rotations import from_matrix, to_matrix
from carosac_toolkit.viewer.gizmo import add_gizmo
from carosac_toolkit.viewer.page import Page
from carosac_toolkit.viewer.publisher import Publisher
from carosac_toolkit.viewer.resting import RestingRobot

TARGET_MODE = "target"
LENGTHS_MODE = "cable lengths"
LENGTH_RANGE_M = 0.5  # [m] that the length of a cable can be moved each way


class Wish(NamedTuple):
    """Request of the user: a pose, or lengths."""

    position: Array | None = None
    rotation: Array | None = None
    length: Array | None = None


class StaticsPage:
    """Connection of the controls of a page with a resting robot.

    Attributes:
        resting: The robot.
        gizmo: Arrows in the scene that move the target.
        answers: Wishes that were answered.
    """

    def __init__(self, page: Page) -> None:
        """Add the controls."""
        self.page = page
        self.resting = RestingRobot(page.robot)
        self.answers = 0
        self._began = time.monotonic()
        self._lock = threading.Lock()
        gui: Any = page.server.gui
        robot, rest = page.robot, self.resting.rest
        turns = robot.n >= 6  # fewer cables leave the rotation free
        self.gizmo = add_gizmo(
            page, rest.position[0], rest.rotation[0] if turns else None, rotations=turns
        )
        with page.controls:
            self.mode = gui.add_dropdown(
                "move", (TARGET_MODE, LENGTHS_MODE), initial_value=TARGET_MODE
            )
            self.place = gui.add_vector3(
                "target [m]", initial_value=tuple(rest.position[0].round(4)), step=0.05
            )
            self.lengths = self._add_sliders(gui)
            self.home = gui.add_button("Home")
        self._connect()
        self._wishes: Publisher[Wish] = Publisher(self._answer)
        page.offer(self.resting.home())

    def close(self) -> None:
        """Stop answering."""
        self._wishes.close()

    def _add_sliders(self, gui: Any) -> list[Any]:
        """Add a slider per cable, about its current length."""
        robot, now = self.page.robot, self.resting.rest.unstrained_length[0]
        return [
            gui.add_slider(
                f"{name} [m]", min=float(max(1e-3, round(now[i] - LENGTH_RANGE_M, 3))),
                max=float(round(now[i] + LENGTH_RANGE_M, 3)), step=0.001,
                initial_value=float(round(now[i], 3)), visible=False,
            )
            for i, name in enumerate(robot.cable_names)
        ]  # fmt: skip

    def _connect(self) -> None:
        """Connect the controls; values that the server sets trigger no request."""
        self.gizmo.on_update(lambda _: self._ask_for_target())
        self.place.on_update(self._typed)
        self.mode.on_update(lambda _: self._change_mode())
        self.home.on_click(lambda _: self._go_home())
        for slider in self.lengths:
            slider.on_update(self._slid)

    def _typed(self, event: Any) -> None:
        """Take a target typed by the user."""
        if event.client_id is not None:
            self.gizmo.position = self.place.value
            self._ask_for_target()

    def _slid(self, event: Any) -> None:
        """Take a length set by the user."""
        if event.client_id is not None:
            self._wishes.offer(Wish(length=np.array([each.value for each in self.lengths])))

    def _go_home(self) -> None:
        """Ask for the home pose."""
        robot = self.page.robot
        self.mode.value = TARGET_MODE
        self._put_target(robot.home_position, robot.home_rotation)
        self._ask_for_target()

    def _ask_for_target(self) -> None:
        """Ask for the pose of the gizmo."""
        turn = to_matrix(np.asarray(self.gizmo.wxyz, dtype=float)[None])[0]
        self._wishes.offer(Wish(position=np.array(self.gizmo.position, dtype=float), rotation=turn))

    def _put_target(self, position: Array, rotation: Array) -> None:
        """Move the gizmo."""
        self.gizmo.position = position
        if self.page.robot.n >= 6:
            self.gizmo.wxyz = from_matrix(rotation[None])[0]

    def _change_mode(self) -> None:
        """Show the controls of the other mode; it begins at the robot's pose."""
        by_target = self.mode.value == TARGET_MODE
        rest = self.resting.rest
        if by_target:
            self._put_target(rest.position[0], rest.rotation[0])
        for slider, now in zip(self.lengths, rest.unstrained_length[0], strict=True):
            slider.visible = not by_target
            if not by_target:
                slider.min = float(max(1e-3, round(now - LENGTH_RANGE_M, 3)))
                slider.max = float(round(now + LENGTH_RANGE_M, 3))
                slider.value = float(round(now, 3))
        self.gizmo.visible = self.place.visible = by_target
        self.page.offer(replace(self.resting.home(), time=self._now()))

    def _answer(self, wish: Wish) -> None:
        """Move the robot, in the thread of the requests."""
        if wish.length is not None:
            picture = self.resting.follow_lengths(wish.length)
        else:
            assert wish.position is not None
            picture = self.resting.follow_target(wish.position, wish.rotation)
            self.place.value = tuple(float(x) for x in wish.position.round(4))
        self.page.offer(replace(picture, time=self._now()))
        self.answers += 1

    def _now(self) -> float:
        """Return the time since the page began [s]."""
        return time.monotonic() - self._began
