"""Acceptance of the identification: on the real recording, and on simulated robots.

Run it from the project's root: ``python -m benchmarks.calibration_identify [--seeds N]``. It takes
some minutes a seed. The real recording is looked for in ``../shared/data`` or `CAROSAC_DATA` and is
left out, saying so, where it is absent.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path
from time import process_time

import numpy as np

import carosac_toolkit as ct
from benchmarks.results import write_section
from calibration import IdentificationSettings, identify, simulate_run
from calibration.identification.open_loop import simulate
from calibration.identification.procedure import poses_of
from carosac_toolkit.base.scaled import resolved
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.recordings.length_path import LengthPath
from carosac_toolkit.robot.parameters import values_of

TITLE = "Identification of the dynamics"
HEADER = (
    "| seed | nominal | truth | identified | worst parameter, in its sigmas | RMS | beyond 3 | s |"
)


def main() -> None:
    """Measure and write."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--seeds", type=int, default=8)
    seeds = parser.parse_args().seeds
    lines = [*_real(), "", *_simulated(seeds)]
    command = "python -m benchmarks.calibration_identify"
    write_section("calibration-identify", TITLE, command, "\n".join(lines))


def _real() -> list[str]:
    """The SCAMPI recording."""
    folder = Path(os.environ.get("CAROSAC_DATA", "../shared/data"))
    path = folder / "scampi_run_part.csv"
    if not path.is_file():
        return [f"Real recording: not run, no {path.name}."]
    start = process_time()
    result = identify(
        ct.load_recording(path), ct.load_robot("scampi"), train=(0, 400), test=(400, 600)
    )
    seconds = process_time() - start
    test, rests = result.test, result.rests
    assert test is not None
    x, y, z, norm = test.after.rmse * 1e3
    delay = result.estimate.index("length_delay")
    late = rests.starts >= 400
    largest, largest_late = np.nanmax(rests.after) * 1e3, np.nanmax(rests.after[late]) * 1e3
    rows = [
        ("open loop on samples 400:600, RMS in norm", "10 mm, aim 6", f"{norm:.2f} mm"),
        ("x, y, z", "reported", f"{x:.2f}, {y:.2f}, {z:.2f} mm"),
        ("orientation", "reported", f"{np.degrees(test.after.orientation_rmse):.2f} deg"),
        ("before", "29", f"{test.before.rmse[3] * 1e3:.1f} mm"),
        ("samples 0:400, which were fitted", "reported",
         f"{result.train.after.rmse[3] * 1e3:.2f} mm"),
        ("delay, 1 sigma", "near 33 ms",
         f"{result.estimate.value[delay] * 1e3:.1f}, {result.estimate.sigma[delay] * 1e3:.1f} ms"),
        ("equilibrium of each rest against its mean pose: largest of all, of those from 400 on",
         "15 mm", f"{largest:.1f}, {largest_late:.1f} mm"),
        ("the same before", "reported", f"{np.nanmax(rests.before) * 1e3:.1f} mm"),
        ("processor time", "reported", f"{seconds:.0f} s"),
    ]  # fmt: skip
    table = [f"| {what} | {bar} | {value} |" for what, bar, value in rows]
    return ["Real recording of the robot scampi, fitted on samples 0:400:", "",
            "| what | bar | measured |", "|---|---|---|", *table]  # fmt: skip


def _simulated(seeds: int) -> list[str]:
    """Robots drawn from nominal-1, simulated with particles, wind and noisy sensors."""
    robot = ct.load_robot("carosac")
    settings = resolved(IdentificationSettings(), Scales(robot).ratios)
    rows, beyond, total = [], 0, 0
    for seed in range(seeds):
        run = simulate_run(robot, seed)
        count = len(run.recording.time)
        cut = round(0.7 * count)
        start = process_time()
        result = identify(run.recording, robot, settings, train=(0, cut), test=(cut, count))
        seconds = process_time() - start
        poses = poses_of(run.recording)
        motion = simulate(
            [run.plant], LengthPath(run.recording), poses.time, time_step=settings.time_step
        )
        errors = poses.errors(motion.position[:, 0], motion.rotation[:, 0])[poses.index >= cut]
        truth = float(np.sqrt((errors[:, :3] ** 2).sum(axis=1).mean()))
        estimate = result.estimate
        off = np.abs(estimate.value - values_of(run.plant, estimate.names)) / estimate.sigma
        worst = int(np.argmax(off))
        assert result.test is not None
        beyond, total = beyond + int((off > 3.0).sum()), total + len(off)
        rows.append(
            f"| {seed} | {result.test.before.rmse[3] * 1e3:.1f} | {truth * 1e3:.1f} | "
            f"{result.test.after.rmse[3] * 1e3:.1f} | {off[worst]:.2f}, {estimate.names[worst]} | "
            f"{np.sqrt((off**2).mean()):.2f} | {int((off > 3.0).sum())} | {seconds:.0f} |"
        )
        print(rows[-1], flush=True)
    return [
        "Simulated robots `carosac` of condition `nominal-1` with 100 Hz sensors, about 90 s each; "
        "the first 70 % are fitted. Open-loop RMS errors of the rest in mm, of the nominal robot, "
        "of the true one (wind alone) and of the identified one; errors of the parameters in their "
        f"stated sigmas: {beyond} of {total} lie beyond 3. An identified robot can come nearer "
        "than the true one: what the wind had started before the cut, and the fit had followed, "
        "still swings after it.",
        "",
        HEADER,
        "|---|---|---|---|---|---|---|---|",
        *rows,
    ]


if __name__ == "__main__":
    main()
