"""The values that flow between driver, estimator and controller: frozen, batched, SI.

An absent channel is None, never NaN. Hardware is a batch of one.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carosac_toolkit.base.arrays import Array, check_rotations, frozen_array
from carosac_toolkit.base.errors import InvalidField


def _freeze(instance: Any, **shapes: tuple[int, ...]) -> None:
    """Freeze each named field that is present; the rest of the shape follows its batch."""
    for name, shape in shapes.items():
        value = getattr(instance, name)
        if value is not None:
            object.__setattr__(instance, name, frozen_array(name, value, shape))


@dataclass(frozen=True, kw_only=True, eq=False)
class Stamped:
    """A measured quantity with its own time stamps.

    Attributes:
        time: Time of measurement [s], shape (B,).
        value: Measured value, shape (B, n), in the unit of its channel.
    """

    time: Array
    value: Array

    def __post_init__(self) -> None:
        """Freeze the arrays."""
        batch = len(self.time)
        _freeze(self, time=(batch,), value=(batch, *self.value.shape[1:]))


@dataclass(frozen=True, kw_only=True, eq=False)
class Pose:
    """A pose of the platform frame P in world frame W.

    Attributes:
        position: Platform origin [m], shape (B, 3).
        rotation: Rotation from P to W, shape (B, 3, 3).
        time: Time of measurement [s], shape (B,), or None.
    """

    position: Array
    rotation: Array
    time: Array | None = None

    def __post_init__(self) -> None:
        """Freeze the arrays."""
        batch = len(self.position)
        _freeze(self, position=(batch, 3), rotation=(batch, 3, 3), time=(batch,))
        check_rotations("rotation", self.rotation)


@dataclass(frozen=True, kw_only=True, eq=False)
class Imu:
    """All inertial samples since the last measurement.

    Attributes:
        time: [s], shape (B, K).
        angular_rate: In the sensor frame [rad/s], shape (B, K, 3).
        specific_force: Acceleration minus gravity, in the sensor frame [m/s^2], shape (B, K, 3).
    """

    time: Array
    angular_rate: Array
    specific_force: Array

    def __post_init__(self) -> None:
        """Freeze the arrays."""
        shape = self.time.shape
        _freeze(self, time=shape, angular_rate=(*shape, 3), specific_force=(*shape, 3))


@dataclass(frozen=True, kw_only=True, eq=False)
class Measurement:
    """Measurement of the sensors at one time.

    Attributes:
        time: Time of this cycle, by the driver's clock [s], shape (B,).
        unstrained_length: From the encoders [m], shape (B, n).
        length_rate: Rate of the unstrained length [m/s], or None.
        tension: Tension at the platform [N], or None.
        swivel_angle: Angles of the pulleys about their swivel axes [rad], (B, n), or None; sign and
            zero as in `carosac_toolkit.recordings.Recording`.
        attitude: From an AHRS on the platform: quaternions w x y z from the frame of the sensor to
            a level frame, z up, of any heading, (B, 4), or None.
        inclination: From an inclinometer on the platform: roll and pitch [rad], (B, 2), or None;
            as in `carosac_toolkit.recordings.Recording`.
        pose: From motion capture, or None.
        imu: Inertial samples, or None.
        drive_status: Status word of each drive, as the driver defines it, or None.
    """

    time: Array
    unstrained_length: Array
    length_rate: Stamped | None = None
    tension: Stamped | None = None
    swivel_angle: Stamped | None = None
    attitude: Stamped | None = None
    inclination: Stamped | None = None
    pose: Pose | None = None
    imu: Imu | None = None
    drive_status: tuple[str, ...] | None = None

    def __post_init__(self) -> None:
        """Freeze the arrays."""
        shape = self.unstrained_length.shape
        _freeze(self, time=shape[:1], unstrained_length=shape)

    def lengths_of(self, size: int, n: int) -> Array:
        """Return unstrained lengths [m], (B, n); refuse those of other robots or cables.

        Raises:
            InvalidField: Another shape, or a length that is not positive.
        """
        lengths = self.unstrained_length
        if lengths.shape != (size, n):
            allowed = f"shape ({size}, {n})"
            raise InvalidField("unstrained_length", f"shape {lengths.shape}", allowed)
        if (lengths <= 0.0).any():
            raise InvalidField("unstrained_length", f"{lengths.min()} m", "> 0 m")
        return lengths


@dataclass(frozen=True, kw_only=True)
class LimitHit:
    """A command that a limit changed.

    Attributes:
        limit: Name of the limit.
        cable: Index of the cable, or None where the limit concerns the platform.
        asked: Value asked for, in the unit of the limit.
        sent: Value sent instead.
        row: Which of the B robots.
    """

    limit: str
    cable: int | None
    asked: float
    sent: float
    row: int = 0


@dataclass(frozen=True, kw_only=True, eq=False)
class Command:
    """Lengths that the winches are asked for.

    Attributes:
        time: [s], shape (B,).
        unstrained_length: [m], shape (B, n).
        length_rate: Feed-forward rate [m/s], shape (B, n), or None.
        limited: Every limit that changed the command on its way.
    """

    time: Array
    unstrained_length: Array
    length_rate: Array | None = None
    limited: tuple[LimitHit, ...] = ()

    def __post_init__(self) -> None:
        """Freeze the arrays."""
        shape = self.unstrained_length.shape
        _freeze(self, time=shape[:1], unstrained_length=shape, length_rate=shape)


@dataclass(frozen=True, kw_only=True, eq=False)
class Innovations:
    """Normalised squared innovations of the measurements since the last belief.

    Attributes:
        squares: Sum of the normalised innovations squared, shape (B,); those that were too far off
            to be used are left out.
        dof: Sum of their degrees of freedom, shape (B,); 0 where nothing was measured.
        rejected: Number of measurements too far off to be used as they are, shape (B,).
    """

    squares: Array
    dof: Array
    rejected: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Belief:
    """Estimate of the platform state.

    Attributes:
        time: [s], shape (B,).
        position: Platform origin in W [m], shape (B, 3).
        rotation: Rotation from P to W, shape (B, 3, 3).
        twist: Linear [m/s], then angular [rad/s] velocity, in W at the platform origin, (B, 6);
            None where the estimator has none.
        covariance: Of [dp; log(R R_hat^T); dv; dw] in W, shape (B, 12, 12), or None.
        tension: At the platform [N], shape (B, n), or None where the estimator has no forces.
        center_of_mass: Of the platform in P [m], shape (B, 3), or None if it is
            not estimated and that of the robot file holds.
        innovations: How well the measurements since the last belief fitted, or None where the
            estimator does not judge them.
        converged: True where the pose is that of the last update, shape (B,); elsewhere an earlier
            one was kept. None where the estimator always has one.
        memory: Internal values of the estimator, such as biases; nobody else reads it.
    """

    time: Array
    position: Array
    rotation: Array
    twist: Array | None = None
    covariance: Array | None = None
    tension: Array | None = None
    center_of_mass: Array | None = None
    innovations: Innovations | None = None
    converged: NDArray[np.bool_] | None = None
    memory: Any = field(default=None, repr=False)

    def __post_init__(self) -> None:
        """Freeze the arrays."""
        b = len(self.position)
        _freeze(self, time=(b,), position=(b, 3), rotation=(b, 3, 3), twist=(b, 6))
        _freeze(self, covariance=(b, 12, 12), center_of_mass=(b, 3))
        check_rotations("rotation", self.rotation)
        if not isinstance(self.innovations, Innovations | None):
            got = type(self.innovations).__name__
            raise InvalidField("innovations", got, "Innovations, or None")
        converged = self.converged
        if converged is not None and (np.shape(converged), np.asarray(converged).dtype) != (
            (b,), np.dtype(bool),
        ):  # fmt: skip
            raise InvalidField("converged", repr(converged), f"booleans of shape ({b},), or None")


@dataclass(frozen=True, kw_only=True, eq=False)
class Reference:
    """The next N samples of the desired platform motion; row 0 is now.

    Attributes:
        time: [s], shape (B, N).
        position: Platform origin in W [m], shape (B, N, 3).
        velocity: [m/s], shape (B, N, 3).
        acceleration: [m/s^2], shape (B, N, 3).
        rotation: Rotation from P to W, shape (B, N, 3, 3), or None where it is free.
    """

    time: Array
    position: Array
    velocity: Array
    acceleration: Array
    rotation: Array | None = None

    def __post_init__(self) -> None:
        """Freeze the arrays."""
        shape = self.time.shape
        _freeze(self, time=shape, position=(*shape, 3), velocity=(*shape, 3))
        _freeze(self, acceleration=(*shape, 3), rotation=(*shape, 3, 3))


@dataclass(frozen=True, kw_only=True, eq=False)
class State:
    """True state, seen only by a driver's world and the scoring.

    Attributes:
        time: [s], shape (B,).
        position: Platform origin in W [m], shape (B, 3).
        rotation: Rotation from P to W, shape (B, 3, 3).
        twist: Linear, then angular velocity, in W at the platform origin, (B, 6), or None.
        unstrained_length: [m], shape (B, n), or None.
        tension: At the platform [N], shape (B, n), or None.
    """

    time: Array
    position: Array
    rotation: Array
    twist: Array | None = None
    unstrained_length: Array | None = None
    tension: Array | None = None
