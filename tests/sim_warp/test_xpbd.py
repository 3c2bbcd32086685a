"""The method of game engines: as its step shrinks it comes to what particles solve at once."""

import numpy as np
import pytest

from sim_warp import Simulator
from tests.robots import simple_robot, with_pulleys
from tests.sim_warp.worlds import KICK, damped, held

STEPS = (2e-3, 1e-3, 5e-4)  # [s]
SEGMENTS = 8


def swing(cables, time_step):
    """Platform positions of a swing over a second [m], shape (20, 3)."""
    sim = Simulator(simple_robot(), cables=cables, time_step=time_step, segments=SEGMENTS)
    sim.reset(twist=[[0.4, 0.2, 0.0, 0.0, 0.0, 0.1]])
    hold, path = held(sim), []
    for _ in range(20):
        sim.step(hold, 0.05)
        path.append(sim.state.position.numpy()[0].copy())
    return np.array(path)


def test_it_swings_as_particles_do_the_better_the_shorter_its_step():
    exact = swing("particles", 5e-4)
    miss = [np.sqrt(((swing("xpbd", h) - exact) ** 2).sum(axis=1).mean()) for h in STEPS]
    assert miss[0] > 2.0 * miss[1] > 4.0 * miss[2]
    assert miss[0] > 5e-3  # its cables are soft: the platform hangs low
    assert miss[2] < 3e-3


@pytest.mark.parametrize("robot", [simple_robot(), with_pulleys(simple_robot())])
def test_it_settles_where_particles_rest_the_better_the_shorter_its_step(robot):
    exact = Simulator(robot, segments=SEGMENTS).state.numpy()
    miss, pull = [], []
    for h in STEPS:
        sim = Simulator(
            damped(robot), cables="xpbd", time_step=h, segments=SEGMENTS, cable_drag=3.0
        )
        sim.reset(twist=KICK)
        sim.step(exact.unstrained_length, 6.0)
        state = sim.state.numpy()
        assert not state.failed.any()
        miss.append(np.linalg.norm(state.position - exact.position))
        pull.append(np.abs(state.tension - exact.tension).max())
    assert miss[0] > 2.0 * miss[1] > 4.0 * miss[2]
    assert miss[2] < 1e-3
    assert pull[2] < 0.05


def test_more_rounds_make_its_cables_stiffer():
    low = []
    for iterations in (5, 20, 80):
        sim = Simulator(
            damped(simple_robot()), cables="xpbd", segments=SEGMENTS, iterations=iterations
        )
        home = sim.state.position.numpy()[0, 2]
        sim.step(held(sim), 4.0)
        low.append(home - sim.state.position.numpy()[0, 2])
        assert sim.state.iterations.numpy()[0] == iterations
    assert low[0] > 2.0 * low[1] > 4.0 * low[2] > 0.0
