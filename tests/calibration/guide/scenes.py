"""Guided robots that differ from their file."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

import carosac_toolkit as ct
from calibration.guide.drivers import (
    enable_where_it_is,
    guarded,
    simulated_driver,
)
from calibration.guide.guide import Guide
from calibration.guide.hand import HandMover
from calibration.guide.mover import DriverMover
from calibration.guide.samples import SampleFile
from calibration.guide.settings import GuideSettings
from calibration.guide.simulated import SimulatedHand, draw_true_robot
from calibration.self_calibration.settings import SelfCalibrationSettings
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.drivers.quasi_static import QuasiStaticDriver

LIMITS = {"tension_min": np.full(4, 1.0), "tension_max": np.full(4, 60.0)}
ROBOT = replace(ct.load_robot("hangprinter"), **LIMITS)
QUICK = GuideSettings(settle_time=0.2, sample_time=0.2, max_samples=7, checks=3)


class Recorded:
    """A driver whose true tensions are noted in every cycle."""

    def __init__(self, driver):
        self._driver = driver
        self.tension = []

    def __getattr__(self, name):
        return getattr(self._driver, name)

    def wait(self, duration):
        going_on = self._driver.wait(duration)
        self.tension.append(self._driver.truth().tension[0])
        return going_on


class Elsewhere(QuasiStaticDriver):
    """A driver whose encoders count from somewhere else than the home lengths of the file."""

    shift = np.zeros(4)

    def measure(self):
        measured = super().measure()
        return replace(measured, unstrained_length=measured.unstrained_length + self.shift)


class WithoutCells(Elsewhere):
    """A driver that has no load cells, and says so."""

    def connect(self):
        if "tension" in self._settings.suite:
            raise InvalidField("suite", repr(self._settings.suite), "one without tension")
        super().connect()


def true_robot(seed, robot=ROBOT):
    return draw_true_robot(robot, np.random.default_rng(seed))


def driven(path, seed, *, settings=QUICK, robot=ROBOT, tension=True):
    """Return a guide that moves the robot by its driver, and the driver."""
    inner = simulated_driver(robot, true_robot(seed, robot), settings, seed=seed, tension=tension)
    driver = Recorded(inner)
    if tension:
        going = guarded(driver, robot, settings)
        enable_where_it_is(going, robot)
    else:  # the guard would judge tensions by the geometry of the file
        going = driver
        going.connect()
    mover = DriverMover(going, robot, settings, real_time=False)
    samples = SampleFile(path, robot)
    return Guide(robot, mover, samples, settings, SelfCalibrationSettings(), seed=seed), driver


def by_hand(path, seed, *, settings=QUICK, robot=ROBOT, at_random=False, read=None, priors=None):
    """Return a guide of a robot that is moved by hand, and the hand."""
    hand = SimulatedHand(robot, true_robot(seed, robot), np.random.default_rng(seed))
    mover = HandMover(hand.place, read(hand) if read else hand.read)
    samples = SampleFile(path, robot)
    priors = priors or SelfCalibrationSettings()
    return Guide(robot, mover, samples, settings, priors, seed=seed, at_random=at_random), hand
