from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from carosac_toolkit import trajectories
from carosac_toolkit.base.errors import CarosacError, InvalidField
from carosac_toolkit.loop.loop import BadPlugin, run
from carosac_toolkit.loop.values import Belief, Command, Innovations, LimitHit, Measurement, State

PATH = trajectories.line([0.0, 0.0, 1.0], [1.0, 0.0, 1.0], speed_max=1.0, acceleration_max=1.0)
CUT = 0.25  # [m] that the scripted driver takes off each command
HIT = LimitHit(limit="speed", cable=0, asked=1.0, sent=0.5)


class FakeDriver:
    """Notes what is called; its clock starts at 100 s and every command comes back shortened."""

    def __init__(self, calls, size=1, cycles=1000, fails=""):
        self.calls, self.size, self.cycles, self.fails = calls, size, cycles, fails
        self.time = 100.0

    def note(self, name):
        self.calls.append(name)
        if name == self.fails:
            raise OSError(f"{name} failed")

    def connect(self):
        self.note("connect")

    def measure(self):
        self.note("measure")
        return Measurement(
            time=np.full(self.size, self.time), unstrained_length=np.full((self.size, 4), 7.0)
        )

    def command(self, command):
        self.note("send")
        return replace(command, unstrained_length=command.unstrained_length - CUT, limited=(HIT,))

    def wait(self, duration):
        self.note("wait")
        self.time += duration
        self.cycles -= 1
        return self.cycles > 0

    def stop(self, reason):
        self.note("stop")
        self.reason = reason

    def close(self):
        self.note("close")


class Knowing(FakeDriver):
    """The same, and it knows the truth."""

    def truth(self):
        self.calls.append("truth")
        return State(
            time=np.full(self.size, self.time),
            position=np.zeros((self.size, 3)),
            rotation=np.tile(np.eye(3), (self.size, 1, 1)),
            tension=np.full((self.size, 4), 50.0),
        )


class FakeEstimator:
    def __init__(self, calls):
        self.calls, self.applied = calls, []

    def reset(self, measurement):
        self.calls.append("reset estimator")
        return self.belief(measurement)

    def update(self, belief, command, measurement):
        self.calls.append("update")
        self.applied.append((float(command.time[0]), float(command.unstrained_length[0, 0])))
        return self.belief(measurement)

    def belief(self, measurement):
        size = len(measurement.time)
        return Belief(
            time=measurement.time,
            position=np.zeros((size, 3)),
            rotation=np.tile(np.eye(3), (size, 1, 1)),
        )


class FakeController:
    period, horizon = 0.1, 0.3

    def __init__(self, calls):
        self.calls, self.references = calls, []

    def reset(self, belief):
        self.calls.append("reset controller")

    def command(self, belief, reference):
        self.calls.append("control")
        self.references.append(reference)
        lengths = np.full((len(belief.time), 4), 8.0 + len(self.references))
        return Command(time=belief.time, unstrained_length=lengths)


@pytest.fixture
def calls():
    return []


def loop(calls, driver, duration=0.3):
    estimator, controller = FakeEstimator(calls), FakeController(calls)
    return run(driver, estimator, controller, PATH, duration=duration), estimator, controller


class LateDriver(FakeDriver):
    """Misses every second tick."""

    def wait(self, duration):
        return super().wait(2.0 * duration)


@pytest.mark.parametrize("kind, by_clock, cycles", [
    (FakeDriver, False, 10), (FakeDriver, True, 10), (LateDriver, False, 10), (LateDriver, True, 6),
])  # fmt: skip
def test_a_duration_counts_cycles_or_the_clock_of_the_driver(kind, by_clock, cycles):
    controller = FakeController([])
    log = run(
        kind([]), FakeEstimator([]), controller, PATH,
        duration=10 * controller.period, by_clock=by_clock,
    )  # fmt: skip
    assert len(log.time) == cycles
    assert log.completed


def test_order_of_calls(calls):
    loop(calls, Knowing(calls))
    cycle = ["control", "send", "wait"]
    assert calls == [
        "connect",
        *["measure", "truth", "reset estimator", "reset controller", *cycle],
        *2 * ["measure", "truth", "update", *cycle],
        *["stop", "close"],
    ]


