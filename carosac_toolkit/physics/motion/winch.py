"""Winches of simulated robots: drive, speed and acceleration limits, and drums that build up."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from carosac_toolkit.base.arrays import Array, batch
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.base.scaled import Scaled
from carosac_toolkit.physics import warp_setup
from carosac_toolkit.physics.device import Buffers, record_type, stacked
from carosac_toolkit.physics.motion import winch_kernels
from carosac_toolkit.physics.motion.winch_kernels import Winch, WinchState
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.robot.robot import Robot

STEPS_PER_LAG = 25  # inner steps in the mean lag of the winches of a robot
STEPS_PER_OWN_LAG = 20  # at least so many in the lag of a winch that is quicker than the others
STEP_WITHOUT_LAG = Scaled(2e-3, "s")  # in which a winch without lag reaches its command
STEP_MIN = Scaled(0.1e-3, "s")  # a lag below it is none
INTEGRAL_TIME_STEPS_MIN = 2.0  # shortest integral time that the inner steps resolve, in steps


@dataclass(frozen=True, kw_only=True)
class WinchSettings:
    """Control of the winches by their drives, beyond the lag and limits of the robot.

    The drive asks for the rate (e + integral(e) / integral_time + derivative_time * de/dt) / lag of
    its cable, e being the length it is asked for minus the one it has. Without integral and
    derivative it trails a moving command by lag times speed.

    Attributes:
        integral_time: Time constant of the integral term [s]; None: no integral. At least two
            inner steps of the winch (`inner_steps`), 4 ms on the robot ``carosac``.
        derivative_time: Time constant of the derivative term [s]; it makes the drive slower.
        believed_drum_buildup: Decrease of the squared drum radius per length paid out that the
            drives assume [m], for all drums; None: the true one.
    """

    integral_time: float | None = None
    derivative_time: float = 0.0
    believed_drum_buildup: float | None = None

    def __post_init__(self) -> None:
        """Refuse times and build-ups that no drive can have."""
        units = {"integral_time": "s", "derivative_time": "s", "believed_drum_buildup": "m"}
        for name, unit in units.items():
            value = getattr(self, name)
            if value is None and name != "derivative_time":
                continue
            number = isinstance(value, int | float) and not isinstance(value, bool)
            above = ">" if name == "integral_time" else ">="
            if not number or not 0.0 <= value < np.inf or (above == ">" and value == 0.0):
                raise InvalidField(name, f"{value} {unit}", f"{name} {above} 0 {unit}, finite")


def inner_steps(robot: Robot) -> Array:
    """Return the longest inner steps of the winches of a robot [s], shape (n,).

    They resolve the lag: a share of the mean lag, so that plants whose lags were drawn at random
    have steps that differ less than their lags, and less where a winch is much quicker.
    """
    ratios = Scales(robot).ratios
    lag = np.where(robot.winch_lag < STEP_MIN.of(ratios), 0.0, robot.winch_lag)
    if not lag.any():
        return np.full(robot.n, STEP_WITHOUT_LAG.of(ratios))
    step = np.full(robot.n, lag[lag > 0.0].mean() / STEPS_PER_LAG)
    short = np.maximum(lag / STEPS_PER_OWN_LAG, STEP_MIN.of(ratios))
    return np.where(lag > 0.0, np.minimum(step, short), step)


def winch_records(robot: Robot, settings: WinchSettings | None = None) -> NDArray[Any]:
    """Return the winches of a robot as an array of `Winch` structs, shape (n,).

    Without drum radius or build-up in the robot, lengths are commanded directly.

    Args:
        robot: Robot description, n cables.
        settings: None takes the defaults.

    Raises:
        InvalidField: A drum, true or believed, from which `length_max` cannot be paid out, or a
            belief about drums that the robot does not have; an integral time that the inner steps
            do not resolve.
    """
    chosen = settings or WinchSettings()
    steps = inner_steps(robot)
    shortest = INTEGRAL_TIME_STEPS_MIN * float(steps.max())
    integral_time = chosen.integral_time
    if integral_time is not None and integral_time < shortest * (1.0 - 1e-9):
        allowed = f"integral_time >= {shortest:g} s for robot {robot.name!r}, finite"
        raise InvalidField("integral_time", f"{integral_time} s", allowed)
    records = np.zeros(robot.n, dtype=record_type(Winch))
    records["lag"] = robot.winch_lag
    records["step_max"] = steps
    records["speed_max"] = robot.speed_max
    records["acceleration_max"] = robot.acceleration_max
    records["integral_rate"] = 0.0 if integral_time is None else 1.0 / integral_time
    records["derivative_time"] = chosen.derivative_time
    records["hysteresis"] = robot.length_hysteresis
    belief = chosen.believed_drum_buildup
    if robot.drum_radius is None or robot.drum_buildup is None:
        if belief is not None:
            allowed = f"None: robot {robot.name!r} has no drum_radius and drum_buildup"
            raise InvalidField("believed_drum_buildup", f"{belief} m", allowed)
        return records
    advantage = 1.0 if robot.drum_advantage is None else robot.drum_advantage
    buildup = advantage * robot.drum_buildup  # per length of cable, not of line
    believed = buildup if belief is None else advantage * np.full(robot.n, belief)
    _check_drums("drum_buildup", robot, robot.drum_radius, buildup)
    _check_drums("believed_drum_buildup", robot, robot.drum_radius, believed)
    records["drum_radius"] = records["believed_radius"] = robot.drum_radius
    records["drum_buildup"] = buildup
    records["believed_buildup"] = believed
    return records


class WinchBatch:
    """Wound lengths of B robots of the same n winches, which follow commands."""

    def __init__(
        self, robot: Robot, unstrained_length: Array, settings: WinchSettings | None = None
    ) -> None:
        """Start at rest.

        Args:
            robot: The plant, n cables.
            unstrained_length: True lengths [m], shape (B, n).
            settings: None takes the defaults.

        Raises:
            InvalidField: As `winch_records`.
        """
        start = batch("unstrained_length", unstrained_length, (robot.n,))
        records = winch_records(robot, settings)
        warp_setup.load(winch_kernels)
        self._records = wp.array(records[None], dtype=Winch, device="cpu")
        self._encoders = Encoders([robot], len(start), settings)
        self._shape = start.shape
        shapes: dict[str, tuple[Any, Any]] = {
            "states": (start.shape, WinchState),
            "command": (start.shape, wp.float64),
            "duration": ((1,), wp.float64),
        }
        self._buffers = Buffers("cpu", shapes)
        states = np.zeros(start.shape, dtype=record_type(WinchState))
        states["length"] = states["wound"] = start
        self._buffers.put("states", states)

    @property
    def length(self) -> Array:
        """True unstrained lengths [m], shape (B, n)."""
        return self._state("length")

    @property
    def rate(self) -> Array:
        """Rate of the true lengths [m/s], shape (B, n)."""
        return self._state("rate")

    def advance(self, command: Array, duration: float) -> None:
        """Follow a constant command.

        Args:
            command: Lengths asked of the drives, by the drums that they assume [m], (B, n).
            duration: [s].
        """
        with self._buffers.lock:
            self._buffers.put("command", command)
            self._buffers.put("duration", np.array([duration]))
            self._buffers.launch(
                "advance", winch_kernels.advance, self._shape,
                self._records, "command", "duration", "states",
            )  # fmt: skip

    def read(self) -> Array:
        """Return lengths read by perfect encoders on the drums [m], shape (B, n)."""
        return self._encoders.read(self._state("wound"))

    def _state(self, name: str) -> Array:
        """Return a number of each winch, shape (B, n)."""
        return np.array(self._buffers.get("states")[name])


class Encoders:
    """Perfect encoders on the drums of B robots of n cables, by the drums that the drives assume.

    Without drums that build up, they say the wound length itself.
    """

    def __init__(
        self, robots: Sequence[Robot], size: int, settings: WinchSettings | None = None
    ) -> None:
        """Take the drums of one robot for all, or of one each.

        Args:
            robots: The plants.
            size: B.
            settings: None takes the defaults.

        Raises:
            InvalidField: As `winch_records`.
        """
        records = stacked(lambda robot: winch_records(robot, settings), robots)
        warp_setup.load(winch_kernels)
        self._records = wp.array(records, dtype=Winch, device="cpu")
        self._shape = (size, robots[0].n)
        shapes = {name: (self._shape, wp.float64) for name in ("length", "reading")}
        self._buffers = Buffers("cpu", shapes)

    def read(self, wound_length: Array) -> Array:
        """Return readings of lengths that the drums have turned for [m], shape (B, n)."""
        with self._buffers.lock:
            self._buffers.put("length", wound_length)
            self._buffers.launch(
                "read", winch_kernels.read, self._shape, self._records, "length", "reading"
            )
            return self._buffers.get("reading")


def lagging_lengths(wound_length: Array, hysteresis: Array) -> Array:
    """Return the true lengths of what drums have turned for, with the hysteresis of winches.

    Args:
        wound_length: In time [m], shape (K, B, n); straight between two of them.
        hysteresis: Of each winch [m], shape (B, n).

    Returns:
        Unstrained lengths [m], shape (K, B, n). The first are in the middle of the hysteresis.
    """
    if not np.any(hysteresis):
        return wound_length
    return _lagging(wound_length, hysteresis, np.zeros(wound_length.shape[1:]))[0]


class PaidOutLengths:
    """Unstrained lengths by what the drums of a robot have turned for, one reading after another.

    The first are in the middle of the hysteresis.
    """

    def __init__(self, robot: Robot) -> None:
        """Take the hysteresis of n winches."""
        self._hysteresis = robot.length_hysteresis[None]
        self._before: Array | None = None
        self._lag = np.zeros(0)

    @classmethod
    def of(cls, robot: Robot) -> PaidOutLengths | None:
        """Return those of a robot whose winches have hysteresis; None where lengths are read."""
        return cls(robot) if robot.length_hysteresis.any() else None

    def __call__(self, wound_length: Array) -> Array:
        """Return the lengths after the next reading [m], both (B, n)."""
        if self._before is None:
            self._before, self._lag = wound_length, np.zeros(wound_length.shape)
        way = np.stack([self._before, wound_length])
        length, self._lag = _lagging(way, self._hysteresis, self._lag)
        self._before = wound_length
        return np.asarray(length[1])


def _lagging(wound_length: Array, hysteresis: Array, lag: Array) -> tuple[Array, Array]:
    """Return true lengths (K, B, n) of wound ones, and lags at the last.

    Args:
        wound_length: shape (K, B, n).
        hysteresis: shape (B, n), or (1, n) of all.
        lag: At the first, shape (B, n).
    """
    warp_setup.load(winch_kernels)
    length = wp.empty(wound_length.shape, dtype=wp.float64, device="cpu")
    lags = wp.array(lag, dtype=wp.float64, device="cpu")
    inputs = [
        wp.array(wound_length, dtype=wp.float64, device="cpu"),
        wp.array(hysteresis, dtype=wp.float64, device="cpu"),
        lags, length,
    ]  # fmt: skip
    wp.launch(winch_kernels.lagging, wound_length.shape[1:], inputs=inputs, device="cpu")
    return np.array(length.numpy()), np.array(lags.numpy())


def _check_drums(name: str, robot: Robot, radius: Array, buildup: Array) -> None:
    """Refuse drums whose cable ends before the longest length."""
    most = radius**2 / robot.length_max
    bad = buildup >= most
    if bad.any():
        i = int(np.argmax(bad))
        allowed = (
            f"below drum_radius^2 / length_max = {most[i]:.6g} m per length of cable, so that the "
            f"drum pays out {robot.length_max[i]:g} m"
        )
        raise InvalidField(f"{name}[{i}]", f"{buildup[i]:g} m", allowed)
