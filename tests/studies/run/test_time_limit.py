from __future__ import annotations

import contextlib
import signal
import threading
import time

import pytest

from carosac_toolkit.studies.run.time_limit import CaseTimeout, TimeLimit


def in_thread(function):
    """Call a function in another thread and return what it returned or raised."""
    results = []

    def target():
        try:
            results.append(function())
        except BaseException as error:
            results.append(error)

    thread = threading.Thread(target=target)
    thread.start()
    thread.join(10.0)
    return results[0]


def here(function):
    try:
        return function()
    except CaseTimeout as error:
        return error


def loop():
    with TimeLimit(0.1):
        while True:
            with contextlib.suppress(Exception):
                time.sleep(0.001)


def swallow():
    with TimeLimit(0.05):
        with contextlib.suppress(BaseException):
            while True:
                time.sleep(0.001)
        return "late"


@pytest.mark.parametrize("call", [here, in_thread])
@pytest.mark.parametrize("function", [loop, swallow])
def test_a_loop_is_stopped_whatever_it_catches(call, function):
    assert isinstance(call(function), CaseTimeout)


def test_a_wait_in_the_main_thread_is_stopped():
    start = time.monotonic()
    with pytest.raises(CaseTimeout), TimeLimit(0.1):
        time.sleep(5.0)
    assert time.monotonic() - start < 1.0


@pytest.mark.parametrize("call", [here, in_thread])
def test_what_ends_in_time_is_left_alone(call):
    def quick():
        before = signal.getsignal(signal.SIGALRM)
        for _ in range(50):
            with TimeLimit(0.05):
                pass
        time.sleep(0.1)
        return signal.getsignal(signal.SIGALRM) is before

    assert call(quick) is True


@pytest.mark.parametrize("seconds", [0.05, 0.3])
def test_an_alarm_of_somebody_else_goes_off_when_the_block_is_left(seconds):
    rung = []
    handler = signal.signal(signal.SIGALRM, lambda number, frame: rung.append(time.monotonic()))
    alarm = signal.setitimer(signal.ITIMER_REAL, 0.15)
    start = time.monotonic()
    try:
        with contextlib.suppress(CaseTimeout), TimeLimit(seconds):
            time.sleep(5.0)
        while not rung and time.monotonic() - start < 10.0:
            time.sleep(0.01)
    finally:
        signal.signal(signal.SIGALRM, handler)
        signal.setitimer(signal.ITIMER_REAL, *alarm)
    assert len(rung) == 1
    assert rung[0] - start > max(0.15, seconds) - 0.001


@pytest.mark.parametrize("call", [here, in_thread])
def test_the_race_between_end_and_limit_has_one_outcome(call):
    def race():
        outcomes = []
        for i in range(200):
            try:
                with TimeLimit(0.002):
                    end = time.perf_counter() + 0.0015 + i * 5e-6
                    while time.perf_counter() < end:
                        pass
                outcomes.append("ok")
            except CaseTimeout:
                outcomes.append("late")
        return outcomes

    outcomes = call(race)
    assert len(outcomes) == 200
    assert set(outcomes) <= {"ok", "late"}
