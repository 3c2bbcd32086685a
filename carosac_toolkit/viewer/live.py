"""Simulated robot in real time with a target dragged by hand; the loop never waits for the page."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import CarosacError, InvalidField
from carosac_toolkit.drivers.plant import Shaped
from carosac_toolkit.live.hand_target import HandTarget
from carosac_toolkit.live.real_time import short_pauses
from carosac_toolkit.loop.loop import Step, run
from carosac_toolkit.loop.protocols import Controller, Estimator
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.viewer.gizmo import add_gizmo
from carosac_toolkit.viewer.page import Page, note_html
from carosac_toolkit.viewer.picture import Picture, take_picture
from carosac_toolkit.viewer.publisher import Publisher

LATENCY_CYCLES_MAX = 1000  # cycles whose latencies are kept


@dataclass(frozen=True, kw_only=True, eq=False)
class Instant:
    """Plain numbers that the loop hands over; cable shapes are computed elsewhere.

    Attributes:
        time: By the driver's clock [s].
        position: True platform origin in W [m], shape (3,).
        rotation: True rotation from P to W, shape (3, 3).
        reference: Reference position now in W [m], shape (3,).
        believed: Estimated position in W [m], shape (3,).
        tension: True [N], shape (n,), or None.
        unstrained_length: True [m], shape (n,), or None.
        points: Points of the cables in W [m], shape (n, samples, 3), where the plant knows them.
        limited: Names of the limits that have changed the command.
        overruns: Ticks that the loop has missed up to now.
    """

    time: float
    position: Array
    rotation: Array
    reference: Array
    believed: Array
    tension: Array | None
    unstrained_length: Array | None
    points: Array | None
    limited: tuple[str, ...]
    overruns: int


@dataclass
class LiveWatch:
    """Observer called by the loop with every step; makes an instant only when one is wanted.

    Attributes:
        driver: Simulated, with a plant and the count of overruns.
        instants: Takes instants at once, and says when one is due.
        cycles: Up to now.
        limits: Number of cycles in which each limit changed a command.
        latencies: Latencies of estimator and controller in the latest cycles [s].
    """

    driver: Any
    instants: Publisher[Instant]
    cycles: int = 0
    limits: Counter[str] = field(default_factory=Counter)
    latencies: list[float] = field(default_factory=list)

    def __call__(self, step: Step) -> None:
        """Count one cycle."""
        place = self.cycles % LATENCY_CYCLES_MAX
        self.latencies[place : place + 1] = [step.latency]
        self.cycles += 1
        self.limits.update({hit.limit for hit in step.command.limited})
        if self.instants.due:
            self.instants.offer(self._instant(step))

    def _instant(self, step: Step) -> Instant:
        """Return what the page needs of a step."""
        plant, truth = self.driver.plant, step.truth
        assert truth is not None
        return Instant(
            time=float(truth.time[0]), position=truth.position[0], rotation=truth.rotation[0],
            reference=step.reference.position[0, 0], believed=step.belief.position[0],
            tension=_first(truth.tension), unstrained_length=_first(truth.unstrained_length),
            points=plant.cable_points()[0] if isinstance(plant, Shaped) else None,
            limited=tuple(sorted({hit.limit for hit in step.command.limited})),
            overruns=int(self.driver.overruns),
        )  # fmt: skip


def _first(values: Array | None) -> Array | None:
    """Return the row of the only robot."""
    return None if values is None else values[0]


def picture_of(robot: Robot, instant: Instant) -> Picture:
    """Return the picture of an instant: true state, reference and estimate."""
    words = f"live, {instant.time:.1f} s"
    if instant.overruns:
        words += f"; {instant.overruns} ticks missed"
    if instant.limited:
        words += f"\ncommand limited by: {', '.join(instant.limited)}"
    return take_picture(
        robot, instant.position, instant.rotation, time=instant.time,
        unstrained_length=instant.unstrained_length, tension=instant.tension,
        points=instant.points, target=instant.reference, believed=instant.believed, status=words,
    )  # fmt: skip


def drawing(page: Page) -> Publisher[Instant]:
    """Return a publisher that draws instants on a page, in a thread of this process."""
    return Publisher(
        lambda instant: page.draw(picture_of(page.robot, instant)), rate=page.rate,
        settle=page.settle,
    )  # fmt: skip


class LivePage:
    """Connection of a page with a target that is moved by hand.

    Attributes:
        gizmo: Arrows in the scene that move the target.
        place: Its field with the numbers of the target.
        note: Says why a target was refused, until the next one is taken.
    """

    def __init__(
        self, page: Page, target: HandTarget, moved: Callable[[Array], None] | None = None
    ) -> None:
        """Add the controls.

        Args:
            page: The page.
            target: Target that is moved; if it refuses to move, the page says why.
            moved: Told of each new target in W [m], shape (3,).
        """
        self._target, self._moved = target, moved
        gui: Any = page.server.gui
        start = target.target
        self.gizmo = add_gizmo(page, start, rotations=False)
        with page.controls:
            self.place = gui.add_vector3("target [m]", initial_value=_numbers(start), step=0.05)
            home = gui.add_button("Home")
            self.note = gui.add_html("")
        self.gizmo.on_update(self._dragged)
        self.place.on_update(self._typed)
        home.on_click(lambda _: self.go(page.robot.home_position))

    def go(self, position: Array, *, dragged: bool = False) -> None:
        """Set the target, or explain the refusal; while dragged the arrows follow the mouse."""
        try:
            reached = self._target.go_to(position)
        except InvalidField as error:
            reached, refused = self._target.target, str(error)
        else:
            refused = ""
            if self._moved is not None:
                self._moved(reached)
        self.note.content = note_html(refused)
        self.place.value = _numbers(reached)
        if not dragged:
            self.gizmo.position = reached

    def _dragged(self, event: Any) -> None:
        """Follow the arrows; once released, they return to the target."""
        self.go(np.array(self.gizmo.position), dragged=event.phase != "end")

    def _typed(self, event: Any) -> None:
        """Take a target typed by the user."""
        if event.client_id is not None:
            self.go(np.array(self.place.value))


def _numbers(place: Array) -> tuple[float, ...]:
    """Return a position in the form that a field of the page shows."""
    return tuple(float(x) for x in place.round(4))


def follow(
    instants: Publisher[Instant], driver: Any, estimator: Estimator, controller: Controller,
    target: HandTarget, *, duration: float | None = None,
    paid_out: Callable[[Array], Array] | None = None,
) -> tuple[LiveWatch, CarosacError | None]:  # fmt: skip
    """Run the loop until its end or Ctrl-C; `instants` is closed then.

    Args:
        instants: Gets what the page shows.
        driver: Simulated, in real time.
        estimator: Estimator of the loop.
        controller: Controller of the loop.
        target: Target to follow.
        duration: Duration [s]; None: until interrupted.
        paid_out: As of the loop.

    Returns:
        What the loop did, and the error that has ended it.
    """
    watch = LiveWatch(driver=driver, instants=instants)
    try:
        with short_pauses():
            run(
                driver, estimator, controller, target, watch=watch, keep=1,
                duration=target.duration if duration is None else duration, paid_out=paid_out,
            )  # fmt: skip
    except CarosacError as error:
        return watch, error
    except KeyboardInterrupt:
        pass
    finally:
        instants.close()
    return watch, None
