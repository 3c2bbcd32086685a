"""Synthetic samples of a robot like the Hangprinter, and a CSV of them."""

from dataclasses import replace

import numpy as np

import carosac_toolkit as ct
from calibration.self_calibration.synthetic import (
    MeasurementNoise,
    draw_positions,
    measure_motor_angles,
)

HAND = 0.02  # [m] of the lengths at home, as measured by hand
LOW = np.array([[0.02, -1.59, -0.11], [1.29, 1.23, -0.16], [-1.42, 0.74, -0.15]])
EXITS = np.vstack([LOW, [0.02, 0.0, 2.35]])
KNOWN = (0, 1, 2, 3, 4, 5)  # five on the bed and one above it


def robots(rng=None):
    """The robot as known before, and the true one, which it may be."""
    before = ct.load_robot("hangprinter")
    truth = replace(before, exit_points=EXITS, exit_covariance=None)
    length = np.linalg.norm(EXITS - truth.anchor_points, axis=1)
    wrong = np.zeros(2) if rng is None else rng.normal(0.0, 2e-3, 2)
    buildup = 6.875e-5 * (1.0 + (0.0 if rng is None else 0.15 * rng.normal()))
    advantage = before.drum_advantage
    truth = replace(
        truth,
        drum_radius=np.sqrt((0.075 + wrong[[0, 0, 0, 1]]) ** 2 + advantage * buildup * length),
        drum_buildup=np.full(4, buildup),
    )
    if rng is None:
        return before, truth
    by_hand = length + rng.normal(0.0, HAND, 4)
    rough = before.exit_points * (by_hand / np.linalg.norm(before.exit_points, axis=1))[:, None]
    radius = np.sqrt(0.075**2 + advantage * 6.875e-5 * by_hand)
    return replace(before, exit_points=rough, drum_radius=radius), truth


def positions(robot, count, rng):
    """Home, four more places on the bed, one high up, and others anywhere."""
    found = draw_positions(robot, count, rng)
    found[1:5] = [[-0.27, -0.28, 0], [0.28, 0.01, 0], [0.3, 0.43, 0], [-0.18, 0.44, 0]]
    found[5] = [0.06, -0.06, 1.4]
    return found


def scene(seed=0, count=24, *, noise=None, known=KNOWN, blunders=None):
    """Robot before, true robot, true positions and motor angles."""
    rng = np.random.default_rng(seed)
    before, truth = robots(rng)
    place = positions(truth, count, rng)
    noise = MeasurementNoise() if noise is None else noise
    angles = measure_motor_angles(
        truth, place, np.array(known, dtype=int), noise, rng, blunders=blunders
    )
    return before, truth, place, angles


def csv_text(angles, unit="deg"):
    """A file as `carosac calibrate lengths` reads it."""
    factor = 180.0 / np.pi if unit == "deg" else 1.0
    columns = [f"motor_{name}_{unit}" for name in angles.cables]
    lines = [",".join(["sample", *columns, "known_x_mm", "known_y_mm", "known_z_mm"])]
    for k, name in enumerate(angles.samples):
        known = [f"{1e3 * v:.6f}" if angles.is_known[k] else "" for v in angles.known_position[k]]
        lines.append(
            ",".join([name, *(f"{v * factor:.6f}" for v in angles.motor_angle[k]), *known])
        )
    return "\n".join(lines) + "\n"
