"""A policy drives as it was trained, and refuses what it was not trained for."""

from __future__ import annotations

import json
from dataclasses import asdict, replace

import numpy as np
import pytest

import carosac_toolkit as ct
from carosac_toolkit import trajectories
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.loop.loop import run
from carosac_toolkit.loop.values import Belief, Reference
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.studies.run.run_case import Truth
from learned.environment import CableEnvironment, EnvironmentSettings
from learned.learning_curve import read_curve
from learned.policy_controller import (
    DEFAULT_POLICIES,
    PolicyController,
    PolicySettings,
    find_policy,
    list_policies,
    policy_of,
)
from learned.policy_file import Policy, PolicyDescription, write_policy
from learned.presets import find_preset
from learned.rewards import RewardSettings
from learned.shaped_fallback import ShapedFallback
from learned.target_paths import PathSettings, sampled
from learned.training_record import with_later_fields
from sim_warp.driver import SimDriver, SimDriverSettings

REALTIME = EnvironmentSettings(
    world="realtime",
    observation=(
        "error",
        "velocity_error",
        "velocity",
        "tilt",
        "turn",
        "target_velocity",
        "preview",
        "last_action",
        "mean_error",
    ),
    preview=(2, 5),
    action="push",
    feedforward=True,
    correction=2.0,
    correction_memory=1.0,
    reward=RewardSettings(terms=("tracking",)),
    path=PathSettings(kind="minimum_snap", speed=(1.0, 1.0), period=0.05, steps=20),
)


def random_policy(path, robot, settings: EnvironmentSettings, sizes: tuple[int, int]) -> Policy:
    """A network that has learned nothing, for a robot and its settings."""
    rng = np.random.default_rng(3)
    shapes = [(16, sizes[0]), (sizes[1], 16)]
    layers = [
        (rng.normal(0, 0.3, s).astype(np.float32), np.zeros(s[0], dtype=np.float32)) for s in shapes
    ]
    description = PolicyDescription(
        preset="none", robot=robot, observation=settings.observation, action=settings.action,
        period=settings.path.period, settings={"environment": asdict(settings)}, seed=0, steps=0,
        commit="", scores={},
    )  # fmt: skip
    write_policy(path, layers, "silu", description)
    return Policy.load(path)


def belief_of(environment: CableEnvironment, result) -> Belief:
    reached = result.reached
    return replace(reached.belief, time=np.zeros(1))


def test_driving_gives_the_lengths_of_training(tmp_path):
    robot = ct.load_robot("carosac")
    environment = CableEnvironment(robot, REALTIME, seed=4)
    sizes = (environment.observation_size, environment.action_size)
    policy = random_policy(tmp_path / "p.onnx", robot, REALTIME, sizes)
    controller = PolicyController(robot, policy, PolicySettings())
    path = trajectories.random_minimum_snap(
        robot, np.random.default_rng(1), speed_max=1.0, acceleration_max=20.0
    )
    environment._draw = lambda: sampled(path, REALTIME.path)
    observation = environment.reset([environment._draw()])
    for _ in range(2):  # the second episode begins where the first one ends
        belief = replace(environment.worlds._reached().belief, time=np.zeros(1))
        controller.reset(belief)
        for k in range(REALTIME.path.steps):  # the path goes on beyond the last one
            window = path.window(k * controller.period, controller.horizon, controller.period)
            driven = controller.command(belief, window).unstrained_length
            result = environment.step(policy.act(observation))
            np.testing.assert_allclose(driven, result.transition.asked, atol=1e-6)
            observation, belief = result.observation, belief_of(environment, result)
        assert result.truncated.all()


