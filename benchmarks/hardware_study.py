"""One study on the simulator, the emulated PLC and a recording: only the driver's name changes.

``python -m benchmarks.hardware_study``. The PLC is a process of its own, in real time, its IMU
comes over UDP, and the recording is of a run on it. Four ways to control shall finish each path.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.results import table, write_section
from carosac_toolkit.cli import run as run_command
from carosac_toolkit.studies.compare.study import Study
from tests.plc_process import PlcProcess, plc_process

DRIVERS = ("simulator", "ads", "replay")
WAYS = {  # controller and estimator
    "KS": ("kinematic_solver", "kinematic_solver"),
    "KS+EKF": ("kinematic_solver", "ks_ekf"),
    "MPC": ("mpc", "ks_ekf"),
    "TD3": ("td3", "ks_ekf"),
}
SUITE = "lengths+imu"
PATHS = ("minimum_snap", "circle")
PORT = 5017  # of the IMU
PATIENCE = 0.25  # [s] that host and PLC wait for each other on a desk
MM = 1e3
Rows = Mapping[str, Sequence[dict[str, Any]]]


def record(plc: PlcProcess, file: Path) -> Path:
    """Record a circle, as ``carosac run`` does."""
    x, y, z = (float(v) for v in plc.robot.home_position)
    options = run_command.Options(
        robot=str(plc.file), driver="ads", estimator="ks_ekf", sensors=SUITE, trajectory="circle",
        speed=0.5, acceleration=0.5, enable=True, home=(x, y, z), home_anew=True,
        settings=(f"driver.inner.start_position=[{x},{y},{z}]", f"driver.hang_time={PATIENCE}"),
        output=file,
    )  # fmt: skip
    result = run_command.run(options)
    if result.status:
        sys.exit(f"the run to be recorded ended with {result.data['reason']}")
    return file


def study(driver: str, robot: Path, recording: Path, output: Path) -> Study:
    """The study; what it says of a driver is passed over by the others."""
    return Study(
        driver=driver, robots=[str(robot)], controllers=["kinematic_solver", "mpc", "td3"],
        estimators=["kinematic_solver", "ks_ekf"], sensors=[SUITE], trajectories=PATHS,
        perturbations=["none"],
        seeds=1, speed_max=0.5, acceleration_max=0.5, output=output, workers=1, timeout=120.0,
        driver_settings={
            "ads": {"motion": True, "hang_time": PATIENCE},
            "replay": {"recording": str(recording)},
        },
    )  # fmt: skip


def of_way(rows: Sequence[dict[str, Any]], way: str) -> list[dict[str, Any]]:
    """Those of one controller and estimator."""
    return [row for row in rows if (row["controller"], row["estimator"]) == WAYS[way]]


def middle(rows: Sequence[dict[str, Any]], name: str) -> str:
    """Median over the paths [mm]."""
    values = [row[name] for row in rows if row.get(name) is not None]
    return f"{MM * float(np.median(values)):.1f}" if values else "-"


def told(rows: Rows) -> str:
    """The table, and why cases failed."""
    lines, reasons = [], set()
    for way in WAYS:
        cells = [way]
        for driver in DRIVERS:
            mine = of_way(rows[driver], way)
            done = [row for row in mine if row["status"] == "ok" and row["completed"]]
            reasons |= {f"{way} on {driver}: {r['reason'] or 'ended early'}" for r in mine
                        if r not in done}  # fmt: skip
            cells.append(f"{len(done)} of {len(mine)}")
            if driver != "replay":
                cells.append(middle(done, "tracking_rmse_norm_m"))
            else:
                cells.append(middle(done, "command_rmse_m"))
            cells.append(middle(done, "estimation_rmse_norm_m"))
        lines.append(cells)
    header = ["", *(f"{driver}: {what}" for driver in DRIVERS for what in (
        "finished", "commands against the recorded ones [mm]" if driver == "replay"
        else "tracking [mm]", "estimation [mm]"))]  # fmt: skip
    return "\n".join([
        "A minimum-snap path and a circle at up to 0.5 m/s on `carosac`; a circle, recorded on the "
        "PLC, is replayed. Medians over the paths of root mean squares. The simulator has sensors "
        "with biases and cables of particles, the emulated PLC catenaries and lengths as its "
        "machine has them. On a recording no command moves anything: a controller that learns from "
        "what its commands do, as the MPC, asks for ever more.", "",
        table(header, lines), "", *sorted(reasons),
    ])  # fmt: skip


def main() -> None:
    """Run the three studies and write the table."""
    words = ("--watchdog", str(PATIENCE))
    with plc_process(*words, imu=PORT) as plc, tempfile.TemporaryDirectory() as folder:
        out = Path(folder)
        recording = record(plc, out / "run.jsonl")
        rows = {x: study(x, plc.file, recording, out / x).run().rows for x in DRIVERS}
    text = told(rows)
    print(text)
    command = "python -m benchmarks.hardware_study"
    write_section("hardware_study", "One study on three drivers", command, text)


if __name__ == "__main__":
    main()
