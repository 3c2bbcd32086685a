"""Worlds that move in real time: simulated platforms that sway, with winches, wind and sensors."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import CarosacError, InvalidField
from carosac_toolkit.base.numbers import check_fields
from carosac_toolkit.base.scaled import Scaled, resolved
from carosac_toolkit.drivers.sensors import SensorSettings, check_suite
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.robot.condition_file import find_condition
from carosac_toolkit.robot.robot import Robot
from learned.belief_errors import (
    ERROR_SIZE,
    BeliefErrorModel,
    BeliefErrors,
    erring,
    reach_of,
)
from learned.sensing import Sensing
from learned.worlds import WorldStates
from sim_warp import Simulator

START_ATTEMPTS_MAX = 10  # to find a start near a position at which a plant can rest
ESTIMATOR_FIELDS = ("estimated", "suite", "modelled")  # settings that mean nothing without one
RETREAT_RATIO = 0.1  # share of the way home that each attempt goes


@dataclass(frozen=True, kw_only=True)
class MovingSettings:
    """Plants, winches and sensors of worlds that move.

    Attributes:
        cables: How cables are modelled, as in `sim_warp.Simulator`.
        perturbation: Condition from which the plant and wind of each world are drawn.
        position_bias: Error of the estimated position, constant in an episode, one sigma per axis
            [m].
        length_bias: Error of the encoders, constant in an episode, one sigma per cable [m].
        start_speed: With which the platform starts, one sigma per axis [m/s].
        estimator: Name of the estimator whose belief is observed in some worlds; None: in none.
            All worlds then move in the time steps between the samples of its sensors, as those of
            driver `simulator` do. Its beliefs must hold all that it remembers.
        estimated: Share of the worlds in which it is, one at least. They have the sensors of driver
            `simulator`: their encoders and belief err as these do.
        suite: Sensors that the estimator measures with, as
            `carosac_toolkit.drivers.sensors.check_suite` allows.
        modelled: Whether beliefs err as those of the estimator do on the average, instead of being
            its own: by a model of `learned.belief_errors`, which takes microseconds.
    """

    cables: Literal["particles", "catenary"] = "catenary"
    perturbation: str = "nominal-1"
    position_bias: float = Scaled(0.01, "m", most=0.01)
    length_bias: float = Scaled(5e-3, "m", most=5e-3)
    start_speed: float = 0.2
    estimator: str | None = None
    estimated: float = 1.0
    suite: str = "lengths+imu"
    modelled: bool = False

    def __post_init__(self) -> None:
        """Refuse numbers that make no sense."""
        check_fields(self, not_negative=("position_bias", "length_bias", "start_speed"))
        find_condition(self.perturbation)
        if not 0.0 < self.estimated <= 1.0:
            raise InvalidField("estimated", self.estimated, "0 < estimated <= 1")
        check_suite(self.suite, inertial=True)
        for name in ESTIMATOR_FIELDS:
            usual = getattr(MovingSettings, name)
            if self.estimator is None and getattr(self, name) != usual:
                raise InvalidField(name, repr(getattr(self, name)), f"{usual!r}, or an estimator")

    def without_estimator(self) -> MovingSettings:
        """Return the settings with beliefs that err by a constant."""
        usual = {name: getattr(MovingSettings, name) for name in ESTIMATOR_FIELDS}
        return replace(self, estimator=None, **usual)


class MovingWorlds:
    """A simulator whose worlds have a plant each."""

    def __init__(
        self, robot: Robot, settings: MovingSettings, period: float, size: int, seed: int,
        device: str = "cpu",
    ) -> None:  # fmt: skip
        ratios = Scales(robot).ratios
        settings = resolved(settings, ratios)
        self._encoder_bias = resolved(SensorSettings(), ratios).encoder_bias
        self.robot = robot
        self.size = size
        self._settings = settings
        self._period = period
        self._device = device
        self._simulator = Simulator(
            robot, worlds=size, cables=settings.cables, seed=seed,
            perturbation=settings.perturbation, device=device,
        )  # fmt: skip
        self._rng = np.random.default_rng([seed, 11])
        self._position_bias = np.zeros((size, 3))
        self._length_bias = np.zeros((size, robot.n))
        self._seed = seed
        self._sensing: Sensing | None = None
        self._errors: BeliefErrors | None = None
        self._modelled = np.arange(0)  # worlds
        if settings.estimator is not None:
            count = max(1, round(settings.estimated * size))
            if settings.modelled:
                self._modelled = np.arange(count)
            else:
                self._sensing = Sensing(
                    robot, self._simulator, settings.suite, settings.estimator, count, seed
                )

    @property
    def lacks_errors(self) -> bool:
        """True if beliefs are to err by a model that is not there yet."""
        return len(self._modelled) > 0 and self._errors is None

    def take_errors(self, model: BeliefErrorModel) -> None:
        """Let beliefs err by a model from the next reset on."""
        self._errors = BeliefErrors(model, len(self._modelled), self.robot.n, self._seed)

    def reset(self, rows: NDArray[Any], position: Array) -> WorldStates:
        """Hang on the equilibrium lengths at positions, with some speed; biases are drawn anew.

        These lengths are what would be asked for there, of the nominal robot; where its plant hangs
        on them differs by centimetres. Where it cannot rest it starts on the way home from there.
        """
        count, sensing = len(rows), self._sensing
        self._position_bias[rows] = self._normal(self._settings.position_bias, (count, 3))
        self._length_bias[rows] = self._normal(self._settings.length_bias, (count, self.robot.n))
        speed = self._normal(self._settings.start_speed, (count, 3))
        twist = np.concatenate([speed, np.zeros((count, 3))], axis=1)
        if sensing is not None:
            sensing.renew(rows)
            self._length_bias[: sensing.count] = -sensing.encoder_bias
        mine = rows[rows < len(self._modelled)]
        if len(mine):
            self._length_bias[mine] = self._normal(self._encoder_bias, (len(mine), self.robot.n))
        length = self._lengths(rows, position)
        self._simulator.reset(unstrained_length=length, twist=twist, worlds=rows)
        if sensing is not None:
            sensing.begin(rows)
        if self._errors is not None and len(mine):
            self._errors.begin(mine, *self._motion())
        return self._reached()

    def advance(self, length: Array) -> WorldStates:
        """Let a period pass."""
        asked = length + self._length_bias
        if self._sensing is None:
            self._simulator.step(asked, self._period)
        else:
            self._sensing.advance(length, asked, self._period)
        if self._errors is not None:
            self._errors.advance(*self._motion())
        return self._reached()

    def hung(self, length: Array) -> statics.Equilibrium:
        """Return the rest of all plants on encoder lengths (B, n) [m]; nothing moves."""
        return statics.forward_kinematics(
            self._simulator.fleet, length + self._length_bias, device=self._device
        )

    def state(self) -> dict[str, Any]:
        """Return simulator, biases and their source, sensors and beliefs."""
        return {
            "sensing": None if self._sensing is None else self._sensing.state(),
            "errors": None if self._errors is None else self._errors.state(),
            "simulator": self._simulator.save(),
            "position_bias": self._position_bias.copy(),
            "length_bias": self._length_bias.copy(),
            "rng": self._rng.bit_generator.state,
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from them."""
        self._simulator.restore(state["simulator"])
        self._position_bias = state["position_bias"].copy()
        self._length_bias = state["length_bias"].copy()
        self._rng.bit_generator.state = state["rng"]
        if self._sensing is not None:
            self._sensing.restore(state["sensing"])
        errors = state.get("errors")  # older checkpoints have none
        if errors is not None:
            self.take_errors(errors["model"])
            assert self._errors is not None
            self._errors.restore(errors)

    def _normal(self, sigma: float, shape: tuple[int, int]) -> Array:
        return sigma * self._rng.standard_normal(shape)

    def _lengths(self, rows: NDArray[Any], position: Array) -> Array:
        """Find lengths near given positions on which the plants of some worlds can rest."""
        fleet = self._simulator.fleet.rows(np.asarray(rows, dtype=np.int32))
        where = np.array(position)
        for _ in range(START_ATTEMPTS_MAX):
            asked = statics.inverse_kinematics(self.robot, where, device=self._device)
            length: Array = asked.unstrained_length + self._length_bias[rows]
            rest = statics.forward_kinematics(fleet, length, device=self._device)
            bad = ~(asked.converged & rest.converged & rest.stable)
            if not bad.any():
                return length
            where[bad] += RETREAT_RATIO * (self.robot.home_position - where[bad])
        raise CarosacError(f"{self.robot.name}: a plant that was drawn cannot rest near its home")

    def _motion(self) -> tuple[Array, Array]:
        """Return twists and reaches of the worlds whose beliefs err by a model."""
        state, rows = self._simulator.state.numpy(), self._modelled
        length = state.unstrained_length[rows] - self._length_bias[rows]
        return state.twist[rows], reach_of(
            self.robot, state.position[rows], state.rotation[rows], length
        )

    def _reached(self) -> WorldStates:
        state = self._simulator.state.numpy()
        error = np.zeros((self.size, ERROR_SIZE))
        error[:, :3] = self._position_bias
        if self._errors is not None:
            error[self._modelled] = self._errors.error
        belief = erring(state.time, state.position, state.rotation, state.twist, error)
        return WorldStates(
            position=state.position, rotation=state.rotation, twist=state.twist,
            length=state.unstrained_length - self._length_bias,
            inconsistency=np.full_like(state.unstrained_length, np.nan), tension=state.tension,
            failed=state.failed,
            belief=belief if self._sensing is None else self._sensing.believed(belief),
        )  # fmt: skip
