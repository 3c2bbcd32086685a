from __future__ import annotations

import numpy as np
import pytest

from calibration.guide.hand import HandMover
from calibration.guide.rest import WINDOWS_MAX, NotAtRest, Periods, Stopped
from carosac_toolkit.loop.values import Measurement, Stamped
from tests.calibration.guide.scenes import QUICK

LENGTH = np.array([1.6, 1.8, 1.59, 2.35])
PULL = np.array([6.0, 7.0, 6.5, 20.0])


class Told:
    """A driver whose readings are told as functions of time [s]."""

    def __init__(self, length=lambda t: LENGTH, tension=lambda t: PULL, alive=lambda t: True):
        self._length, self._tension, self._alive = length, tension, alive
        self.time = 0.0
        self._rng = np.random.default_rng(0)

    def measure(self):
        time, pull = np.array([self.time]), self._tension(self.time)
        noise = 1e-4 * self._rng.normal(0.0, 1.0, 4)
        return Measurement(
            time=time,
            unstrained_length=(self._length(self.time) + noise)[None],
            tension=None if pull is None else Stamped(time=time, value=pull[None]),
        )

    def wait(self, duration):
        self.time += duration
        return self._alive(self.time)


def read(driver):
    return Periods(driver, QUICK).rest(None)


def test_a_platform_that_swings_out_is_read_once_it_rests():
    def swing(t):
        return LENGTH + 0.02 * np.exp(-t / 0.2) * np.array([1.0, -1.0, 0.0, 0.5])

    assert read(Told(swing)).length == pytest.approx(LENGTH, abs=3e-4)
    assert read(Told()).tension == pytest.approx(PULL)


def test_what_drifts_is_no_sample():
    driver = Told(lambda t: LENGTH - 0.01 * t)
    with pytest.raises(NotAtRest, match=r"does not rest: a length drifts by [12](\.\d)? mm"):
        read(driver)
    assert driver.time == pytest.approx(QUICK.settle_time + WINDOWS_MAX * QUICK.sample_time)
    with pytest.raises(NotAtRest, match="a tension drifts by"):
        read(Told(tension=lambda t: PULL * (1.0 + t)))


def test_a_person_who_did_not_hold_still_is_asked_again():
    driver, asked = Told(lambda t: LENGTH - 0.01 * min(t, 5.0)), []
    periods = Periods(driver, QUICK)
    hand = HandMover(lambda *places: None, lambda: periods.rest(None), asked.append)
    rest = hand.rest()
    assert len(asked) >= 1
    assert "does not rest" in asked[0]
    assert rest.length == pytest.approx(LENGTH - 0.05, abs=3e-4)


def test_a_driver_that_ends_gives_no_sample():
    with pytest.raises(Stopped, match="the driver has stopped"):
        read(Told(alive=lambda t: t < 0.3))


def test_tensions_that_vanish_are_not_ignored():
    with pytest.raises(Stopped, match="no longer measures tensions"):
        read(Told(tension=lambda t: PULL if t < 0.3 else None))
    assert read(Told(tension=lambda t: None)).tension is None


def test_an_error_of_a_driver_is_told_in_one_sentence():
    def unplugged(t):
        if t > 0.3:
            raise OSError("cable pulled")
        return LENGTH

    with pytest.raises(Stopped, match="the driver fails: cable pulled"):
        read(Told(unplugged))
