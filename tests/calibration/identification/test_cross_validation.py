"""Held-out costs from one fit are those of all fits; parameters are kept only if they predict."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import lsq_linear

import carosac_toolkit as ct
from calibration.identification import procedure
from calibration.identification.cross_validation import Candidate, Folds
from calibration.identification.doubts import Judge
from calibration.identification.error_noise import PoseErrorNoise
from calibration.identification.procedure import identify
from calibration.identification.quadratic import Quadratic
from calibration.identification.settings import IdentificationSettings
from calibration.identification.synthetic import RunSettings, simulate_run
from carosac_toolkit.base.errors import InvalidField

FEW = IdentificationSettings(
    exit_points=0.0, anchor_points=0.0, length_scale=0.0, mass=0.0, linear_density=0.0,
    axial_stiffness=0.0, axial_damping=0.0, run_length=0.0, drag=0.0, exit_friction=0.0,
    anchor_friction=0.0, length_hysteresis=0.0, pose_tilt=0.0,
)  # fmt: skip


class Regression:
    """A linear model of 12 parts of data, with parameters that are of it and others that are not.

    The first two are always fitted, the next two may be held, as may the last two, which are 0.
    """

    def __init__(self, seed):
        rng = np.random.default_rng(seed)
        self.truth = np.array([1.0, -0.5, 0.8, 0.4, 0.0, 0.0])
        self.slopes = rng.standard_normal((12, 8, 6))
        self.data = self.slopes @ self.truth + rng.standard_normal((12, 8))
        self.precision = np.eye(6)

    def fit(self, rows, free):
        slopes = self.slopes[rows].reshape(-1, 6)[:, free]
        known = self.precision[np.ix_(free, free)] + slopes.T @ slopes
        found = np.zeros(6)
        found[free] = np.linalg.solve(known, slopes.T @ self.data[rows].ravel())
        return found

    def folds(self):
        at = self.fit(np.arange(12), np.arange(6))
        off = self.slopes @ at - self.data
        return Folds(
            parts=[
                Quadratic(cost=float(e @ e), gradient=s.T @ e, information=s.T @ s)
                for s, e in zip(self.slopes, off, strict=True)
            ],
            known=Quadratic(cost=0.0, gradient=self.precision @ at, information=self.precision),
            at=at,
            lower=np.full(6, -np.inf),
            judge=Judge(noise=PoseErrorNoise(sigma=np.ones(6), repeats=np.ones(6))),
            places=tuple(range(12)),
        )


def mask(*rows):
    return np.isin(np.arange(6), rows)


@pytest.mark.parametrize("held", [(), (2, 3), (4, 5), (2, 3, 4, 5)])
def test_costs_of_parts_held_out_are_those_of_fits_without_them(held):
    model = Regression(0)
    free = np.flatnonzero(~mask(*held))
    expected = []
    for part in range(12):
        found = model.fit(np.delete(np.arange(12), part), free)
        expected.append(((model.slopes[part] @ found - model.data[part]) ** 2).sum())
    assert model.folds().held_out(mask(*held)) == pytest.approx(np.array(expected))


def test_what_is_of_the_model_is_kept_and_what_is_not_is_left():
    verdicts = [
        {one.name: one.kept for one in Regression(seed).folds().choose(GROUPS)}
        for seed in range(40)
    ]
    assert all(verdict["true"] for verdict in verdicts)
    assert np.mean([verdict["none"] for verdict in verdicts]) < 0.1


GROUPS = {"true": mask(2, 3), "none": mask(4, 5)}


def test_all_are_kept_where_a_fit_without_them_predicts_worse():
    """As where they are so far from the robot file that the cost is no parabola there."""
    folds = Regression(0).folds()
    judged = folds.choose(GROUPS)
    assert folds.verified(folds, judged) == judged
    worse = [replace(part, cost=1.3 * part.cost) for part in folds.parts]
    verified = folds.verified(replace(folds, parts=worse), judged)
    assert all(one.kept for one in verified)
    assert next(one.gain for one in verified if one.name == "none") > 0.1
    some = replace(folds, parts=worse[:5], places=(0, 3, 4, 7, 8))  # others were left out of it
    assert folds.verified(some, judged)[0] == judged[0]


def test_words_say_what_was_found():
    tried = {one.name: one for one in Regression(0).folds().choose(GROUPS)}
    assert tried["true"].words.startswith("true kept: ")
    assert "left as in the robot file" in tried["none"].words
    assert tried["true"].gain > tried["true"].error > 0.0


def test_what_could_not_be_left_is_said_to_be_kept_with_the_others():
    one = Candidate(name="drag", kept=True, gain=0.46, error=0.22, together=True)
    assert one.words.startswith("drag kept, as a fit without those to be left predicts worse")
    assert one.data()["together"] is True


def test_coordinates_stay_within_their_bounds_in_each_fit():
    model = Regression(0)
    folds = replace(model.folds(), lower=np.array([-np.inf] * 3 + [0.5, 0.0, 0.0]))
    folds = replace(folds, at=np.maximum(folds.at, folds.lower))
    change = folds.at - model.folds().at  # to the bounds, where the cost is the same parabola
    about = [
        Quadratic(
            cost=part.at(change),
            gradient=part.gradient + part.information @ change,
            information=part.information,
        )
        for part in [folds.known, *folds.parts]
    ]
    folds = replace(folds, known=about[0], parts=about[1:])
    for part, cost in enumerate(folds.held_out(mask())):
        rows = np.delete(np.arange(12), part)
        slopes = np.concatenate([model.slopes[rows].reshape(-1, 6), np.eye(6)])
        data = np.concatenate([model.data[rows].ravel(), np.zeros(6)])
        found = lsq_linear(slopes, data, bounds=(folds.lower, np.inf), tol=1e-13).x
        off = model.slopes[part] @ found - model.data[part]
        assert cost == pytest.approx(off @ off, rel=1e-4)


@pytest.fixture(scope="module")
def robot():
    return ct.load_robot("carosac")


def tried(robot, plant, candidate="inertia_products"):
    """Identify a plant from one run, with some parameters as candidates."""
    run = simulate_run(plant, 4, RunSettings(condition="none", moves=4, rate=20.0)).recording
    span = (0, len(run.time))
    return identify(run, robot, FEW, train=span, candidates=[candidate])


def test_products_of_inertia_are_kept_where_the_body_has_them(robot):
    moments = 0.5 * np.trace(robot.inertia) - np.diag(robot.inertia)
    shares = np.array([[0.0, 0.3, -0.25], [0.3, 0.0, 0.2], [-0.25, 0.2, 0.0]])
    skew = robot.inertia + shares * np.sqrt(np.outer(moments, moments))
    found = tried(robot, replace(robot, inertia=skew))
    assert found.candidates[0].kept and "inertia.xy" in found.estimate.names
    assert any("inertia_products kept: " in line for line in found.sentences())
    off = found.robot.inertia - skew
    assert np.linalg.norm(off) < np.linalg.norm(robot.inertia - skew)


def test_friction_on_pulleys_is_found_where_runs_stretch(robot):
    soft = replace(robot, run_length=np.full(4, 6.0), axial_stiffness=np.full(4, 2e4))
    found = tried(soft, replace(soft, capstan_friction=np.full(4, 0.15)), "capstan_friction")
    assert found.candidates[0].kept and found.candidates[0].gain > 0.5
    row = found.estimate.names.index("capstan_friction")
    assert abs(found.estimate.value[row] - 0.15) < 3.0 * found.estimate.sigma[row] < 0.05


def test_they_stay_as_in_the_robot_file_where_it_has_none(robot, monkeypatch):
    """What is told of the robot is then less, and must not refuse what was accepted before."""
    checked, check = [], procedure._check
    monkeypatch.setattr(procedure, "_check", lambda *given: (checked.append(1), check(*given))[1])
    found = tried(robot, robot)
    assert len(checked) == 1
    assert not found.candidates[0].kept and "inertia.xy" not in found.estimate.names
    assert found.data()["candidates"]["inertia_products"]["kept"] is False
    assert found.robot.inertia[0, 1] == 0.0


def test_a_candidate_that_is_no_parameter_is_refused():
    with pytest.raises(
        InvalidField, match=r"candidates: got 'colour'; allowed: any of exit_points"
    ):
        IdentificationSettings().with_candidates(["colour"])
    with pytest.raises(InvalidField, match="'rate'"):
        IdentificationSettings().with_candidates(["rate"])


def test_what_a_few_parts_tell_is_called_undecided():
    told = Candidate(name="capstan_friction", kept=False, gain=0.6, error=0.68)
    assert "capstan_friction undecided" in told.words
    assert "left as in" in replace(told, gain=0.01, error=0.02).words
    assert "undecided" not in replace(told, gain=0.01, error=0.02).words
