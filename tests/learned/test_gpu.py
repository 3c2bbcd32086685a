"""Environments on a GPU: the same worlds as on the CPU."""

import copy
from dataclasses import replace

import numpy as np
import pytest

from carosac_toolkit.physics.cable import straight_line
from learned.environment import CableEnvironment
from learned.length_map import LengthMap
from tests.gpu import NEEDS_GPU
from tests.learned.test_environment import WORLDS, played
from tests.robots import simple_robot, with_pulleys

pytestmark = NEEDS_GPU
BOTH = ("cpu", "cuda")


def test_straight_lines_on_both_agree():
    robot = with_pulleys(simple_robot())
    points = np.random.default_rng(0).uniform(robot.workspace_min, robot.workspace_max, (300, 3))
    host, gpu = (straight_line.inverse_kinematics(robot, points, device=x) for x in BOTH)
    np.testing.assert_allclose(gpu, host, atol=1e-12)
    host, gpu = (straight_line.forward_kinematics(robot, host, device=x) for x in BOTH)
    np.testing.assert_allclose(gpu.position, host.position, atol=1e-9)
    np.testing.assert_array_equal(gpu.converged, host.converged)


def test_length_maps_on_both_agree():
    robot = simple_robot()
    rng = np.random.default_rng(0)
    points = rng.uniform(robot.workspace_min, robot.workspace_max, (300, 3))
    push = rng.normal(size=points.shape)
    host, gpu = (LengthMap(robot, x).lengths(points, push=push) for x in BOTH)
    np.testing.assert_allclose(gpu, host, atol=1e-12)


@pytest.mark.parametrize("name", WORLDS)
def test_environments_on_both_agree(name):
    """More worlds than a block of threads, through the end of an episode."""
    runs = []
    for device in BOTH:
        environment = CableEnvironment(simple_robot(), WORLDS[name], size=300, device=device)
        environment.reset()
        runs.append(played(environment, 6))
    for host, gpu in zip(*runs, strict=True):
        for first, second in zip(host, gpu, strict=True):
            np.testing.assert_allclose(second, first, atol=1e-6)


def test_on_a_gpu_an_environment_goes_on_from_its_state_bit_by_bit():
    settings = replace(WORLDS["realtime"], path=replace(WORLDS["realtime"].path, steps=20))
    environment = CableEnvironment(simple_robot(), settings, size=70, device="cuda")
    environment.reset()
    played(environment, 3)
    state = copy.deepcopy(environment.state())
    first = played(environment, 5)
    environment.restore(state)
    for before, after in zip(first, played(environment, 5), strict=True):
        for one, other in zip(before, after, strict=True):
            np.testing.assert_array_equal(one, other)
