"""Encoder data of a real Hangprinter v4, with the bounds that its calibration is held to."""

from dataclasses import replace

import numpy as np
import pytest

import carosac_toolkit as ct
from calibration.self_calibration.calibrate import calibrate_motor_angles
from calibration.self_calibration.motor_angle_files import load_motor_angles
from calibration.self_calibration.settings import SelfCalibrationSettings

PUBLISHED = np.array(
    [
        [16.83, -1584.86, -113.17],
        [1290.18, 1229.19, -157.45],
        [-1409.88, 742.61, -151.80],
        [21.85, -0.16, 2343.67],
    ]
)  # [mm], from nine known positions


@pytest.fixture(scope="module")
def angles(real_data):
    path = real_data / "hangprinter_hp4.csv"
    if not path.is_file():
        pytest.skip(f"no {path}")
    return load_motor_angles(path)


def test_lengths_fit_and_anchors_agree_with_the_published_ones(angles):
    result = calibrate_motor_angles(angles, ct.load_robot("hangprinter"))
    assert result.residual_rms < 0.6e-3
    anchors = 1e3 * result.estimate.value[:12].reshape(4, 3)
    assert np.linalg.norm(anchors - PUBLISHED, axis=1).max() < 20.0
    assert result.blunders == () and result.warnings == ()
    assert result.residual.mean(axis=0) == pytest.approx(0.0, abs=2e-4)


@pytest.mark.parametrize(("order", "names"), [([1, 0, 2, 3], "a and b"), ([0, 2, 1, 3], "b and c")])
def test_swapped_motors_are_named_without_any_known_position(angles, order, names):
    unknown = angles.without_known(angles.samples)
    swapped = replace(unknown, motor_angle=unknown.motor_angle[:, order])
    settings = SelfCalibrationSettings(drum_radius_sigma=5e-3)
    robot = ct.load_robot("hangprinter")
    assert calibrate_motor_angles(unknown, robot, settings).warnings == ()
    warnings = calibrate_motor_angles(swapped, robot, settings).warnings
    assert any(f"with the motors {names} exchanged" in line for line in warnings)


@pytest.mark.parametrize("sample", ["3", "8"])
def test_a_known_position_is_predicted_without_itself(angles, sample):
    result = calibrate_motor_angles(angles.without_known([sample]), ct.load_robot("hangprinter"))
    row = angles.index(sample)
    error = np.linalg.norm(result.position[row] - angles.known_position[row])
    assert error < 4e-3
