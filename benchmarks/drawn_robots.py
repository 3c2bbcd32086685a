"""Robots drawn at random: 2 to 12 cables, 0.3 to 100 m, 0.1 to 5000 kg, taut to deeply sagging.

Size and mass are drawn first, all else as shares of them, so that every draw could be built as far
as its numbers go. Whether it can stand, move or be controlled is not asked: that is what the
toolkit has to find out, and say.
"""

from __future__ import annotations

from typing import Any

import numpy as np

import carosac_toolkit as ct
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.robot.robot import Robot

GRAVITY = 9.81  # [m/s^2]
CABLES = (2, 12)
SIZE_M, MASS_KG = (0.3, 100.0), (0.1, 5000.0)
ABOVE_SHARE = 0.5  # of robots with six cables and more, whose exit points are all above
STRETCH = (1e-4, 3e-3)  # strain under the mean tension of rest
SAG = (1e-3, 0.5)  # weight of a cable as long as the frame, over that tension
PLATFORM = (0.02, 0.1)  # size over that of the frame
HEIGHT = (0.4, 1.0)  # of the exit points over the width of the frame
SPEED, ACCELERATION = (0.2, 0.6), (0.3, 1.0)  # of winches, in sqrt(g size) and g
LAG = (0.02, 0.1)  # of winches, in sqrt(size / g)
TENSION_MIN, TENSION_MAX = (0.02, 0.15), (4.0, 15.0)  # over weight / n
BOX = (0.15, 0.35)  # sides of the workspace box over those of the frame
DAMPING = (0.005, 0.05)  # of the stretch, as a share of critical


def drawn_robot(seed: int) -> Robot:
    """Draw a robot; the same for the same seed."""
    rng = np.random.default_rng([28, seed])
    n = int(rng.integers(CABLES[0], CABLES[1] + 1))
    size, mass = _log(rng, SIZE_M), _log(rng, MASS_KG)
    tension = mass * GRAVITY / n
    time = np.sqrt(size / GRAVITY)
    exits, low = _frame(rng, n, size)
    anchors = _platform(rng, n, size * _log(rng, PLATFORM), crossed=low.any())
    radius = float(np.linalg.norm(anchors, axis=1).max())
    height = float(exits[~low, 2].mean())
    stiffness = tension / _log(rng, STRETCH)
    density = tension * _log(rng, SAG) / (GRAVITY * size)
    center = np.array([*rng.normal(0.0, 0.05 * radius, 2), -rng.uniform(0.0, 0.7) * radius])
    spread = mass * radius**2 * rng.uniform(0.1, 0.3, 3)  # second moments of the mass
    inertia = spread.sum() - spread
    middle = np.array([*exits[:, :2].mean(axis=0), rng.uniform(0.3, 0.5) * height])
    sides = np.array([*np.ptp(exits[:, :2], axis=0), height]) * rng.uniform(*BOX, 3)
    sides = np.maximum(sides, 0.05 * size)
    reach = float(np.linalg.norm(exits - middle, axis=1).max() + np.linalg.norm(sides))
    ring = np.ones(n)
    critical = 2.0 * np.sqrt(stiffness / size * mass) * size  # per strain rate
    record: dict[str, Any] = {
        "name": f"drawn_{seed}", "cable_names": tuple(f"cable_{k + 1}" for k in range(n)),
        "exit_points": exits, "exit_covariance": None, "pulley_radius": 0.0 * ring,
        "swivel_axis": np.tile([0.0, 0.0, 1.0], (n, 1)),
        "run_length": rng.uniform(0.0, 1.0) * size * ring,
        "anchor_points": anchors, "linear_density": density * ring,
        "axial_stiffness": stiffness * ring,
        "axial_damping": _log(rng, DAMPING) * critical * ring,
        "cable_diameter": np.sqrt(density / 1000.0) * ring,
        "tension_min": _log(rng, TENSION_MIN) * tension * ring,
        "tension_max": _log(rng, TENSION_MAX) * tension * ring,
        "speed_max": rng.uniform(*SPEED) * size / time * ring,
        "acceleration_max": rng.uniform(*ACCELERATION) * GRAVITY * ring,
        "winch_lag": _log(rng, LAG) * time * ring, "length_min": 0.02 * size * ring,
        "length_max": 1.3 * reach * ring, "drum_radius": None, "drum_buildup": None, "mass": mass,
        "center_of_mass": center, "inertia": np.diag(inertia),
        "drag": rng.uniform(0.0, 0.02) * mass / time,
        "angular_drag": rng.uniform(0.0, 0.02) * mass * radius**2 / time, "gravity": GRAVITY,
        "workspace_min": middle - 0.5 * sides, "workspace_max": middle + 0.5 * sides,
        "home_position": middle, "home_rotation": np.eye(3),
        "description": f"drawn at random, seed {seed}", "licence": "Apache-2.0", "provenance": {},
    }  # fmt: skip
    return ct.Robot(**record)


def _log(rng: np.random.Generator, bounds: tuple[float, float]) -> float:
    """Draw a number, all ratios alike."""
    return float(np.exp(rng.uniform(*np.log(bounds))))


def _frame(rng: np.random.Generator, n: int, size: float) -> tuple[Array, np.ndarray[Any, Any]]:
    """Draw exit points about a ring [m], (n, 3), and which of them are below the platform, (n,)."""
    height = size * rng.uniform(*HEIGHT)
    low = np.zeros(n, dtype=bool)
    if n >= 6 and rng.uniform() > ABOVE_SHARE:
        low[1::2] = True
    corners = np.arange(n) if not low.any() else np.arange(n) // 2
    count = int(corners.max()) + 1
    turn = 2.0 * np.pi * (corners + 0.5) / count + rng.normal(0.0, 0.1, n)
    widths = 0.5 * size * np.array([1.0, rng.uniform(0.5, 1.0)])
    ring = np.stack([np.cos(turn), np.sin(turn)], axis=1) * widths
    level = np.where(low, 0.0, height) + rng.normal(0.0, 0.02 * size, n)
    return np.column_stack([ring, level]), low


def _platform(rng: np.random.Generator, n: int, size: float, *, crossed: bool) -> Array:
    """Draw anchor points about a ring [m], (n, 3); on two levels where cables come from two."""
    corners = np.arange(n) // 2 if crossed else np.arange(n)
    count = int(corners.max()) + 1
    turn = 2.0 * np.pi * (corners + 0.5) / count + rng.normal(0.0, 0.15, n)
    level = np.zeros(n)
    if crossed:
        level[0::2], level[1::2] = -0.5 * size, 0.5 * size  # cables from above to the lower side
    elif n >= 6:
        turn[1::2] += 2.0 * np.pi / count
        level[1::2] = size
    ring = size * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    return np.column_stack([ring, level + rng.normal(0.0, 0.05 * size, n)])
