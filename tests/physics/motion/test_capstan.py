"""The stretch of a run behind a pulley with friction, against bisection; what counts as slip."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import warp as wp

import carosac_toolkit as ct
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.physics.device_kernels import Cable
from carosac_toolkit.physics.motion.capstan_kernels import PulledRun, Run, stretched
from sim_warp import Simulator
from tests.physics.motion.test_friction import COEFFICIENT, with_runs

SHARE = 0.1  # of the stretch, after which a cable slides


@wp.kernel
def stretch_runs(
    cables: wp.array(dtype=Cable), runs: wp.array(dtype=Run), length: wp.array(dtype=wp.float64),
    exponent: wp.array(dtype=wp.float64), alone: wp.array(dtype=wp.float64),
    pulled: wp.array(dtype=wp.float64), right: wp.array(dtype=wp.float64),
    out: wp.array(dtype=PulledRun),
):  # fmt: skip
    k = wp.tid()
    out[k] = stretched(cables[k], runs[k], length[k], exponent[k], alone[k], pulled[k], right[k])


def left_side(e, run, paid, exponent, alone, pulled):
    """What is solved, and the bend there, by Dahl's law."""
    slip = paid + e - run["stretch"]
    a = np.abs(slip) / (SHARE * run["stretch"])
    bend = np.exp(-a) * run["bend"] + (1.0 - np.exp(-a)) * np.sign(slip)
    return alone * e + pulled * e * np.exp(exponent * bend), bend


def test_the_stretch_is_that_of_bisection_however_far_a_cable_slips():
    rng, count = np.random.default_rng(0), 20_000
    cables = np.zeros(count, dtype=Cable.numpy_dtype())
    cables["run_length"], cables["capstan_friction"] = 6.0, 0.2
    runs = np.zeros(count, dtype=Run.numpy_dtype())
    runs["bend"], runs["known"] = rng.uniform(-1.0, 1.0, count), 1
    runs["stretch"] = 10.0 ** rng.uniform(-4.0, -1.0, count)
    paid = runs["stretch"] * rng.normal(0.0, 1.0, count) * 10.0 ** rng.uniform(-3.0, 1.0, count)
    exponent, alone = rng.uniform(0.0, 2.0, count), rng.integers(0, 2, count).astype(float)
    pulled = 10.0 ** rng.uniform(-2.0, 2.0, count)
    right = (alone + pulled) * runs["stretch"] * 10.0 ** rng.normal(0.0, 0.3, count)
    out = wp.zeros(count, dtype=PulledRun, device="cpu")
    given = [wp.array(cables, dtype=Cable, device="cpu"), wp.array(runs, dtype=Run, device="cpu")]
    given += [
        wp.array(each, dtype=wp.float64, device="cpu")
        for each in (paid, exponent, alone, pulled, right)
    ]
    wp.launch(stretch_runs, dim=count, inputs=given, outputs=[out], device="cpu")
    low, high = np.zeros(count), right / (alone + pulled * np.exp(-exponent))
    for _ in range(80):
        middle = 0.5 * (low + high)
        above = left_side(middle, runs, paid, exponent, alone, pulled)[0] > right
        low, high = np.where(above, low, middle), np.where(above, middle, high)
    found = out.numpy()
    assert found["run"]["stretch"] == pytest.approx(high, rel=1e-9)
    bend = left_side(high, runs, paid, exponent, alone, pulled)[1]
    assert found["run"]["bend"] == pytest.approx(bend, abs=1e-6)
    assert (np.abs(found["miss"]) < 1e-9 * right).all()


def test_a_run_of_which_nothing_is_known_stretches_as_without_friction():
    robot = with_runs(0.05, capstan_friction=COEFFICIENT)
    rest = ct.statics.inverse_kinematics(robot, robot.home_position[None])
    for cables in ("catenary", "straight", "particles"):
        simulator = Simulator(robot, cables=cables)
        simulator.reset(unstrained_length=rest.unstrained_length)
        before = simulator.state.numpy().position
        simulator.follow(rest.unstrained_length, 1.0)
        moved = simulator.state.numpy().position - before
        assert np.abs(moved).max() < 1e-6


def test_worlds_with_and_without_friction_keep_their_runs_apart():
    gripping = with_runs(0.05, capstan_friction=COEFFICIENT)
    free = replace(gripping, capstan_friction=np.zeros(4))
    rest = ct.statics.inverse_kinematics(gripping, gripping.home_position[None])
    lengths = np.repeat(rest.unstrained_length, 2, axis=0)
    moved = lengths + np.array([[0.05], [0.0]])
    heights = []
    for robots, rows in (([gripping, free], [0, 1]), ([gripping], [0]), ([free], [1])):
        simulator = Simulator(robots, cables="particles")
        simulator.reset(unstrained_length=lengths[rows])
        simulator.follow(moved[rows], 1.0)
        heights.append(simulator.state.numpy().position[:, 2])
    assert heights[0] == pytest.approx(np.concatenate(heights[1:]), abs=1e-12)


def test_a_coefficient_that_no_cable_has_is_refused():
    robot = ct.load_robot("carosac")
    with pytest.raises(InvalidField, match=r"capstan_friction\[2\]: got 3.0; allowed: .*<= 2"):
        replace(robot, capstan_friction=np.array([0.1, 0.1, 3.0, 0.1]))