def test_set_points_are_read_ahead_by_the_lag(tmp_path):
    robot = ct.load_robot("carosac")
    settings = EnvironmentSettings(observation=("target",))
    policy = random_policy(tmp_path / "p.onnx", robot, settings, (3, 4))
    controller = PolicyController(robot, policy, PolicySettings(period=0.02))
    path = trajectories.build("line", robot, 0)
    belief = Belief(
        time=np.zeros(1), position=robot.home_position[None], rotation=robot.home_rotation[None]
    )
    controller.reset(belief)
    window = path.window(1.0, controller.horizon, controller.period)
    there = path.sample([1.0 + robot.winch_lag.mean() + 0.01]).position
    unit = controller._scales.to_unit(there)
    wanted = controller._scales.to_length(policy.act(unit))
    found = controller.command(belief, window).unstrained_length
    np.testing.assert_allclose(found, wanted, atol=1e-4)
    short = path.window(1.0, 0.0, controller.period)
    with pytest.raises(InvalidField, match=r"reference: got 1 rows; allowed: at least \d+, those"):
        controller.command(belief, short)


def test_other_robots_are_refused_by_what_differs(tmp_path):
    robot = ct.load_robot("carosac")
    settings = EnvironmentSettings(observation=("target",))
    policy = random_policy(tmp_path / "p.onnx", robot, settings, (3, 4))
    heavy = replace(robot, mass=30.0)
    with pytest.raises(InvalidField, match="mass differ"):
        PolicyController(heavy, policy, PolicySettings())
    box = replace(robot, workspace_max=robot.workspace_max + 0.1)
    with pytest.raises(InvalidField, match="workspace_max differ"):
        PolicyController(box, policy, PolicySettings())
    with pytest.raises(InvalidField, match="8 cables"):
        PolicyController(ct.load_robot("cogiro"), policy, PolicySettings())


@pytest.mark.parametrize(
    "name", ["winch_lag", "speed_max", "acceleration_max", "axial_damping", "drag", "angular_drag"]
)
def test_winches_and_damping_matter_in_motion_alone(tmp_path, name):
    robot = ct.load_robot("carosac")
    other = replace(robot, **{name: 1.1 * getattr(robot, name)})
    size = CableEnvironment(robot, REALTIME).observation_size
    moving = random_policy(tmp_path / "m.onnx", robot, REALTIME, (size, 3))
    with pytest.raises(InvalidField, match=f"trained for; {name} differ"):
        PolicyController(other, moving, PolicySettings())
    still = EnvironmentSettings(observation=("target",))
    PolicyController(
        other, random_policy(tmp_path / "s.onnx", robot, still, (3, 4)), PolicySettings()
    )


@pytest.mark.parametrize("name", ["tension_min", "tension_max"])
def test_tension_limits_matter_to_all_policies(tmp_path, name):
    robot = ct.load_robot("carosac")
    other = replace(robot, **{name: 1.1 * getattr(robot, name)})
    settings = EnvironmentSettings(observation=("target",))
    policy = random_policy(tmp_path / "s.onnx", robot, settings, (3, 4))
    with pytest.raises(InvalidField, match=f"trained for; {name} differ"):
        PolicyController(other, policy, PolicySettings())


def random_controller(tmp_path, robot, settings):
    """A controller whose policy has learned nothing."""
    environment = CableEnvironment(robot, settings)
    sizes = (environment.observation_size, environment.action_size)
    policy = random_policy(tmp_path / "p.onnx", robot, settings, sizes)
    return PolicyController(robot, policy, PolicySettings())


def belief_at(robot, position, time=0.0):
    """Robots believed to be at rest at positions (B, 3), turned as at home."""
    size = len(position)
    return Belief(
        time=np.full(size, time), position=position,
        rotation=robot.home_rotation[None].repeat(size, axis=0), twist=np.zeros((size, 6)),
    )  # fmt: skip


@pytest.mark.parametrize("settings", [EnvironmentSettings(observation=("target",)), REALTIME])
def test_input_shaping_takes_over_for_targets_outside_the_workspace_box(tmp_path, settings):
    robot = ct.load_robot("carosac")
    start = robot.home_position
    belief = belief_at(robot, start[None])
    top = float(robot.workspace_max[2])
    for height, fallbacks in (
        (top, {}), (top + 0.01, {}), (top + 0.1, {"target outside the box": 1}),
    ):  # fmt: skip
        controller = random_controller(tmp_path, robot, settings)
        controller.reset(belief)
        path = trajectories.line((*start[:2], height - 1.0), (*start[:2], height),
                                 speed_max=1.0, acceleration_max=2.0)  # fmt: skip
        controller.command(
            belief, path.window(path.duration, controller.horizon, controller.period)
        )
        assert controller.fallbacks == fallbacks


