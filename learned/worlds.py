"""Worlds in which actions act: without sag, and with each set-point settling.

A third kind moves in real time: `learned.moving_worlds`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.loop.values import Belief
from carosac_toolkit.physics.cable import straight_line
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.physics.rest.statics import Equilibrium
from carosac_toolkit.robot.robot import Robot


@dataclass(frozen=True, kw_only=True, eq=False)
class WorldStates:
    """State of B platforms.

    Attributes:
        position: Platform origin in W [m], shape (B, 3).
        rotation: From P to W, shape (B, 3, 3).
        twist: Linear [m/s], then angular [rad/s], in W at the platform origin, shape (B, 6).
        length: Wound [m], shape (B, n).
        inconsistency: As in `learned.transition.Transition`, shape (B, n).
        tension: At the platform [N], shape (B, n); None without forces.
        failed: No solution was found; the platform is where it was before, shape (B,).
        belief: What is observed instead, or None: the truth is.
    """

    position: Array
    rotation: Array
    twist: Array
    length: Array
    inconsistency: Array
    tension: Array | None
    failed: NDArray[np.bool_]
    belief: Belief | None = None


class TrainingWorlds(Protocol):
    """B worlds that advance together."""

    robot: Robot
    size: int

    def reset(self, rows: NDArray[Any], position: Array) -> WorldStates:
        """Put some worlds at rest at positions (K, 3); where all worlds are then."""
        ...

    def advance(self, length: Array) -> WorldStates:
        """Ask the winches for lengths [m], shape (B, n); where the platforms get by that."""
        ...

    def state(self) -> dict[str, Any]:
        """Return everything that changes."""
        ...

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from a state."""
        ...


class NoSagWorlds:
    """Straight cables and a fixed orientation: the position of least squared length error.

    The paper's first stage. Lengths that contradict each other are forgiven: their inconsistency
    says by how much.
    """

    def __init__(self, robot: Robot, size: int, device: str = "cpu") -> None:
        self.robot = robot
        self._device = device
        self.size = size
        home = np.tile(robot.home_position, (size, 1))
        self._now = self._at(home, straight_line.inverse_kinematics(robot, home))

    def reset(self, rows: NDArray[Any], position: Array) -> WorldStates:
        """Put some worlds at positions, with the lengths of these."""
        where, length = self._now.position.copy(), self._now.length.copy()
        where[rows] = position
        length[rows] = straight_line.inverse_kinematics(self.robot, position)
        self._now = self._at(where, length)
        return self._now

    def advance(self, length: Array) -> WorldStates:
        """Fit the positions; each starts at home, on the side where the robot works."""
        fit = straight_line.forward_kinematics(self.robot, length, device=self._device)
        where = np.where(fit.converged[:, None], fit.position, self._now.position)
        self._now = replace(self._at(where, length), failed=~fit.converged)
        return self._now

    def state(self) -> dict[str, Any]:
        """Return positions and lengths."""
        return {"position": self._now.position, "length": self._now.length}

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from them."""
        self._now = self._at(state["position"], state["length"])

    def _at(self, position: Array, length: Array) -> WorldStates:
        """Return the state there, with the inconsistency of the lengths."""
        straight = straight_line.straight_length(self.robot, position, device=self._device)
        return WorldStates(
            position=position,
            rotation=np.broadcast_to(self.robot.home_rotation, (self.size, 3, 3)),
            twist=np.zeros((self.size, 6)),
            length=length,
            inconsistency=length - straight.length,
            tension=None,
            failed=np.zeros(self.size, dtype=bool),
        )


class SettledWorlds:
    """Sagging cables; each step lets the platform settle before it is looked at.

    What a platform settles to is the static equilibrium of its lengths, so that is solved for: the
    cables are elastic catenaries, which those of particles end on. Lengths fail without a stable
    equilibrium, or with one at a position where the robot cannot rest within its tension limits.
    """

    def __init__(self, robot: Robot, size: int, device: str = "cpu") -> None:
        self.robot = robot
        self._device = device
        self.size = size
        rest = statics.inverse_kinematics(robot, np.tile(robot.home_position, (size, 1)))
        if not (rest.converged & rest.stable).all():
            allowed = f"one with a stable equilibrium at home; {robot.name} has none"
            raise InvalidField("robot", robot.name, allowed)
        self._rest = rest
        self._inconsistency = np.zeros((size, robot.n))

    def reset(self, rows: NDArray[Any], position: Array) -> WorldStates:
        """Put some worlds at rest at positions; they must be feasible."""
        rest = statics.inverse_kinematics(self.robot, position, device=self._device)
        sound = rest.converged & rest.stable
        if not sound.all():
            bad = position[int(np.argmin(sound))]
            raise InvalidField("position", bad, "where the robot can rest")
        self._merge(np.asarray(rows), rest)
        self._inconsistency[rows] = 0.0
        return self._reached(np.zeros(self.size, dtype=bool))

    def advance(self, length: Array) -> WorldStates:
        """Settle on the lengths; the way there leads downhill in energy from home."""
        device = self._device
        settled = statics.forward_kinematics(self.robot, length, device=device)
        consistent = statics.inverse_kinematics(self.robot, settled.position, device=device)
        good = settled.converged & settled.stable & consistent.converged
        rows = np.flatnonzero(good)
        self._merge(rows, settled, rows)
        lack = settled.unstrained_length - consistent.unstrained_length
        self._inconsistency[rows] = lack[rows]
        return self._reached(~good)

    def state(self) -> dict[str, Any]:
        """Return the equilibria."""
        return {"rest": self._rest, "inconsistency": self._inconsistency.copy()}

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from them."""
        self._rest = state["rest"]
        self._inconsistency = np.array(state["inconsistency"])

    def _merge(self, rows: NDArray[Any], new: Equilibrium, of: NDArray[Any] | None = None) -> None:
        """Take over equilibria for some worlds."""
        merged = {}
        for name in Equilibrium.__dataclass_fields__:
            values = np.array(getattr(self._rest, name))
            source = getattr(new, name)
            values[rows] = source if of is None else source[of]
            merged[name] = values
        self._rest = Equilibrium(**merged)

    def _reached(self, failed: NDArray[np.bool_]) -> WorldStates:
        """Return the equilibria, as all worlds report themselves."""
        return WorldStates(
            position=self._rest.position,
            rotation=self._rest.rotation,
            twist=np.zeros((self.size, 6)),
            length=self._rest.unstrained_length,
            inconsistency=self._inconsistency.copy(),
            tension=self._rest.tension,
            failed=failed,
        )