def test_the_estimator_gets_the_command_that_was_really_applied(calls):
    log, estimator, _ = loop(calls, FakeDriver(calls))
    expected = np.array([(100.0, 9.0 - CUT), (100.1, 10.0 - CUT)])
    assert np.array(estimator.applied) == pytest.approx(expected)
    assert log.asked[:, 0, 0].tolist() == [9.0, 10.0, 11.0]
    assert log.command[:, 0, 0].tolist() == [8.75, 9.75, 10.75]
    assert log.limited == ((0, HIT), (1, HIT), (2, HIT))


def test_reference_starts_with_the_driver_and_tells_its_time(calls):
    log, _, controller = loop(calls, FakeDriver(calls))
    for k, reference in enumerate(controller.references):
        assert reference.time[0] == pytest.approx(100.0 + 0.1 * (k + np.arange(4)))
        expected = PATH.sample(0.1 * (k + np.arange(4))).position
        assert reference.position[0] == pytest.approx(expected, abs=1e-12)
    assert log.time == pytest.approx([0.0, 0.1, 0.2])
    assert log.reference[:, 0] == pytest.approx(PATH.sample(log.time).position, abs=1e-12)


def test_without_duration_it_runs_one_second_past_the_trajectory(calls):
    log, *_ = loop(calls, FakeDriver(calls), duration=None)
    assert len(log.time) == round((PATH.duration + 1.0) / 0.1)
    assert log.completed


def test_a_duration_below_one_period_is_one_cycle(calls):
    log, *_ = loop(calls, FakeDriver(calls), duration=0.01)
    assert len(log.time) == 1


def test_end_of_data_ends_the_run(calls):
    driver = FakeDriver(calls, cycles=2)
    log, *_ = loop(calls, driver, duration=1.0)
    assert (len(log.time), log.completed, driver.reason) == (2, False, "end of data")


def test_data_that_last_just_long_enough_are_complete(calls):
    driver = FakeDriver(calls, cycles=3)
    log, *_ = loop(calls, driver)
    assert (len(log.time), log.completed) == (3, True)
    assert driver.reason == "end of the trajectory"


def test_truth_is_logged_where_the_driver_knows_it(calls):
    log, *_ = loop(calls, Knowing(calls, size=2))
    assert log.position.shape == (3, 2, 3)
    assert log.rotation.shape == (3, 2, 3, 3)
    assert log.tension.shape == log.command.shape == (3, 2, 4)
    assert log.reference.shape == log.belief_position.shape == (3, 2, 3)


def test_nobody_knows_the_truth_of_a_driver_without(calls):
    log, *_ = loop(calls, FakeDriver(calls))
    assert log.position is log.rotation is log.tension is None


@pytest.mark.parametrize("fails", ["connect", "measure", "send", "wait"])
def test_the_driver_is_stopped_and_closed_when_it_fails(calls, fails):
    driver = FakeDriver(calls, fails=fails)
    with pytest.raises(OSError, match=f"{fails} failed"):
        loop(calls, driver)
    assert calls[-2:] == ["stop", "close"]
    assert driver.reason == f"OSError: {fails} failed"


def test_it_is_closed_also_where_stopping_fails(calls):
    with pytest.raises(OSError, match="stop failed"):
        loop(calls, FakeDriver(calls, fails="stop"))
    assert calls[-1] == "close"


@pytest.mark.parametrize(
    ("returned", "message"),
    [
        (None, "controller: got NoneType; allowed: a Command"),
        (np.ones((1, 4)), "controller: got ndarray; allowed: a Command"),
        (Command(time=np.zeros(1), unstrained_length=np.ones((1, 5))),
         r"controller: got lengths of shape \(1, 5\); allowed: \(1, 4\)"),
        (Command(time=np.zeros(2), unstrained_length=np.ones((2, 4))),
         r"controller: got lengths of shape \(2, 4\); allowed: \(1, 4\)"),
    ],
)  # fmt: skip
def test_what_is_no_command_is_refused_and_never_sent(calls, returned, message):
    driver, controller = FakeDriver(calls), FakeController(calls)
    controller.command = lambda belief, reference: returned
    with pytest.raises(BadPlugin, match=message):
        run(driver, FakeEstimator(calls), controller, PATH, duration=0.3)
    assert "send" not in calls and calls[-2:] == ["stop", "close"]
    assert driver.reason.startswith("BadPlugin: controller")


