"""Target moved by hand, and the smooth reference that goes there."""

from __future__ import annotations

import threading
from typing import NamedTuple

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.loop.values import Reference
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.robot.sizes import SURFACE_CABLES

KEY_STEP_M = 0.05
BOX_TOLERANCE_M = 1e-9
ARRIVAL_TOLERANCE = 1e-3  # [m], [m/s]
KEY_DIRECTIONS = {
    "\x1b[A": (0, 1, 0), "\x1b[B": (0, -1, 0), "\x1b[C": (1, 0, 0), "\x1b[D": (-1, 0, 0),
    "\x1b[5~": (0, 0, 1), "\x1b[6~": (0, 0, -1), "u": (0, 0, 1), "d": (0, 0, -1),
}  # fmt: skip
KEYS_HELP = (
    "arrows: x, y; u, d or page keys: z; space: stay here; x y z and Enter: go there; q: end"
)
SPEED_CORRECTION_TIME_S = 0.15


class _ReferencePoint(NamedTuple):
    """State of the reference: in W [m], [m/s], [m/s^2], each of shape (3,)."""

    position: Array
    velocity: Array
    acceleration: Array


class HandTarget:
    """Endless reference towards a target in the workspace box; safe from several threads.

    With two cables targets are projected onto the plane in which the robot can rest.

    Attributes:
        duration: Duration for the loop, longer than any run [s].
        over: Whether the operator has ended the run.
    """

    duration = 1e7

    def __init__(
        self, robot: Robot, start: Array, *, speed_max: float, acceleration_max: float
    ) -> None:
        """Stand still at `start` in W [m], shape (3,)."""
        self._box = (robot.workspace_min, robot.workspace_max)
        self._plane = _plane(robot, start)
        self._limits = (speed_max, acceleration_max)
        self._lock = threading.Lock()
        self._target = np.array(start, dtype=float)
        self._here = _ReferencePoint(self._target.copy(), np.zeros(3), np.zeros(3))
        self._time = 0.0
        self.over = False

    @property
    def target(self) -> Array:
        """Target in W [m], shape (3,)."""
        with self._lock:
            return self._target.copy()

    @property
    def arrived(self) -> bool:
        """True where the reference rests at the target."""
        with self._lock:
            near = np.abs(self._here.position - self._target).max() < ARRIVAL_TOLERANCE
            return bool(near and np.abs(self._here.velocity).max() < ARRIVAL_TOLERANCE)

    def go_to(self, position: Array) -> Array:
        """Set the target.

        Returns:
            The target in W [m], shape (3,).

        Raises:
            InvalidField: It lies outside the workspace box, and not on the way back into it; the
                old target stays.
        """
        asked = np.array(position, dtype=float)
        if self._plane is not None:
            normal, point = self._plane
            asked -= (asked - point) @ normal * normal
        low, high = self._box
        with self._lock:
            outside = np.maximum(low - asked, asked - high)
            before = np.maximum(low - self._target, self._target - high)
            if (outside > np.maximum(before, BOX_TOLERANCE_M)).any():
                kept = " ".join(f"{x:.3f}" for x in self._target)
                box = f"{low.tolist()} to {high.tolist()} m, the workspace box"
                got = " ".join(f"{x:g}" for x in asked)
                raise InvalidField("target", f"{got} m", f"{box}; it stays at {kept} m")
            self._target = asked.copy()
            return asked

    def obey(self, word: str) -> None:
        """Take a key, or a line of three numbers.

        Raises:
            InvalidField: It means nothing, or a place that is not allowed; the target stays.
        """
        if word in KEY_DIRECTIONS:
            self.go_to(self.target + KEY_STEP_M * np.array(KEY_DIRECTIONS[word]))
        elif word == " ":
            with self._lock:
                self._target = self._here.position.copy()
        elif word.strip() == "q":
            self.over = True
        else:
            self.go_to(_place(word))

    def window(self, time: float, horizon: float, period: float) -> Reference:
        """Return the reference from `time` on, which must not go back; see `Trajectory.window`."""
        rows = 1 + int(np.floor(horizon / period + 1e-9))
        with self._lock:
            target = self._target
            for _ in range(max(0, round((time - self._time) / period))):
                self._here = self._next(self._here, target, period)
            self._time = max(time, self._time)
            ahead = [self._here]
            for _ in range(rows - 1):
                ahead.append(self._next(ahead[-1], target, period))
        position, velocity, acceleration = (
            np.stack(part)[None] for part in zip(*ahead, strict=True)
        )
        return Reference(
            time=np.asarray((time + period * np.arange(rows))[None], dtype=float),
            position=position, velocity=velocity, acceleration=acceleration,
        )  # fmt: skip

    def _next(self, here: _ReferencePoint, target: Array, period: float) -> _ReferencePoint:
        """Return the state a period later, within the limits, without overshoot at the target."""
        speed_max, acceleration_max = self._limits
        way = target - here.position
        far = float(np.linalg.norm(way))
        pace = min(
            speed_max, np.sqrt(0.5 * acceleration_max * far), far / (4.0 * SPEED_CORRECTION_TIME_S)
        )
        wanted = way / far * pace if far > 0.0 else np.zeros(3)
        change = (wanted - here.velocity) / max(SPEED_CORRECTION_TIME_S, period)
        size = float(np.linalg.norm(change))
        change = change * min(1.0, acceleration_max / size) if size > 0.0 else change
        velocity = here.velocity + change * period
        return _ReferencePoint(here.position + velocity * period, velocity, change)


def _plane(robot: Robot, start: Array) -> tuple[Array, Array] | None:
    """Return normal and point of the plane in which two cables rest; None for more cables."""
    from carosac_toolkit.physics.rest.nearest import nearest_rest, plane_of_rest

    if robot.n != SURFACE_CABLES:
        return None
    return plane_of_rest(robot, nearest_rest(robot, start[None]).equilibrium.position)


def _place(word: str) -> Array:
    """Return the position on a line of three numbers."""
    try:
        numbers = [float(x) for x in word.replace(",", " ").split()]
    except ValueError:
        numbers = []
    if len(numbers) != 3 or not np.isfinite(numbers).all():
        raise InvalidField("input", repr(word), KEYS_HELP)
    return np.array(numbers)
