from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calibration.rest_readings import rest_readings
from carosac_toolkit.base.rotations import from_rotation_vector
from carosac_toolkit.loop.values import Stamped
from carosac_toolkit.recordings.recording import Recording
from tests.calibration.rests.scenes import scene


def test_each_rest_has_the_means_of_all_sensors():
    drawn = scene(0, rests=8)
    read = rest_readings(drawn.recording)
    assert not read.single and read.skipped == {}
    assert read.length.shape == read.tension.shape == read.swivel_angle.shape == (8, 4)
    np.testing.assert_allclose(read.length[0], drawn.recording.unstrained_length[5], atol=1e-12)
    turn = from_rotation_vector(
        np.array([drawn.truth.get(f"mounting.{axis}", 0.0) for axis in "xyz"])
    )
    heading = from_rotation_vector(np.array([0.0, 0.0, drawn.truth["heading"]]))
    np.testing.assert_allclose(read.attitude, heading @ drawn.rotation @ turn, atol=0.03)


def test_rows_far_apart_are_rests_of_their_own():
    recording = Recording(
        time=np.arange(3.0), unstrained_length=np.array([[5.0], [5.001], [7.0]]),
        tension=Stamped(time=np.array([0.01, 0.99, 1.5]), value=np.array([[1.0], [2.0], [9.0]])),
    )  # fmt: skip
    read = rest_readings(recording)
    assert read.single
    assert read.length.tolist() == [[5.0], [5.001]]  # a tension between rests is of neither
    assert read.tension.tolist() == [[1.0], [2.0]]
    assert read.skipped == {"tension": 1}


def test_a_run_without_a_rest_has_none():
    time = np.arange(0.0, 10.0, 0.1)
    moving = Recording(time=time, unstrained_length=5.0 + np.sin(time)[:, None])
    turned = rest_readings(moving.slice(40, 44))
    assert len(turned.time) == 0 and turned.length.shape == (0, 1)


def test_the_mean_of_angles_knows_no_seam():
    drawn = scene(0, rests=8).recording
    around = np.where(np.arange(len(drawn.time)) % 2, np.pi - 0.01, 0.03 - np.pi)
    value = np.repeat(around[:, None], 4, axis=1)
    seam = replace(drawn, swivel_angle=Stamped(time=drawn.time, value=value))
    mean = rest_readings(seam).swivel_angle
    assert np.abs(mean) == pytest.approx(np.full((8, 4), np.pi), abs=0.03)
