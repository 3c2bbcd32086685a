"""The paper's protocols for a trained policy, and catenary inverse kinematics beside it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import CarosacError, InvalidField
from carosac_toolkit.base.numbers import check_whole
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.trajectories import Trajectory, random_minimum_snap
from learned.environment import CableEnvironment, EnvironmentSettings
from learned.moving_worlds import MovingSettings, MovingWorlds
from learned.policy_file import Policy
from learned.scores import TENSION_TOLERANCE_N, Act, PolicyScores, score
from learned.settings_data import environment_settings
from learned.target_paths import PATH_ATTEMPTS_MAX, PathSettings, TargetPath, sampled
from sim_warp import Simulator

Protocol = Literal["no-sag", "settle", "realtime"]
PROTOCOL_PATHS = {"no-sag": 1000, "settle": 20, "realtime": 20}
SET_POINTS_PER_PATH = 100  # set-points along a path
SET_POINT_BATCH = 100  # paths of set-points at once
EVALUATION_SEED_OFFSET = 1_000_003  # added to seeds, so that no path of a training comes again
SETTLING_TIME_S = 1.0  # of particles at a set-point, and of platforms at the end of a path
PEAK_SPEED_RANGE_M_PER_S = (0.5, 2.08)  # in real time
ACCELERATION_MAX_M_PER_S2 = 2.0  # in real time
FEASIBILITY_STEP_S = 0.05  # between points of a path at which the robot must be able to rest
EVALUATION_WORLDS = MovingSettings(cables="particles", perturbation="nominal-1", start_speed=0.0)


def evaluate(policy: Policy, protocol: Protocol, *, paths: int, seed: int) -> PolicyScores:
    """Follow random paths of a protocol.

    * ``no-sag``: cubic splines with peak speeds up to 5 m/s as set-points of straight cables.
    * ``settle``: the same with sagging cables; each set-point settles, in cables of particles.
    * ``realtime``: whole minimum-snap paths, and a second of rest, with peak speeds up to 2.08 m/s
      on a robot that sways; plants and wind of `nominal-1`, cables of particles.

    Paths, plants and errors of the belief depend on the robot, the number of paths and the seed
    alone, not on how the policy was trained; wind is drawn in time steps that divide its period.

    Args:
        policy: Trained for set-points, or for real time.
        protocol: Which.
        paths: How many.
        seed: Of the paths, and of plants and biases.

    Raises:
        InvalidField: A policy of set-points in real time, or the other way round.
    """
    trial = _trial(policy, protocol, paths, seed)
    scores = trial.follow(trial.settings, policy.act)
    return settled_particles(trial.robot, scores) if protocol == "settle" else scores


def evaluate_inverse_kinematics(
    policy: Policy, protocol: Protocol, *, paths: int, seed: int, feedforward: bool = False
) -> PolicyScores:
    """Follow the same paths, on the same plants, by catenary inverse kinematics.

    In real time it acts as often as the policy and is aimed ahead as the reference of `Push` is.
    What it errs by, and the cables that it leaves slack, the set-points themselves cause.

    Args:
        policy: With which it shall be compared.
        protocol: ``settle`` or ``realtime``; without sag it is exact.
        paths: As in `evaluate`.
        seed: The same.
        feedforward: Whether the acceleration of the target is pushed for, in real time; see `Push`.

    Raises:
        InvalidField: The protocol ``no-sag``, or one that does not fit the policy.
    """
    if protocol == "no-sag":
        raise InvalidField("protocol", repr(protocol), "'settle' or 'realtime'")
    trial = _trial(policy, protocol, paths, seed)
    if protocol == "realtime":
        still = replace(
            trial.settings, observation=("target",), preview=(), action="push",
            feedforward=feedforward, correction=0.0,
        )  # fmt: skip
        return trial.follow(still, lambda seen: np.zeros((len(seen), 3)))
    return settled_particles(trial.robot, solved(trial.robot, trial.paths))


def slack_at_rest(policy: Policy, *, paths: int, seed: int) -> float:
    """Return how often the plants of ``realtime`` have a slack cable without any motion.

    They hang at rest on the lengths of catenary inverse kinematics of each target. Nothing but the
    errors of robot file and encoders takes their tension away.

    Args:
        policy: As in `evaluate`.
        paths: As there.
        seed: The same.

    Returns:
        Share of the points at which the plants can rest.
    """
    trial = _trial(policy, "realtime", paths, seed)
    robot, moving, period = trial.robot, trial.settings.moving, trial.settings.path.period
    assert period is not None
    worlds = MovingWorlds(robot, moving, period, paths, EVALUATION_SEED_OFFSET + seed)
    points = [path.position for path in trial.paths]
    worlds.reset(np.arange(paths), np.stack([one[0] for one in points]))
    slack_rows = []
    for step in range(1, max(len(one) for one in points)):
        there = np.array([step < len(one) for one in points])
        target = np.stack([one[min(step, len(one) - 1)] for one in points])
        asked = statics.inverse_kinematics(robot, target).unstrained_length
        rest = worlds.hung(asked)
        slack = rest.tension < robot.tension_min - TENSION_TOLERANCE_N
        slack_rows.append(slack[there & rest.converged & rest.stable].any(axis=1))
    return float(np.concatenate(slack_rows).mean())


@dataclass(frozen=True, kw_only=True, eq=False)
class _PolicyTrial:
    """Robot, settings and paths of a protocol, the same for all that follow them."""

    robot: Robot
    settings: EnvironmentSettings
    paths: list[TargetPath]
    seed: int

    def follow(self, settings: EnvironmentSettings, act: Act) -> PolicyScores:
        """Act on all paths."""
        count = len(self.paths)
        size = count  # in real time all have a plant of their own
        if settings.world != "realtime":
            size = next(k for k in range(min(SET_POINT_BATCH, count), 0, -1) if count % k == 0)
        environment = CableEnvironment(
            self.robot, settings, size=size, seed=EVALUATION_SEED_OFFSET + self.seed
        )
        return score(environment, act, self.paths)


def _trial(policy: Policy, protocol: Protocol, paths: int, seed: int) -> _PolicyTrial:
    """Prepare the settings and paths of a protocol."""
    check_whole("paths", paths, 1)
    robot = policy.description.robot
    settings = settings_of(environment_settings(policy.description.settings), protocol)
    if protocol == "realtime":
        period = settings.path.period
        assert period is not None
        targets = [timed(one, period) for one in random_trajectories(robot, paths, seed)]
        steps = max(len(path.position) for path in targets)  # one more: no row begins anew
        settings = replace(settings, path=replace(settings.path, steps=steps))
    else:
        targets = CableEnvironment(robot, settings, seed=EVALUATION_SEED_OFFSET + seed).first_paths(
            paths
        )
    return _PolicyTrial(robot=robot, settings=settings, paths=targets, seed=seed)


def settings_of(trained: EnvironmentSettings, protocol: Protocol) -> EnvironmentSettings:
    """Return the environment of a protocol, for a policy that was trained in another one."""
    if protocol not in PROTOCOL_PATHS:
        raise InvalidField("protocol", repr(protocol), f"one of {list(PROTOCOL_PATHS)}")
    if (trained.world == "realtime") != (protocol == "realtime"):
        allowed = "'realtime'" if trained.world == "realtime" else "'no-sag' or 'settle'"
        raise InvalidField("protocol", repr(protocol), f"{allowed}, as the policy was trained")
    if protocol == "realtime":
        path = PathSettings(
            kind="minimum_snap", speed=PEAK_SPEED_RANGE_M_PER_S,
            acceleration_max=ACCELERATION_MAX_M_PER_S2, period=trained.path.period,
        )  # fmt: skip
        return replace(trained, lost=None, moving=EVALUATION_WORLDS, path=path)
    world: Literal["no_sag", "settle"] = "no_sag" if protocol == "no-sag" else "settle"
    return replace(trained, world=world, lost=None, path=PathSettings(steps=SET_POINTS_PER_PATH))


def random_trajectories(robot: Robot, count: int, seed: int) -> list[Trajectory]:
    """Draw the paths of ``realtime``, from rest to rest, for any period of a policy.

    Raises:
        CarosacError: The robot cannot rest along any of 100 paths that were drawn.
    """
    trajectories = []
    for index in range(count):
        rng = np.random.default_rng([EVALUATION_SEED_OFFSET + seed, 7, index])
        drawn = (_drawn(robot, rng) for _ in range(PATH_ATTEMPTS_MAX))
        one = next((trajectory for trajectory in drawn if trajectory is not None), None)
        if one is None:
            raise CarosacError(
                f"{robot.name}: none of {PATH_ATTEMPTS_MAX} random paths is feasible"
            )
        trajectories.append(one)
    return trajectories


def _drawn(robot: Robot, rng: np.random.Generator) -> Trajectory | None:
    """Draw a path; return None if it leaves the box or the robot cannot rest along it."""
    speed = float(rng.uniform(*PEAK_SPEED_RANGE_M_PER_S))
    try:
        path = random_minimum_snap(
            robot, rng, speed_max=speed, acceleration_max=ACCELERATION_MAX_M_PER_S2
        )
    except InvalidField:
        return None
    times = np.linspace(0.0, path.duration, int(np.ceil(path.duration / FEASIBILITY_STEP_S)) + 1)
    rest = statics.inverse_kinematics(robot, path.sample(times).position)
    return path if (rest.converged & rest.stable).all() else None


def timed(trajectory: Trajectory, period: float) -> TargetPath:
    """Sample a whole path and a second of rest, one target each period."""
    steps = int(np.ceil((trajectory.duration + SETTLING_TIME_S) / period - 1e-9))
    return sampled(trajectory, PathSettings(steps=steps, period=period))


def solved(robot: Robot, paths: list[TargetPath]) -> PolicyScores:
    """Solve for set-points at rest by catenary inverse kinematics; they are reached."""
    target = np.stack([path.position[1:] for path in paths])
    rest = statics.inverse_kinematics(robot, target.reshape(-1, 3))
    shape = target.shape[:2]
    zero = np.zeros((*shape, robot.n))
    return PolicyScores(
        target=target,
        position=rest.position.reshape(target.shape),
        length_error=zero,
        inconsistency=zero[..., 0],
        length=rest.unstrained_length.reshape(zero.shape),
        tilt=zero[..., 0],
        tension=rest.tension.reshape(zero.shape),
        failed=~(rest.converged & rest.stable).reshape(shape),
        counted=np.ones(shape, dtype=bool),
    )


def settled_particles(robot: Robot, scores: PolicyScores) -> PolicyScores:
    """Settle the same set-points in cables of particles: at rest, left alone for a second.

    Positions and tensions are those of the particles then; tilt and inconsistency stay those of
    the catenaries.
    """
    paths, points, _ = scores.length.shape
    simulator = Simulator(robot, worlds=paths, cables="particles")
    position, tension = np.array(scores.position), np.array(scores.tension)
    failed = np.array(scores.failed)
    for k in range(points):
        simulator.reset(unstrained_length=scores.length[:, k])
        simulator.step(scores.length[:, k], SETTLING_TIME_S)
        state = simulator.state.numpy()
        position[:, k], tension[:, k] = state.position, state.tension
        failed[:, k] |= state.failed
    return replace(scores, position=position, tension=tension, failed=failed)


def trajectory_errors(scores: PolicyScores) -> tuple[Array, Array]:
    """Return mean distance and mean absolute length error of each path [m], each (N,)."""
    distance = np.linalg.norm(scores.error, axis=2)
    length = np.abs(scores.length_error).mean(axis=2)
    return _mean_of_path(scores, distance), _mean_of_path(scores, length)


def trajectory_rmse(scores: PolicyScores) -> Array:
    """Return the RMSE of each path along each axis of W [m], shape (N, 3)."""
    squares = (_mean_of_path(scores, scores.error[..., k] ** 2) for k in range(3))
    return np.asarray(np.sqrt(np.stack(list(squares), axis=1)))


def rmse_ratio(scores: PolicyScores, other: PolicyScores) -> float:
    """Return the RMSE of the distance over that of another, over steps that count for both."""
    failed = np.maximum.accumulate(scores.failed | other.failed, axis=1)
    seen = scores.counted & ~failed
    mine, theirs = ((one.error[seen] ** 2).sum() for one in (scores, other))
    return float(np.sqrt(mine / theirs)) if seen.any() else float("nan")


def _mean_of_path(scores: PolicyScores, values: Array) -> Array:
    """Average values (N, T) over the steps of each path that count, shape (N,)."""
    total = np.where(scores.counted, values, 0.0).sum(axis=1)
    return np.asarray(total / scores.counted.sum(axis=1))
