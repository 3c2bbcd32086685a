"""Contract between a simulated driver and its simulation: the robot behind winches and sensors."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.loop.values import State
from carosac_toolkit.robot.robot import Robot


class Plant(Protocol):
    """B simulated robots with their winches, without clock, sensors or command limits.

    Attributes:
        robot: Its limits and gravity count for all B robots; n cables.
        size: B.
        inertial: True if it has a twist and an `acceleration`, as an IMU needs.
    """

    robot: Robot
    size: int
    inertial: bool

    def reset(self, position: Array) -> None:
        """Set the robots down at rest; whatever is random starts over.

        Args:
            position: Platform origin in W [m], shape (B, 3).

        Raises:
            InvalidField: One of them cannot rest there; names ``start_position``.
        """
        ...

    def advance(self, command: Array, duration: float) -> None:
        """Advance time while the winches follow a constant command.

        Args:
            command: Unstrained lengths asked of the winches [m], shape (B, n).
            duration: [s].
        """
        ...

    def truth(self) -> State:
        """Return the current state; its `time` is ignored."""
        ...

    def acceleration(self) -> Array:
        """Return the current acceleration of the platform; called only if `inertial`.

        Returns:
            Linear [m/s^2], then angular [rad/s^2], in W at the platform origin, shape (B, 6).
        """
        ...

    def read_lengths(self) -> Array:
        """Return readings of perfect encoders on the drums as the drives know them [m], (B, n)."""
        ...


@runtime_checkable
class Swivelling(Protocol):
    """A plant that knows how far its pulleys have swivelled."""

    def swivel_angles(self) -> Array:
        """Return the angles of the pulleys about their swivel axes.

        Returns:
            As `carosac_toolkit.physics.cable.swivel.swivel_angle`, shape (B, n).
        """
        ...


@runtime_checkable
class Shaped(Protocol):
    """A plant that knows more of the shapes of its cables than their lengths and the pose say."""

    def cable_points(self) -> Array:
        """Return points along the cables.

        Returns:
            Points in W [m], shape (B, n, samples, 3), from tangent point to anchor point.
        """
        ...
