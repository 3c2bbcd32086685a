"""Self-calibration of a real Hangprinter from its motor angles; figures go to RESULTS.md."""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path

import numpy as np

import carosac_toolkit as ct
from benchmarks.results import table, write_section
from calibration import SelfCalibration, calibrate_motor_angles, load_motor_angles

COMMAND = "python -m benchmarks.calibration_hangprinter"
PUBLISHED = np.array(
    [
        [16.83, -1584.86, -113.17],
        [1290.18, 1229.19, -157.45],
        [-1409.88, 742.61, -151.80],
        [21.85, -0.16, 2343.67],
    ]
)  # [mm], by the owner of the machine, from nine known positions


def anchors(result: SelfCalibration) -> list[str]:
    """Distance of each anchor from the published one [mm]."""
    found = 1e3 * result.estimate.value[:12].reshape(4, 3)
    away = np.linalg.norm(found - PUBLISHED, axis=1)
    return [f"{name} {value:.1f}" for name, value in zip("ABCD", away, strict=True)]


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
    ]  # fmt: skip
    body = table(["what", "bar", "measured"], rows)
    write_section(
        "calibration-hangprinter", "Self-calibration of a real Hangprinter", COMMAND, body
    )
    print(body)


if __name__ == "__main__":
    main()
