"""Sensors and estimators of simulated worlds that are set down anew one by one."""

from __future__ import annotations

from dataclasses import fields, is_dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import CarosacError, InvalidField
from carosac_toolkit.base.scaled import resolved
from carosac_toolkit.drivers.sensor_suite import SensorSuite
from carosac_toolkit.drivers.sensors import SensorSettings
from carosac_toolkit.loop import plugins
from carosac_toolkit.loop.plugin_builder import build_plugin, uses_of
from carosac_toolkit.loop.protocols import Estimator
from carosac_toolkit.loop.values import Belief, Command, Measurement
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.robot.robot import Robot
from sim_warp import Simulator
from sim_warp.driver import SimPlant

TRIAL_STEP_S = 0.01  # after which an estimator is tried


class Sensing:
    """Sensors of the first worlds of a simulator, and the beliefs of estimators there.

    Sensors, their rates and delays are those of driver `simulator`. Each world has a belief of its
    own, so that one can be set down anew while the others go on.

    Attributes:
        count: In how many worlds there is an estimator.
    """

    def __init__(
        self, robot: Robot, simulator: Simulator, suite: str, estimator: str, count: int, seed: int
    ) -> None:
        """Make them; nothing is believed before `begin`.

        Args:
            robot: The nominal one, which the estimator knows.
            simulator: With the plants; it may have more worlds.
            suite: As `carosac_toolkit.drivers.sensors.check_suite` allows.
            estimator: By its name as a plug-in; its beliefs hold all that it remembers.
            count: In how many worlds.
            seed: Of the sensors.
        """
        self._name = estimator
        self.count = count
        self._beliefs: list[Belief | None] = [None] * count
        self._plant = SimPlant.around(simulator)
        sensors = resolved(SensorSettings(), Scales(robot).ratios)
        self._sensors = SensorSuite(suite, sensors, self._plant, seed)
        self._estimator: Estimator = build_plugin(
            plugins.load("estimators", estimator), robot, where=f"estimator.{estimator}",
            offered=uses_of(suite.split("+")),
        )  # fmt: skip
        self._tried = False
        self._now = 0.0
        self._sensors.sample(self._plant, self._now)

    @property
    def encoder_bias(self) -> Array:
        """Encoder errors of the worlds with an estimator [m], shape (count, n)."""
        return self._sensors.encoder_bias[: self.count]

    def renew(self, rows: NDArray[Any]) -> None:
        """Give some worlds other sensors of the same make; they are about to be set down anew."""
        self._sensors.renew(rows)

    def begin(self, rows: NDArray[Any]) -> None:
        """Let the estimators of some worlds start, where these have just been set down.

        Raises:
            InvalidField: The estimator remembers something beside its beliefs, or gives no twist.
        """
        self._plant.look()
        self._sensors.restart(rows, self._plant, self._now)
        measured = self._sensors.measure(self._now)
        if not self._tried:
            self._try(one_row(measured, 0))
        for row in rows[rows < self.count]:
            self._beliefs[row] = self._estimator.reset(one_row(measured, row))

    def _try(self, measured: Measurement) -> None:
        """Make sure that a belief can go on after another one has begun, or been restored."""
        first = self._estimator.reset(measured)
        self._estimator.reset(measured)
        sent = Command(time=measured.time, unstrained_length=measured.unstrained_length)
        later = replace(measured, time=measured.time + TRIAL_STEP_S, imu=None)
        try:
            belief = self._estimator.update(first, sent, later)
        except CarosacError as error:
            allowed = f"one whose beliefs hold all that it remembers; this one says: {error}"
            raise InvalidField("estimator", repr(self._name), allowed) from error
        if belief.twist is None:
            allowed = "one that gives velocities, such as dynamic_estimator"
            raise InvalidField("estimator", repr(self._name), allowed)
        self._tried = True

    def advance(self, command: Array, asked: Array, duration: float) -> None:
        """Let time pass with a stop at each sample, then let the estimators measure.

        Args:
            command: Lengths as encoders say them [m], shape (B, n).
            asked: What that comes to as lengths that are wound [m], shape (B, n).
            duration: [s].
        """
        for step in self._sensors.steps(self._now, duration):
            self._plant.simulator.step(asked, step)
            self._plant.look()
            self._now += step
            self._sensors.sample(self._plant, self._now)
        measured = self._sensors.measure(self._now)
        sent = Command(time=measured.time - duration, unstrained_length=command)
        for row, belief in enumerate(self._beliefs):
            if belief is not None:
                news = one_row(sent, row), one_row(measured, row)
                self._beliefs[row] = self._estimator.update(belief, *news)

    def believed(self, truth: Belief) -> Belief:
        """Return the beliefs of the estimators, and another one where there is none.

        While an estimator stands nowhere it believes in the last pose, at rest.
        """
        position, rotation = np.array(truth.position), np.array(truth.rotation)
        assert truth.twist is not None
        twist = np.array(truth.twist)
        for row, belief in enumerate(self._beliefs):
            if belief is not None:
                position[row], rotation[row] = belief.position[0], belief.rotation[0]
                twist[row] = 0.0 if belief.twist is None else belief.twist[0]
        return replace(truth, position=position, rotation=rotation, twist=twist)

    def state(self) -> dict[str, Any]:
        """Return everything that changes."""
        return {"sensors": self._sensors.state(), "beliefs": list(self._beliefs), "now": self._now}

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from there; the simulator has been restored before."""
        self._plant.look()
        self._sensors.restore(state["sensors"])
        self._beliefs = list(state["beliefs"])
        self._now = state["now"]


def one_row(value: Any, row: int) -> Any:
    """Return one row of everything batched in a value that flows, as a batch of one."""
    if isinstance(value, np.ndarray):
        return value[row : row + 1]
    if not is_dataclass(value):
        return value
    parts = {part.name: one_row(getattr(value, part.name), row) for part in fields(value)}
    return replace(value, **parts)  # type: ignore[type-var]
