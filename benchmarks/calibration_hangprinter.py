"""Self-calibration of a real Hangprinter from its motor angles; figures go to RESULTS.md."""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path

import numpy as np

import carosac_toolkit as ct
from benchmarks.results import table, write_section
from calibration import (
    MotorAngles,
    SelfCalibration,
    SelfCalibrationSettings,
    calibrate_motor_angles,
    load_motor_angles,
)
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.rotations import best_rotation
from carosac_toolkit.robot.robot import Robot

COMMAND = "python -m benchmarks.calibration_hangprinter"
PUBLISHED = np.array(
    [
        [16.83, -1584.86, -113.17],
        [1290.18, 1229.19, -157.45],
        [-1409.88, 742.61, -151.80],
        [21.85, -0.16, 2343.67],
    ]
)  # [mm], by the owner of the machine, from nine known positions
RADIUS_SIGMA_M = 5e-3  # of the drums where no position is known: they tell nothing of the scale


def anchors(result: SelfCalibration) -> list[str]:
    """Distance of each anchor from the published one [mm]."""
    found = 1e3 * result.estimate.value[:12].reshape(4, 3)
    away = np.linalg.norm(found - PUBLISHED, axis=1)
    return [f"{name} {value:.1f}" for name, value in zip("ABCD", away, strict=True)]


def unknown_rows(angles: MotorAngles, robot: Robot, full: SelfCalibration) -> list[list[str]]:
    """Calibrate without any known position; compare after a rigid motion.

    Args:
        angles: With known positions, which are withheld.
        robot: As known before, with the lengths at home as measured by hand.
        full: Calibration with all known positions.
    """
    names = [name for name, known in zip(angles.samples, angles.is_known, strict=True) if known]
    withheld = angles.without_known(names)
    result = calibrate_motor_angles(
        withheld, robot, SelfCalibrationSettings(drum_radius_sigma=RADIUS_SIGMA_M)
    )
    known = angles.is_known
    turn, shift = rigid_motion(result.position[known], angles.known_position[known])
    places = result.position[known] @ turn + shift - angles.known_position[known]
    distance = np.linalg.norm(places, axis=1)
    sigma = np.linalg.norm(np.hypot(result.position_sigma[known], 1e-3), axis=1)
    exits = [one.estimate.value[:12].reshape(4, 3) for one in (result, full)]
    here = exits[0] @ turn + shift - exits[1]
    turn, shift = rigid_motion(exits[0], exits[1])
    apart = np.linalg.norm(exits[0] @ turn + shift - exits[1], axis=1)
    spread = exit_sigma(result), exit_sigma(full)
    ratio = max((distance / sigma).max(), (apart / np.hypot(*spread)).max())
    rms = float(np.sqrt((distance**2).mean()))
    away = 1e3 * np.linalg.norm(here, axis=1)
    return [
        ["no known position: known positions after a rigid motion, RMS", "8 mm",
         f"{1e3 * rms:.1f} mm"],
        ["no known position: anchors against the fit with all of them, after the same motion",
         "20 mm", f"{', '.join(f'{a} {v:.1f}' for a, v in zip('ABCD', away, strict=True))} mm"],
        ["no known position: largest of these errors in stated sigmas", "3", f"{ratio:.1f}"],
        ["no known position: scale, 1 sigma; cost of the mirror image", "reported",
         f"{100.0 * result.scale.sigma:.2f} %; {result.rivals[0].cost:.0f}"],
    ]  # fmt: skip


def rigid_motion(points: Array, towards: Array) -> tuple[Array, Array]:
    """Return turn and shift that bring points closest to others: points @ turn + shift."""
    middle = points.mean(axis=0)
    turn = best_rotation(points - middle, towards - towards.mean(axis=0)).T
    return turn, towards.mean(axis=0) - middle @ turn


def exit_sigma(result: SelfCalibration) -> Array:
    """Return the RMS error of each exit point once all are moved to fit best [m], shape (n,)."""
    exits = result.estimate.value[:12].reshape(4, 3)
    arm = exits - exits.mean(axis=0)
    moves = np.hstack(
        [np.tile(np.eye(3), (4, 1)), *(np.cross(axis, arm).reshape(-1, 1) for axis in np.eye(3))]
    )
    project = np.eye(12) - moves @ np.linalg.pinv(moves)
    covariance = project @ result.estimate.covariance[:12, :12] @ project.T
    return np.sqrt(np.diag(covariance).reshape(4, 3).sum(axis=1))


def main() -> None:
    """Measure and write."""
    path = Path(os.environ.get("CAROSAC_DATA", "../shared/data")) / "hangprinter_hp4.csv"
    if not path.is_file():
        sys.exit(f"no {path} (set CAROSAC_DATA)")
    angles, robot = load_motor_angles(path), ct.load_robot("hangprinter")
    calibrate_motor_angles(angles, robot)  # compiles
    start = time.process_time()
    result = calibrate_motor_angles(angles, robot)
    seconds = time.process_time() - start
    errors = []
    for sample in (name for name, k in zip(angles.samples, angles.is_known, strict=True) if k):
        again = calibrate_motor_angles(angles.without_known([sample]), robot)
        row = angles.index(sample)
        error = 1e3 * np.linalg.norm(again.position[row] - angles.known_position[row])
        errors.append(f"{sample}: {error:.2f}")
    rms = np.sqrt(np.mean([float(text.split()[1]) ** 2 for text in errors]))
    rows = [
        ["residual of the cable lengths, RMS over all samples", "0.6 mm",
         f"{1e3 * result.residual_rms:.3f} mm"],
        ["the same as line paid out (length times advantage 2, 2, 2, 4)", "reported",
         f"{1e3 * result.line_residual_rms:.3f} mm"],
        ["anchors against the published ones", "20 mm", f"{', '.join(anchors(result))} mm"],
        ["each known position predicted from everything else, by sample", "4 mm",
         f"{', '.join(errors)} mm; RMS {rms:.2f} mm"],
        ["samples left out as blunders", "reported", f"{len(result.blunders)}"],
        ["noise of the line; 1 sigma of the exit points", "reported",
         f"{1e3 * result.line_sigma:.2f} mm; {1e3 * result.estimate.sigma[:12].min():.1f} to "
         f"{1e3 * result.estimate.sigma[:12].max():.1f} mm"],
        ["time, all starts", "reported", f"{seconds:.1f} s"],
        *unknown_rows(angles, robot, result),
    ]  # fmt: skip
    body = table(["what", "bar", "measured"], rows)
    write_section(
        "calibration-hangprinter", "Self-calibration of a real Hangprinter", COMMAND, body
    )
    print(body)


if __name__ == "__main__":
    main()
