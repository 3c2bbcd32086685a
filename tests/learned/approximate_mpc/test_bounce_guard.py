"""A bounce is in motion and in stretch by turns."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

import carosac_toolkit as ct
from baselines.mpc.length_offsets import OFFSET_TIME
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.robot.similar import similar_robot
from learned.approximate_mpc.bounce_guard import BounceGuard

PERIOD = 0.02


class Told:
    """A guard of a robot whose cables all pull alike, told of energies over the usual one."""

    def __init__(self, robot, period=PERIOD):
        self.guard = BounceGuard(robot, period)
        self.free = np.linspace(0.5, 1.0, robot.n) * Scales(robot).length
        self.usual = np.full(robot.n, robot.weight / robot.n)
        soft = (self.free + robot.run_length) / robot.axial_stiffness
        self.held = 0.5 * soft @ self.usual**2

    def tell(self, motion=0.0, stretch=0.0):
        tension = (1.0 + np.sqrt(stretch)) * self.usual
        return self.guard.bounce(motion * self.held, self.free, tension, self.usual, self.usual)


@pytest.fixture
def robot():
    return ct.load_robot("carosac")


def test_it_is_the_lesser_of_both_energies(robot):
    told = Told(robot)
    assert told.tell() == 0.0
    assert told.tell(motion=0.5, stretch=0.3) == pytest.approx(0.3)
    assert Told(robot).tell(motion=0.5) == 0.0


def test_one_after_the_other_is_remembered_for_a_while(robot):
    told = Told(robot)
    told.tell()
    told.tell(motion=0.8)
    quarter = told.tell(stretch=0.9)
    forgotten = OFFSET_TIME.of(Scales(robot).ratios)
    assert quarter == pytest.approx(0.8 * (1.0 - PERIOD / forgotten))
    left = [told.tell() for _ in range(int(3.0 * forgotten / PERIOD))]
    assert all(later < earlier for earlier, later in pairwise(left))
    assert left[-1] < 0.1


def test_tensions_that_always_differ_are_of_the_plant(robot):
    told = Told(robot)
    assert max(told.tell(motion=5.0, stretch=0.9) for _ in range(100)) < 1e-9


def test_without_tensions_motion_counts_alone_and_now(robot):
    told = Told(robot)
    for tension in (None, np.full(robot.n, np.nan)):
        for motion in (5.0, 0.0):
            energy = told.guard.bounce(
                motion * told.held, told.free, tension, told.usual, told.usual
            )
            assert energy == pytest.approx(motion)


def test_it_is_the_same_for_a_similar_robot(robot):
    """Times grow with the root of its size, by Froude's law."""
    small = similar_robot(robot, 0.1)
    both = Told(robot), Told(small, np.sqrt(0.1) * PERIOD)
    for told in ((0.0, 0.0), (0.6, 0.0), (0.0, 0.4), (0.2, 0.1)):
        first, second = (each.tell(*told) for each in both)
        assert first == pytest.approx(second, abs=1e-9)
