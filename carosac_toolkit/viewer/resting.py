"""Robot at rest that the user moves: by a target pose, or by its cable lengths."""

from __future__ import annotations

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import CarosacError
from carosac_toolkit.base.numbers import plain
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.physics.rest.statics import Equilibrium
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.viewer.picture import Picture, take_picture


class RestingRobot:
    """Robot that keeps the last feasible pose when an infeasible one is asked for.

    Attributes:
        rest: The pose of rest that is shown.
    """

    def __init__(self, robot: Robot) -> None:
        """Rest at home.

        Raises:
            CarosacError: The robot cannot rest at its home position.
        """
        self.robot = robot
        self.rest = statics.inverse_kinematics(robot, robot.home_position[None])
        if not self.rest.converged[0]:
            reason = statics.STATUS_REASONS[self.rest.status[0]]
            raise CarosacError(
                f"{robot.name}: no equilibrium at its home position ({reason}); "
                "carosac check says more"
            )

    def home(self) -> Picture:
        """Return the robot as it rests now."""
        return self._picture(self.rest, self.rest.position[0].copy(), "at rest", ())

    def follow_target(self, position: Array, rotation: Array | None = None) -> Picture:
        """Move to a position, if the robot can rest there.

        Args:
            position: Platform origin in W [m], shape (3,).
            rotation: From P to W, shape (3, 3); only with six cables or more.
        """
        held = None if self.robot.n < 6 or rotation is None else rotation[None]
        rest = statics.inverse_kinematics(
            self.robot, position[None], held, guess=self.rest if self.robot.n < 6 else None
        )
        faults = self._faults(rest)
        if faults:
            return self._stay("this target", faults, position)
        self.rest = rest
        notes = ("outside the workspace box",) if self._outside(position) else ()
        return self._picture(rest, position, "at rest", notes)

    def follow_lengths(self, length: Array) -> Picture:
        """Hang on cables of given unstrained lengths [m], shape (n,).

        Poses of rest outside the tension limits are shown, as they are real, and called so.
        """
        if (length <= 0.0).any():
            return self._stay("these lengths", ("a length that is not positive",), None)
        rest = statics.forward_kinematics(self.robot, length[None], guess=self.rest)
        if not rest.converged[0]:
            return self._stay("these lengths", ("no equilibrium found",), None)
        if not rest.stable[0]:
            return self._stay("these lengths", ("the equilibrium is unstable",), None)
        self.rest = rest
        return self._picture(rest, None, "at rest with these lengths", self._strained(rest))

    def _faults(self, rest: Equilibrium) -> tuple[str, ...]:
        """Return the reasons why a pose cannot be taken; none if it can."""
        if not rest.converged[0]:
            return (statics.STATUS_REASONS[rest.status[0]],)
        faults = [] if rest.stable[0] else ["the pose of rest is unstable"]
        faults += [
            f"cable {self.robot.cable_names[i]} would be {rest.unstrained_length[0, i]:.2f} m "
            f"long; its winch holds {self.robot.length_min[i]:g} to {self.robot.length_max[i]:g} m"
            for i in np.flatnonzero(~rest.in_winch_range[0])
        ]
        return tuple(faults)

    def _strained(self, rest: Equilibrium) -> tuple[str, ...]:
        """Return cables outside their tension limits."""
        robot, tension = self.robot, rest.tension[0]
        over = tension > robot.tension_max * (1.0 + 1e-9)
        sentences = []
        for mask, word, limit in (
            (rest.slack[0], "slack", robot.tension_min),
            (over, "overloaded", robot.tension_max),
        ):
            sentences += [
                f"cable {robot.cable_names[i]} {word}: {plain(tension[i], 3)} N, limit "
                f"{limit[i]:g} N"
                for i in np.flatnonzero(mask)
            ]
        return tuple(sentences)

    def _outside(self, position: Array) -> bool:
        """Return whether a position is outside the workspace box."""
        low, high = self.robot.workspace_min, self.robot.workspace_max
        return bool(((position < low) | (position > high)).any())

    def _stay(self, what: str, faults: tuple[str, ...], target: Array | None) -> Picture:
        """Return the last feasible pose, marked as such."""
        status = f"INFEASIBLE: {what}: {'; '.join(faults)}\nshown: the last feasible pose"
        rest = self.rest
        return take_picture(
            self.robot, rest.position[0], rest.rotation[0],
            points=statics.cable_shape(self.robot, rest)[0], tension=rest.tension[0],
            target=target, held=True, status=status, problem=True,
        )  # fmt: skip

    def _picture(
        self, rest: Equilibrium, target: Array | None, status: str, notes: tuple[str, ...]
    ) -> Picture:
        """Return the picture of an equilibrium."""
        strained = status != "at rest" and bool(notes)
        words = "\n".join([f"OUTSIDE THE TENSION LIMITS: {notes[0]}", *notes[1:]]) if strained \
            else "; ".join([status, *notes])  # fmt: skip
        return take_picture(
            self.robot, rest.position[0], rest.rotation[0],
            points=statics.cable_shape(self.robot, rest)[0], tension=rest.tension[0],
            target=target, status=words, problem=strained,
        )  # fmt: skip
