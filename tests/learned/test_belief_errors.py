import copy
from dataclasses import replace

import numpy as np
import pytest

import carosac_toolkit as ct
from carosac_toolkit.base.errors import CarosacError, InvalidField
from learned import belief_drives
from learned.belief_errors import (
    BeliefErrors,
    Episode,
    erring,
    errors_of,
    fit_belief_errors,
    reach_of,
)
from learned.environment import CableEnvironment
from learned.moving_worlds import MovingSettings
from learned.presets import find_preset
from tests.robots import simple_robot

N = 4
START = find_preset("residual").stage("realtime").environment
SETTINGS = replace(
    START,
    path=replace(START.path, pool=8, steps=60),
    moving=replace(START.moving, estimator="dynamic_estimator", modelled=True, cables="catenary"),
)


def known_episodes(count, steps=150, growth=0.0, seed=0):
    """Drives of an estimator whose errors are linear in what the platform does."""
    rng = np.random.default_rng(seed)
    fading = np.diag(np.linspace(0.5, 0.9, 12)) + growth * np.eye(12)
    fading[0, 6] = 0.025  # what the velocity is wrong by adds up
    motion = np.zeros((12, 18 + N))
    motion[6, 0], motion[6, 6] = -0.6, 0.5  # a swing is believed to be smaller, and later
    motion[2, 18:] = 0.25
    by_reach = np.zeros((12, 1 + N))
    by_reach[0, 0], by_reach[1, 1:] = 0.01, 0.3
    episodes = []
    for _ in range(count):
        twist = np.cumsum(0.05 * rng.standard_normal((steps + 1, 6)), axis=0)
        reach = 0.01 * rng.standard_normal(N) + 5e-3 * rng.standard_normal((steps + 1, N))
        offset = by_reach @ [1.0, *reach[0]] + 1e-3 * rng.standard_normal(12)
        error = [np.concatenate([0.02 * rng.standard_normal(6), -twist[0]])]
        past = np.concatenate([twist[:1], twist[:1], twist])
        for k in range(1, steps + 1):
            u = np.concatenate([past[k + 2], past[k + 1], past[k], reach[k] - reach[0]])
            noise = 2e-3 * rng.standard_normal(12)
            error.append(fading @ error[-1] + motion @ u + offset + noise)
        episodes.append(Episode(error=np.array(error), twist=twist, reach=reach))
    return episodes, fading, motion, by_reach


def small(monkeypatch):
    """Let few short drives say how the estimator errs."""
    monkeypatch.setattr(belief_drives, "DRIVES", 20)
    monkeypatch.setattr(belief_drives, "STEPS", 30)


def test_what_is_believed_with_an_error_errs_by_it():
    rng = np.random.default_rng(1)
    worlds = CableEnvironment(simple_robot(), START, size=3)
    worlds.reset()
    truth = worlds.reached
    error = 0.3 * rng.standard_normal((3, 12))
    belief = erring(np.zeros(3), truth.position, truth.rotation, truth.twist, error)
    np.testing.assert_allclose(errors_of(truth, belief), error, atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(belief.rotation), 1.0)


def test_a_model_is_found_again_in_drives_that_follow_it():
    episodes, fading, motion, by_reach = known_episodes(60)
    found = fit_belief_errors(episodes)
    np.testing.assert_allclose(found.fading, fading, atol=0.03)
    # Twists of three steps in a row tell their sum and their change, not each alone.
    np.testing.assert_allclose(
        found.motion[6, [0, 6, 12]].sum(), motion[6, [0, 6]].sum(), atol=0.01
    )
    sigma = 2e-3 / (5e-3 * np.sqrt(60 * 150))  # noise over what reaches vary by
    np.testing.assert_allclose(found.motion[:, 18:], motion[:, 18:], atol=5.0 * sigma)
    np.testing.assert_allclose(found.offset[1, 1:], by_reach[1, 1:], atol=0.1)
    np.testing.assert_allclose(found.noise @ found.noise.T, 4e-6 * np.eye(12), atol=4e-7)
    np.testing.assert_allclose(found.start[6:, -6:], -np.eye(6), atol=0.05)


def test_modelled_errors_spread_and_last_as_those_that_they_were_learned_from():
    episodes, *_ = known_episodes(60)
    model = fit_belief_errors(episodes[:40])
    others = episodes[40:]
    errors = BeliefErrors(model, len(others), N, seed=5)
    twist = np.stack([one.twist for one in others], axis=1)
    reach = np.stack([one.reach for one in others], axis=1)
    errors.begin(np.arange(len(others)), twist[0], reach[0])
    said = [errors.error]
    for k in range(1, len(twist)):
        errors.advance(twist[k], reach[k])
        said.append(errors.error)
    said, true = np.stack(said), np.stack([one.error for one in others], axis=1)
    for part in (lambda e: e[20:], lambda e: np.diff(e[20:], axis=0)):
        spread = [np.sqrt((part(e) ** 2).mean(axis=(0, 1))) for e in (said, true)]
        np.testing.assert_allclose(spread[0], spread[1], rtol=0.35)
    both = [np.corrcoef(said[20:, :, k].ravel(), true[20:, :, k].ravel())[0, 1] for k in (6, 2)]
    assert min(both) > 0.3  # what motion causes is there; noise is another


