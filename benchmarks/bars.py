"""Slow acceptance measurements of the core; figures go to RESULTS.md."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

import carosac_toolkit as ct
from benchmarks.results import table, write_section
from carosac_toolkit.physics.kernel_modules import kernel_modules
from carosac_toolkit.physics.rest import statics
from tests import reference
from tests.physics.cable.test_catenary import KNOWN, random_cables

COUNT = 10_000


def catenary() -> list[list[str]]:
    """Known cables, and random ones from near-taut to slack."""
    span, rise, length, stiffness, weight, *known = KNOWN.T
    found = ct.catenary.solve(span, rise, length, weight, stiffness)
    values = (found.horizontal, found.vertical_lower, found.vertical_upper)
    error = max(float(np.abs(a / b - 1.0).max()) for a, b in zip(values, known, strict=True))
    cables = random_cables(np.random.default_rng(0), 100_000)
    many = ct.catenary.solve(*cables)
    closure = float((many.closure / cables[2]).max())
    return [
        ["known cables, relative error", "1e-8", f"{error:.1e}"],
        ["1e5 random cables converged", "all", f"{many.converged.mean():.5%}"],
        ["their closure over length", "1e-9", f"{closure:.1e}"],
    ]


def round_trip(name: str) -> list[list[str]]:
    """IK of uniform positions, FK of its lengths without a guess."""
    robot = ct.load_robot(name)
    rng = np.random.default_rng(0)
    where = rng.uniform(robot.workspace_min, robot.workspace_max, (COUNT, 3))
    there = statics.inverse_kinematics(robot, where)
    good = there.converged
    back = statics.forward_kinematics(robot, there.unstrained_length[good])
    distance = np.linalg.norm(back.position - where[good], axis=1)
    home = back.converged & (distance < 1e-6)
    other = back.converged & ~home & back.stable
    silent = back.converged & ~home & ~back.stable
    worst = max(float(there.residual[good].max()), float(back.residual[back.converged].max()))
    sample = np.concatenate([np.flatnonzero(other), np.arange(0, len(distance), 100)])
    truth = max(
        float(
            np.abs(
                reference.cable_wrench(
                    robot,
                    back.unstrained_length[k],
                    back.position[k],
                    back.rotation[k],
                    back.exit_tension[k],
                )
            ).max()
        )
        for k in sample
    )
    reasons = np.bincount(there.status, minlength=3)
    return [
        [f"{name}: IK feasible (of them stable)", "reported",
         f"{good.mean():.2%} ({there.stable[good].mean():.2%})"],
        [f"{name}: IK infeasible / not converged", "reported", f"{reasons[2]} / {reasons[0]}"],
        [f"{name}: FK without a guess back to 1e-6 m", "99.9 %", f"{home.mean():.3%}"],
        [f"{name}: other stable equilibrium / not converged / wrong", "- / - / 0",
         f"{other.sum()} / {(~back.converged).sum()} / {silent.sum()}"],
        [f"{name}: largest residual over weight", "1e-9", f"{worst / robot.weight:.1e}"],
        [f"{name}: the same by independent equations, {len(sample)} poses and all exceptions",
         "1e-8", f"{truth / robot.weight:.1e}"],
    ]  # fmt: skip


def compile_time() -> list[list[str]]:
    """CPU time to compile all kernels of the core into an empty cache."""
    code = (
        "import resource\n"
        "from importlib import import_module\n"
        "from carosac_toolkit.physics import warp_setup\n"
        f"for name in {kernel_modules(('learned', 'sim_warp'))!r}:\n"
        "    warp_setup.load(import_module(name))\n"
        "usage = resource.getrusage(resource.RUSAGE_SELF)\n"
        "print(usage.ru_utime + usage.ru_stime)\n"
    )
    with tempfile.TemporaryDirectory() as cache:
        environment = os.environ | {"WARP_CACHE_PATH": cache}
        run = subprocess.run(
            [sys.executable, "-c", code],
            env=environment,
            capture_output=True,
            text=True,
            check=True,
        )
    return [["all kernels compiled, CPU time", "60 s", f"{float(run.stdout):.0f} s"]]


def recording() -> list[list[str]]:
    """The kinematic solver on the real recording, if it is there."""
    from carosac_toolkit.validation import validate

    data = Path(os.environ.get("CAROSAC_DATA", "../shared/data"))
    path = data / "scampi_run_part.csv"
    if not path.is_file():
        return [["real recording", "31.7 / 10.7 / 11.2 mm +- 1.5", "not run: no data"]]
    bundled = ct.load_robot("scampi")
    authors = replace(bundled, center_of_mass=np.array([0.0, 0.0, -0.0764]))
    rows = []
    for label, robot in (("authors' moment", authors), ("bundled scampi", bundled)):
        result = validate(ct.load_recording(path), robot, ["kinematic_solver"])
        rmse = result.data()["models"]["kinematic_solver"]["rmse_m"]
        axes = " / ".join(f"{rmse[k] * 1e3:.1f}" for k in ("x", "y", "z"))
        rows.append(
            [f"KS on the real recording, {label}", "31.7 / 10.7 / 11.2, 35.3 mm +- 1.5",
             f"{axes}, {rmse['norm'] * 1e3:.1f} mm"]
        )  # fmt: skip
    return rows


def main() -> None:
    """Measure and write."""
    start = time.time()
    rows = catenary()
    for name in ("carosac", "ipanema1", "cogiro"):
        rows += round_trip(name)
    rows += compile_time() + recording()
    body = table(["bar", "required", "measured"], rows)
    write_section("bars:core", "Acceptance of the core", "make bars", body)
    print(body)
    print(f"{time.time() - start:.0f} s")


if __name__ == "__main__":
    main()
