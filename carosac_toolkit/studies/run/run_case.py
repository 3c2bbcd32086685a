"""Case of a study: build everything by name, run the loop, return its row."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from carosac_toolkit import trajectories
from carosac_toolkit.base.arrays import evenly
from carosac_toolkit.base.errors import CarosacError, InvalidField
from carosac_toolkit.base.rotations import from_matrix
from carosac_toolkit.base.scaled import Scaled
from carosac_toolkit.live.rehearsal import rehearse
from carosac_toolkit.loop import plugins
from carosac_toolkit.loop.loop import Log, run
from carosac_toolkit.loop.plugin_builder import build_plugin, uses_of
from carosac_toolkit.loop.plugin_errors import BadPlugin
from carosac_toolkit.loop.protocols import TruthSource, replays
from carosac_toolkit.loop.values import Belief, Command, Measurement
from carosac_toolkit.physics.motion.winch import PaidOutLengths
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.robot.condition_file import condition_digest, find_condition
from carosac_toolkit.robot.file import load_robot, robot_text
from carosac_toolkit.robot.perturbations import Condition, PlainCondition, draw_plant
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.safety.settled import settled
from carosac_toolkit.studies.run.case import TRUTH, Case
from carosac_toolkit.studies.run.divergence import DIVERGED, divergence
from carosac_toolkit.studies.run.limit_scores import own_words
from carosac_toolkit.studies.run.scores import score
from carosac_toolkit.trajectories.path_file import is_path_file, path_digest
from carosac_toolkit.trajectories.trajectory import Trajectory

DEFAULT_DRIVER = "simulator"
CASE_DRIVER_SETTINGS = (  # what a case says itself
    "suite", "period", "start_position", "scene", "set_down", "wind_force", "wind_time",
)  # fmt: skip
FINAL_REST = Scaled(3.0, "s")  # after the trajectory, for the residual sway
SERIES_SAMPLES_MAX = 500  # samples kept of a case for pictures
CASE_SETTINGS = (
    "driver", "speed_max", "acceleration_max", "controller_settings", "estimator_settings",
    "driver_settings", "timeout", "example_seed", "robot_digest", "condition_digest",
    "trajectory_digest", "file_digests",
)  # fmt: skip
PLUGIN_SETTINGS = ("controller_settings", "estimator_settings", "driver_settings")


class Truth:
    """Estimator `truth`: the state of the simulated world. For simulation only."""

    def __init__(self, source: object) -> None:
        if not isinstance(source, TruthSource) or replays(source):
            raise InvalidField("estimator", "'truth'", "a simulated driver, which knows the truth")
        self._source = source

    def reset(self, measurement: Measurement) -> Belief:
        """Return the state now."""
        state = self._source.truth()
        if state is None:
            raise CarosacError("estimator truth: the driver does not know the truth here")
        return Belief(
            time=measurement.time,
            position=state.position,
            rotation=state.rotation,
            twist=state.twist,
            tension=state.tension,
        )

    def update(self, belief: Belief, command: Command, measurement: Measurement) -> Belief:
        """Return the state now."""
        return self.reset(measurement)


def run_case(case: Case) -> dict[str, Any]:
    """Run and score one case.

    Settings that are read: ``driver`` (default `DEFAULT_DRIVER`), ``speed_max`` [m/s],
    ``acceleration_max`` [m/s^2] of the trajectory (default: `default_limits` of the robot),
    ``controller_settings``, ``estimator_settings`` and ``driver_settings`` (fields of the plug-in's
    own settings, a dict for each settings dataclass inside them; what stands under the name of a
    driver is for it alone); ``timeout`` is read by `run_cases`.

    Returns:
        One flat row: errors in m, latency in s, counts; ``series`` holds what pictures need, as
        JSON text, for the seed ``example_seed`` (default 0) only. On a driver that replays,
        tracking says nothing about the controller and is None; ``command_rmse_m`` compares what
        it asked with what was sent. ``diverged`` is why its errors are no score, or None.

    Raises:
        InvalidField: A setting that nobody reads.
    """
    settings = known_settings(case.settings)
    robot = robot_of(case.robot, digest_of(case))
    condition = condition_of(case).of(robot)
    plant = plant_of(case, robot)
    controller = build_part("controllers", case.controller, robot, case, "controller_settings")
    name = str(settings.get("driver", DEFAULT_DRIVER))
    recorded = replays(plugins.load("drivers", name))
    path = None if recorded else path_of(case, robot)
    start = robot.home_position if path is None else path.sample(np.zeros(1)).position[0]
    driver_settings = given_to_driver(
        case, condition, period_of(controller), tuple(float(x) for x in start)
    )
    driver = build_part(
        "drivers", name, plant, case, "driver_settings", driver_settings, nominal=robot
    )
    estimator = estimator_of(case, robot, driver)
    if path is None:
        duration = controller.period * len(driver.recording.time)
    else:
        duration = final_rest(robot) + path.duration
    path = path or trajectories.from_recording(driver.recording, robot)
    if getattr(driver, "real_time", False):
        rehearse(robot, estimator, controller, path, suite=case.sensors)
    paid_out = None if recorded else PaidOutLengths.of(robot)
    log = run(driver, estimator, controller, path, duration=duration, paid_out=paid_out)
    if getattr(driver, "fault", None) is not None:
        raise CarosacError(f"driver {name}: {driver.fault}")
    row = score(log, robot, path.duration, replayed=recorded)
    row |= own_words(controller) | {"path_moved_m": path.moved}
    row["final_rest_s"] = None if recorded else final_rest(robot)
    row[DIVERGED] = divergence(log, robot, replayed=recorded)
    return row | {"series": example_series(case, log)}


def plant_of(case: Case, robot: Robot) -> Robot:
    """Return the plant that a case draws from its condition."""
    condition = condition_of(case).of(robot)
    return draw_plant(robot, condition, np.random.default_rng(case.plant_seed))


def path_of(case: Case, robot: Robot) -> Trajectory:
    """Return the trajectory that a case draws, or that of its file.

    Raises:
        CarosacError: The file is not the one that the case was made for.
    """
    if is_path_file(case.trajectory):
        if case.settings.get("trajectory_digest") not in (None, path_digest(case.trajectory)):
            raise CarosacError(
                f"trajectory {case.trajectory}: this file is not the one the study was made for"
            )
        return trajectories.from_file(case.trajectory, robot)
    limits = {x: case.settings.get(x) for x in ("speed_max", "acceleration_max")}
    return trajectories.build(case.trajectory, robot, case.path_seed % 2**32, **limits)


def final_rest(robot: Robot) -> float:
    """Return the time after a trajectory that is simulated and scored for residual sway [s]."""
    return FINAL_REST.of(Scales(robot).ratios)


def estimator_of(case: Case, robot: Robot, driver: object) -> Any:
    """Return the estimator that a case names; `truth` asks the driver."""
    if case.estimator == TRUTH:
        return Truth(driver)
    sensors = case.sensors.split("+")
    given = {"load_cells": "tension" in sensors, **uses_of(sensors, simulated=not replays(driver))}
    asked = case.settings.get("estimator_settings", {})
    given = {name: value for name, value in given.items() if name not in asked}
    return build_part("estimators", case.estimator, robot, case, "estimator_settings", given)


def given_to_driver(
    case: Case, condition: Condition | PlainCondition, period: float, start: tuple[Any, ...]
) -> dict[str, Any]:
    """Return settings of a driver that the case itself says; `start` in W [m], one or a row each.

    A guard gets the `scene` for the driver behind it.
    """
    scene = {
        "set_down": True, "wind_force": condition.wind_force, "wind_time": condition.wind_time,
    }  # fmt: skip
    values = (case.sensors, period, start, scene, *scene.values())
    return dict(zip(CASE_DRIVER_SETTINGS, values, strict=True))


def period_of(controller: Any) -> float:
    """Return the time between two commands [s], which drivers need."""
    period = getattr(controller, "period", None)
    if not isinstance(period, int | float) or not 0.0 < period < np.inf:
        raise BadPlugin(f"controller: got period {period!r}; allowed: > 0 s, finite")
    return float(period)


def known_settings(settings: Mapping[str, Any]) -> Mapping[str, Any]:
    """Refuse unknown settings of a case."""
    unknown = sorted(set(settings) - set(CASE_SETTINGS))
    if unknown:
        raise InvalidField(f"settings.{unknown[0]}", "a name", f"one of {sorted(CASE_SETTINGS)}")
    return settings


def example_series(case: Case, log: Log) -> str | None:
    """Return the thinned-out time series for pictures and viewer, as JSON; order w x y z.

    None for all seeds but the one that is shown.
    """
    if case.seed != case.settings.get("example_seed", 0):
        return None
    keep = evenly(len(log.time), SERIES_SAMPLES_MAX)
    channels: dict[str, Any] = {
        "time_s": log.time[keep],
        "reference_m": log.reference[keep, 0],
        "position_m": None if log.position is None else log.position[keep, 0],
        "quaternion": None if log.rotation is None else from_matrix(log.rotation[keep, 0]),
        "tension_N": None if log.tension is None else log.tension[keep, 0],
        "unstrained_length_m": None if log.true_length is None else log.true_length[keep, 0],
        "belief_m": log.belief_position[keep, 0],
        "length_error_m": (log.unstrained_length - log.command)[keep, 0],
    }
    thin = {k: None if v is None else np.round(v, 6).tolist() for k, v in channels.items()}
    return json.dumps(thin)


def build_part(
    kind: plugins.Kind, name: str, robot: Robot | Sequence[Robot], case: Case, key: str,
    given: Mapping[str, Any] | None = None, *, seeds: Sequence[int] | None = None,
    nominal: Robot | None = None,
) -> Any:  # fmt: skip
    """Make a plug-in by name, with its own settings.

    Args:
        kind: Kind of the plug-in.
        name: Name of the plug-in, or of a variant of it.
        robot: Robot that it is built for; several for a driver of a batch.
        case: Whose settings count, and whose seed.
        key: Key of its settings among those of the case.
        given: Settings that the case itself sets, as far as the plug-in has them.
        seeds: For a driver of a batch, one for each robot.
        nominal: For a driver, the robot whose size settles its settings; `robot` is a plant.
    """
    check_files(case)
    plugin = plugins.load(kind, plugin_name(name))
    seed = case.sensor_seed if kind == "drivers" else case.rng_seed
    own = dict(case.settings.get(key, {}))
    asked = own_settings(name, own) if kind == "drivers" else own
    offered = given or {}
    if hasattr(plugin, "Settings"):
        for clash in sorted(set(offered) & set(asked)):
            allowed = "none: the case itself sets it"
            raise InvalidField(f"{key}.{clash}", repr(asked[clash]), allowed)
    return build_plugin(
        plugin, robot, where=key, asked=asked, offered=offered, seed=seed, seeds=seeds,
        settle=None if nominal is None else lambda settings: settled(settings, nominal),
    )  # fmt: skip


def own_settings(name: str, asked: Mapping[str, Any]) -> dict[str, Any]:
    """Return the settings of a driver: those for any driver, and those under its own name.

    So one study runs on several drivers, and each has settings that the others do not know.
    """
    drivers = plugins.names("drivers")
    return {k: v for k, v in asked.items() if k not in drivers} | dict(asked.get(name, {}))


def plugin_name(name: str) -> str:
    """Return the plug-in that a name stands for: ``ks_ekf`` for its variant ``ks_ekf@tight``."""
    return name.partition("@")[0]


def robot_digest(name: str) -> str:
    """Return the digest of a robot file that is part of the identity of a case."""
    return hashlib.sha256(robot_text(name).encode()).hexdigest()[:16]


def digest_of(case: Case) -> str:
    """Return the digest of the local robot file, which must be the one the case was made for."""
    here = robot_digest(case.robot)
    if case.settings.get("robot_digest", here) != here:
        raise CarosacError(f"robot {case.robot}: this file is not the one the study was made for")
    return here


def file_digests(settings: Mapping[str, Any]) -> dict[str, str]:
    """Return digests of the files that settings of plug-ins name, such as a policy, by setting."""
    found: dict[str, str] = {}

    def look(where: str, value: Any) -> None:
        if isinstance(value, Mapping):
            for name, inner in value.items():
                look(f"{where}.{name}", inner)
        elif isinstance(value, str) and os.path.isfile(value):  # any text may be asked
            state = Path(value).stat()
            found[where] = _file_digest(value, state.st_mtime_ns, state.st_size)

    for key in PLUGIN_SETTINGS:
        look(key, settings.get(key, {}))
    return found


@lru_cache(maxsize=64)
def _file_digest(name: str, changed: int, size: int) -> str:
    """Return the digest of a file, read once as long as it does not change."""
    return hashlib.sha256(Path(name).read_bytes()).hexdigest()[:16]


def check_files(case: Case) -> None:
    """Refuse files of settings that are not the ones that the case was made for."""
    here = file_digests(case.settings)
    for where, digest in case.settings.get("file_digests", {}).items():
        if here.get(where) != digest:
            raise CarosacError(f"{where}: this file is not the one the study was made for")


def condition_of(case: Case) -> Condition:
    """Return the condition of a case; a file must be the one that the case was made for."""
    if case.settings.get("condition_digest") not in (None, condition_digest(case.perturbation)):
        raise CarosacError(
            f"condition {case.perturbation}: this file is not the one the study was made for"
        )
    return find_condition(case.perturbation)


@lru_cache(maxsize=8)
def robot_of(name: str, digest: str) -> Robot:
    """Return a robot; each is read once per process and content, to keep its device buffers."""
    return load_robot(name)