def test_errors_that_grow_by_themselves_are_refused():
    with np.errstate(all="ignore"):
        episodes, *_ = known_episodes(40, steps=40, growth=0.4)
    with pytest.raises(CarosacError, match="they grow by themselves"):
        fit_belief_errors(episodes)


def test_too_few_drives_are_refused():
    episodes, *_ = known_episodes(12)
    with pytest.raises(CarosacError, match="only 12 of 12 drives ended with the platform found"):
        fit_belief_errors(episodes)
    with pytest.raises(CarosacError, match="only 0 of 0 drives"):
        fit_belief_errors([])


def test_straight_cables_reach_as_far_as_they_are_long():
    robot = simple_robot()
    where = robot.home_position[None]
    straight = reach_of(robot, where, robot.home_rotation[None], np.zeros((1, robot.n)))
    assert reach_of(robot, where, robot.home_rotation[None], straight) == pytest.approx(0.0)


def test_a_training_world_learns_how_its_estimator_errs_and_goes_on_bit_by_bit(monkeypatch):
    small(monkeypatch)
    told = []

    def made():
        return CableEnvironment(simple_robot(), SETTINGS, size=4, seed=3)

    def learned():
        return belief_drives.learn_belief_errors(
            simple_robot(), SETTINGS, 3, watch=lambda step, of: told.append((step, of))
        )

    def go_on(cables):
        return np.stack([cables.step(np.full((4, 3), 0.2)).observation for _ in range(4)])

    cables = made()
    with pytest.raises(InvalidField, match="modelled: got no model of the errors; allowed: those"):
        cables.reset()
    cables.take_errors(learned())
    cables.reset()
    assert told[-1] == (30, 30)
    np.testing.assert_allclose(cables.reached.belief.twist, 0.0, atol=0.5)  # begun at rest, nearly
    go_on(cables)
    state = copy.deepcopy(cables.state())
    expected = go_on(cables)
    again = made()
    again.restore(state)
    np.testing.assert_array_equal(go_on(again), expected)
    assert not again.lacks_errors  # a state brings its model along
    error = errors_of(cables.reached, cables.reached.belief)
    assert (np.abs(error) > 1e-6).all()


def test_worlds_beyond_the_share_have_constant_errors(monkeypatch):
    small(monkeypatch)
    moving = replace(SETTINGS.moving, estimated=0.5)
    settings = replace(SETTINGS, moving=moving)
    cables = CableEnvironment(simple_robot(), settings, size=4)
    cables.take_errors(belief_drives.learn_belief_errors(simple_robot(), settings, 0))
    cables.reset()
    errors = []
    for _ in range(3):
        cables.step(np.zeros((4, 3)))
        errors.append(errors_of(cables.reached, cables.reached.belief))
    moved = np.ptp(np.stack(errors), axis=0)
    assert (moved[:2] > 1e-6).all()
    np.testing.assert_allclose(moved[2:], 0.0, atol=1e-12)


def test_there_is_no_model_without_an_estimator():
    with pytest.raises(InvalidField, match="modelled: got True; allowed: False, or an estimator"):
        MovingSettings(modelled=True)


@pytest.mark.slow
def test_modelled_errors_are_as_large_and_as_lasting_as_those_of_the_estimator():
    """On plants, paths and sensors that the model was not learned from, 24 of each."""
    robot, spreads = ct.load_robot("carosac"), []
    environment = replace(START, moving=replace(SETTINGS.moving, cables="particles"))
    model = belief_drives.learn_belief_errors(robot, environment, seed=0)
    for modelled in (False, True):
        moving = replace(environment.moving, modelled=modelled)
        cables = CableEnvironment(robot, replace(environment, moving=moving), size=24, seed=77)
        if modelled:
            cables.take_errors(model)
        cables.reset()
        errors, lost = [], np.zeros(24, dtype=bool)
        for _ in range(160):
            lost |= cables.step(np.zeros((24, 3))).truncated
            errors.append(errors_of(cables.reached, cables.reached.belief))
        error = np.stack(errors)[20:, ~lost]
        spreads.append([np.sqrt((x**2).mean(axis=(0, 1))) for x in (error, np.diff(error, axis=0))])
    real, modelled = np.array(spreads[0]), np.array(spreads[1])
    assert (0.4 * real < modelled).all() and (modelled < 2.5 * real).all()
