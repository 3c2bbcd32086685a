"""Calibration from rests without poses: accuracy, consistency, what load cells add."""

from __future__ import annotations

import sys
from dataclasses import dataclass, fields, replace
from time import process_time
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

import carosac_toolkit as ct
from benchmarks.calibration_lengths import TACHYMETER
from benchmarks.results import table, write_section
from calibration import RestScene, calibrate_rests, draw_rest_scene
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.robot.similar import similar_robot

COMMAND = "python -m benchmarks.calibration_rests"
SCENES, SCENES_SLOW = 50, 20


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """One scene: errors of the first pose [m], [rad], its squared normalised error, time [s]."""

    position: float
    rotation: float
    sigma: float
    nees: float
    warned: bool
    cpu: float


def surveyed(robot: Robot) -> Robot:
    """Return the robot with exit points known to 1 mm per axis."""
    covariance = np.tile(TACHYMETER**2 * np.eye(3), (robot.n, 1, 1))
    return replace(robot, exit_covariance=covariance)


def suspended(n: int) -> Robot:
    """Return a robot on n < 6 cables from a ring of 4 m, 3 m high, over pulleys of 3 cm."""
    base = ct.load_robot("carosac")
    angle = 2.0 * np.pi * (np.arange(n) + 0.5) / n
    ring = np.stack([np.cos(angle), np.sin(angle), np.zeros(n)], axis=1)
    cut = {
        field.name: value[:n]
        for field in fields(base)
        if isinstance(value := getattr(base, field.name), np.ndarray) and len(value) == base.n
    }
    changes: dict[str, Any] = {
        "name": f"suspended_{n}", "cable_names": base.cable_names[:n],
        "exit_points": 2.0 * ring + [0.0, 0.0, 3.0], "anchor_points": 0.15 * ring,
        "pulley_radius": np.full(n, 0.03), "swivel_axis": np.tile([0.0, 0.0, 1.0], (n, 1)),
        "run_length": np.full(n, 2.0), "axial_stiffness": np.full(n, 2e5),
        "linear_density": np.full(n, 0.005), "tension_min": np.full(n, 2.0), "mass": 10.0,
        "center_of_mass": np.array([0.0, 0.0, -0.1]), "inertia": 0.3 * np.eye(3),
        "workspace_min": np.array([-0.8, -0.8, 0.5]), "workspace_max": np.array([0.8, 0.8, 2.0]),
        "home_position": np.array([0.0, 0.0, 1.0]), "home_rotation": np.eye(3), "hardware": None,
    }  # fmt: skip
    return replace(base, **(cut | changes))


def robots() -> dict[str, Robot]:
    """Return the robots, by what they are called in the table."""
    third = similar_robot(ct.load_robot("warehouse"), 1.0 / 3.0)
    return {
        "warehouse in a third of its size, 8 cables": third,
        "suspended, ring of 4 m, 4 cables": suspended(4),
        "suspended, ring of 4 m, 3 cables": suspended(3),
        "warehouse, 12 x 8 x 6 m, 8 cables": ct.load_robot("warehouse"),
    }


def judge(scene: RestScene, robot: Robot) -> Outcome:
    """Calibrate, and compare the first pose with the truth."""
    began = process_time()
    found = calibrate_rests(scene.recording, robot)
    turn = Rotation.from_matrix(found.rotation[0] @ scene.rotation[0].T).as_rotvec()
    error = np.concatenate([found.position[0] - scene.position[0], turn])
    covariance = found.pose_covariance[0]
    return Outcome(
        position=float(np.linalg.norm(error[:3])),
        rotation=float(np.linalg.norm(error[3:])),
        sigma=float(np.sqrt(np.trace(covariance[:3, :3]))),
        nees=float(error @ np.linalg.solve(covariance, error)),
        warned=bool(found.warnings),
        cpu=process_time() - began,
    )


def rows_of(name: str, robot: Robot, scenes: int) -> list[tuple[str, ...]]:
    """Return two lines of the table: with load cells and without."""
    outcomes: dict[str, list[Outcome]] = {"all": [], "without load cells": []}
    for seed in range(scenes):
        scene = draw_rest_scene(robot, np.random.default_rng(seed))
        bare = replace(scene, recording=replace(scene.recording, tension=None))
        outcomes["all"].append(judge(scene, robot))
        outcomes["without load cells"].append(judge(bare, robot))
    rows: list[tuple[str, ...]] = []
    for sensors, each in outcomes.items():
        position = 1e3 * np.array([o.position for o in each])
        rotation = np.rad2deg([o.rotation for o in each])
        count = 6 * len(each)
        low, high = chi2.ppf([0.025, 0.975], count) / count
        rows.append(
            (
                name, sensors,
                f"{np.median(position):.1f}", f"{np.quantile(position, 0.95):.1f}",
                f"{1e3 * np.median([o.sigma for o in each]):.1f}",
                f"{np.median(rotation):.2f}", f"{np.quantile(rotation, 0.95):.2f}",
                f"{sum(o.nees for o in each) / count:.2f} ({low:.2f}-{high:.2f})",
                f"{sum(o.warned for o in each)} of {len(each)}",
                f"{np.median([o.cpu for o in each]):.1f}",
            )
        )  # fmt: skip
        print(rows[-1], flush=True)
    return rows


def main() -> None:
    """Measure and write the section."""
    wanted = sys.argv[1:]
    rows = []
    for name, robot in robots().items():
        if not wanted or any(name.startswith(word) for word in wanted):
            slow = name.startswith("warehouse, 12")
            rows += rows_of(name, surveyed(robot), SCENES_SLOW if slow else SCENES)
    header = (
        "robot", "sensors beside lengths", "first pose, median [mm]", "95 % [mm]",
        "claimed 1 sigma [mm]", "rotation, median [degrees]", "rotation, 95 % [degrees]",
        "NEES of the pose per freedom (95 % band)", "with a warning", "CPU time [s]",
    )  # fmt: skip
    body = (
        f"{SCENES} scenes a robot, {SCENES_SLOW} of the large warehouse: exit points off by 1 mm "
        "per axis, 27 rests spread through the workspace box, turned by up to 0.3 rad per axis "
        "where cables hold a rotation; relative lengths 0.5 mm; load cells 1 %, their scales off "
        "by up to 20 %, their zeros by a tenth of the weight per cable; AHRS 0.3 degrees, mounted "
        "2 degrees off, of unknown heading; swivel angles 0.2 degrees. The noise is drawn once for "
        "each rest. Position errors are distances in space; claimed: root of the trace of their "
        "covariance, median.\n\n" + table(header, rows)
    )
    write_section("calibration-rests", "Calibration from rests without poses", COMMAND, body)


if __name__ == "__main__":
    main()
