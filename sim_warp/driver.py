"""The driver `simulator`: a simulated robot with inertia, cables that sag, winches and wind."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from carosac_toolkit.base.arrays import Array, as_floats
from carosac_toolkit.base.errors import CarosacError, InvalidField
from carosac_toolkit.base.numbers import check_not_negative, check_positive
from carosac_toolkit.base.scaled import Scaled
from carosac_toolkit.drivers.simulated import SimulatedDriver, SimulatedSettings
from carosac_toolkit.loop.values import State
from carosac_toolkit.physics.cable.swivel import swivel_angle
from carosac_toolkit.physics.motion.winch import Encoders, WinchSettings
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.robot.robot import Robot
from sim_warp.arguments import as_seeds
from sim_warp.options import CableOptions
from sim_warp.simulator import TIME_STEPS, Simulator

BATCH_FIELDS = (
    "speed_max", "acceleration_max", "length_min", "length_max", "workspace_min", "workspace_max",
    "gravity",
)  # fmt: skip
"""Fields that command limits and sensors take from the first robot of a batch."""
# One for all sensor suites, so that no sensor changes the motion: 5 ms, and a little, so that a
# robot that differs a little needs no step more in 5 ms.
TIME_STEP = Scaled(5.05e-3, "s")


@dataclass(frozen=True, kw_only=True)
class SimDriverSettings(CableOptions, SimulatedSettings):
    """Settings of `SimDriver`: those of every simulated driver, of the cables, and of the wind.

    A `time_step` of None takes 5 ms on the robot ``carosac``, and as much longer or shorter as
    others sway, or that of the cable model if shorter.

    Attributes:
        wind_force: Standard deviation of the force of the wind on the platform per horizontal
            axis [N]; in a study, as the condition says.
        wind_time: Correlation time of the wind [s]; in a study, as the condition says.
    """

    wind_force: float = 0.0
    wind_time: float = 2.0

    def __post_init__(self) -> None:
        """Refuse what cannot be simulated."""
        CableOptions.__post_init__(self)
        SimulatedSettings.__post_init__(self)
        check_not_negative("wind_force", self.wind_force, "N")
        check_positive("wind_time", self.wind_time, "s")

    def derived(self, robot: Robot) -> SimDriverSettings:
        """Return them with the time step for a robot, where it was left open."""
        if self.time_step is not None:
            return self
        ratios = Scales(robot).ratios
        step = min(TIME_STEP.of(ratios), TIME_STEPS[self.cables].of(ratios))
        return replace(self, time_step=step)


class SimPlant:
    """B robots in a `Simulator`, as a `carosac_toolkit.drivers.plant.Plant`.

    Attributes:
        robot: The plant robot, the first one where each has its own; n cables.
        size: B.
        inertial: True.
        simulator: The simulator that moves them.
    """

    inertial = True

    def __init__(
        self,
        robot: Robot | Sequence[Robot],
        settings: SimDriverSettings | None = None,
        *,
        size: int | None = None,
        seed: int | Sequence[int] = 0,
    ) -> None:
        """Create the worlds; call `reset` before anything else.

        Args:
            robot: The plant of all worlds, or one for each; nothing more is drawn.
            settings: Cables, winches and wind; None takes the defaults.
            size: Number of worlds B; None: one, or as many as there are robots.
            seed: Seed of the wind, from which each world gets its own, or one for each world.

        Raises:
            InvalidField: As `Simulator`.
        """
        chosen = settings or SimDriverSettings()
        chosen = chosen.derived(robot if isinstance(robot, Robot) else robot[0])
        options = chosen.simulator_options
        simulator = Simulator(
            robot, worlds=size, seed=seed, winch=chosen.winch,
            wind_force=chosen.wind_force, wind_time=chosen.wind_time, **options,
        )  # fmt: skip
        self._wrap(simulator, chosen.winch)

    @classmethod
    def around(cls, simulator: Simulator) -> SimPlant:
        """Wrap a simulator with default winches that the caller resets and steps.

        The plant shows the worlds as they were at the last call of `look`.
        """
        plant = cls.__new__(cls)
        plant._wrap(simulator, None)
        return plant

    def _wrap(self, simulator: Simulator, winch: WinchSettings | None) -> None:
        """Set all attributes from a simulator."""
        self.simulator = simulator
        self.robot = simulator.robots[0]
        self.size = simulator.size
        self._encoders = Encoders(simulator.robots, self.size, winch)
        self.look()

    def look(self) -> None:
        """Read the present state of the worlds."""
        self._state = self.simulator.state.numpy()

    def reset(self, position: Array) -> None:
        """Place the worlds at rest at positions in W [m], shape (B, 3); the wind starts over.

        Raises:
            InvalidField: One of them cannot rest there.
        """
        try:
            self.simulator.reset(position)
        except InvalidField as error:
            row = error.field.removeprefix("position") if self.size > 1 else ""
            raise InvalidField(f"start_position{row}", error.value, error.allowed) from error
        self.look()

    def advance(self, command: Array, duration: float) -> None:
        """Advance the worlds while the winches follow a constant command.

        Args:
            command: Lengths asked of the winches [m], shape (B, n).
            duration: [s].

        Raises:
            CarosacError: No time step, however short, had a finite solution in some worlds.
        """
        self.simulator.step(command, duration)
        self.look()
        if self._state.failed.any():
            worlds = np.flatnonzero(self._state.failed)
            names = ", ".join(str(b) for b in worlds[:8]) + (", ..." if len(worlds) > 8 else "")
            raise CarosacError(
                f"simulator: no finite motion in world {names} after "
                f"{self._state.time[worlds[0]]:.3f} s, with lengths of "
                f"{np.round(self._state.unstrained_length[worlds[0]], 3)} m"
            )

    def truth(self) -> State:
        """Return pose, twist, wound lengths and tensions."""
        state = self._state
        return State(
            time=state.time,
            position=state.position,
            rotation=state.rotation,
            twist=state.twist,
            unstrained_length=state.unstrained_length,
            tension=state.tension,
        )

    def acceleration(self) -> Array:
        """Return linear [m/s^2], then angular [rad/s^2] acceleration of the origin in W, (B, 6)."""
        return self._state.acceleration

    def swivel_angles(self) -> Array:
        """Return how far pulleys have swivelled, by how cables leave them [rad], shape (B, n)."""
        points = self.cable_points()
        leaving = points[:, :, 1] - points[:, :, 0]
        robots = self.simulator.robots
        if len(robots) == 1:
            return swivel_angle(robots[0], leaving)
        pairs = zip(robots, leaving, strict=True)
        return np.concatenate([swivel_angle(robot, each[None]) for robot, each in pairs])

    def cable_points(self) -> Array:
        """Return points on the cables in W [m], shape (B, n, segments + 1, 3); for pictures."""
        return self.simulator.cable_points()

    def read_lengths(self) -> Array:
        """Return readings of perfect encoders, by the drum parameters of the drives [m], (B, n)."""
        return self._encoders.read(self._state.wound_length)


class SimDriver(SimulatedDriver):
    """A simulated robot that sways, or several at once if `start_position` has a row for each.

    It has suites with an IMU; the wind is that of the settings.
    """

    Settings: ClassVar = SimDriverSettings
    name: ClassVar = "simulator"

    @classmethod
    def build(
        cls, robot: Robot, settings: SimDriverSettings | None = None, *, seed: int = 0
    ) -> SimDriver:
        """Build one for a plant; `seed` draws the wind, and bias and noise of the sensors."""
        chosen = settings or SimDriverSettings()
        start = chosen.start_position
        each = start is not None and as_floats("start_position", start).ndim == 2
        size = len(start) if start is not None and each else 1
        return cls(SimPlant(robot, chosen, size=size, seed=seed), chosen, seed)

    @classmethod
    def build_batch(
        cls, robots: Sequence[Robot], settings: SimDriverSettings, *, seeds: Sequence[int]
    ) -> SimDriver:
        """Build one for several plants, each as `build` builds it alone.

        Args:
            robots: The plants; their limits and gravity must be those of the first one.
            settings: Shared; `start_position` may have a row for each.
            seeds: Seeds of the wind and the sensors, one for each.

        Raises:
            InvalidField: The plants differ in limits or gravity.
        """
        for name in BATCH_FIELDS:
            first = getattr(robots[0], name)
            if any(not np.array_equal(getattr(robot, name), first) for robot in robots):
                raise InvalidField(f"robots: {name}", "several", "the same for all of a batch")
        winds = [int(as_seeds(seed, 1)[0]) for seed in seeds]
        return cls(SimPlant(robots, settings, seed=winds), settings, seeds)
