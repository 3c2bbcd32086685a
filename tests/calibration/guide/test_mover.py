from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import carosac_toolkit as ct
from calibration.guide.mover import DriverMover, Stopped
from calibration.self_calibration.suggested_positions import NoSafePosition
from tests.calibration.guide.scenes import QUICK, ROBOT, driven, true_robot


@pytest.mark.parametrize(
    "seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2))]
)
def test_tensions_of_the_true_robot_stay_within_their_limits(tmp_path, seed):
    """Exit points are off by up to 0.4 m, and the cables are stiff: 10 mm would be 100 N."""
    guide, driver = driven(tmp_path / "samples.csv", seed)
    guide.resume()
    samples = list(guide.collect())
    tension, true = np.array(driver.tension), true_robot(seed)
    assert len(samples) == QUICK.max_samples
    assert np.abs(true.exit_points - ROBOT.exit_points).max() > 0.15
    assert tension.min() >= true.tension_min.max()
    assert tension.max() <= true.tension_max.min()
    extent = np.linalg.norm(guide.fit.position - ROBOT.home_position, axis=1).max()
    assert extent > 0.2


def test_lengths_alone_do_not_move_a_stiff_robot_that_is_hardly_known(tmp_path):
    robot = replace(ROBOT, exit_covariance=np.tile(0.05**2 * np.eye(3), (4, 1, 1)))
    guide, driver = driven(tmp_path / "samples.csv", 0, robot=robot, tension=False)
    guide.resume()
    with pytest.raises(NoSafePosition, match="tensions would be wrong by"):
        list(guide.collect())
    assert np.ptp(driver.tension, axis=0).max() < 0.5


def test_without_feedback_the_same_move_slackens_cables(tmp_path):
    """Why tensions are needed: the test above is no excess of caution."""
    guide, driver = driven(tmp_path / "samples.csv", 0)
    guide.resume()
    mover = guide._mover
    home = ROBOT.home_position
    known = guide.known
    end = home + np.array([0.1, 0.15, 0.1])
    mover.move(known, home, home)
    assert mover.move(known, home, end) == ""
    held = np.array(driver.tension)
    other, blind = driven(tmp_path / "other.csv", 0, tension=False)
    other.resume()
    other._mover.move(known, home, end)
    assert held.min() >= ROBOT.tension_min.max()
    assert np.array(blind.tension).min() < ROBOT.tension_min.max()


def test_a_move_into_a_limit_turns_back_before_it(tmp_path):
    """Above the top of the ceiling line nothing holds the platform."""
    guide, driver = driven(tmp_path / "samples.csv", 1)
    guide.resume()
    mover, home = guide._mover, ROBOT.home_position
    mover.move(guide.known, home, home)
    reason = mover.move(guide.known, home, home + np.array([1.6, 0.0, 0.3]))
    rest = mover.rest()
    tension = np.array(driver.tension)
    assert "did not come back" in reason
    assert tension.min() >= ROBOT.tension_min.max()
    assert tension.max() <= ROBOT.tension_max.min()
    assert (rest.tension > ROBOT.tension_min).all()


def test_a_driver_that_stops_ends_the_move(tmp_path):
    guide, _ = driven(tmp_path / "samples.csv", 0)
    guide.resume()
    mover = guide._mover
    assert isinstance(mover, DriverMover)
    mover._driver.end("the operator has had enough")
    with pytest.raises(Stopped, match="the operator has had enough"):
        mover.rest()


@pytest.mark.slow
def test_five_cables_are_held_taut_too(tmp_path):
    four = ct.load_robot("hangprinter")
    fields = {
        name: np.concatenate([value, value[:1]])
        for name, value in vars(four).items()
        if isinstance(value, np.ndarray) and value.shape[:1] == (4,)
    }
    fields["exit_points"] = np.vstack([four.exit_points, [0.9, -1.3, -0.1]])
    robot = replace(
        four, **fields, cable_names=("a", "b", "c", "d", "e"), name="five", hardware=None
    )
    robot = replace(robot, tension_min=np.full(5, 1.0), tension_max=np.full(5, 60.0))
    guide, driver = driven(tmp_path / "samples.csv", 3, robot=robot)
    guide.resume()
    samples = list(guide.collect())
    tension = np.array(driver.tension)
    assert tension.min() >= 1.0
    assert tension.max() <= 60.0
    assert samples[-1].fit.known.exit_sigma.max() < 0.2 * samples[0].fit.known.exit_sigma.max()
