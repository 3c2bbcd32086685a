"""The family `suspended-4`: robots of four cables from above, of any size, in stated ranges.

Lengths are in that of a cable, L, times in sqrt(L / g), forces in the weight per cable; see
`carosac_toolkit.physics.scales`. Only the size of the frame and the fastest motion have
units. A small platform turns fast on its cables, so that it gets its commands at a higher rate.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from baselines.mpc.plan_times import fastest_motion
from baselines.mpc.settings import MpcSettings
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import CarosacError, InvalidField
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.physics.scales import CAROSAC_GRAVITY_M_PER_S2, Scales
from carosac_toolkit.robot.robot import Robot

FAMILY, CABLES = "suspended-4", 4
RANGES = {
    "size of the frame [m]": (0.5, 60.0),  # longer side
    "aspect of the frame": (0.3, 1.0),
    "exit points off a level rectangle, over its size": (0.0, 0.08),
    "height of the exit points over home, over the size": (0.13, 0.95),
    "box over frame": (0.0, 0.92),  # the largest of sides and height
    "pulley radius over L": (0.0, 0.015),
    "platform over L": (0.003, 0.08),  # mean distance of an anchor point
    "anchor points off a level rectangle, over the platform": (0.0, 0.3),
    "centre of mass below the platform, over it": (-0.15, 1.3),
    "centre of mass beside its middle, over it": (0.0, 0.2),
    "spread of mass, over the platform's squared": (0.05, 0.6),  # least and largest along an axis
    "strain at rest": (3e-5, 1e-3),
    "cable weight over tension": (5e-4, 0.15),
    "least tension": (0.05, 0.15),
    "largest tension": (6.0, 32.0),
    "speed": (0.2, 0.8),
    "acceleration [g]": (0.35, 1.6),
    "winch lag": (0.02, 0.08),
    "air drag": (0.0, 0.08),
    "fastest motion [rad/s]": (0.0, 60.0),
}
TURN_MAX = 0.3  # of the fastest motion from one command to the next [rad]
DAMPING = (0.004, 0.05)  # of the stretch, as a share of critical
# All over so much of the box there is a rest, with so much of the largest tension and tilted by 60
# degrees at most. The box of `carosac` reaches as far.
RESTING_SHARE = 0.95
TENSION_SHARE_MAX = 0.6
TILT_COSINE_MIN = 0.5
TRIES_MAX = 2000
MASS_KG = (0.1, 20.0)  # of a robot of a metre


@dataclass(frozen=True, kw_only=True, eq=False)
class Layout:
    """How cables are numbered and axes turned, so that alike robots look alike.

    Attributes:
        order: Cables at (-, -), (+, -), (+, +) and (-, +) of the turned axes, shape (4,).
        turn: From W to axes whose x is along the longer side of the frame, shape (3, 3).
    """

    order: NDArray[np.intp]
    turn: Array


def layout_of(robot: Robot) -> Layout:
    """Return the layout of a robot of four cables."""
    spread = robot.exit_points - robot.exit_points.mean(axis=0)
    around = np.argsort(np.arctan2(spread[:, 1], spread[:, 0]))
    a, b, c, d = spread[around]
    along, across = (b - a) + (c - d), (c - b) + (d - a)
    side = along if np.hypot(*along[:2]) >= np.hypot(*across[:2]) else across
    angle = np.arctan2(side[1], side[0])
    cos, sin = np.cos(angle), np.sin(angle)
    turn = np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])
    turned = spread @ turn.T
    return Layout(order=np.argsort(np.arctan2(turned[:, 1], turned[:, 0])), turn=turn)


def quantities(robot: Robot) -> dict[str, Array]:
    """Return what `RANGES` are of, by name; of each the least and the largest value."""
    scales, layout = Scales(robot), layout_of(robot)
    length, time, tension = scales.length, scales.time, scales.tension
    frame, frame_off = _rectangle(robot.exit_points @ layout.turn.T, layout.order)
    arms = robot.anchor_points @ robot.home_rotation.T @ layout.turn.T
    _, arms_off = _rectangle(arms, layout.order)
    platform = np.linalg.norm(arms - arms.mean(axis=0), axis=1).mean()
    size = frame[:2].max()
    above = robot.exit_points[:, 2].mean() - robot.home_position[2]
    center = robot.home_rotation @ robot.center_of_mass - robot.home_rotation @ (
        robot.anchor_points.mean(axis=0)
    )
    half = 0.5 * np.trace(robot.inertia)
    spread = np.linalg.eigvalsh(half * np.eye(3) - robot.inertia) / robot.mass
    sides = robot.workspace_max - robot.workspace_min
    low = robot.workspace_min[2]
    corners = np.abs(_corners(sides) @ layout.turn.T).max(axis=0)  # the box in turned axes
    above_low = robot.exit_points[:, 2].mean() - low
    with np.errstate(divide="ignore", invalid="ignore"):  # NaN is in no range
        box = np.array([*(corners[:2] / frame[:2]), sides[2] / above_low])
        off = arms_off / platform, -center[2] / platform, np.hypot(*center[:2]) / platform
        values = (
            size, frame[:2].min() / size, frame_off / size, above / size, box.max(),
            robot.pulley_radius / length, platform / length, *off, spread / platform**2,
            tension / robot.axial_stiffness, robot.weight_per_length * length / tension,
            robot.tension_min / tension, robot.tension_max / tension,
            robot.speed_max * time / length, robot.acceleration_max / robot.gravity,
            robot.winch_lag / time, robot.drag * time / robot.mass,
            fastest_motion(robot),
        )  # fmt: skip
    return {
        name: np.array([np.min(value), np.max(value)])
        for name, value in zip(RANGES, values, strict=True)
    }


def outside(robot: Robot) -> str:
    """Return which quantity of a robot of four cables is outside of its range, or nothing."""
    for name, found in quantities(robot).items():
        low, high = RANGES[name]
        if not (low <= found[0] and found[1] <= high):
            worst = found[0] if not low <= found[0] else found[1]
            return f"{name} {worst:.3g}, beyond {low:g} to {high:g}"
    return ""


def family_settings(robot: Robot) -> MpcSettings:
    """Return the settings of MPC for a robot of the family: the defaults, and its period.

    That is shorter where the platform moves so fast that a command each 20 ms would be too few.
    """
    usual, fastest = MpcSettings(), fastest_motion(robot)
    if fastest * usual.period <= TURN_MAX:
        return usual
    return replace(usual, period=TURN_MAX / fastest)


def not_of_family(robot: Robot) -> str:
    """Return why a robot is not of the family, or nothing."""
    if robot.n != CABLES:
        return f"{robot.n} cables, not {CABLES}"
    reason = outside(robot)
    if not reason and not _rests(robot):
        tilt = np.degrees(np.arccos(TILT_COSINE_MIN))
        return (
            f"a box whose inner {100.0 * RESTING_SHARE:g} % has places of no rest tilted by up to "
            f"{tilt:.0f} degrees, with up to {100.0 * TENSION_SHARE_MAX:g} % of the largest tension"
        )
    return reason


def rests_record() -> dict[str, float]:
    """Return what rests of the family are held to, as JSON holds it."""
    return {
        "resting_share": RESTING_SHARE, "tension_share_max": TENSION_SHARE_MAX,
        "tilt_cosine_min": TILT_COSINE_MIN,
    }  # fmt: skip


def check_family(robot: Robot) -> None:
    """Refuse a robot that is not of the family.

    Raises:
        InvalidField: Names the quantity that is outside of its range.
    """
    reason = not_of_family(robot)
    if reason:
        raise InvalidField("robot", f"{robot.name!r} with {reason}", f"a robot of {FAMILY}")


def draw_robot(rng: np.random.Generator, name: str) -> Robot:
    """Draw a robot of the family that can rest anywhere in its box but at its very edge."""
    for _ in range(TRIES_MAX):
        robot = _draw(rng, name)
        if not not_of_family(robot):
            return robot
    raise CarosacError(f"{FAMILY}: no robot in {TRIES_MAX} tries")


def _draw(rng: np.random.Generator, name: str) -> Robot:
    """Draw a robot; whether it is of the family, and can rest, is not asked."""
    n, size = CABLES, _log(rng, RANGES["size of the frame [m]"])
    gravity = CAROSAC_GRAVITY_M_PER_S2
    mass = _log(rng, MASS_KG) * size ** rng.uniform(0.5, 1.5)
    frame = size * np.array([1.0, _log(rng, RANGES["aspect of the frame"])])
    frame = frame[:: rng.choice([-1, 1])]
    height = size * _log(rng, (0.25, 1.2))
    corners = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    exits = np.column_stack([0.5 * corners * frame, np.full(n, height)])
    exits += rng.normal(0.0, 0.015 * size, (n, 3))
    home = np.array([*exits[:, :2].mean(axis=0), rng.uniform(0.15, 0.6) * height])
    sides = np.array([*(frame * rng.uniform(0.25, 0.9, 2)), 0.0])
    sides[2] = (height - home[2]) * rng.uniform(0.3, 1.2)
    length = float(np.linalg.norm(exits - home, axis=1).mean())
    time, tension = np.sqrt(length / gravity), mass * gravity / n
    platform = _log(rng, RANGES["platform over L"]) * length
    plate = np.array([1.0, _log(rng, (0.6, 1.6))])
    anchors = np.column_stack([corners * plate / np.hypot(*plate) * platform, np.zeros(n)])
    anchors += rng.normal(0.0, 0.04 * platform, (n, 3))
    center = platform * np.array([*rng.normal(0.0, 0.04, 2), -rng.uniform(-0.1, 1.2)])
    spread = mass * platform**2 * rng.uniform(0.06, 0.5, 3)
    stiffness = tension / _log(rng, RANGES["strain at rest"])
    density = tension * _log(rng, RANGES["cable weight over tension"]) / (gravity * length)
    pulley = _log(rng, (0.002, 0.015)) * length if rng.uniform() < 0.3 else 0.0
    critical = 2.0 * np.sqrt(stiffness / length * mass) * length  # per strain rate
    reach = float(np.linalg.norm(exits - home, axis=1).max() + np.linalg.norm(sides))
    ring = np.ones(n)
    return Robot(
        name=name, cable_names=tuple(f"cable_{k + 1}" for k in range(n)), exit_points=exits,
        exit_covariance=None, pulley_radius=pulley * ring,
        swivel_axis=np.tile([0.0, 0.0, 1.0], (n, 1)),
        run_length=rng.uniform(0.0, 1.2) * length * ring, anchor_points=anchors,
        linear_density=density * ring, axial_stiffness=stiffness * ring,
        axial_damping=_log(rng, DAMPING) * critical * ring,
        cable_diameter=np.sqrt(density / 1000.0) * ring,
        tension_min=_log(rng, RANGES["least tension"]) * tension * ring,
        tension_max=_log(rng, RANGES["largest tension"]) * tension * ring,
        speed_max=_log(rng, RANGES["speed"]) * length / time * ring,
        acceleration_max=_log(rng, RANGES["acceleration [g]"]) * gravity * ring,
        winch_lag=_log(rng, RANGES["winch lag"]) * time * ring, length_min=0.02 * length * ring,
        length_max=1.3 * reach * ring, drum_radius=None, drum_buildup=None, mass=mass,
        center_of_mass=center, inertia=np.diag(spread.sum() - spread),
        drag=rng.uniform(*RANGES["air drag"]) * mass / time,
        angular_drag=rng.uniform(0.0, 0.05) * mass * platform**2 / time, gravity=gravity,
        workspace_min=home - 0.5 * sides, workspace_max=home + 0.5 * sides, home_position=home,
        home_rotation=np.eye(3), description=f"drawn from {FAMILY}", licence="Apache-2.0",
        provenance={},
    )  # fmt: skip


def _rests(robot: Robot) -> bool:
    """Return whether a robot rests all over its box but for its edge, as the family does."""
    sides = robot.workspace_max - robot.workspace_min
    middle = 0.5 * (robot.workspace_min + robot.workspace_max)
    places = middle + 0.5 * RESTING_SHARE * _corners(sides)
    rest = statics.inverse_kinematics(robot, places)
    return bool(
        (rest.converged & rest.stable).all()
        and (rest.tension <= TENSION_SHARE_MAX * robot.tension_max).all()
        and (rest.rotation[:, 2, 2] > TILT_COSINE_MIN).all()
    )


def _rectangle(points: Array, order: NDArray[np.intp]) -> tuple[Array, float]:
    """Return the sides (3,) of a level rectangle whose corners are near points (4, 3), the last 0.

    Args:
        points: [m], axes along its sides.
        order: Of the points, those at (-, -), (+, -), (+, +) and (-, +).

    Returns:
        Sides [m], and the largest distance of a point from its corner [m].
    """
    corners = np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]])
    away = points[order] - points.mean(axis=0)
    half = (away * corners).mean(axis=0)
    return 2.0 * half, float(np.linalg.norm(away - corners * half, axis=1).max())


def _corners(sides: Array) -> Array:
    """Return the middle, the middles of sides and the corners of a box of some sides, (27, 3)."""
    return np.array(list(product((-1.0, 0.0, 1.0), repeat=3))) * sides


def _log(rng: np.random.Generator, bounds: tuple[float, float]) -> float:
    """Draw a number, all ratios alike."""
    return float(np.exp(rng.uniform(*np.log(bounds))))
