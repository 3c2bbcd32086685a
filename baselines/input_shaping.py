r"""Input shaping on the catenary inverse kinematics: the reference, moved so that it ends calm.

A suspended platform on few cables sways: four cables leave two slow modes, which hardly anything
damps. A shaper convolves the reference with impulses that cancel a mode (`baselines.shapers`). The
frequencies differ from pose to pose, by a factor of two in the workspace of ``carosac``. They are
those of the pose of rest at the reference at this moment, and impulses are set apart by the phase
that a mode has gone through since, not by a time: the second one comes when the mode has swung by
half a period, however its frequency has changed meanwhile, and as the frequency is as smooth as the
reference, so is the shaped one. Sway lives on the tension, so its stiffness is that of a pendulum:
a platform that accelerates upwards swings faster.

Only motion along its own direction excites a mode. With its excitation :math:`g_k` (a row of
`SwayModes.excitation`) and the shaped reference :math:`s_k`, the platform is sent to

.. math:: u = r + \sum_k d_k\, g_k^\top (s_k - r), \qquad
    [d_1 \dots d_K] = G (G^\top G + \epsilon m 1)^{-1}, \quad G = [g_1 \dots g_K],

so that :math:`g_k^\top u = g_k^\top s_k`, and motion that excites nothing is left as it is. The
small :math:`\epsilon` lets a mode go smoothly where translation hardly excites it.

The impulse times lie about the present: with preview, what a shaper gets is the reference read
ahead by its mean delay, so the shaped path is late by nothing.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar, Literal, Self, get_args

import numpy as np

from baselines.kinematic_solver_controller import UnreachableReference, rest_at
from baselines.lookahead import LookaheadSettings, delay_of, interpolated
from baselines.shaped_signal import ShapedSignal, SignalHistory
from baselines.shapers import SHAPER_NAMES, Shaper, impulses, mean_delay
from baselines.sway_modes import SwayModes, sway_modes
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.base.numbers import check_not_negative, check_positive
from carosac_toolkit.base.scaled import Scaled, resolved
from carosac_toolkit.loop.values import Belief, Command, Reference
from carosac_toolkit.physics.rest import nearest, statics
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.robot.robot import Robot

ShapingDirections = Literal["modal", "all"]
CONTROLLER_NAME = "input_shaping"  # in messages
UNEXCITED_MASS_RATIO = 2e-3  # epsilon: below this share of the mass a mode is not excited
WORKSPACE_GRID_POSES = 5  # along each side of the workspace box, to find the slowest sway


@dataclass(frozen=True, kw_only=True)
class InputShapingSettings(LookaheadSettings):
    """Settings of `InputShaping`.

    Attributes:
        shaper: ``zv`` or, wider and slower, ``zvd``.
        frequency_max: Modes that are slower at home are shaped [Hz]; 0 shapes none. None: those
            that the winches can follow, slower than 1 / (2 pi lag).
        directions: ``modal``: each shaper acts on motion that excites its mode; ``all``: all
            shapers, one after the other, act on all motion.
        preview: Whether the reference is read ahead by the mean delay of the shapers.
        start_time: In this time after the reset the look ahead grows from 0 to its full size [s]:
            a motion that begins at once cannot have been prepared. The default is that of
            ``carosac``, and scales with the robot.
    """

    shaper: Shaper = "zv"
    frequency_max: float | None = None
    directions: ShapingDirections = "modal"
    preview: bool = True
    start_time: float = Scaled(1.0, "s")

    def __post_init__(self) -> None:
        """Refuse what makes no sense."""
        super().__post_init__()
        for name, allowed in (
            ("shaper", SHAPER_NAMES),
            ("directions", get_args(ShapingDirections)),
        ):
            if getattr(self, name) not in allowed:
                raise InvalidField(name, repr(getattr(self, name)), f"one of {list(allowed)}")
        if not isinstance(self.preview, bool):
            raise InvalidField("preview", repr(self.preview), "true or false")
        if self.frequency_max is not None:
            check_not_negative("frequency_max", self.frequency_max, "Hz")
        check_positive("start_time", self.start_time, "s")


class InputShaping:
    """Sends equilibrium lengths at the shaped reference, as the kinematic solver does at its own.

    Attributes:
        period: Time between two commands [s].
        horizon: How far ahead of now it needs the reference [s].
        lag: Mean delay of each shaper in the slowest pose of the workspace [s], shape (K,), one for
            each mode that is shaped, or a single one for all directions: without preview the
            platform is late by it along the shaped direction.
        modes: How many modes it shapes.
        feedback: False if its commands follow from the reference alone, with a gain of 0.
    """

    Settings: ClassVar = InputShapingSettings
    batched: ClassVar = True
    _correction: Array
    _start: Array | None

    def __init__(self, robot: Robot, settings: InputShapingSettings) -> None:
        settings = resolved(settings, Scales(robot).ratios)
        delay = delay_of(robot, settings)
        self._robot, self._settings = robot, settings
        self._delay = delay
        self.modes = _slow_modes(robot, frequency_max_of(robot, settings))
        self.lag = self._largest_delays()
        self.period = settings.period
        self.feedback = settings.gain > 0.0
        lead = delay + (float(self.lag.max(initial=0.0)) if settings.preview else 0.0)
        self.horizon = settings.period * float(np.ceil(lead / settings.period + 1e-9))
        self._forget(1)

    @classmethod
    def build(
        cls, robot: Robot, settings: InputShapingSettings | None = None, *, seed: int = 0
    ) -> Self:
        """Make one for the nominal robot; it draws no random numbers, so `seed` has no effect."""
        return cls(robot, settings or InputShapingSettings())

    @property
    def remark(self) -> str | None:
        """Reason why it does nothing for this robot, or None."""
        if self.modes:
            return None
        return (
            "no mode of this robot at home is slower than "
            f"{frequency_max_of(self._robot, self._settings):.3g} Hz: "
            "nothing is shaped, and its commands are those of kinematic_solver"
        )

    def reset(self, belief: Belief) -> None:
        """Forget the correction and all of the reference that has gone by."""
        self._forget(len(belief.position))

    def command(self, belief: Belief, reference: Reference) -> Command:
        """Return the equilibrium lengths at the shaped reference.

        Raises:
            UnreachableReference: There is no stable rest within the tension limits there.
            InvalidField: The time of the reference does not go on.
        """
        error = reference.position[:, 0] - belief.position
        self._correction = self._correction + self._settings.gain * self.period * error
        when = (reference.time[:, 0] + self._delay)[:, None]
        aim = interpolated(when, reference.time, reference.position)[:, 0]
        if self.modes:
            aim = self._shaped(aim, reference)
        rest = rest_at(self._robot, aim + self._correction, CONTROLLER_NAME)
        return Command(time=belief.time, unstrained_length=rest.unstrained_length)

    def _forget(self, size: int) -> None:
        """Start anew with B robots at rest."""
        self._correction = np.zeros((size, 3))
        self._start = None
        self._past = [SignalHistory() for _ in self.lag]
        self._signals = [ShapedSignal(self._settings.shaper) for _ in range(self.modes)]

    def _shaped(self, aim: Array, reference: Reference) -> Array:
        """Return the shaped reference [m], (B, 3), whose unshaped value is `aim`."""
        now = reference.time[:, 0]
        if self._start is None:
            self._start = now
        elif not (now > self._past[0].last).all():
            allowed = "later than in the last call, or reset() in between"
            raise InvalidField("reference.time[0]", f"{now} s", allowed)
        modes = sway_modes(self._robot, rest_at(self._robot, aim, CONTROLLER_NAME), self.modes)
        if not (modes.frequency > 0.0).all():
            row = int((~(modes.frequency > 0.0)).any(axis=1).argmax())
            raise UnreachableReference(
                f"input_shaping: position {aim[row].round(4)} m: rest is not stable there"
            )
        modes = replace(modes, frequency=modes.frequency * self._stiffening(reference))
        signals = self._prepared(reference, self._delays(modes), now - self._start)
        chained = self._settings.directions == "all"
        made: list[Array] = []
        for k, shaper in enumerate(self._signals):
            value = (made or signals)[-1] if chained else signals[k]
            made.append(shaper.next(now, value, modes.frequency[:, k], modes.damping[:, k]))
        return made[-1] if chained else self._joined(aim, np.stack(made, axis=1), modes.excitation)

    def _stiffening(self, reference: Reference) -> Array:
        """Return the frequency ratio of a pendulum in the accelerated frame, shape (B, 1).

        Within a quarter of gravity and four times as much: half and twice the frequency.
        """
        when = (reference.time[:, 0] + self._delay)[:, None]
        rise = interpolated(when, reference.time, reference.acceleration)[:, 0, 2:]
        return np.asarray(np.sqrt(np.clip(1.0 + rise / self._robot.gravity, 0.25, 4.0)))

    def _prepared(self, reference: Reference, delays: list[Array], elapsed: Array) -> list[Array]:
        """Return the input of each shaper, (B, 3), read ahead so that its output is in time.

        The look ahead grows smoothly after the reset. It is as long as the slowest pose of the
        workspace needs; where the mode is faster, the rest is waited for.
        """
        now = reference.time[:, 0]
        share = np.clip(elapsed / self._settings.start_time, 0.0, 1.0)
        smooth = share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
        made = []
        for past, lag, delay in zip(self._past, self.lag, delays, strict=True):
            lead = self._delay + (lag if self._settings.preview else 0.0)
            when = (now + lead * smooth)[:, None]
            read = interpolated(when, reference.time, reference.position)[:, 0]
            past.add(now, read, keep=float(lag))
            made.append(past.at((now - np.maximum(lag - delay, 0.0))[:, None])[:, 0])
        return made

    def _joined(self, aim: Array, shaped: Array, excitation: Array) -> Array:
        """Replace the part of `aim` that excites each mode by its shaped one: (B, 3) [m].

        Args:
            aim: (B, 3) [m].
            shaped: The reference after the shaper of each mode [m], (B, K, 3).
            excitation: Of each mode, (B, K, 3).
        """
        along = np.einsum("bki,bki->bk", excitation, shaped - aim[:, None])
        gram = excitation @ excitation.swapaxes(1, 2)
        small = UNEXCITED_MASS_RATIO * self._robot.mass * np.eye(self.modes)
        weights = np.linalg.solve(gram + small, along[..., None])
        return aim + np.asarray((excitation.swapaxes(1, 2) @ weights)[..., 0])

    def _delays(self, modes: SwayModes) -> list[Array]:
        """Return the mean delay of each shaper [s], (B,); one of all where they act in series."""
        kind, columns = self._settings.shaper, range(modes.frequency.shape[1])
        each = [
            mean_delay(impulses(kind, modes.frequency[:, k], modes.damping[:, k])) for k in columns
        ]
        return [np.sum(each, axis=0)] if self._settings.directions == "all" else each

    def _largest_delays(self) -> Array:
        """Return the mean delay of each shaper at the slowest sway of the workspace box [s]."""
        if self.modes == 0:
            return np.zeros(0)
        box = zip(self._robot.workspace_min, self._robot.workspace_max, strict=True)
        sides = [np.linspace(low, high, WORKSPACE_GRID_POSES) for low, high in box]
        poses = np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1).reshape(-1, 3)
        rest = nearest.rest_at(self._robot, poses)
        stable = rest.converged & rest.stable
        poses = np.vstack([self._robot.home_position, rest.position[stable]])
        delays = self._delays(
            sway_modes(self._robot, rest_at(self._robot, poses, CONTROLLER_NAME), self.modes)
        )
        return np.array([delay.max() for delay in delays])


def frequency_max_of(robot: Robot, settings: InputShapingSettings) -> float:
    """Return the frequency below which modes are shaped [Hz]; infinite for winches without lag."""
    if settings.frequency_max is not None:
        return settings.frequency_max
    lag = float(robot.winch_lag.mean())
    return float(1.0 / (2.0 * np.pi * lag)) if lag > 0.0 else np.inf


def _slow_modes(robot: Robot, frequency_max: float) -> int:
    """Count the modes at home that are slower than a limit.

    Raises:
        UnreachableReference: The robot cannot rest at home, or is not stable there.
    """
    rest = statics.inverse_kinematics(robot, robot.home_position[None])
    if not rest.converged[0]:
        reason = statics.STATUS_REASONS[rest.status[0]]
        raise UnreachableReference(f"input_shaping: {robot.name} at home: {reason}")
    if not rest.stable[0]:
        raise UnreachableReference(f"input_shaping: {robot.name} at home: rest is not stable there")
    return int((sway_modes(robot, rest, 6).frequency[0] < frequency_max).sum())
