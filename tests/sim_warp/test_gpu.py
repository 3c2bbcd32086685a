"""The simulator on a GPU: the same worlds as on the CPU."""

from dataclasses import replace

import numpy as np
import pytest

from sim_warp import SimDriverSettings, SimPlant, Simulator
from tests.gpu import NEEDS_GPU
from tests.robots import eight_cable_robot, simple_robot, with_pulleys
from tests.sim_warp.worlds import KICK, MODELS, assert_same, held, on_device, rows

pytestmark = NEEDS_GPU
ALL_MODELS = pytest.mark.parametrize("cables", MODELS)


def swung(robot, device, seconds=1.0, **options):
    """State after a kick with the winches at work."""
    sim = Simulator(robot, device=device, segments=8, **options)
    sim.reset(twist=np.repeat(KICK, sim.size, axis=0))
    start = held(sim)
    for k in range(round(seconds / 0.1)):
        sim.step(start + 0.02 * np.sin(k + np.arange(start.shape[1])), 0.1)
    return sim.state.numpy()


@ALL_MODELS
@pytest.mark.parametrize(
    "robot",
    [simple_robot(), with_pulleys(simple_robot()), eight_cable_robot(tension_min=np.full(8, 40.0))],
    ids=["simple", "simple with pulleys", "eight"],
)
def test_gpu_and_cpu_agree(robot, cables):
    """Both are float64 with the same Newton steps; what differs is the order of roundings."""
    host, gpu = (swung(robot, device, cables=cables, worlds=4) for device in ("cpu", "cuda"))
    assert not host.failed.any() and not gpu.failed.any()
    assert gpu.position == pytest.approx(host.position, abs=1e-9)
    assert gpu.rotation == pytest.approx(host.rotation, abs=1e-9)
    assert gpu.unstrained_length == pytest.approx(host.unstrained_length, abs=1e-12)


def test_the_device_of_the_settings_is_that_of_the_worlds():
    host, gpu = (
        SimPlant(simple_robot(), SimDriverSettings(segments=8, device=device), size=4)
        for device in ("cpu", "cuda")
    )
    for plant in (host, gpu):
        plant.reset(np.tile(simple_robot().home_position, (4, 1)))
        plant.advance(plant.read_lengths() + 0.02, 0.5)
    assert gpu.simulator.state.position.device.is_cuda
    assert gpu.truth().position == pytest.approx(host.truth().position, abs=1e-9)


@ALL_MODELS
def test_on_a_gpu_a_permutation_of_worlds_permutes_what_happens(cables):
    """Over 300 worlds, more than a block of threads, each with a plant and a wind of its own."""
    order = np.random.default_rng(0).permutation(300)
    robots = [replace(simple_robot(), mass=20.0 + 0.02 * k) for k in range(300)]
    options = {"cables": cables, "seconds": 0.3, "wind_force": 2.0}
    first = swung(robots, "cuda", seed=list(range(300)), **options)
    second = swung([robots[k] for k in order], "cuda", seed=[int(k) for k in order], **options)
    assert_same(rows(first, order), rows(second, slice(None)))
    assert len(np.unique(first.position[:, 2])) == 300


@ALL_MODELS
def test_on_a_gpu_a_world_that_fails_is_flagged_and_the_others_go_on(cables):
    sound, lost = (
        Simulator(simple_robot(), worlds=70, cables=cables, segments=5, device="cuda")
        for _ in range(2)
    )
    command = held(sound) - 0.02
    broken = command.copy()
    broken[33, 2] = np.nan
    sound.follow(on_device(command, "cuda"), 0.1)
    lost.follow(on_device(broken, "cuda"), 0.1)
    assert np.flatnonzero(lost.state.numpy().failed).tolist() == [33]
    others = np.arange(70) != 33
    assert_same(rows(sound.state.numpy(), others), rows(lost.state.numpy(), others))


@ALL_MODELS
def test_on_a_gpu_a_restored_simulator_goes_on_bit_for_bit(cables):
    sim, other = (
        Simulator(simple_robot(), worlds=5, cables=cables, segments=5, device="cuda", wind_force=2)
        for _ in range(2)
    )
    command = held(sim) + 0.05
    sim.step(command, 0.2)
    snapshot = sim.save()
    other.restore(snapshot)
    for each in (sim, other):
        each.step(command, 0.2)
    assert_same(sim.save().arrays, other.save().arrays)
