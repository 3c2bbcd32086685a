"""A simulated robot in real time whose target somebody drags; the loop never waits for the page."""

from __future__ import annotations

import sys
from collections import Counter
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from carosac_toolkit.arrays import Array
from carosac_toolkit.drivers.plant import Shaped
from carosac_toolkit.errors import CarosacError
from carosac_toolkit.live.hand_target import HandTarget
from carosac_toolkit.loop import Step, run
from carosac_toolkit.protocols import Controller, Estimator
from carosac_toolkit.robot import Robot
from carosac_toolkit.viewer.page import Page
from carosac_toolkit.viewer.picture import Picture, take_picture
from carosac_toolkit.viewer.publisher import Publisher

SWITCH = 5e-4  # [s] after which the page lets the loop run
WORST = 1000  # latest cycles that the state of the loop is judged by


@dataclass(frozen=True, kw_only=True, eq=False)
class Instant:
    """What the loop hands over; shapes are worked out elsewhere.

    Attributes:
        step: The cycle.
        points: Of the cables in W [m], shape (n, samples, 3), where the plant knows them.
        overruns: Ticks that the loop has missed up to now.
    """

    step: Step
    points: Array | None
    overruns: int


@dataclass
class LiveWatch:
    """Called by the loop with every step; makes a picture only when the page is ready for one.

    Attributes:
        driver: Simulated, with a plant and the count of overruns.
        publisher: Says when one is due.
        cycles: Up to now.
        limits: How often each limit changed a command, by cycles.
        latencies: Of estimator and controller, the latest cycles [s].
    """

    driver: Any
    publisher: Publisher[Instant]
    cycles: int = 0
    limits: Counter[str] = field(default_factory=Counter)
    latencies: list[float] = field(default_factory=list)

    def __call__(self, step: Step) -> None:
        """Take one cycle in."""
        self.latencies[self.cycles % WORST : self.cycles % WORST + 1] = [step.latency]
        self.cycles += 1
        self.limits.update({hit.limit for hit in step.command.limited})
        if self.publisher.due:
            plant = self.driver.plant
            points = plant.cable_points()[0] if isinstance(plant, Shaped) else None
            self.publisher.offer(
                Instant(
                    step=step,
                    points=points,
                    overruns=self.driver.overruns,
                )
            )


def picture_of(robot: Robot, instant: Instant) -> Picture:
    """The picture of an instant: the true state, the reference, and what the estimator believes."""
    step = instant.step
    truth = step.truth
    assert truth is not None
    limited = sorted({hit.limit for hit in step.command.limited})
    words = f"live, {float(truth.time[0]):.1f} s"
    if limited:
        words += f"\ncommand limited by: {', '.join(limited)}"
    if instant.overruns:
        words += f"; {instant.overruns} ticks missed"
    return take_picture(
        robot, truth.position[0], truth.rotation[0], time=float(truth.time[0]),
        unstrained_length=None if truth.unstrained_length is None else truth.unstrained_length[0],
        tension=None if truth.tension is None else truth.tension[0], points=instant.points,
        target=step.reference.position[0, 0], believed=step.belief.position[0], status=words,
    )  # fmt: skip


class LivePage:
    """Connects a page with a target that is moved by hand.

    Attributes:
        gizmo: Arrows in the scene that move the target.
    """

    def __init__(self, page: Page, target: HandTarget) -> None:
        """Add the controls."""
        from carosac_toolkit.viewer.gizmo import add_gizmo

        self._page, self._target = page, target
        gui: Any = page.server.gui
        start = target.target
        self.gizmo = add_gizmo(page, start, rotations=False)
        with page.controls:
            self.place = gui.add_vector3(
                "target [m]", initial_value=tuple(float(x) for x in start.round(4)), step=0.05
            )
            home = gui.add_button("Home")

        self.gizmo.on_update(self._dragged)
        self.place.on_update(self._typed)
        home.on_click(lambda _: self.go(page.robot.home_position))

    def _dragged(self, event: Any) -> None:
        """Go along; once let go, the arrows are where the target is: in the workspace box."""
        self.go(np.array(self.gizmo.position), dragged=event.phase != "end")

    def _typed(self, event: Any) -> None:
        """Somebody has typed a target."""
        if event.client_id is not None:
            self.go(np.array(self.place.value))

    def go(self, position: Array, *, dragged: bool = False) -> None:
        """Set the target, which stays in the workspace box."""
        taken = self._target.go_to(position)
        self.place.value = tuple(float(x) for x in taken.round(4))
        if not dragged:
            self.gizmo.position = taken


def follow(
    page: Page, driver: Any, estimator: Estimator, controller: Controller, target: HandTarget, *,
    duration: float | None = None,
) -> tuple[LiveWatch, CarosacError | None]:  # fmt: skip
    """Run the loop until its end or Ctrl-C, with the page in other threads.

    Args:
        page: Gets the pictures.
        driver: Simulated, in real time.
        estimator: Of the loop.
        controller: Of the loop.
        target: That is followed.
        duration: How long [s]; None: until interrupted.

    Returns:
        What the loop did, and the error that has ended it.
    """
    instants: Publisher[Instant] = Publisher(
        lambda instant: page.draw(picture_of(page.robot, instant)),
        rate=page.rate,
        settle=page.settle,
    )
    watch = LiveWatch(driver=driver, publisher=instants)
    usual = sys.getswitchinterval()
    sys.setswitchinterval(SWITCH)
    try:
        run(
            driver, estimator, controller, target, watch=watch, keep=1,
            duration=target.duration if duration is None else duration,
        )  # fmt: skip
    except CarosacError as error:
        return watch, error
    except KeyboardInterrupt:
        pass
    finally:
        sys.setswitchinterval(usual)
        instants.close()
    return watch, None
