from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calibration.guide.samples import Rest
from calibration.guide.settings import GuideSettings
from calibration.guide.verdict import CHANCE_MIN, Verdict, aligned_errors
from carosac_toolkit.base.errors import CarosacError, InvalidField
from tests.calibration.guide.scenes import QUICK, ROBOT, by_hand, driven, true_robot

HOME = ROBOT.home_position
SETTINGS = replace(QUICK, accuracy=0.025, max_samples=20, checks=10)


def exit_error(fit, true, home):
    """Return the distances of the exit points from the truth after a turn about home."""
    arm, true_arm = fit.known.exit_points - HOME, true.exit_points - home
    turn, _ = Rotation.align_vectors(true_arm, arm)
    return np.linalg.norm(turn.apply(arm) - true_arm, axis=1)


@pytest.mark.parametrize("seed", [0, 1])
def test_it_stops_at_the_wanted_accuracy_and_has_it(tmp_path, seed):
    guide, hand = by_hand(tmp_path / "samples.csv", seed, settings=SETTINGS)
    guide.resume()
    home = hand.position
    samples = list(guide.collect())
    sigma = [sample.fit.known.exit_distance for sample in samples]
    assert guide.accurate
    assert sigma[-1] <= SETTINGS.accuracy < min(sigma[:-1])
    assert len(samples) < SETTINGS.max_samples
    error = exit_error(guide.fit, true_robot(seed), home)
    assert (error < 3.0 * guide.known.exit_sigma).all()
    assert exit_error(samples[0].fit, true_robot(seed), home).max() > 0.1


@pytest.mark.slow
def test_informative_positions_need_fewer_samples_than_random_ones(tmp_path):
    counts = {True: [], False: []}
    for seed in range(4):
        for at_random, count in counts.items():
            path = tmp_path / f"{seed}{at_random}.csv"
            guide, _ = by_hand(path, seed, settings=SETTINGS, at_random=at_random)
            guide.resume()
            count.append(len(list(guide.collect())))
    assert np.median(counts[False]) < np.median(counts[True])


def test_a_second_run_goes_on_with_the_samples_of_the_first(tmp_path):
    few = replace(SETTINGS, max_samples=4)
    first, _ = by_hand(tmp_path / "samples.csv", 1, settings=few)
    first.resume()
    before = list(first.collect())
    kept = (tmp_path / "samples.csv").read_bytes()
    assert [sample.name for sample in before] == ["home", "1", "2", "3"]
    second, _ = by_hand(tmp_path / "samples.csv", 1, settings=SETTINGS)
    resumed = second.resume()
    assert resumed.known.shared == pytest.approx(first.known.shared, abs=1e-5)
    after = list(second.collect())
    assert after[0].name == "4"
    assert (tmp_path / "samples.csv").read_bytes().startswith(kept)
    assert second.accurate
    third, _ = by_hand(tmp_path / "samples.csv", 1, settings=SETTINGS)
    third.resume()
    assert list(third.collect()) == []
    assert len(list(third.check())) == SETTINGS.checks
    fourth, _ = by_hand(tmp_path / "samples.csv", 1, settings=SETTINGS)
    fourth.resume()
    assert list(fourth.check()) == []
    assert len(fourth.checked) == SETTINGS.checks


def test_lengths_that_lost_their_meaning_are_no_continuation(tmp_path):
    """As after homing anew at another place, or a slipped cable."""
    first, _ = by_hand(tmp_path / "samples.csv", 1, settings=SETTINGS)
    first.resume()
    list(first.collect())

    def shifted(hand):
        def read():
            rest = hand.read()
            return Rest(length=rest.length + np.array([0.05, 0.0, 0.0, 0.0]), tension=rest.tension)

        return read

    second, _ = by_hand(tmp_path / "samples.csv", 1, settings=SETTINGS, read=shifted)
    with pytest.raises(CarosacError, match="the lengths now do not belong to these samples"):
        second.resume()


