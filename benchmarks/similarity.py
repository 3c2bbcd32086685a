"""Froude similarity: the same robot in other sizes must give the same dimensionless results.

    python -m benchmarks.similarity                       # the whole table
    python -m benchmarks.similarity --robots carosac --factors 0.1 10 --rows mpc/truth
    python -m benchmarks.similarity --no-counts           # encoders without resolution

Robot, path, control period, and rates and errors of the sensors are
scaled; all other settings are the defaults. What then differs is a constant in the code, or comes
from encoder counts: under a controller with feedback, a change in the last digit shifts counts
later, so that a run differs from itself by percents. Without counts it does not, and over several
seeds of the sensors the difference becomes small: with counts, that row is the root mean square of
eight, and what is limited their sum. Two processes.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import carosac_toolkit as ct
from benchmarks.results import table, write_section
from carosac_toolkit import trajectories
from carosac_toolkit.base.scaled import Ratios
from carosac_toolkit.drivers.sensors import SensorSettings
from carosac_toolkit.loop import loop, plugins
from carosac_toolkit.loop.plugin_builder import build_plugin
from carosac_toolkit.robot.similar import similar_robot, similarity
from carosac_toolkit.studies.run.run_case import Truth, final_rest
from carosac_toolkit.studies.run.scores import score

FACTORS = (0.1, 0.3, 3.0, 10.0)
BAR = 0.02
SPEED, ACCELERATION = 2.0, 3.0  # of the path at factor 1
PERIOD_S = 0.02
PATHS = {  # without slack cables or limited commands at factor 1
    "carosac": ("minimum_snap", 1), "scampi": ("minimum_snap", 0), "cogiro": ("minimum_snap", 0),
}  # fmt: skip
ROWS = (
    "straight_line/truth", "kinematic_solver/truth", "input_shaping/truth", "mpc/truth",
    "kinematic_solver/kinematic_solver", "kinematic_solver/ks_ekf",
    "kinematic_solver/dynamic_estimator", "mpc/dynamic_estimator",
)  # fmt: skip
FEEDBACK_ROW = "mpc/dynamic_estimator"  # in which encoder counts come back as commands
SEED, FEEDBACK_SEEDS = 1, 8  # of the sensors; how many in that row
PROCESSES = 2
SENSOR_UNITS = {
    "encoder_rate": "Hz", "encoder_noise": "m", "encoder_resolution": "m", "encoder_bias": "m",
    "encoder_delay": "s", "pose_rate": "Hz", "position_noise": "m", "pose_delay": "s",
    "imu_rate": "Hz", "angular_rate_noise": "rad/s", "angular_rate_bias": "rad/s",
    "specific_force_noise": "m/s^2", "specific_force_bias": "m/s^2", "imu_delay": "s",
    "tension_rate": "Hz", "tension_noise": "N", "tension_bias": "N", "tension_delay": "s",
    "swivel_rate": "Hz", "swivel_delay": "s", "attitude_rate": "Hz", "attitude_delay": "s",
    "inclination_rate": "Hz", "inclination_delay": "s",
}  # fmt: skip
# What estimators are told of the sensors, with units; other settings are theirs to derive.
TOLD_OF_SENSORS: Mapping[str, Mapping[str, str]] = {
    "dynamic_estimator": {
        "encoder_noise": "m", "encoder_bias": "m",
        "angular_rate_noise": "rad/s", "angular_rate_bias": "rad/s",
        "specific_force_noise": "m/s^2", "specific_force_bias": "m/s^2",
        "position_noise": "m", "rotation_noise": "rad",
        "load_cell_noise": "N", "load_cell_bias": "N", "attitude_heading_walk": "1/sqrt(s)",
    },
    "ks_ekf": {
        "length_noise": "m", "length_bias": "m",
        "angular_rate_noise": "rad/s", "angular_rate_bias": "rad/s",
        "specific_force_noise": "m/s^2", "specific_force_bias": "m/s^2",
        "bias_walk": "1/sqrt(s)",
    },
}  # fmt: skip
SCALES_WITH_LENGTH = ("tracking_rmse_norm_m", "residual_sway_m", "estimation_rmse_norm_m")
SCORES = (*SCALES_WITH_LENGTH, "nees", "tension_min_N", "limited")


@dataclass(frozen=True)
class World:
    """A robot in a size, with its path."""

    robot: ct.Robot
    ratios: Ratios
    path: trajectories.Trajectory


def world_of(name: str, factor: float) -> World:
    """Return a bundled robot in another size and the same path there."""
    robot, ratios = similar_robot(ct.load_robot(name), factor), similarity(factor)
    kind, seed = PATHS[name]
    path = trajectories.build(
        kind, robot, seed, speed_max=SPEED * ratios.of_unit("m/s"),
        acceleration_max=ACCELERATION,
    )  # fmt: skip
    return World(robot, ratios, path)


def run(
    world: World, row: str, *, counts: bool = True, seed: int = SEED, **asked: Mapping[str, Any]
) -> dict[str, Any]:
    """Run a controller on an estimator, ``controller/estimator``; return its scores.

    Args:
        world: Robot and path.
        row: Names.
        counts: Whether lengths are read in steps of the encoder's resolution.
        seed: Of the sensors.
        asked: Settings beside the defaults: of the ``controller``, ``estimator`` or ``driver``.
    """
    controller_name, estimator_name = row.split("/")
    robot, ratios = world.robot, world.ratios
    period = PERIOD_S * ratios.time
    usual = SensorSettings()
    errors: dict[str, Any] = {
        name: float(getattr(usual, name)) * ratios.of_unit(unit)
        for name, unit in SENSOR_UNITS.items()
    }
    if not counts:
        errors["encoder_resolution"] = 0.0
    sensors = SensorSettings(**errors)
    driver = build_plugin(
        plugins.load("drivers", "simulator"), robot, where="driver", seed=seed,
        asked={
            "suite": "lengths+imu", "sensors": sensors, "period": period,
            "start_position": tuple(world.path.sample(np.zeros(1)).position[0]),
            **asked.get("driver", {}),
        },
    )  # fmt: skip
    controller = build_plugin(
        plugins.load("controllers", controller_name), robot, where="controller",
        asked=asked.get("controller", {}), offered={"period": period},
    )  # fmt: skip
    estimator = Truth(driver)
    if estimator_name != "truth":
        plugin = plugins.load("estimators", estimator_name)
        estimator = build_plugin(
            plugin, robot, where="estimator",
            asked={**told_of_sensors(estimator_name, ratios), **asked.get("estimator", {})},
        )  # fmt: skip
    duration = world.path.duration + final_rest(robot)
    log = loop.run(driver, estimator, controller, world.path, duration=duration)
    scores = score(log, robot, world.path.duration)
    scores["limited_by"] = sorted({hit.limit for _, hit in log.limited})
    return scores


def told_of_sensors(estimator: str, ratios: Ratios) -> dict[str, float]:
    """Return the settings of an estimator that describe the scaled sensors."""
    told = TOLD_OF_SENSORS.get(estimator, {})
    usual = plugins.load("estimators", estimator).Settings() if told else None
    return {name: float(getattr(usual, name)) * ratios.of_unit(unit) for name, unit in told.items()}


def dimensionless(scores: Mapping[str, Any], world: World) -> dict[str, float | None]:
    """Return scores in lengths of factor 1, and tensions in shares of the weight per cable."""
    found = {name: scores[name] for name in SCORES}
    for name in SCALES_WITH_LENGTH:
        if found[name] is not None:
            found[name] /= world.ratios.length
    found["tension_min_N"] *= world.robot.n / world.robot.weight
    return found


def measure(job: tuple[str, str, float, bool]) -> dict[str, Any]:
    """Run a row on a robot in a size, with several seeds if counts matter; return all scores."""
    name, row, factor, counts = job
    began = time.perf_counter()
    world = world_of(name, factor)
    seeds = FEEDBACK_SEEDS if counts and row == FEEDBACK_ROW else 1
    runs = [run(world, row, counts=counts, seed=SEED + k) for k in range(seeds)]
    each = [dimensionless(scores, world) for scores in runs]
    found = {score_name: _together(score_name, each) for score_name in SCORES}
    limits = sorted({limit for scores in runs for limit in scores["limited_by"]})
    print(name, row, f"{factor:g}", found, limits, f"{time.perf_counter() - began:.1f} s",
          sep=" | ", flush=True)  # fmt: skip
    return {"robot": name, "row": row, "factor": factor, **found}


def _together(name: str, each: list[dict[str, float | None]]) -> float | None:
    """Return a score of several runs: RMS of errors, least tension, sum of `limited`, mean NEES."""
    values = [one[name] for one in each]
    known = np.array([value for value in values if value is not None])
    if len(known) < len(values):
        return None
    if name in SCALES_WITH_LENGTH:
        return float(np.sqrt(np.mean(known**2)))
    if name == "limited":
        return int(known.sum())
    return float(known.min() if name == "tension_min_N" else known.mean())


def main() -> None:
    """Run the table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--robots", nargs="+", default=list(PATHS))
    parser.add_argument("--factors", nargs="+", type=float, default=list(FACTORS))
    parser.add_argument("--rows", nargs="+")
    parser.add_argument("--no-counts", action="store_true")
    parser.add_argument("--json", type=Path)
    asked = parser.parse_args()
    whole = [FEEDBACK_ROW] if asked.no_counts else list(ROWS)
    rows = asked.rows or whole
    jobs = [
        (name, row, factor, not asked.no_counts)
        for name in asked.robots for row in rows for factor in (1.0, *asked.factors)
    ]  # fmt: skip
    with multiprocessing.get_context("spawn").Pool(PROCESSES) as pool:
        kept = pool.map(measure, jobs, chunksize=1)
    first = {(one["robot"], one["row"]): one for one in kept if one["factor"] == 1.0}
    lines = [
        [one["robot"], one["row"], f"{one['factor']:g}",
         *_shown(one, first[one["robot"], one["row"]], one["factor"])]
        for one in kept
    ]  # fmt: skip
    if asked.json:
        asked.json.write_text(json.dumps(kept))
    body = table(["robot", "controller/estimator", "factor", *SCORES], lines)
    if set(asked.robots) >= set(PATHS) and set(rows) >= set(whole):
        command = "python -m benchmarks.similarity"
        if asked.no_counts:
            title = "Similarity without encoder counts"
            write_section("similarity-no-counts", title, f"{command} --no-counts", body)
        else:
            write_section("similarity", "Similarity", command, body)


def _shown(found: Mapping[str, Any], first: Mapping[str, Any], factor: float) -> list[str]:
    """Return values at factor 1, and ratios to them at others; least tensions as differences."""
    cells = []
    for name in SCORES:
        value, before = found[name], first[name]
        if value is None:
            cells.append("-")
        elif name == "limited":
            cells.append(str(value))
        elif before == 0.0:
            cells.append(f"{value:.3g}")
        elif name == "tension_min_N":
            cells.append(f"{value:.3f}" if factor == 1.0 else f"{value - before:+.3f}")
        else:
            unit = 1e3 if name.endswith("_m") else 1.0
            cells.append(f"{unit * value:.3g}" if factor == 1.0 else f"{value / before:.3f}")
    return cells


if __name__ == "__main__":
    main()
