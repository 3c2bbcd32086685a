from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import carosac_toolkit as ct
from calibration.guide.drivers import enable_where_it_is, guarded, simulated_driver
from calibration.guide.fit import nothing_measured
from calibration.guide.guide import Guide
from calibration.guide.mover import WOUND_RATIO, DriverMover, _Winding
from calibration.guide.rest import Stopped
from calibration.guide.samples import SampleFile
from calibration.self_calibration.settings import SelfCalibrationSettings
from calibration.self_calibration.suggested_positions import NoSafePosition
from carosac_toolkit.loop.values import Stamped
from tests.calibration.guide.scenes import QUICK, ROBOT, Recorded, driven, true_robot

HELD_AFTER = 60  # commands: load cells have been probed
BROKEN_AFTER = 700  # measurements: on the way to the first sample


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


class Cautious(Recorded):
    """A driver that no longer sends what it is told, once a move has begun."""

    def __init__(self, driver):
        super().__init__(driver)
        self.held, self.asked, self._count = None, [], 0

    def command(self, command):
        self._count += 1
        if self._count < HELD_AFTER:
            return self._driver.command(command)
        if self.held is None:
            self.held = np.array(command.unstrained_length)
        self.asked.append(command.unstrained_length[0])
        return self._driver.command(replace(command, unstrained_length=self.held))


def test_commands_go_on_from_what_was_really_sent(tmp_path):
    """Winding that limits held back must not come all at once later."""
    inner = simulated_driver(ROBOT, true_robot(0), QUICK, seed=0)
    driver = Cautious(inner)
    driver.connect()
    mover = DriverMover(driver, ROBOT, QUICK, real_time=False)
    home = ROBOT.home_position
    known = nothing_measured(ROBOT, SelfCalibrationSettings(), tension=True)
    mover.move(known, home, home + np.array([0.0, 0.05, 0.0]))
    apart = np.abs(np.array(driver.asked) - driver.held).max()
    assert apart < 5e-3


def test_a_driver_that_stops_ends_the_move(tmp_path):
    guide, _ = driven(tmp_path / "samples.csv", 0)
    guide.resume()
    mover = guide._mover
    assert isinstance(mover, DriverMover)
    mover._periods._driver.end("the operator has had enough")
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
    fewer = replace(QUICK, max_samples=5)
    guide, driver = driven(tmp_path / "samples.csv", 3, robot=robot, settings=fewer)
    guide.resume()
    samples = list(guide.collect())
    tension = np.array(driver.tension)
    assert tension.min() >= 1.0
    assert tension.max() <= 60.0
    assert samples[-1].fit.known.exit_sigma.max() < 0.2 * samples[0].fit.known.exit_sigma.max()


class BrokenCells(Recorded):
    """A driver whose load cells fail on the way."""

    def __init__(self, driver, fail):
        super().__init__(driver)
        self._fail, self._count, self._last = fail, 0, None

    def measure(self):
        now = self._driver.measure()
        self._count += 1
        if self._count <= BROKEN_AFTER:
            self._last = now.tension
            return now
        return replace(now, tension=self._fail(now.tension, self._last))


def broken(path, fail):
    """Return a guide of a robot whose cells fail, with the driver."""
    robot = replace(ROBOT, tension_max=np.full(4, 200.0))
    inner = simulated_driver(robot, true_robot(0, robot), QUICK, seed=0)
    driver = BrokenCells(inner, fail)
    guard = guarded(driver, robot, QUICK)
    enable_where_it_is(guard, robot)
    mover = DriverMover(guard, robot, QUICK, real_time=False)
    samples = SampleFile(path, robot)
    return Guide(robot, mover, samples, QUICK, SelfCalibrationSettings(), seed=0), driver


def one_stuck(now, last):
    value = np.array(now.value)
    value[0, 1] = last.value[0, 1]
    return Stamped(time=now.time, value=value)


@pytest.mark.parametrize(
    ("fail", "message"),
    [
        (lambda now, last: last, r"no new tensions for 0.10 s; allowed: 0.08 s"),
        (one_stuck, "load cell of cable b shows .* it is stuck"),
        (lambda now, last: Stamped(time=now.time, value=last.value), "it is stuck"),
    ],
)
def test_load_cells_that_fail_on_the_way_stop_the_robot(tmp_path, fail, message):
    """Feedback of tensions that do not answer would wind the cables to their breaking."""
    guide, driver = broken(tmp_path / "samples.csv", fail)
    guide.resume()
    with pytest.raises(Stopped, match=message):
        list(guide.collect())
    tension = np.array(driver.tension)
    assert tension.min() >= ROBOT.tension_min.max()
    assert tension.max() < 2.0 * tension[:BROKEN_AFTER].max()


def test_winding_beyond_what_wrong_lengths_explain_turns_back_and_then_stops():
    """Load cells that only make noise never show the same twice."""
    winding, rng = _Winding(ROBOT, np.full(4, 4.0)), np.random.default_rng(0)
    error, pull = 30.0, 0.1
    turned = []
    with pytest.raises(Stopped, match=r"were wound by .* N were expected"):
        for _ in range(10_000):
            turned.append(winding.is_too_much(np.full(4, pull), rng.normal(5.0, 0.5, 4), error))
    allowed = (error + ROBOT.weight) / pull
    assert turned.index(True) == pytest.approx(allowed, abs=1.0)
    assert len(turned) == pytest.approx(WOUND_RATIO * allowed, abs=1.0)


@pytest.mark.parametrize(
    ("shown", "message"),
    [
        (np.zeros(4), "load cells show .* the platform weighs"),
        (np.array([0.0, 0.0, 0.0, ROBOT.weight]), "cable a shows .* was wound in"),
    ],
)
def test_slack_cables_are_not_wound_in_for_ever(tmp_path, shown, message):
    """Cells that show slack cables, as when they are unplugged; those of a clamp show 0 exactly."""
    guide, driver = broken(tmp_path / "samples.csv", lambda now, last: now)
    driver._fail = lambda now, last: Stamped(time=now.time, value=shown[None])
    driver._count = BROKEN_AFTER
    guide.resume()
    with pytest.raises(Stopped, match=message):
        list(guide.collect())


def test_cables_that_are_slack_at_first_are_taken_in():
    winding = _Winding(ROBOT, np.full(4, 4.0))
    for _ in range(80):  # nothing is felt yet, and it is more than the weight of the platform
        assert not winding.is_too_much(np.ones(4), np.array([0.0, 0.0, 0.0, ROBOT.weight]), 0.0)
    assert not winding.is_too_much(np.ones(4), np.array([3.5, 3.5, 3.5, ROBOT.weight]), 0.0)


def test_a_stuck_load_cell_that_makes_noise_is_found_before_the_next_move(tmp_path):
    """It never shows the same twice, but it does not notice winding at rest either."""
    rng = np.random.default_rng(0)

    def noisy(now, last):
        value = np.array(now.value)
        value[0, 1] = last.value[0, 1] + rng.normal(0.0, 0.1)
        return Stamped(time=now.time, value=value)

    guide, driver = broken(tmp_path / "samples.csv", lambda now, last: now)
    guide.resume()
    samples = guide.collect()
    next(samples)
    next(samples)
    driver._last, driver._fail = driver.measure().tension, noisy
    driver._count = BROKEN_AFTER
    with pytest.raises(Stopped, match=r"load cell of cable b shows .* where winding should make"):
        next(samples)
