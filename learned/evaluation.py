"""The paper's protocols for a trained policy."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np

from carosac_toolkit.arrays import Array
from carosac_toolkit.errors import InvalidField
from carosac_toolkit.robot import Robot
from learned.environment import CableEnvironment, EnvironmentSettings, WorldName
from learned.episodes import PathSettings
from learned.policy_file import Policy
from learned.scores import Scores, score
from learned.settings_data import environment_settings
from sim_warp import Simulator

Protocol = Literal["no-sag", "settle", "realtime"]
PATHS = {"no-sag": 1000, "settle": 20, "realtime": 20}
POINTS = {"no-sag": 100, "settle": 100}  # set-points along a path
BATCH = 100  # paths at once
UNSEEN = 1_000_003  # added to seeds, so that no path of a training comes again
REST = 1.0  # [s] that particles get to come to their own rest
WORLDS: dict[str, WorldName] = {
    "no-sag": "no_sag", "settle": "settle", "realtime": "realtime"
}  # fmt: skip


def evaluate(policy: Policy, protocol: Protocol, *, paths: int, seed: int) -> Scores:
    """Follow random paths of a protocol.

    * ``no-sag``: cubic splines with peak speeds up to 5 m/s as set-points of straight cables.
    * ``settle``: the same with sagging cables; each set-point settles, in cables of particles.
    * ``realtime``: minimum-snap paths with peak speeds up to 2.08 m/s on a robot that sways, with
      the plants, winches and wind that the policy was trained for, in cables of particles.

    Args:
        policy: Trained for set-points, or for real time.
        protocol: Which.
        paths: How many.
        seed: Of the paths, and of plants and biases.

    Raises:
        InvalidField: A policy of set-points in real time, or the other way round.
    """
    robot = policy.description.robot
    trained = environment_settings(policy.description.settings)
    settings = settings_of(trained, protocol)
    size = next(k for k in range(min(BATCH, paths), 0, -1) if paths % k == 0)
    environment = CableEnvironment(robot, settings, size=size, seed=UNSEEN + seed)
    found = score(environment, policy.act, environment.first_paths(paths))
    return settled_particles(robot, found) if protocol == "settle" else found


def settings_of(trained: EnvironmentSettings, protocol: Protocol) -> EnvironmentSettings:
    """The environment of a protocol, for a policy that was trained in another one."""
    if protocol not in WORLDS:
        raise InvalidField("protocol", repr(protocol), f"one of {list(WORLDS)}")
    if (trained.world == "realtime") != (protocol == "realtime"):
        allowed = "'realtime'" if trained.world == "realtime" else "'no-sag' or 'settle'"
        raise InvalidField("protocol", repr(protocol), f"{allowed}, as the policy was trained")
    if protocol == "realtime":
        return replace(
            trained, lost=None, moving=replace(trained.moving, cables="particles", start_speed=0.0)
        )
    path = PathSettings(steps=POINTS[protocol])
    return replace(trained, world=WORLDS[protocol], lost=None, path=path)


def settled_particles(robot: Robot, scores: Scores) -> Scores:
    """The same set-points in cables of particles: placed at rest, and left alone for a second.

    Positions and tensions are those of the particles then; tilt and inconsistency stay those of
    the catenaries.
    """
    paths, points, _ = scores.length.shape
    simulator = Simulator(robot, worlds=paths, cables="particles")
    position, tension = np.array(scores.position), np.array(scores.tension)
    failed = np.array(scores.failed)
    for k in range(points):
        simulator.reset(unstrained_length=scores.length[:, k])
        simulator.step(scores.length[:, k], REST)
        state = simulator.state.numpy()
        position[:, k], tension[:, k] = state.position, state.tension
        failed[:, k] |= state.failed
    return replace(scores, position=position, tension=tension, failed=failed)


def trajectory_errors(scores: Scores) -> tuple[Array, Array]:
    """Mean distance and mean absolute length error of each path [m], each of shape (N,)."""
    distance = np.linalg.norm(scores.error, axis=2).mean(axis=1)
    return distance, np.abs(scores.length_error).mean(axis=(1, 2))
