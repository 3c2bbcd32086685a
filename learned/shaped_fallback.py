"""Input shaping in place of a policy that has left what it was trained for.

Beyond the workspace box of its training, or as far from the reference as episodes of training were
cut short, nothing is known of what a policy does. There the controller `input_shaping` takes over:
it follows from the reference alone, so no wrong belief drives it. Commands fade from one to the
other.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.scaled import Scaled
from carosac_toolkit.loop import plugins
from carosac_toolkit.loop.protocols import Controller
from carosac_toolkit.loop.values import Belief, Reference
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.robot.robot import Robot

CONTROLLER = "input_shaping"
FADE_TIME = Scaled(1.0, "s")  # from one controller to the other
CALM_TIME = Scaled(1.0, "s")  # within what was trained, before the policy takes over again


@dataclass(kw_only=True)
class _Takeover:
    """Who commands one robot, and how far its command has faded.

    Attributes:
        shaper: Commands it; None: the policy does.
        passed: Since the last change [s].
        calm: For how long the policy could have commanded [s].
        apart: Last command before the change less the first one after it [m], shape (n,).
    """

    shaper: Controller | None = None
    passed: float = np.inf
    calm: float = 0.0
    apart: Array | None = None


class ShapedFallback:
    """Commands the robots of a batch whose policy must not.

    Attributes:
        horizon: How far ahead of now it needs the reference [s].
        counts: Commands that were not the policy's since the reset, by reason.
    """

    def __init__(self, robot: Robot, period: float) -> None:
        """Look for the controller.

        Args:
            robot: The nominal robot.
            period: Time between two commands [s].
        """
        ratios = Scales(robot).ratios
        self._robot, self._period = robot, period
        self._fade, self._calm = FADE_TIME.of(ratios), CALM_TIME.of(ratios)
        self._spare: list[Controller] = []
        self.horizon = self._shaper(keep=True).horizon
        self.reset(np.zeros((1, robot.n)))

    def reset(self, length: Array) -> None:
        """Let the policy command all robots, which rest on lengths (B, n) [m]."""
        self.counts: Counter[str] = Counter()
        self._last = np.array(length)
        self._rows = [_Takeover() for _ in length]

    @property
    def active(self) -> NDArray[np.bool_]:
        """Which robots the policy does not command, shape (B,)."""
        return np.array([row.shaper is not None for row in self._rows])

    def decide(self, reasons: Mapping[int, str], belief: Belief) -> None:
        """Change between the controllers before a command.

        Args:
            reasons: Why the policy must not command, by row of the batch.
            belief: Now.
        """
        for k, row in enumerate(self._rows):
            row.passed += self._period
            row.calm = 0.0 if k in reasons else row.calm + self._period
            if k in reasons and row.shaper is None:
                row.shaper = self._shaper()
                row.shaper.reset(_row(belief, k))
                row.passed, row.apart = 0.0, None
            elif row.shaper is not None and row.calm > self._calm:
                self._spare.append(row.shaper)
                row.shaper, row.passed, row.apart = None, 0.0, None
            if row.shaper is not None:
                self.counts[reasons.get(k, "calming down")] += 1

    def command(self, length: Array, belief: Belief, reference: Reference) -> Array:
        """Return the lengths to send [m], shape (B, n).

        Args:
            length: What the policies ask for [m], shape (B, n); unused where they must not command.
            belief: Now.
            reference: From now on.
        """
        sent = np.array(length)
        for k, row in enumerate(self._rows):
            if row.shaper is not None:
                ahead = reference if len(reference.time) == 1 else _reference_row(reference, k)
                sent[k] = row.shaper.command(_row(belief, k), ahead).unstrained_length[0]
            if row.passed < self._fade:
                if row.apart is None:
                    row.apart = self._last[k] - sent[k]
                share = row.passed / self._fade
                sent[k] += (1.0 - share**3 * (10.0 - 15.0 * share + 6.0 * share**2)) * row.apart
        self._last = sent
        return sent

    def _shaper(self, *, keep: bool = False) -> Controller:
        """Take a controller that is not in use, or build one."""
        if not self._spare:
            kind = plugins.load("controllers", CONTROLLER)
            self._spare.append(kind.build(self._robot, kind.Settings(period=self._period)))
        return self._spare[-1] if keep else self._spare.pop()


def _row(belief: Belief, k: int) -> Belief:
    """Return what input shaping needs of one row: time and pose."""
    return Belief(
        time=belief.time[k : k + 1],
        position=belief.position[k : k + 1],
        rotation=belief.rotation[k : k + 1],
    )


def _reference_row(reference: Reference, k: int) -> Reference:
    """Return the reference of one robot."""
    one = slice(k, k + 1)
    return replace(
        reference, time=reference.time[one], position=reference.position[one],
        velocity=reference.velocity[one], acceleration=reference.acceleration[one],
    )  # fmt: skip
