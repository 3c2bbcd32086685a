"""The one who offers pictures never waits, and the newest one wins."""

import threading
import time
from itertools import pairwise

import pytest

from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.viewer.publisher import Publisher


def until(condition, patience=20.0):
    end = time.monotonic() + patience
    while not condition() and time.monotonic() < end:
        time.sleep(0.005)
    assert condition()


def test_while_one_is_drawn_only_the_newest_of_the_others_is_kept():
    free, drawn = threading.Event(), []

    def draw(item):
        drawn.append(item)
        free.wait(20.0)

    publisher = Publisher(draw, rate=1000.0)
    publisher.offer(0)
    until(lambda: drawn == [0])
    began = time.monotonic()
    for k in range(1, 1000):
        publisher.offer(k)  # the drawing hangs, and this returns all the same
    assert time.monotonic() - began < 10.0
    assert drawn == [0]
    free.set()
    publisher.close()
    assert drawn == [0, 999]
    assert (publisher.drawn, publisher.dropped) == (2, 998)


def test_no_more_are_drawn_than_the_rate_allows():
    times = []
    publisher = Publisher(lambda _: times.append(time.monotonic()), rate=50.0)
    end = time.monotonic() + 0.5
    while time.monotonic() < end:
        publisher.offer(1)
        time.sleep(0.001)
    publisher.close()
    gaps = [later - earlier for earlier, later in pairwise(times[:-1])]
    assert min(gaps) > 0.015


def test_what_was_put_off_is_drawn_once_it_is_quiet():
    settled = []
    publisher = Publisher(lambda _: None, settle=lambda: settled.append(1))
    publisher.offer(1)
    until(lambda: settled == [1])
    time.sleep(0.6)
    assert settled == [1]
    publisher.close()


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_fault_in_drawing_is_kept_and_harms_nobody_else():
    def fail(_):
        raise ValueError("no picture")

    publisher = Publisher(fail)
    publisher.offer(1)
    until(lambda: publisher.error is not None)
    publisher.offer(2)
    publisher.close()
    assert str(publisher.error) == "no picture" and publisher.drawn == 0


def test_a_rate_must_be_positive():
    with pytest.raises(InvalidField, match="rate"):
        Publisher(lambda _: None, rate=0.0)
