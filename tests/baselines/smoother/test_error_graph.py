"""The factor graph against a Rauch-Tung-Striebel smoother and dense least squares."""

import numpy as np
import pytest

from baselines.dynamic_estimator.filter_state import Errors
from baselines.dynamic_estimator.measurement_models import LinearisedMeasurement
from baselines.smoother.error_graph import ErrorGraph
from baselines.smoother.forward_pass import ForwardPass, KeyFrameLink

COUNT = 25
TIME = 0.1 * np.arange(COUNT)


@pytest.fixture(scope="module")
def linear():
    """Random linear dynamics of a robot of four cables, with IMU at every link and some poses."""
    rng = np.random.default_rng(3)
    errors = Errors(4, 2)
    size = errors.size
    fixed = np.r_[errors.mass.start : errors.center.stop, errors.imu.start : size]

    def covariance(k, scale):
        half = rng.normal(size=(k, k))
        return scale * (half @ half.T + 0.5 * np.eye(k))

    links = []
    for _ in range(COUNT - 1):
        carry = np.eye(size) + 0.1 * rng.normal(size=(size, size))
        carry[fixed] = np.eye(size)[fixed]
        noise = covariance(size, 0.02)
        noise[fixed] = noise[:, fixed] = 0.0
        felt = LinearisedMeasurement(
            residual=rng.normal(size=6), by=rng.normal(size=(6, size)), noise=covariance(6, 1.0)
        )
        links.append(KeyFrameLink(carry=carry, noise=noise, felt=felt))
    said = {
        k: {
            name: LinearisedMeasurement(
                residual=rng.normal(size=m), by=rng.normal(size=(m, size)), noise=covariance(m, 1.0)
            )
            for name, m in (("pose", 6), ("attitude", 3))
        }
        for k in range(0, COUNT, 4)
    }
    corrections = 0.1 * rng.normal(size=(COUNT, size))
    corrections[1:, fixed] = 0.0
    passed = ForwardPass(delay=0.0, states=[], corrections=corrections, links=links, said=said)
    return errors, covariance(size, 1.0), passed


def rauch_tung_striebel(start, passed):
    """Smoothed means and covariances of the errors."""
    mean, matrix = -passed.corrections[0], start.copy()

    def heard(mean, matrix, said):
        gain = matrix @ said.by.T @ np.linalg.inv(said.by @ matrix @ said.by.T + said.noise)
        return mean + gain @ (said.residual - said.by @ mean), matrix - gain @ said.by @ matrix

    before, after = [], []
    for k in range(COUNT):
        before.append((mean, matrix))
        for said in passed.said.get(k, {}).values():
            mean, matrix = heard(mean, matrix, said)
        if k < COUNT - 1:
            link = passed.links[k]
            mean, matrix = heard(mean, matrix, link.felt)
            after.append((mean, matrix))
            mean = link.carry @ mean - passed.corrections[k + 1]
            matrix = link.carry @ matrix @ link.carry.T + link.noise
    found = [(mean, matrix)]
    for k in range(COUNT - 2, -1, -1):
        mean, matrix = after[k]
        expected, spread = before[k + 1]
        gain = matrix @ passed.links[k].carry.T @ np.linalg.inv(spread)
        mean = mean + gain @ (found[0][0] - expected)
        matrix = matrix + gain @ (found[0][1] - spread) @ gain.T
        found.insert(0, (mean, matrix))
    return np.array([m for m, _ in found]), np.array([p for _, p in found])


def test_the_graph_agrees_with_a_rauch_tung_striebel_smoother(linear):
    errors, start, passed = linear
    graph = ErrorGraph(errors, np.ones(errors.size), start)
    found = graph.solve(passed, TIME, {}, None)
    mean, matrix = rauch_tung_striebel(start, passed)
    changing, constant = graph.changing, graph.constant
    assert found.error == pytest.approx(mean, abs=1e-6)
    assert found.covariance == pytest.approx(matrix[:, changing][:, :, changing], abs=1e-6)
    assert found.constant == pytest.approx(matrix[-1][np.ix_(constant, constant)], abs=1e-6)


def test_the_scale_of_the_errors_does_not_matter(linear):
    errors, start, passed = linear
    scale = np.geomspace(0.1, 10.0, errors.size)
    one = ErrorGraph(errors, np.ones(errors.size), start).solve(passed, TIME, {}, None)
    other = ErrorGraph(errors, scale, start).solve(passed, TIME, {}, None)
    assert other.error == pytest.approx(one.error, abs=1e-5)
    assert other.covariance == pytest.approx(one.covariance, abs=1e-5)


def test_a_lag_is_the_whole_up_to_its_end(linear):
    """Fixed lag: an estimate knows what is measured up to the end of the part it leaves in."""
    errors, start, passed = linear
    graph = ErrorGraph(errors, np.ones(errors.size), start)
    lag = 0.7
    found = graph.solve(passed, TIME, {}, lag)
    whole = graph.solve(passed, TIME, {}, None)
    last = found.error[TIME > TIME[-1] - lag + 1e-6]  # these know all
    assert last == pytest.approx(whole.error[-len(last) :], abs=1e-6)
    assert np.abs(found.error - whole.error).max() > 1e-3
    less = np.diagonal(found.covariance, axis1=1, axis2=2)
    more = np.diagonal(whole.covariance, axis1=1, axis2=2)
    assert (less >= more * (1.0 - 1e-6)).all()  # to know less is to be less sure
    longer = graph.solve(passed, TIME, {}, 100.0)
    assert longer.error == pytest.approx(whole.error, abs=1e-6)


def test_a_measurement_of_no_weight_is_not_there(linear):
    errors, start, passed = linear
    graph = ErrorGraph(errors, np.ones(errors.size), start)
    gone = ForwardPass(
        delay=0.0, states=[], corrections=passed.corrections, links=passed.links,
        said={k: said for k, said in passed.said.items() if k != 8},
    )  # fmt: skip
    left = graph.solve(passed, TIME, dict.fromkeys(((8, "pose"), (8, "attitude")), 1e-12), None)
    assert left.error == pytest.approx(graph.solve(gone, TIME, {}, None).error, abs=1e-5)
