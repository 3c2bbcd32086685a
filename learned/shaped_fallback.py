"""Input shaping in place of a policy that has left what it was trained for.

Beyond the workspace box of its training, or as far from the reference as episodes of training were
cut short, nothing is known of what a policy does. There the controller `input_shaping` takes over:
it follows from the reference alone, so no wrong belief drives it. It first hears of the reference
of the last seconds, as if it had commanded all along, and lengths and their rates fade from one to
the other. A robot whose sway cannot be shaped gets the `kinematic_solver` instead.

A policy that lets the platform bounce would often do so again: each time it has, it waits twice as
long before it takes over.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import CarosacError
from carosac_toolkit.base.scaled import Scaled
from carosac_toolkit.loop import plugins
from carosac_toolkit.loop.protocols import Controller
from carosac_toolkit.loop.values import Belief, Reference
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.robot.robot import Robot

CONTROLLERS = ("input_shaping", "kinematic_solver")  # the first that can be built
FADE_TIME = Scaled(1.0, "s")  # from one controller to the other
CALM_TIME = Scaled(1.0, "s")  # within what was trained, before the policy takes over again
PAST_TIME = Scaled(1.5, "s")  # of the reference that input shaping hears of when it takes over
PAST_CALLS = 10  # in which it does, each as long as a command
OUTSIDE, FAR = "target outside the box", "far from the reference"
BOUNCING = "bouncing on its cables"
CALMING = "calming down"


@dataclass(kw_only=True)
class _Row:
    """Who commands one robot, and how far its command has faded.

    Attributes:
        shaper: Of this robot; None before it is needed.
        shaped: Whether it commands, and not the policy.
        passed: Since the last change [s].
        calm: For how long the policy could have commanded [s].
        wait: How long that must be before it does [s].
        before: Lengths of the last cycle by who commands now, without the fade [m], shape (n,).
        apart: Of lengths and rates, before less after the change [m, m/s], shape (2, n).
    """

    shaper: Controller | None = None
    shaped: bool = False
    passed: float = np.inf
    calm: float = 0.0
    wait: float
    before: Array | None = None
    apart: Array | None = field(default=None, repr=False)


class ShapedFallback:
    """Commands the robots of a batch whose policy must not.

    Attributes:
        horizon: How far ahead of now it needs the reference [s].
        counts: Commands that were not the policy's since the reset, by reason.
    """

    def __init__(self, robot: Robot, period: float, *, continues: bool = False) -> None:
        """Build the controller.

        Args:
            robot: The nominal robot.
            period: Time between two commands [s].
            continues: Whether policies go on from the lengths that were sent, and at their rate, so
                that nothing has to fade when they take over again.
        """
        ratios = Scales(robot).ratios
        self._robot, self._period, self._continues = robot, period, continues
        self._fade, self._calm = FADE_TIME.of(ratios), CALM_TIME.of(ratios)
        self._past: deque[Reference] = deque(maxlen=max(2, round(PAST_TIME.of(ratios) / period)))
        self._spare = [_build(robot, period)]
        self.horizon = self._spare[0].horizon
        self._rows: list[_Row] = []
        self.reset(np.zeros((1, robot.n)))

    def reset(self, length: Array) -> None:
        """Let the policy command all robots, which rest on lengths (B, n) [m]."""
        self.counts: Counter[str] = Counter()
        self._past.clear()
        self._spare += [row.shaper for row in self._rows if row.shaper is not None]
        self._rows = [_Row(wait=self._calm) for _ in length]
        self._sent = np.array([length, length])  # the last two commands
        self._asked = np.array(length)  # by the policies, a cycle ago

    @property
    def active(self) -> NDArray[np.bool_]:
        """Which robots the policy does not command, shape (B,)."""
        return np.array([row.shaped for row in self._rows])

    def decide(self, reasons: Mapping[int, str], belief: Belief) -> None:
        """Change between the controllers before a command.

        Args:
            reasons: Why the policy must not command, by row of the batch.
            belief: Now.
        """
        for k, row in enumerate(self._rows):
            row.passed += self._period
            row.calm = 0.0 if k in reasons else row.calm + self._period
            if k in reasons and not row.shaped:
                if reasons[k] == BOUNCING:
                    row.wait *= 2.0
                self._take_over(k, belief)
            elif row.shaped and row.calm > row.wait:
                row.shaped, row.apart = False, None
                row.passed = np.inf if self._continues else 0.0
                row.before = self._asked[k]
            if row.shaped:
                self.counts[reasons.get(k, CALMING)] += 1

    def command(
        self, length: Array, belief: Belief, reference: Reference, reasons: Mapping[int, str]
    ) -> Array:
        """Return the lengths to send [m], shape (B, n).

        Args:
            length: What the policies ask for [m], shape (B, n); where they must not command, what
                they ask for without an action.
            belief: Now.
            reference: From now on.
            reasons: As in `decide`.

        Raises:
            UnreachableReference: The reference is beyond the box, where the robot cannot rest.
        """
        sent = np.array(length)
        for k, row in enumerate(self._rows):
            if row.shaped:
                assert row.shaper is not None
                try:
                    command = row.shaper.command(_belief(belief, k), _reference(reference, k))
                    sent[k] = command.unstrained_length[0]
                except CarosacError:
                    if reasons.get(k) == OUTSIDE:
                        raise  # else the lengths without an action lead on to where it can rest
            own = np.array(sent[k])
            if row.passed < self._fade:
                sent[k] += self._faded(k, own)
            row.before = own
        self._sent = np.array([self._sent[1], sent])
        self._asked = np.array(length)
        self._past.append(reference)
        return sent

    def _take_over(self, k: int, belief: Belief) -> None:
        """Let input shaping command a robot, after it has heard of the past of the reference."""
        row = self._rows[k]
        row.shaper = row.shaper or (
            self._spare.pop() if self._spare else _build(self._robot, self._period)
        )
        row.shaper.reset(_belief(belief, k))
        row.shaped, row.passed, row.apart, row.before = True, 0.0, None, None
        last = len(self._past) - 1
        calls = sorted({round(x) for x in np.linspace(0, last, PAST_CALLS)}) if self._past else []
        for index in calls:
            past = _reference(self._past[index], k)
            try:
                command = row.shaper.command(_belief(belief, k), past)
            except CarosacError:
                continue  # no rest there
            if index == last:
                row.before = command.unstrained_length[0]

    def _faded(self, k: int, own: Array) -> Array:
        """Return what is left of the distance between both controllers [m], shape (n,).

        It begins with the lengths and rates before the change and ends with those after it.

        Args:
            k: Row of the batch.
            own: Lengths by who commands now [m], shape (n,).
        """
        row = self._rows[k]
        if row.apart is None:
            h = self._period
            rate = np.zeros_like(own) if row.before is None else (own - row.before) / h
            moved = (self._sent[1, k] - self._sent[0, k]) / h
            row.apart = np.array([self._sent[1, k] + h * moved - own, moved - rate])
        s = row.passed / self._fade
        place = 1.0 - s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
        speed = self._fade * (s - s**3 * (6.0 - 8.0 * s + 3.0 * s**2))
        return np.asarray(place * row.apart[0] + speed * row.apart[1])


def _build(robot: Robot, period: float) -> Controller:
    """Build the first controller that this robot can have."""
    for name in CONTROLLERS:
        kind = plugins.load("controllers", name)
        try:
            controller: Controller = kind.build(robot, kind.Settings(period=period))
        except CarosacError:
            if name == CONTROLLERS[-1]:
                raise
            continue
        return controller
    raise AssertionError(CONTROLLERS)


def _belief(belief: Belief, k: int) -> Belief:
    """Return the belief about one robot, as far as these controllers need it: time and pose."""
    one = slice(k, k + 1)
    return Belief(
        time=belief.time[one], position=belief.position[one], rotation=belief.rotation[one]
    )


def _reference(reference: Reference, k: int) -> Reference:
    """Return the reference of one robot, which may be that of all."""
    one = slice(k, k + 1) if len(reference.time) > 1 else slice(0, 1)
    return Reference(
        time=reference.time[one], position=reference.position[one],
        velocity=reference.velocity[one], acceleration=reference.acceleration[one],
    )  # fmt: skip
