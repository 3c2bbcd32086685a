from __future__ import annotations

import json

import numpy as np
import pytest

from calibration.estimate import ParameterEstimate
from carosac_toolkit.base.errors import InvalidField


def estimate(**changes):
    known = {
        "names": ("mass", "length_delay", "exit_points[a].x"),
        "value": [24.0, 0.033, 1.5],
        "covariance": [[0.04, 1e-4, 0.0], [1e-4, 1e-6, 0.0], [0.0, 0.0, 0.0]],
        "start": [23.0, 0.0, 1.5],
        "prior_sigma": [1.0, np.inf, 0.05],
    }
    return ParameterEstimate(**(known | changes))


def test_sigma_and_correlation_are_those_of_the_covariance():
    found = estimate()
    assert found.sigma == pytest.approx([0.2, 1e-3, 0.0])
    expected = [[1.0, 0.5, 0.0], [0.5, 1.0, 0.0], [0.0, 0.0, 0.0]]  # the last is known exactly
    assert found.correlation == pytest.approx(np.array(expected))


def test_a_selection_keeps_what_belongs_together_in_another_order():
    part = estimate().select(["length_delay", "mass"])
    assert part.names == ("length_delay", "mass") and part.units == ("s", "kg")
    assert part.value.tolist() == [0.033, 24.0] and part.start.tolist() == [0.0, 23.0]
    assert part.covariance == pytest.approx(np.array([[1e-6, 1e-4], [1e-4, 0.04]]))
    assert part.prior_sigma.tolist() == [np.inf, 1.0]
    assert part.index("mass") == 1


def test_a_factor_moves_by_its_logarithm_and_changes_by_its_own_unit():
    free, held = estimate(value=[46.0, 0.033, 1.4]), 0.2 / 46.0 / (1.0 / 23.0)
    found = estimate(value=[46.0, 0.033, 1.4], factors=("mass",))
    assert free.moved == pytest.approx([23.0, 0.0, -2.0])
    assert found.moved == pytest.approx([23.0 * np.log(2.0), 0.0, -2.0])
    assert found.kept == pytest.approx([held, 0.0, 0.0])  # the share of its own value counts
    back = estimate(value=[11.5, 0.033, 1.5], factors=("mass",))
    assert back.moved[0] == pytest.approx(-found.moved[0])
    assert back.select(["mass"]).moved == pytest.approx(back.moved[:1])
    assert estimate().select(["length_delay"]).factors == ()


def test_json_holds_every_parameter_with_its_unit_and_null_for_no_prior():
    data = json.loads(json.dumps(estimate().data(), allow_nan=False))
    assert data["mass"] == {
        "value": 24.0, "sigma": pytest.approx(0.2), "start": 23.0, "prior_sigma": 1.0, "unit": "kg",
    }  # fmt: skip
    assert data["length_delay"]["prior_sigma"] is None
    assert list(data) == ["mass", "length_delay", "exit_points[a].x"]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"value": [1.0, 2.0]}, r"value.*\(3,\)"),
        ({"value": [1.0, np.nan, 2.0]}, r"value\[1\]"),
        ({"covariance": np.eye(2)}, r"covariance.*\(3, 3\)"),
        ({"prior_sigma": [1.0, 0.0, 1.0]}, r"prior_sigma: .* > 0, inf for none"),
        ({"prior_sigma": [1.0, np.nan, 1.0]}, r"prior_sigma: .* > 0, inf for none"),
        ({"prior_sigma": [1.0]}, r"prior_sigma: .*shape \(3,\)"),
    ],
)
def test_what_does_not_belong_together_is_named(changes, message):
    with pytest.raises(InvalidField, match=message):
        estimate(**changes)


def test_what_was_not_estimated_is_named():
    with pytest.raises(InvalidField, match=r"parameter: got 'drag'; allowed: one of .*'mass'"):
        estimate().select(["mass", "drag"])


def test_numbers_cannot_be_changed():
    for name in ("value", "covariance", "start", "prior_sigma"):
        with pytest.raises(ValueError, match="read-only"):
            getattr(estimate(), name)[0] = 1.0
