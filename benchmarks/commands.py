"""Figures of README and docs that ``carosac`` commands print: the commands, run anew.

Run it from the project's root: ``python -m benchmarks.commands [--parts ...]``; each part is a
section of ``benchmarks/RESULTS.md`` and takes some minutes. Part ``recording`` needs the real
SCAMPI recording in ``../shared/data`` or `CAROSAC_DATA`.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import carosac_toolkit as ct
from benchmarks.results import table, write_section
from carosac_toolkit.recordings.encoders import calibrated
from carosac_toolkit.validation.phases import find_phases
from carosac_toolkit.validation.run import run_open_loop
from sim_warp.estimator import SimulatorEstimator, SimulatorSettings

COMMAND = "python -m benchmarks.commands"
POLICIES = tuple(
    f"{robot}-{kind}"
    for robot in ("carosac", "scampi")
    for kind in ("no-sag", "settle", "residual")
)
MOVES = "--speed 2 --acceleration 1.5 --seed 20 --seeds 3"
SHAPERS = (
    "--controllers kinematic_solver input_shaping input_shaping@zvd input_shaping@all "
    "--estimators kinematic_solver --sensors lengths --set "
    "controller.input_shaping@zvd.shaper=zvd --set controller.input_shaping@all.directions=all"
)
STUDIES = {
    "make demo": "--seeds 6",
    "minimum_snap": f"{SHAPERS} --trajectories minimum_snap {MOVES}",
    "waypoints": f"{SHAPERS} --trajectories waypoints {MOVES}",
}


def carosac(command: str, folder: Path) -> dict[str, Any]:
    """Run a command in a folder and return the numbers of its ``--json``.

    Raises:
        CalledProcessError: It could not run; status 1 means that it warns or that a case failed.
    """
    program = Path(sys.executable).with_name("carosac")
    numbers = folder / "numbers.json"
    numbers.unlink(missing_ok=True)
    done = subprocess.run([program, *command.split(), "--json", numbers], cwd=folder, check=False)
    if done.returncode > 1:
        done.check_returncode()
    return dict(json.loads(numbers.read_text(encoding="utf-8")))


def millimetres(value: float | None, digits: int = 1) -> str:
    """Return a length in millimetres, or a dash where there is none."""
    return "-" if value is None else f"{value * 1e3:.{digits}f}"


def per_axis(errors: dict[str, float]) -> str:
    """Return the errors along x, y and z in millimetres."""
    return " / ".join(millimetres(errors[axis]) for axis in "xyz")


def percent(share: float | None) -> str:
    """Return a share in percent, or a dash where there is none."""
    return "-" if share is None else f"{share * 100:.2f}"


def policies(folder: Path) -> str:
    """Evaluate the bundled policies by the protocols in which they were trained."""
    header = [
        "policy", "lengths of", "median \\|error\\| x / y / z [mm]", "median [mm]",
        "median of the paths' means [mm]", "p95 [mm]", "RMSE [mm]", "ratio of the RMSE",
        "inconsistency [mm]", "tilt against rest, median [deg]", "points with a slack cable [%]",
        "at rest [%]", "least tension [N]", "paths", "paths that failed",
    ]  # fmt: skip
    rows = []
    for name in POLICIES:
        scores = carosac(f"evaluate {name} --output pictures", folder)
        for label, of in (
            ("policy", scores),
            ("catenary inverse kinematics", scores.get("inverse_kinematics")),
            ("with feedforward", scores.get("feedforward")),
        ):
            if of is None:
                continue
            ratio, tilt = of.get("rmse_ratio"), of.get("median_tilt_rad")
            tensions = of.get("tension_range_N")
            rows.append(
                [
                    name, label, per_axis(of["median_error_m"]),
                    millimetres(of["median_error_m"]["norm"]),
                    millimetres(of["median_of_trajectory_means_m"]),
                    millimetres(of["p95_error_m"]), millimetres(of["rmse_m"]),
                    "-" if ratio is None else f"{ratio:.2f}",
                    millimetres(of.get("inconsistency_m")),
                    "-" if tilt is None else f"{math.degrees(tilt):.2f}",
                    percent(of.get("slack_share")), percent(of.get("slack_share_at_rest")),
                    "-" if tensions is None else f"{tensions[0]:.1f}",
                    str(of["trajectories"]), str(of["failures"]),
                ]
            )  # fmt: skip
    return (
        "`carosac evaluate POLICY` for each bundled policy, seed 0. The ratio is to catenary "
        "inverse kinematics on the same paths and plants.\n\n" + table(header, rows)
    )


def studies(folder: Path) -> str:
    """Compare controllers on the studies that README and docs show."""
    rows = []
    for name, options in STUDIES.items():
        summary = carosac(f"compare {options} --output {name.replace(' ', '-')}", folder)["summary"]
        rows += [
            [
                name, row["controller"], str(row["cases"] - row["failures"]), str(row["failures"]),
                millimetres(row["tracking_rmse_m"]["norm"]), millimetres(row["residual_sway_m"]),
            ]
            for row in summary
        ]  # fmt: skip
    commands = "\n".join(f"* {name}: `carosac compare {STUDIES[name]}`" for name in STUDIES)
    header = ["study", "controller", "cases", "failed", "tracking RMSE [mm]", "sway [mm]"]
    return f"{commands}\n\n{table(header, rows)}"


def rest_errors(recording: ct.Recording, robot: ct.Robot, start: int) -> str:
    """Return mean and largest error of the kinematic solver at the mean pose of each rest."""
    lengths = calibrated(recording, robot).unstrained_length
    measured = recording.pose_at(recording.time)
    errors = []
    for first, last in find_phases(recording.time, recording.unstrained_length).rests:
        if first >= start:
            rows = np.arange(first, last)[measured.valid[first:last]]
            hanging = ct.statics.forward_kinematics(robot, lengths[rows]).position
            off = hanging.mean(axis=0) - measured.pose.position[rows].mean(axis=0)
            errors.append(np.linalg.norm(off))
    return f"{millimetres(float(np.mean(errors)))} / {millimetres(float(np.max(errors)))}"


def catenary_errors(recording: ct.Recording, robot: ct.Robot) -> dict[str, float]:
    """Return the RMSE of the simulator with catenaries, per axis and in norm [m]."""
    model = SimulatorEstimator.build(robot, SimulatorSettings(cables="catenary"))
    motion = run_open_loop(model, recording, len(recording.time))
    measured = recording.pose_at(recording.time)
    error = (motion.position - measured.pose.position)[measured.valid]
    squared = (error**2).mean(axis=0)
    norms = dict(zip("xyz", np.sqrt(squared), strict=True))
    return {**norms, "norm": float(np.sqrt(squared.sum()))}


def recording(folder: Path) -> str:
    """Score models, estimators and calibrations on the real recording."""
    data = Path(os.environ.get("CAROSAC_DATA", "../shared/data"))
    path = (data / "scampi_run_part.csv").resolve()
    if not path.is_file():
        print(f"not run: no real recording at {path}")
        return ""
    run, scampi = ct.load_recording(path), ct.load_robot("scampi")
    rows = []

    def add(what: str, rmse: dict[str, float], robot: str, samples: str, nees: str = "-") -> None:
        rows.append([what, robot, samples, per_axis(rmse), millimetres(rmse["norm"]), nees])

    models = "straight_line kinematic_solver simulator"
    scores = carosac(f"validate {path} --robot scampi --models {models} --output v", folder)
    for name, model in scores["models"].items():
        add(name, model["rmse_m"], "scampi", "0:600")
    add("simulator, catenaries", catenary_errors(run, scampi), "scampi", "0:600")
    identify = f"identify {path} --robot scampi --train 0:400 --test 400:600 --report i"
    carosac(f"{identify} --output identified.yaml", folder)
    late = "--robot identified.yaml --start 400 --stop 600"
    models = "kinematic_solver dynamic_estimator simulator"
    scores = carosac(f"validate {path} {late} --models {models} --output w", folder)
    for name, model in scores["models"].items():
        claimed = model["nees"]
        nees = "-" if claimed is None else f"{claimed:.2f}"
        add(name, model["rmse_m"], "identified", "400:600", nees)
    for poses in ("withheld", "half"):
        smoothed = carosac(f"smooth {path} {late} --poses {poses} --report s-{poses}", folder)
        of = smoothed["scores"]["all"]
        add(f"smoother, poses {poses}", of["rmse_m"], "identified", "400:600", f"{of['nees']:.2f}")
    header = ["model", "robot", "samples", "RMSE x / y / z [mm]", "norm [mm]", "NEES [-]"]
    fits = []
    for stop, start in ((600, 0), (400, 400)):
        calibrate = f"calibrate lengths {path} --robot scampi --stop {stop} --report c{stop}"
        fit = carosac(f"{calibrate} --output calibrated{stop}.yaml", folder)
        after = ct.load_robot(folder / f"calibrated{stop}.yaml")
        fits += [
            [f"0:{stop}", f"{start}:600", "before", millimetres(fit["residual_rms_before_m"]),
             rest_errors(run, scampi, start)],
            [f"0:{stop}", f"{start}:600", "after", millimetres(fit["residual_rms_m"]),
             rest_errors(run, after, start)],
        ]  # fmt: skip
    return (
        "600 samples of the SCAMPI run, open loop from sample 0; `identified` is fitted to samples "
        f"0:400.\n\n{table(header, rows)}\n\n`carosac calibrate lengths`, and the kinematic solver "
        "at the mean pose of each rest:\n\n"
        + table(
            ["calibrated on", "scored on", "when", "lengths, RMS [mm]",
             "rests, mean / largest error [mm]"],
            fits,
        )
    )  # fmt: skip


Part = tuple[str, Callable[[Path], str]]
PARTS: dict[str, Part] = {
    "policies": ("Bundled policies", policies),
    "studies": ("Studies of the documentation", studies),
    "recording": ("Commands on the real recording", recording),
}


def main() -> None:
    """Run the commands and write the sections."""
    parser = argparse.ArgumentParser(prog=COMMAND)
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=list(PARTS))
    for name in parser.parse_args().parts:
        title, part = PARTS[name]
        with tempfile.TemporaryDirectory() as folder:
            body = part(Path(folder))
        print(body, flush=True)
        if body:
            write_section(f"commands:{name}", title, f"{COMMAND} --parts {name}", body)


if __name__ == "__main__":
    main()
