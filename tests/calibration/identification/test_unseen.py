"""Sigmas beside a parameter that is not told by the data, and coordinates of known robots."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.calibration_oscillations import SURVEYED, _coordinates, robot_with_pulleys
from calibration.identification.error_noise import PoseErrorNoise
from calibration.identification.fit import Fitter, _Search
from calibration.identification.unknowns import choose_coordinates
from calibration.prior import Prior


@pytest.mark.parametrize("cables", [3, 4])
def test_coordinates_of_a_robot_are_those_that_it_was_made_of(cables):
    unknowns = choose_coordinates(robot_with_pulleys(cables), SURVEYED)
    at = np.random.default_rng(cables).standard_normal(len(unknowns.prior.names))
    at = np.maximum(at, unknowns.lower)
    assert _coordinates(unknowns, unknowns.robot_at(at)) == pytest.approx(at, abs=1e-9)


def test_a_held_parameter_widens_the_sigmas_of_what_it_moves():
    """Many draws of noise and of the held parameter scatter as the covariance says."""
    rng = np.random.default_rng(0)
    slopes = rng.normal(size=(40, 6, 3))  # of two coordinates that are searched, and of a held one
    sigma = np.repeat([0.5, 0.2], 3)
    noise = PoseErrorNoise(sigma=sigma, repeats=np.ones(6))
    prior = np.diag([1.0, 1.0, 0.7**2])
    fitter = Fitter.__new__(Fitter)
    fitter._searched = np.array([True, True, False])
    fitter._sways, fitter._count, fitter._time_step = True, 3, 1.0
    fitter._own, fitter._precision = [np.arange(3)], np.linalg.inv(prior)
    fitter._unknowns = type("Unknowns", (), {})()
    fitter._unknowns.prior = Prior(names=("a", "b", "c"), mean=np.zeros(3), covariance=prior)
    held_alone = slopes * [0.0, 0.0, 1.0]
    fitter._slopes = lambda at, searched, time_step, **kinds: [held_alone]
    searched = slopes * [1.0, 1.0, 0.0]
    errors = 1e-6 * rng.normal(size=(40, 6))  # so small that all count alike
    flat, weight = searched.reshape(-1, 3), np.tile(1.0 / sigma**2, 40)
    hessian = flat.T @ (weight[:, None] * flat) + fitter._precision
    inverse = np.linalg.inv(hessian)
    state = _Search(at=np.zeros(3), errors=[errors], jacobians=[searched], count=1, settled=True)
    told = fitter._with_unseen(inverse, inverse, state, noise)
    found = []
    for _ in range(20_000):
        truth = np.linalg.cholesky(prior) @ rng.standard_normal(3)
        seen = (slopes @ truth + sigma * rng.standard_normal((40, 6))).ravel()
        best = inverse @ (flat.T @ (weight * seen))  # with the held one at 0, its prior
        best[2] = 0.0
        found.append(best - truth)
    assert np.cov(np.array(found).T) == pytest.approx(told, rel=0.05, abs=2e-4)
    assert told[0, 0] > 2.0 * inverse[0, 0]