def test_input_shaping_brings_back_a_robot_that_is_lost(tmp_path):
    """Of two robots the lost one is taken over smoothly, and given back once it is calm."""
    robot = ct.load_robot("carosac")
    settings = replace(REALTIME, lost=0.5)
    controller = random_controller(tmp_path, robot, settings)
    place = robot.home_position
    path = trajectories.line(
        place, place + np.array([1e-3, 0.0, 0.0]), speed_max=0.1, acceleration_max=0.1
    )
    shaped = statics.inverse_kinematics(robot, path.sample([path.duration]).position)

    def commands(off, begin, end):
        found = []
        for k in range(begin, end):
            there = place + np.array([[0.0] * 3, [off, 0.0, 0.0]])
            belief = belief_at(robot, there, time=0.02 * k)
            if k == 0:
                controller.reset(belief)
            window = path.window(0.02 * k, controller.horizon, controller.period)
            found.append(controller.command(belief, window).unstrained_length)
        return np.array(found)

    near = commands(0.0, 0, 100)
    assert controller.fallbacks == {}
    far = commands(0.51, 100, 250)
    assert controller.fallbacks == {"far from the reference": 150}
    back = commands(0.0, 250, 400)
    assert set(controller.fallbacks) == {"far from the reference", "calming down"}
    np.testing.assert_allclose(far[-1, 1], shaped.unstrained_length[0], atol=1e-4)
    np.testing.assert_allclose(back[-1, 1], back[-1, 0], atol=2e-3)  # the policies of both agree
    steps = np.abs(np.diff(np.concatenate([near, far, back])[60:, 1], axis=0)).max(axis=1)
    assert steps.max() < 0.02 * 0.3  # no jump: at most 0.3 m/s


FAR_OFF = np.array([0.6, 0.0, 0.0])


class Glitch:
    """The truth, but for some beliefs that are far off."""

    def __init__(self, driver, begin, end):
        self._truth, self._begin, self._end = Truth(driver), begin, end

    def reset(self, measurement):
        return self._truth.reset(measurement)

    def update(self, belief, command, measurement):
        now = self._truth.update(belief, command, measurement)
        wrong = self._begin <= now.time[0] < self._end
        return replace(now, position=now.position + FAR_OFF) if wrong else now


@pytest.mark.parametrize("lost_for", [0.08, 10.0])
def test_input_shaping_takes_over_in_motion_without_a_jerk(lost_for):
    """At full speed; then no cable accelerates beyond its limit, and the platform stays near."""
    robot = ct.load_robot("carosac")
    controller = PolicyController.build(robot)
    place = robot.home_position
    path = trajectories.line(place + np.array([-1.0, -1.0, 0.0]), place + np.array([1.0, 1.0, 0.5]),
                             speed_max=1.0, acceleration_max=1.0)  # fmt: skip
    middle = 0.5 * path.duration
    start = tuple(path.sample([0.0]).position[0])
    settings = SimDriverSettings(period=controller.period, start_position=start)
    driver = SimDriver.build(robot, settings)
    log = run(driver, Glitch(driver, middle, middle + lost_for), controller, path,
              duration=path.duration + 2.0)  # fmt: skip
    fallbacks = controller.fallbacks
    assert fallbacks["far from the reference"] == sum(
        middle <= t < middle + lost_for for t in log.time
    )
    error = np.linalg.norm(log.position - log.reference, axis=2)[:, 0]
    assert error.max() < 0.12  # input shaping alone: 0.053
    around = np.abs(log.time - middle) < 0.5
    rate = np.diff(log.command[:, 0], axis=0) / controller.period
    acceleration = np.abs(np.diff(rate, axis=0)) / controller.period
    assert acceleration[around[2:]].max() < robot.acceleration_max.max()


