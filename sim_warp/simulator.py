"""Many simulated cable robots at once: platforms, sagging cables, winches and wind.

Four models of the cables share one interface:

* ``particles``: chains of masses and unilateral springs, advanced by implicit Newton steps
  (`sim_warp.particle_kernels`): sag, sway, slack and waves.
* ``catenary``: quasi-static elastic catenaries on a rigid platform
  (`carosac_toolkit.physics.motion.dynamics`): sag, sway and slack without waves, several times
  faster.
* ``straight``: straight massless springs: the baseline without sag.
* ``xpbd``: chains by extended position-based dynamics (`sim_warp.xpbd_kernels`), the method of game
  engines, for comparison.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Literal, get_args

import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray

from carosac_toolkit.base.arrays import Array, batch, check_rotations
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.base.numbers import check_not_negative, check_positive, check_whole
from carosac_toolkit.base.scaled import Scaled
from carosac_toolkit.physics import warp_setup
from carosac_toolkit.physics.cable.shapes import hanging_cables
from carosac_toolkit.physics.device import check_call
from carosac_toolkit.physics.fleet import Fleet
from carosac_toolkit.physics.motion.dynamics import NodelessDynamics, Placement
from carosac_toolkit.physics.motion.winch import WinchSettings
from carosac_toolkit.physics.motion.worlds import STATE_FIELDS, allocate_worlds, upload_plants
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.physics.rest.nearest import rest_at
from carosac_toolkit.physics.rest.statics import Equilibrium
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.robot.condition_file import find_condition
from carosac_toolkit.robot.perturbations import PlainCondition, draw_plant
from carosac_toolkit.robot.robot import Robot
from sim_warp.arguments import (
    as_robots,
    as_seeds,
    check_lengths,
    check_rows,
)
from sim_warp.particles import ParticleDynamics
from sim_warp.snapshot import Snapshot
from sim_warp.state import StateViews

Cables = Literal["particles", "catenary", "straight", "xpbd"]
TIME_STEPS: dict[str, Scaled] = {
    "particles": Scaled(1.0 / 120.0, "s"), "catenary": Scaled(1.0 / 70.0, "s"),
    "straight": Scaled(1.0 / 120.0, "s"), "xpbd": Scaled(1e-3, "s"),
}  # fmt: skip  # defaults by model
SEGMENTS_MAX = 256
CALL_STEPS_MAX = 1e6
STRAIGHT_DENSITY_KG_PER_M = 1e-12  # statics needs some weight


class Simulator:
    """B worlds, each with a robot of its own, that advance together; float64 throughout."""

    def __init__(
        self,
        robot: Robot | Sequence[Robot],
        *,
        worlds: int | None = None,
        cables: Cables = "particles",
        segments: int = 16,
        time_step: float | None = None,
        device: str = "cpu",
        seed: int | Sequence[int] = 0,
        perturbation: str = "none",
        wind_force: float | None = None,
        wind_time: float | None = None,
        cable_drag: float | None = None,
        winch: WinchSettings | None = None,
        iterations: int = 20,
        at_home: bool = True,
    ) -> None:
        """Place all worlds at rest at home unless told not to; others have failed until `reset`.

        Args:
            robot: The robot of all worlds, or one for each.
            worlds: Number of worlds B; None: one, or as many as there are robots.
            cables: Model of the cables.
            segments: Segments of a cable, for ``particles`` and ``xpbd``.
            time_step: Longest time step [s]; None takes, on the robot ``carosac``, 1/120 s
                (``particles``, ``straight``), 1/70 s (``catenary``) or 1 ms (``xpbd``), and for
                others as much longer or shorter as they sway. `step` divides its duration evenly.
            device: Warp device.
            seed: Seed of the plants and the wind: one number, from which each world gets its own,
                or one for each world.
            perturbation: Condition from which each world's plant and wind are drawn; see
                `carosac_toolkit.robot.perturbations`.
            wind_force: Standard deviation of the force of the wind on the platform per horizontal
                axis [N]; None: as the condition says.
            wind_time: Its correlation time [s]; None: as the condition says.
            cable_drag: Air drag of the cables per mass [1/s]; ``straight`` ones have no mass. None:
                that of each robot, or, where it is unknown, 0.5 on ``carosac``, scaled to its size.
            winch: Response of the drives to commands; None takes the defaults.
            iterations: Passes over the constraints in a time step, for ``xpbd``.
            at_home: False places no world: all have failed until `reset`, which saves time.

        Raises:
            InvalidField: Names the argument; no kernel has run then.
        """
        robots = [robot] if isinstance(robot, Robot) else as_robots(robot)
        check_call(robots[0], device)
        size = len(robots) if worlds is None else worlds
        check_whole("worlds", size, 1, None)
        if len(robots) not in (1, size):
            raise InvalidField("robot", f"{len(robots)} robots", f"1 or {size}, as worlds")
        if cables not in get_args(Cables):
            raise InvalidField("cables", repr(cables), f"one of {list(get_args(Cables))}")
        check_whole("segments", segments, 2, SEGMENTS_MAX)
        check_whole("iterations", iterations, 1, None)
        if time_step is None:
            time_step = TIME_STEPS[cables].of(Scales(robots[0]).ratios)
        check_positive("time_step", time_step, "s")
        if cable_drag is not None:
            check_not_negative("cable_drag", cable_drag, "1/s")
            asked = {id(each): each for each in robots}  # each robot of many worlds once
            for key, each in asked.items():
                asked[key] = replace(each, cable_drag=float(cable_drag))
            robots = [asked[id(each)] for each in robots]
        if not (winch is None or isinstance(winch, WinchSettings)):
            raise InvalidField("winch", type(winch).__name__, "WinchSettings, or None")
        self.cables: Cables = cables
        self.segments = segments
        self.time_step = float(time_step)
        self.device = device
        self.seeds = as_seeds(seed, size)
        self._size = size
        condition = find_condition(perturbation).of(robots[0])
        force = condition.wind_force if wind_force is None else wind_force
        gust = condition.wind_time if wind_time is None else wind_time
        check_positive("wind_time", gust, "s")
        check_not_negative("wind_force", force, "N")
        drawn = robots if perturbation == "none" else _draw(robots, condition, self.seeds)
        self.fleet = Fleet(drawn)
        warp_setup.initialise()
        self._plants = upload_plants(
            self.fleet, device, winch or WinchSettings(), float(force), float(gust)
        )
        self._worlds = allocate_worlds(size, self.fleet.n, device, self.seeds.astype(np.int32))
        command = self._worlds.command  # on the CPU numpy writes to it directly, which is faster
        self._host_command: Array | None = command.numpy() if command.device.is_cpu else None
        self._dynamics = self._make_dynamics(iterations)
        self.state = StateViews(self._worlds, self._dynamics.arrays.get("position"))
        if at_home:
            self._go_home()
        else:
            self._worlds.failed.fill_(1)

    def _make_dynamics(self, iterations: int) -> NodelessDynamics | ParticleDynamics:
        """Allocate the model of the cables."""
        common = (self._plants, self._worlds, self._size, self.fleet.n, self.device)
        if self.cables == "particles":
            return ParticleDynamics(*common, self.segments)
        if self.cables == "xpbd":
            return ParticleDynamics(*common, self.segments, iterations)
        return NodelessDynamics(*common, self.cables)

    def _go_home(self) -> None:
        """Place the worlds that can rest at home, and flag the others."""
        which = np.arange(self._size, dtype=np.int32)
        fleet = self._static_fleet(which)
        home = np.broadcast_to(fleet.home_position, (self._size, 3))
        rest = rest_at(fleet, home, device=self.device)
        sound = rest.converged & rest.stable
        if sound.any():
            start = Placement.of(rest, sound)
            self._place(which[sound], start, np.zeros((int(sound.sum()), 6)))
        if not sound.all():
            self._fail_at_home(np.flatnonzero(~sound).astype(np.int32), fleet)

    def _fail_at_home(self, which: NDArray[np.int32], fleet: Fleet) -> None:
        """Flag worlds as failed, and show them at home on straight cables."""
        worlds = self._worlds
        state = self.state.numpy()
        command = worlds.command.numpy()
        for b in which:
            robot = fleet.robots[min(int(b), len(fleet) - 1)]
            state.position[b], state.rotation[b] = robot.home_position, robot.home_rotation
            anchors = robot.home_position + robot.anchor_points @ robot.home_rotation.T
            straight = np.linalg.norm(robot.exit_points - anchors, axis=1)
            state.unstrained_length[b] = command[b] = straight
            state.failed[b] = True
        for name in ("position", "rotation", "unstrained_length"):
            getattr(worlds, name).assign(getattr(state, name))
        worlds.command.assign(command)
        worlds.failed.assign(state.failed.astype(np.int32))

    def _place(self, which: NDArray[np.int32], start: Placement, twist: Array) -> None:
        """Place worlds; their command holds the lengths that they have wound."""
        self._dynamics.place(which, start, twist)
        command = self._worlds.command.numpy()
        command[which] = start.unstrained_length
        self._worlds.command.assign(command)

    def _static_fleet(self, which: NDArray[np.int32]) -> Fleet:
        """Return the robots of some worlds for the statics: straight cables without weight."""
        fleet = self.fleet.rows(which)
        return _weightless(fleet) if self.cables == "straight" else fleet

    @property
    def size(self) -> int:
        """Number of worlds B."""
        return self._size

    @property
    def robots(self) -> tuple[Robot, ...]:
        """Plants: one for all worlds, or one for each."""
        return self.fleet.robots

    def reset(
        self,
        position: ArrayLike | None = None,
        rotation: ArrayLike | None = None,
        *,
        unstrained_length: ArrayLike | None = None,
        twist: ArrayLike | None = None,
        sliding: ArrayLike | None = None,
        worlds: Sequence[int] | NDArray[Any] | None = None,
    ) -> None:
        """Place worlds at rest in static equilibrium, or anywhere; their winches hold still.

        A position or lengths define a rest. With cables of particles the platform rests within
        micrometres of `position`, in the equilibrium of the chains. Position and lengths together
        define a start away from the equilibrium: the platform is released there, with cables that
        hang between their exit and anchor points as if the platform stood still.

        Args:
            position: Platform origins in W [m], shape (K, 3); None: home, or where lengths hang it.
            rotation: From P to W, shape (K, 3, 3), for a rest with six cables or more only; None:
                home rotation.
            unstrained_length: Lengths [m], shape (K, n); None: those of the rest.
            twist: Velocity with which they start, linear [m/s] then angular [rad/s] of the
                platform origin in W, shape (K, 6); cables move along. None: at rest.
            sliding: Twist along which the platform moved last, shape (K, 6): where there is dry
                friction, it has bent what rubs, but for cables on pulleys. None: `twist`.
            worlds: Indices of K worlds, or a mask of shape (B,); None: all of them.

        Raises:
            InvalidField: A wrong shape, numbers that are not finite, a pose at which that world's
                robot cannot rest, or lengths at which a cable cannot hang. No world has been
                changed then.
        """
        which = self._indices(worlds)
        count = len(which)
        moving = np.zeros((count, 6)) if twist is None else batch("twist", twist, (6,))
        check_rows("twist", moving, count)
        if unstrained_length is not None and (position is not None or rotation is not None):
            start = self._displaced(which, position, rotation, unstrained_length)
        else:
            start = Placement.of(self._rest(which, position, rotation, unstrained_length))
        if sliding is not None:
            before = batch("sliding", sliding, (6,))
            check_rows("sliding", before, count)
            start = replace(start, sliding=before)
        self._place(which, start, moving)

    def step(self, unstrained_length_command: ArrayLike | wp.array, duration: float) -> None:
        """Advance all worlds while the winches follow a constant command.

        Worlds that have failed stand still; see `SimulatorState.failed`.

        Args:
            unstrained_length_command: Lengths asked of the drives [m], shape (B, n); a Warp array
                on the device is used unchecked.
            duration: [s].

        Raises:
            InvalidField: A wrong shape, or a length that is not finite and positive.
        """
        self._advance(unstrained_length_command, duration, follow=False)

    def follow(self, unstrained_length: ArrayLike | wp.array, duration: float) -> None:
        """Advance all worlds while the wound lengths change linearly in time, without winches.

        Args:
            unstrained_length: True lengths at the end [m], shape (B, n).
            duration: [s].

        Raises:
            InvalidField: As `step`.
        """
        self._advance(unstrained_length, duration, follow=True)

    def cable_points(self) -> Array:
        """Return points on the cables as they are now, for pictures and sag.

        Returns:
            Points in W [m], shape (B, n, segments + 1, 3), from tangent point to anchor point.
            Those of particles lie on the cable that their chain approximates, which touches the
            middle of each segment, not on the nodes.
        """
        points: Array = self._dynamics.points(self.segments).numpy()
        return points

    def save(self) -> Snapshot:
        """Copy everything that changes; `restore` continues from there, bit for bit."""
        return Snapshot(
            cables=self.cables,
            segments=self.segments,
            arrays={name: np.array(array.numpy()) for name, array in self._named().items()},
        )

    def restore(self, snapshot: Snapshot) -> None:
        """Continue from a snapshot of a simulator with as many worlds and the same cables.

        The robots are those of this simulator and may differ from those of the snapshot.

        Raises:
            InvalidField: Its kind or size differs. Nothing has been changed then.
        """
        if not isinstance(snapshot, Snapshot):
            raise InvalidField("snapshot", type(snapshot).__name__, "a Snapshot, from save")
        kind = f"{self.cables} of {self.segments} segments"
        other = f"{snapshot.cables} of {snapshot.segments} segments"
        if other != kind:
            raise InvalidField("snapshot", other, kind)
        for name, array in self._named().items():
            present = array.numpy()
            saved = snapshot.arrays.get(name)
            if saved is None or saved.shape != present.shape:
                shape = None if saved is None else saved.shape
                raise InvalidField(f"snapshot.{name}", f"shape {shape}", f"shape {present.shape}")
            if saved.dtype != present.dtype:
                raise InvalidField(f"snapshot.{name}", saved.dtype, str(present.dtype))
        for name, array in self._named().items():
            array.assign(snapshot.arrays[name])

    def _named(self) -> dict[str, wp.array]:
        """Return the device arrays of everything that changes, by name."""
        shared = {name: getattr(self._worlds, name) for name in STATE_FIELDS}
        return shared | {f"cable_{name}": array for name, array in self._dynamics.arrays.items()}

    def _advance(self, command: ArrayLike | wp.array, duration: float, *, follow: bool) -> None:
        """Check and upload the command, then launch."""
        check_positive("duration", duration, "s")
        shape = (self._size, self.fleet.n)
        if isinstance(command, wp.array):
            if command.shape != shape:
                raise InvalidField("command", f"shape {command.shape}", f"shape {shape}")
            if command.dtype != wp.float64:
                raise InvalidField("command", f"a Warp array of {command.dtype}", "of wp.float64")
            wp.copy(self._worlds.command, command)
        else:
            name = "unstrained_length" if follow else "unstrained_length_command"
            lengths = batch(name, command, (self.fleet.n,))
            check_rows(name, lengths, self._size)
            check_lengths(name, lengths)
            if self._host_command is None:
                self._worlds.command.assign(lengths)
            else:
                self._host_command[:] = lengths
        if duration > CALL_STEPS_MAX * self.time_step:
            allowed = f"at most {CALL_STEPS_MAX:g} time steps of {self.time_step:g} s"
            raise InvalidField("duration", f"{duration} s", allowed)
        count = max(1, int(np.ceil(duration / self.time_step - 1e-6)))
        self._dynamics.advance(follow, count, duration / count)

    def _indices(self, worlds: Sequence[int] | NDArray[Any] | None) -> NDArray[np.int32]:
        """Return indices of worlds; refuse what selects none or one twice."""
        if worlds is None:
            return np.arange(self._size, dtype=np.int32)
        try:
            indices = np.asarray(worlds)
        except ValueError:
            indices = np.empty((0, 0))
        if indices.dtype == bool and indices.shape == (self._size,):
            indices = np.flatnonzero(indices)
        whole = indices.ndim == 1 and len(indices) > 0 and np.issubdtype(indices.dtype, np.integer)
        allowed = f"indices below {self._size}, each once, or a mask of shape ({self._size},)"
        if (
            not whole
            or indices.min() < 0
            or indices.max() >= self._size
            or len(np.unique(indices)) < len(indices)
        ):
            raise InvalidField("worlds", worlds, allowed)
        return indices.astype(np.int32)

    def _displaced(
        self,
        which: NDArray[np.int32],
        position: ArrayLike | None,
        rotation: ArrayLike | None,
        unstrained_length: ArrayLike,
    ) -> Placement:
        """Return poses away from equilibrium; refuse lengths at which a cable cannot hang."""
        fleet, count = self._static_fleet(which), len(which)
        if position is None:
            raise InvalidField("position", None, "a position beside rotation and unstrained_length")
        where = batch("position", position, (3,))
        turn = np.broadcast_to(fleet.home_rotation, (count, 3, 3))
        if rotation is not None:
            turn = batch("rotation", rotation, (3, 3))
            check_rotations("rotation", turn)
        lengths = batch("unstrained_length", unstrained_length, (self.fleet.n,))
        for name, value in (
            ("position", where), ("rotation", turn), ("unstrained_length", lengths),
        ):  # fmt: skip
            check_rows(name, value, count)
        check_lengths("unstrained_length", lengths)
        cables = hanging_cables(fleet, where, turn, lengths, device=self.device)
        if not cables.valid.all():
            k, i = (int(x) for x in np.argwhere(~cables.valid)[0])
            allowed = f"a length at which this cable can hang to its anchor point at position[{k}]"
            raise InvalidField(f"unstrained_length[{k}, {i}]", f"{lengths[k, i]} m", allowed)
        return Placement(
            position=where,
            rotation=turn,
            unstrained_length=lengths,
            tension=cables.tension,
            exit_tension=cables.exit_tension,
            at_rest=False,
        )

    def _rest(
        self,
        which: NDArray[np.int32],
        position: ArrayLike | None,
        rotation: ArrayLike | None,
        unstrained_length: ArrayLike | None,
    ) -> Equilibrium:
        """Return equilibria of some worlds; refuse the first that has none by its name."""
        fleet = self._static_fleet(which)
        count = len(which)
        if unstrained_length is not None:
            name, given = "unstrained_length", batch("unstrained_length", unstrained_length,
                                                     (self.fleet.n,))  # fmt: skip
            check_rows(name, given, count)
            rest = statics.forward_kinematics(fleet, given, device=self.device)
        else:
            name = "position"
            home = np.broadcast_to(fleet.home_position, (count, 3))
            given = home if position is None else batch("position", position, (3,))
            check_rows(name, given, count)
            held = None
            if rotation is not None:
                held = batch("rotation", rotation, (3, 3))
                check_rows("rotation", held, count)
                check_rotations("rotation", held)
            rest = rest_at(fleet, given, held, device=self.device)
        sound = rest.converged & rest.stable
        if not sound.all():
            k = int(np.argmin(sound))
            reason = (
                statics.STATUS_REASONS[rest.status[k]] if not rest.converged[k] else "not stable"
            )
            robot = f"the robot of world {which[k]}" if self._size > 1 else "the robot"
            raise InvalidField(f"{name}[{k}]", given[k], f"where {robot} can rest ({reason})")
        return rest


def _draw(robots: list[Robot], condition: PlainCondition, seeds: NDArray[np.int64]) -> list[Robot]:
    """Draw the plant of each world."""
    each = robots * len(seeds) if len(robots) == 1 else robots
    draws = [np.random.default_rng([int(seed), 1]) for seed in seeds]
    return [draw_plant(robot, condition, draw) for robot, draw in zip(each, draws, strict=True)]


def _weightless(fleet: Fleet) -> Fleet:
    """Return the same robots on cables without weight."""
    light = np.full(fleet.n, STRAIGHT_DENSITY_KG_PER_M)
    return Fleet([replace(robot, linear_density=light) for robot in fleet.robots])