def test_slack_cables_at_a_second_start_are_tightened_before_lengths_are_compared(tmp_path):
    first, _ = by_hand(tmp_path / "samples.csv", 1, settings=SETTINGS)
    first.resume()
    list(first.collect())
    tightened = []

    def slack(hand):
        def read():
            rest = hand.read()
            if tightened and tightened[-1]:
                foreign = np.array([0.05, 0.0, 0.0, 0.0])
                return Rest(length=rest.length + foreign, tension=rest.tension)
            return Rest(length=rest.length, tension=np.array([0.0, 9.0, 9.0, 20.0]))

        return read

    still, _ = by_hand(tmp_path / "samples.csv", 1, settings=SETTINGS, read=slack)
    with pytest.raises(CarosacError, match="cables are slack: tensions 0, 9, 9, 20 N"):
        still.resume()
    second, _ = by_hand(tmp_path / "samples.csv", 1, settings=SETTINGS, read=slack)
    second._mover.move = lambda known, start, end: tightened.append(bool((start == end).all()))
    with pytest.raises(CarosacError, match="the lengths now do not belong to these samples"):
        second.resume()


def test_predictions_are_within_their_claim_and_a_cable_that_slips_is_told(tmp_path):
    slip = np.zeros(4)

    def slipping(hand):
        def shifted():
            rest = hand.read()
            return Rest(length=rest.length + slip, tension=rest.tension)

        return shifted

    verdicts = []
    for slipped in (0.0, 0.05):
        slip[:] = 0.0
        guide, hand = by_hand(tmp_path / f"{slipped}.csv", 2, settings=SETTINGS, read=slipping)
        guide.resume()
        true, place = [], []
        for _ in guide.collect():
            true.append(hand.position)
        place = list(guide.fit.position)
        slip[0] = slipped
        for check in guide.check():
            true.append(hand.position)
            place.append(check.position)
        error = aligned_errors(place, true, HOME)[-SETTINGS.checks :]
        verdicts.append(Verdict(checks=guide.checked, position_error=error))
    good, bad = verdicts
    assert good.holds and good.chance > CHANCE_MIN
    claimed = np.sqrt(np.mean([check.position_sigma**2 for check in good.checks]))
    assert np.sqrt(np.mean(good.position_error**2)) < 2.0 * claimed
    assert not bad.holds
    assert "NOT within their claim" in bad.sentences()[-1]
    assert "within their claim" in good.sentences()[-1]
    assert bad.data()["holds"] is False


def test_slack_cables_are_no_sample(tmp_path):
    guide, _ = by_hand(
        tmp_path / "samples.csv", 0,
        read=lambda hand: lambda: Rest(
            length=hand.read().length, tension=np.array([0.0, 9.0, 9.0, 20.0])
        ),
    )  # fmt: skip
    guide.resume()
    with pytest.raises(CarosacError, match="not taut at home: tensions 0, 9, 9, 20 N"):
        list(guide.collect())
    assert guide.samples.names == []


@pytest.mark.slow
def test_moved_by_its_driver_it_finds_the_same_robot(tmp_path):
    guide, driver = driven(tmp_path / "samples.csv", 0, settings=SETTINGS)
    guide.resume()
    true = []
    for _ in guide.collect():
        true.append(driver.truth().position[0])
    error = exit_error(guide.fit, true_robot(0), true[0])
    assert guide.accurate
    assert (error < 3.0 * guide.known.exit_sigma).all()


def test_settings_refuse_what_cannot_be():
    for field, value in (("accuracy", 0.0), ("speed", -1.0), ("max_samples", 1), ("checks", -1)):
        with pytest.raises(InvalidField, match=field):
            GuideSettings(**{field: value})
    with pytest.raises(InvalidField, match=r"sample_time: got 0.01 s; allowed: >= 0.02 s"):
        GuideSettings(sample_time=0.01)
