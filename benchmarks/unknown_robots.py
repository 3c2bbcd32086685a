"""Simulated robots that nobody measured, for the calibration without known positions.

Frames of 1 to 10 m. Point-like movers on 4 to 6 cables: three low exit points and one above them as
on a Hangprinter, or corners of a box; boxes that turn on 7 or 8 cables. Motors hold the lines with
a constant torque while the platform is put to its places by hand: lines stretch by a stiffness that
is known to 30 %, friction adds up to 10 % to a tension or takes it away, drums and their build-up
are not quite as they are thought to be, and some readings are blunders.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

import carosac_toolkit as ct
from calibration.self_calibration.motor_angles import MotorAngles
from calibration.self_calibration.settings import Distance, SelfCalibrationSettings
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.rotations import from_rotation_vector
from carosac_toolkit.physics.cable.drum import Drums
from carosac_toolkit.robot.robot import Robot
from tests.robots import PER_CABLE

EXIT_SIGMA_SHARE = 0.1  # of the frame's size, per axis: exit points are known that well before
RADIUS_SHARE = 0.01  # 1 sigma of the drums' radius
BUILDUP_SHARE = 0.2  # 1 sigma of the build-up
TURN_SIGMA_RAD = 0.25  # per axis, of platforms on seven cables or more
PLATFORM_SHARE = 0.12  # side of such a platform over the frame's size
STIFFNESS_SHARE = 0.3  # 1 sigma of the lines' stiffness
FRICTION_SHARE = 0.1  # largest error of a tension by friction
TENSION_N = 20.0  # that the motors hold
STIFFNESS_N = 20e3  # of the lines
LINE_SIGMA_M = 0.5e-3
DISTANCE_SIGMA_M = 1e-3
BLUNDER_SHARE = 0.03  # of the samples have one cable off by 1 to 10 % of the frame's size
GEAR = 10.0
SAMPLINGS = ("spread", "plane", "cluster", "line", "few", "home")
KNOWN_EXIT_SIGMA_SHARE = 0.015  # of the frame's size: exit points of robots sampled at home only


@dataclass(frozen=True, kw_only=True, eq=False)
class UnknownRobot:
    """A robot as known before, its samples, and the truth.

    Attributes:
        before: As known before, home at the origin.
        settings: What else is known.
        angles: Samples without any known position; the first is at home.
        exit_points: True ones [m], shape (n, 3).
        position: True own unknowns of the samples: positions [m], and rotation vectors from home
            [rad] of platforms on seven cables or more, shape (N, 3) or (N, 6).
        size: Of the frame, its longest side [m].
        blunders: Names of the samples with a blunder.
    """

    before: Robot
    settings: SelfCalibrationSettings
    angles: MotorAngles
    exit_points: Array
    position: Array
    size: float
    blunders: frozenset[str]


def draw_unknown_robot(
    rng: np.random.Generator, *, cables: int, samples: int = 40, sampling: str = "spread"
) -> UnknownRobot:
    """Draw a robot and its samples.

    Args:
        rng: Generator.
        cables: 4 to 8.
        samples: Number of samples.
        sampling: ``spread`` over the workspace, or too little: in a ``plane``, in a small
            ``cluster``, along a ``line``, ``few`` samples, or all at ``home``, which teach nothing
            about exit points that are known well.
    """
    size, exits, low, high = _frame(rng, cables)
    n = cables
    home = np.array([*(0.5 * (low + high))[:2], low[2]]) + rng.normal(0.0, 0.02 * size, 3)
    exits, low, high = exits - home, low - home, high - home
    position = _sampled(rng, low, high, samples, sampling)
    radius = np.full(n, rng.uniform(0.02, 0.08))
    buildup = float(rng.choice([1e-6, 7e-5]))
    wrong, gear = np.full(n, rng.normal(0.0, RADIUS_SHARE)), np.full(n, GEAR)
    if rng.random() < 0.5:  # each cable has a drum of another make
        radius = radius * rng.uniform(0.95, 1.05, n)
        wrong, gear = rng.normal(0.0, RADIUS_SHARE, n), GEAR + np.arange(n)
    spread = size * (KNOWN_EXIT_SIGMA_SHARE if sampling == "home" else EXIT_SIGMA_SHARE)
    guess = exits + rng.normal(0.0, spread, exits.shape)
    anchors = _anchors(n, size)
    before = replace(
        _robot(guess, radius, buildup, low, high, size),
        drum_gear=gear,
        anchor_points=anchors,
        exit_covariance=np.tile(spread**2 * np.eye(3), (n, 1, 1)),
    )
    arms = anchors[None]
    if n > 6:
        turns = rng.normal(0.0, TURN_SIGMA_RAD, position.shape)
        turns[0] = 0.0
        arms = anchors @ from_rotation_vector(turns).swapaxes(1, 2)
    true_buildup = buildup * (1.0 + BUILDUP_SHARE * rng.normal())
    length = np.linalg.norm(position[:, None] + arms - exits, axis=2)
    drums = Drums(
        radius=np.sqrt((radius * (1.0 + wrong)) ** 2 + true_buildup * length[0]),
        buildup=np.full(n, true_buildup),
        gear=gear,
        advantage=np.ones(n),
    )
    strain = TENSION_N / (STIFFNESS_N * max(1.0 + STIFFNESS_SHARE * rng.normal(), 0.2))
    friction = 1.0 + rng.uniform(-FRICTION_SHARE, FRICTION_SHARE, length.shape)
    line = length / (1.0 + strain * friction) + rng.normal(0.0, LINE_SIGMA_M, length.shape)
    bad = np.flatnonzero(rng.random(len(position)) < BLUNDER_SHARE)
    bad = bad[bad > 0]
    for row in bad:
        line[row, rng.integers(n)] += rng.choice([-1, 1]) * rng.uniform(0.01, 0.1) * size
    angle = drums.motor_angle(line)
    names = tuple(str(k) for k in range(len(position)))
    span = float(np.linalg.norm(exits[0] - exits[1])) + rng.normal(0.0, DISTANCE_SIGMA_M)
    return UnknownRobot(
        before=before,
        settings=SelfCalibrationSettings(
            length_at_zero_sigma=EXIT_SIGMA_SHARE * size,
            drum_radius_sigma=RADIUS_SHARE * float(radius.mean()),
            drum_buildup_share=BUILDUP_SHARE,
            distances=(Distance(first="a", second="b", length=span, sigma=DISTANCE_SIGMA_M),),
        ),
        angles=MotorAngles(
            samples=names,
            cables=before.cable_names,
            motor_angle=angle - angle[0],
            known_position=np.zeros((len(names), 3)),
            is_known=np.zeros(len(names), dtype=np.bool_),
        ),
        exit_points=exits,
        position=np.hstack([position, turns]) if n > 6 else position,
        size=size,
        blunders=frozenset(names[row] for row in bad),
    )


def _frame(rng: np.random.Generator, n: int) -> tuple[float, Array, Array, Array]:
    """Draw a frame: its size, exit points (n, 3), and the corners of its workspace [m]."""
    size = float(np.exp(rng.uniform(0.0, np.log(10.0))))
    width, depth, height = size, size * rng.uniform(0.6, 1.0), size * rng.uniform(0.4, 1.0)
    if n == 4 and rng.random() < 0.5:
        turn = np.deg2rad([-90.0, 30.0, 150.0]) + rng.uniform(-0.2, 0.2, 3)
        around = [
            0.5 * width * np.cos(turn),
            0.5 * depth * np.sin(turn),
            np.full(3, -0.05 * height),
        ]
        exits = np.vstack([np.stack(around, axis=1), [0.0, 0.0, height]])
    else:
        corners = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
        up = np.column_stack([corners, np.full(4, 2.0)])
        down = [[-1.0, 0.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0]]
        floor = np.column_stack([corners, np.zeros(4)])
        unit = {4: up, 5: np.vstack([up, down[:1]]), 6: np.vstack([up[:3], down])}.get(
            n, np.vstack([up, floor])[:n]
        )
        exits = unit * [0.5 * width, 0.5 * depth, 0.5 * height]
    low = np.array([-0.35 * width, -0.35 * depth, 0.05 * height])
    high = np.array([0.35 * width, 0.35 * depth, 0.7 * height])
    return size, exits + rng.normal(0.0, 0.03 * size, exits.shape), low, high


def _anchors(n: int, size: float) -> Array:
    """Return the anchor points [m], shape (n, 3): nearly one point, or the corners of a box."""
    if n <= 6:
        return 1e-6 * np.arange(3 * n).reshape(n, 3)
    corners = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    low = np.column_stack([np.roll(corners, -1, axis=0), np.full(4, -1.0)])
    high = np.column_stack([np.roll(corners, 1, axis=0), np.full(4, 1.0)])
    box = 0.5 * PLATFORM_SHARE * size * np.array([1.0, 0.8, 0.7])
    return np.asarray((np.vstack([low, high]) * box)[:n])


def _sampled(rng: np.random.Generator, low: Array, high: Array, count: int, sampling: str) -> Array:
    """Return home and further positions [m], shape (N, 3)."""
    place = rng.uniform(low, high, (count, 3))
    place[0] = 0.0
    if sampling == "plane":
        place[:, 2] *= 0.01
    elif sampling == "cluster":
        place *= 0.03
    elif sampling == "line":
        place = place[:, :1] * np.array([0.6, 0.6, 0.5]) + 0.01 * place
    elif sampling == "few":
        place = place[: 6 + int(rng.integers(3))]
    elif sampling == "home":
        place *= 0.0
    return place


def _robot(
    exits: Array, radius: Array, buildup: float, low: Array, high: Array, size: float
) -> Robot:
    """Return the robot as known before."""
    base, n = ct.load_robot("hangprinter"), len(exits)
    fields = {}
    for name in PER_CABLE:
        value = getattr(base, name)
        fields[name] = value if len(value) == 1 else np.repeat(value[:1], n, axis=0)
    return replace(
        base,
        **fields
        | {
            "name": "unknown",
            "cable_names": tuple("abcdefgh"[:n]),
            "exit_points": exits,
            "exit_covariance": None,
            "anchor_points": np.zeros((n, 3)),
            "length_max": np.full(n, 10.0 * size),
            "drum_radius": np.sqrt(radius**2 + buildup * np.linalg.norm(exits, axis=1)),
            "drum_buildup": np.full(n, buildup),
            "drum_gear": np.full(n, GEAR),
            "drum_advantage": np.ones(n),
            "home_position": np.zeros(3),
            "workspace_min": low - 0.05 * size,
            "workspace_max": high + 0.05 * size,
        },
    )