def test_each_of_two_robots_has_its_own_reference(tmp_path):
    robot = ct.load_robot("carosac")
    settings = replace(REALTIME, lost=0.5)
    controller = random_controller(tmp_path, robot, settings)
    places = robot.home_position + np.array([[0.0, 0.0, 0.0], [0.3, 0.2, 0.1]])
    rows = round(controller.horizon / controller.period) + 1
    still = np.zeros((2, rows, 3))
    window = Reference(
        time=np.tile(controller.period * np.arange(rows), (2, 1)),
        position=np.repeat(places[:, None], rows, axis=1), velocity=still, acceleration=still,
        rotation=np.tile(robot.home_rotation, (2, rows, 1, 1)),
    )  # fmt: skip
    belief = belief_at(robot, places + np.array([[0.0] * 3, [0.6, 0.0, 0.0]]))
    controller.reset(belief)
    for _ in range(2):  # a reset gives back who has commanded
        for k in range(80):
            later = replace(belief, time=belief.time + controller.period * k)
            moved = replace(window, time=window.time + controller.period * k)
            lengths = controller.command(later, moved).unstrained_length
        rest = statics.inverse_kinematics(robot, places[1:]).unstrained_length
        np.testing.assert_allclose(lengths[1:], rest, atol=1e-4)
        assert controller.fallbacks == {"far from the reference": 80}
        controller.reset(belief)


@pytest.mark.parametrize("name", ["hangprinter", "desktop", "warehouse"])
def test_any_robot_has_something_to_fall_back_on(name):
    robot = ct.load_robot(name)
    fallback = ShapedFallback(robot, 0.02)
    assert fallback.horizon >= 0.0
    assert not fallback.active.any()


def test_an_observation_of_another_size_is_refused(tmp_path):
    robot = ct.load_robot("carosac")
    settings = EnvironmentSettings(observation=("target",))
    policy = random_policy(tmp_path / "p.onnx", robot, settings, (4, 4))
    with pytest.raises(InvalidField, match=r"policy.observation: got 4 numbers; allowed: 3"):
        PolicyController(robot, policy, PolicySettings())


def test_what_the_belief_lacks_is_said(tmp_path):
    robot = ct.load_robot("carosac")
    controller = random_controller(tmp_path, robot, REALTIME)
    belief = Belief(
        time=np.zeros(1), position=robot.home_position[None], rotation=robot.home_rotation[None]
    )
    controller.reset(belief)
    window = trajectories.build("line", robot, 0).window(0.0, controller.horizon, controller.period)
    with pytest.raises(InvalidField, match=r"belief\.twist: got None; allowed: that of an"):
        controller.command(belief, window)


@pytest.mark.parametrize("name", list_policies())
def test_bundled_policies_are_those_of_the_presets(name):
    about = Policy.load(find_policy(name)).description
    stages = find_preset(about.preset).stages.values()
    filled = with_later_fields(about.settings)
    settings = {key: filled[key] for key in ("environment", "td3")}
    assert settings in [json.loads(json.dumps(asdict(stage))) for stage in stages]
    assert about.steps >= settings["td3"]["steps"]
    last = read_curve(find_policy(name).with_suffix(".csv"))[-1]  # its own, not an older one
    for column, value in about.scores.items():
        assert last[column] == pytest.approx(value, rel=1e-5), column


def test_policies_go_by_name_or_path(tmp_path):
    robot = ct.load_robot("carosac")
    assert policy_of(robot) == "carosac-residual"
    assert set(DEFAULT_POLICIES.values()) <= set(list_policies())
    for name, default in DEFAULT_POLICIES.items():
        assert Policy.load(find_policy(default)).description.robot.name == name
    for name in list_policies():
        assert Policy.load(find_policy(name)).description.robot.name in name
    with pytest.raises(InvalidField, match=r"policy: got 'carosak'; allowed: one of"):
        find_policy("carosak")
    other = replace(robot, name="mine")
    with pytest.raises(InvalidField, match="carosac train"):
        policy_of(other)
    assert find_policy(str(tmp_path / "p.onnx")) == tmp_path / "p.onnx"