def test_a_command_with_nan_cannot_be_made(calls):
    controller = FakeController(calls)
    controller.command = lambda belief, reference: Command(
        time=belief.time, unstrained_length=np.full((1, 4), np.nan)
    )
    with pytest.raises(InvalidField, match=r"unstrained_length\[0, 0\]: got nan"):
        run(FakeDriver(calls), FakeEstimator(calls), controller, PATH, duration=0.3)
    assert "send" not in calls and calls[-2:] == ["stop", "close"]


@pytest.mark.parametrize(
    ("name", "returned", "message"),
    [
        ("reset", None, "estimator: got NoneType; allowed: a Belief"),
        ("update", np.zeros(3), "estimator: got ndarray; allowed: a Belief"),
        ("update", Belief(time=np.zeros(2), position=np.zeros((2, 3)),
                          rotation=np.tile(np.eye(3), (2, 1, 1))),
         "estimator: got 2 poses; allowed: 1"),
    ],
)  # fmt: skip
def test_what_is_no_belief_is_refused(calls, name, returned, message):
    estimator = FakeEstimator(calls)
    setattr(estimator, name, lambda *arguments: returned)
    with pytest.raises(BadPlugin, match=message):
        run(FakeDriver(calls), estimator, FakeController(calls), PATH, duration=0.3)
    assert calls[-2:] == ["stop", "close"]


@pytest.mark.parametrize("value", [0.0, -1.0, np.nan, np.inf])
def test_a_period_and_a_duration_must_be_positive(calls, value):
    controller = FakeController(calls)
    with pytest.raises(InvalidField, match="duration: got"):
        run(FakeDriver(calls), FakeEstimator(calls), controller, PATH, duration=value)
    controller.period = value
    with pytest.raises(InvalidField, match=r"controller\.period: got"):
        run(FakeDriver(calls), FakeEstimator(calls), controller, PATH)
    assert calls == []  # the driver was not touched


def test_a_negative_horizon_is_refused_and_the_driver_closed(calls):
    controller = FakeController(calls)
    controller.horizon = -1.0
    with pytest.raises(CarosacError, match="horizon"):
        run(FakeDriver(calls), FakeEstimator(calls), controller, PATH)
    assert calls[-2:] == ["stop", "close"]


class Sure(FakeEstimator):
    """It has a twist, a covariance and, from the second belief on, innovations."""

    def belief(self, measurement):
        size = len(measurement.time)
        count = len(self.applied)
        result = Innovations(squares=np.full(size, 3.0 * count), dof=np.full(size, 4.0),
                            rejected=np.zeros(size))  # fmt: skip
        return replace(
            super().belief(measurement),
            twist=np.full((size, 6), 0.1 * count),
            covariance=np.tile(np.eye(12) * (1.0 + count), (size, 1, 1)),
            innovations=result if count else None,
        )


def test_the_log_keeps_what_an_estimator_says_about_itself():
    log = run(Knowing([], size=2), Sure([]), FakeController([]), PATH, duration=0.3)
    count = len(log.time)
    assert log.belief_twist[:, 1, 0] == pytest.approx(0.1 * np.arange(count))
    assert log.belief_covariance[:, 0, 3, 3] == pytest.approx(1.0 + np.arange(count))
    assert log.innovations.squares[:, 0] == pytest.approx(3.0 * np.arange(count))
    assert log.innovations.dof[:, 1].tolist() == [0.0] + [4.0] * (count - 1)
    assert log.twist is None  # this driver does not know it


def test_what_an_estimator_does_not_say_is_none():
    log = run(Knowing([]), FakeEstimator([]), FakeController([]), PATH, duration=0.3)
    assert log.belief_twist is log.belief_covariance is log.innovations is None
