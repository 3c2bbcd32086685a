import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.loop.consistency import band, normalised_square, state_error
from carosac_toolkit.loop.values import Belief, State


def test_errors_drawn_from_their_covariance_are_in_the_band():
    rng = np.random.default_rng(0)
    root = rng.normal(size=(12, 12))
    errors = rng.normal(size=(4000, 12)) @ root.T
    mean = normalised_square(errors, root @ root.T).mean()
    low, high = band(12, 4000)
    assert low < mean < high
    assert 0.95 < low < 1.0 < high < 1.05


def test_the_band_of_one_normal_number_is_that_of_its_square():
    low, high = band(1)
    assert (low, high) == pytest.approx((0.00098, 5.02389), abs=1e-5)


def test_error_leads_from_belief_to_truth():
    turn = Rotation.from_rotvec([0.1, -0.2, 0.3])
    tilt = Rotation.from_rotvec([0.4, 0.5, -0.1]).as_matrix()[None]
    belief = Belief(
        time=np.zeros(1), position=np.zeros((1, 3)), rotation=tilt, twist=np.zeros((1, 6))
    )
    truth = State(
        time=np.zeros(1), position=np.array([[1.0, 2.0, 3.0]]), rotation=turn.as_matrix() @ tilt,
        twist=np.arange(6.0)[None],
    )  # fmt: skip
    expected = [1.0, 2.0, 3.0, 0.1, -0.2, 0.3, 0.0, 1.0, 2.0, 3.0, 4.0, 5.0]
    assert state_error(truth, belief)[0] == pytest.approx(expected, abs=1e-12)
    pose_only = State(time=truth.time, position=truth.position, rotation=truth.rotation)
    assert state_error(pose_only, belief)[0] == pytest.approx(expected[:6], abs=1e-12)


def test_a_covariance_that_is_none_is_refused():
    with pytest.raises(InvalidField, match="positive definite"):
        normalised_square(np.ones(2), np.array([[1.0, 2.0], [2.0, 1.0]]))
