"""A prior: information, places and distances of its unknowns."""

from __future__ import annotations

import numpy as np
import pytest

from calibration.linear_samples import LinearSamples
from calibration.prior import Prior

PRIOR = Prior(
    names=("exit_points[a].x", "exit_points[a].y", "mass"),
    mean=np.array([1.0, 2.0, 20.0]),
    covariance=np.array([[4e-12, 1e-12, 0.0], [1e-12, 9e-12, 0.0], [0.0, 0.0, 1e6]]),
)


def test_information_is_the_inverse_even_where_units_differ_by_orders():
    assert PRIOR.information @ PRIOR.covariance == pytest.approx(np.eye(3), abs=1e-12)
    assert PRIOR.sigma == pytest.approx([2e-6, 3e-6, 1e3])


def test_unknowns_are_named_and_measured_in_their_sigmas():
    assert PRIOR.rows("exit_points").tolist() == [0, 1]
    assert PRIOR.rows("drag").tolist() == []
    assert PRIOR.deviation(PRIOR.mean + np.array([4e-6, 0.0, -3e3])) == pytest.approx(
        [2.0, 0.0, 3.0]
    )


def test_data_that_say_nothing_leave_every_combination_to_the_prior():
    seen = PRIOR.judge(np.diag([1e14, 1e14, 0.0]))
    assert seen.rank == 2 and seen.blind == ("mass",) and seen.weak == ()


def test_scaling_samples_scales_residuals_with_their_derivatives():
    rng = np.random.default_rng(0)
    samples = LinearSamples(
        residual=rng.normal(size=(5, 2)),
        by_shared=rng.normal(size=(5, 2, 3)),
        by_own=rng.normal(size=(5, 2, 6)),
    )
    scaled = samples.scaled(np.array([2.0, 10.0]))
    shared, own = rng.normal(size=3), rng.normal(size=(5, 6))
    change = samples.by_shared @ shared + np.einsum("smi,si->sm", samples.by_own, own)
    other = scaled.by_shared @ shared + np.einsum("smi,si->sm", scaled.by_own, own)
    assert scaled.residual + other == pytest.approx((samples.residual + change) * [2.0, 10.0])
