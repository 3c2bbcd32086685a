"""A simulated robot that differs from its file, as a new robot differs from a first guess."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calibration.guide.samples import Rest
from calibration.self_calibration.settings import HOME, Distance
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.base.scaled import resolved
from carosac_toolkit.drivers.plant import Plant
from carosac_toolkit.drivers.quasi_static import QuasiStaticPlant
from carosac_toolkit.drivers.sensors import SensorSettings
from carosac_toolkit.loop.values import State
from carosac_toolkit.physics.cable.drum import drums_of
from carosac_toolkit.physics.cable.straight_line import straight_length
from carosac_toolkit.physics.rest import tension_distribution
from carosac_toolkit.physics.rest.structure import structure_matrix
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.robot.robot import Robot

SIDEWAYS_SHARE = 0.08  # of the longest cable: 1 sigma per horizontal axis of an exit point
HEIGHT_SHARE = 0.015  # of the longest cable: 1 sigma of the height, which a level floor tells
DISTANCE_SIGMA_M = 0.02  # [m] of its distance from home, as measured by hand
RADIUS_SHARE = 0.01  # of the drum radius
BUILDUP_SHARE = 0.15  # of the build-up
STIFFNESS_SHARE = 0.3  # of the stiffness of the cables
MASS_SHARE = 0.02  # of the mass
LINE_SIGMA_M = 0.5e-3  # [m] of the line of a drum at each rest: friction, layers, the hand
TAPE_SIGMA_M = 1e-3  # [m] of a tape
TAPE_STREAM = 7  # of random numbers, apart from those of the robot
DRAWS_MAX = 1000
PULL_TIME_S = 2.0  # [s] in which a person pulls the cables tight
HAND_SIGMA_SHARE = 0.02  # of the longest cable: how near to a place a hand puts the platform
HAND_STEPS = 21  # places on the way of a hand at which it feels for slack cables
HUNG_WEIGHTS = 0.4  # of the weight: tension above its limit that every cable has at first


def draw_true_robot(robot: Robot, rng: np.random.Generator) -> Robot:
    """Draw a robot that a first guess may stand for, and whose cables can all be taut at home.

    Exit points are at their distance from home, but in another direction; drums of one make are
    wrong by the same.

    Args:
        robot: As in its file.
        rng: Generator.

    Raises:
        InvalidField: Hardly any such robot has taut cables at home.
    """
    arm = robot.exit_points - robot.home_position
    far, drums = np.linalg.norm(arm, axis=1), drums_of(robot)
    spread = float(far.max()) * np.array([SIDEWAYS_SHARE, SIDEWAYS_SHARE, HEIGHT_SHARE])
    for _ in range(DRAWS_MAX):
        moved = arm + rng.normal(0.0, 1.0, arm.shape) * spread
        length = far + rng.normal(0.0, DISTANCE_SIGMA_M, robot.n)
        moved *= (length / np.linalg.norm(moved, axis=1))[:, None]
        drawn = replace(
            robot,
            exit_points=robot.home_position + moved,
            exit_covariance=None,
            mass=robot.mass * (1.0 + MASS_SHARE * rng.normal()),
            axial_stiffness=robot.axial_stiffness * np.exp(STIFFNESS_SHARE * rng.normal()),
            drum_radius=drums.radius * (1.0 + RADIUS_SHARE * rng.normal()),
            drum_buildup=drums.buildup * np.exp(BUILDUP_SHARE * rng.normal()),
        )
        if np.isfinite(taut_tensions(drawn, robot.home_position[None])).all():
            return drawn
    allowed = f"a robot whose cables are all taut at home; none of {DRAWS_MAX} like it are"
    raise InvalidField("robot", robot.name, allowed)


def taped_distance(robot: Robot, first: str, second: str, seed: int) -> Distance:
    """Measure the distance between two exit points, or one and home, with a tape.

    Args:
        robot: The true one.
        first: Name of a cable, or ``home``.
        second: The same.
        seed: Of the error of the tape; the same seed reads the same between the same ends.

    Raises:
        InvalidField: No such cable.
    """
    ends = []
    for name in (first, second):
        if name not in (*robot.cable_names, HOME):
            allowed = f"one of {list(robot.cable_names)}, or {HOME!r}"
            raise InvalidField("--tape", repr(name), allowed)
        row = robot.cable_names.index(name) if name != HOME else None
        ends.append(robot.home_position if row is None else robot.exit_points[row])
    ends_of_tape = sorted(
        robot.n if name == HOME else robot.cable_names.index(name) for name in (first, second)
    )
    draw = np.random.default_rng((seed, TAPE_STREAM, *ends_of_tape)).normal()
    error = TAPE_SIGMA_M * float(draw)
    length = float(np.linalg.norm(ends[0] - ends[1])) + error
    return Distance(first=first, second=second, length=round(length, 4), sigma=TAPE_SIGMA_M)


def taut_tensions(robot: Robot, position: Array) -> Array:
    """Return tensions of a point-like platform that keep all cables taut [N], shape (B, n).

    Where there are none, all are not a number.

    Args:
        robot: The true one.
        position: Platform origin in W [m], shape (B, 3).
    """
    matrix = structure_matrix(robot, position)
    matrix[:, 3:] = 0.0
    weight = np.zeros((len(position), 6))
    weight[:, 2] = -robot.weight
    low = robot.tension_min + HUNG_WEIGHTS * robot.weight
    high = 0.5 * (robot.tension_min + robot.tension_max)
    found = tension_distribution.solve(matrix, weight, low, high, arm=1.0)
    return np.where(found.feasible[:, None], found.tension, np.nan)


class MisjudgedDrums:
    """Drives that take the drums of a robot for those of its file."""

    def __init__(self, robot: Robot, true_robot: Robot, home_length: Array) -> None:
        """Take the robot of the file, the true one, and its lengths at home [m], (n,)."""
        self._assumed, self._drums = drums_of(robot), drums_of(true_robot)
        home = straight_length(robot, robot.home_position[None]).length
        self._shown = self._assumed.motor_angle(home[0])
        self._turned = self._drums.motor_angle(home_length)

    def shown(self, length: Array) -> Array:
        """Return what encoders show at true lengths [m], shapes (..., n)."""
        return self._assumed.length(self._drums.motor_angle(length) - self._turned + self._shown)

    def wound(self, command: Array) -> Array:
        """Return the true lengths that drives wind for a command [m], shapes (..., n)."""
        return self._drums.length(self._assumed.motor_angle(command) - self._shown + self._turned)


class MisjudgedPlant:
    """A plant whose drives wind by the drums of the robot file, which are not its own.

    The cables are taut at the start: whoever hangs up a robot pulls them tight.

    Attributes:
        robot: As in its file: that is what drives and limits know.
        size: 1.
        inertial: That of the plant.
        true_robot: The plant's.
    """

    def __init__(self, robot: Robot, true_robot: Robot) -> None:
        """Take the robot of the file and the true one."""
        loose = replace(true_robot, tension_min=np.zeros(true_robot.n))  # until it is pulled tight
        self._plant: Plant = QuasiStaticPlant(loose)
        self.robot, self.true_robot = robot, true_robot
        self.size, self.inertial = self._plant.size, self._plant.inertial

    def reset(self, position: Array) -> None:
        """Rest with taut cables at a position in W [m], shape (1, 3), where drives are homed."""
        self._plant.reset(position)
        self._plant.advance(taut_lengths(self.true_robot, position), PULL_TIME_S)
        home = self._plant.read_lengths()[0]
        self._drums = MisjudgedDrums(self.robot, self.true_robot, home)

    def advance(self, command: Array, duration: float) -> None:
        """Wind towards the lengths asked of the drives [m], (1, n), for a time [s]."""
        self._plant.advance(self._drums.wound(command), duration)

    def truth(self) -> State:
        """Return the true state."""
        return self._plant.truth()

    def acceleration(self) -> Array:
        """Return that of the plant."""
        return self._plant.acceleration()

    def read_lengths(self) -> Array:
        """Return readings of perfect encoders by the drums of the robot file [m], shape (1, n)."""
        return self._drums.shown(self._plant.read_lengths())


class SimulatedHand:
    """A person who puts a platform near a place, pulls all cables taut and reads the sensors.

    Attributes:
        position: True position [m], shape (3,).
    """

    def __init__(self, robot: Robot, true_robot: Robot, rng: np.random.Generator) -> None:
        """Take the robot of the file and the true one, at home.

        Args:
            robot: As in its file.
            true_robot: The one that is moved.
            rng: Source of how far the hand misses, and of noise.
        """
        self._true, self._rng = true_robot, rng
        arm = robot.exit_points - robot.home_position
        self._sigma = HAND_SIGMA_SHARE * float(np.linalg.norm(arm, axis=1).max())
        sensors = resolved(SensorSettings(), Scales(robot).ratios)
        self._length_noise = LINE_SIGMA_M / drums_of(robot).advantage
        self._tension_noise = sensors.tension_noise
        self.position = np.array(robot.home_position)
        home = taut_lengths(true_robot, self.position[None])[0]
        self._drums = MisjudgedDrums(robot, true_robot, home)

    def place(self, start: Array, position: Array) -> None:
        """Put it near a position [m], shape (3,), as far as cables can be taut on the way."""
        way = position + self._rng.normal(0.0, self._sigma, 3) - self.position
        places = self.position + np.linspace(0.0, 1.0, HAND_STEPS)[:, None] * way
        taut = np.isfinite(taut_tensions(self._true, places)).all(axis=1)
        self.position = places[int(np.argmin(taut)) - 1] if not taut.all() else places[-1]

    def read(self) -> Rest:
        """Return the readings there."""
        place = self.position[None]
        length = self._drums.shown(taut_lengths(self._true, place)[0])
        noise = self._rng.normal(0.0, 1.0, (2, len(length)))
        return Rest(
            length=length + self._length_noise * noise[0],
            tension=taut_tensions(self._true, place)[0] + self._tension_noise * noise[1],
        )


def taut_lengths(robot: Robot, position: Array) -> Array:
    """Return the unstrained lengths of cables with `taut_tensions` [m], shape (B, n).

    Args:
        robot: The true one.
        position: Platform origin in W [m], shape (B, 3).
    """
    straight = straight_length(robot, position).length
    soft = (straight + robot.run_length) / robot.axial_stiffness
    return np.asarray(straight - soft * taut_tensions(robot, position))
