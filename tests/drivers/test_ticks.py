import pytest

from carosac_toolkit.drivers import ticks as tick_schedule
from carosac_toolkit.drivers.ticks import TickSchedule


class SteppedClock:
    def __init__(self):
        self.now = 50.0

    def monotonic(self):
        return self.now

    def sleep(self, duration):
        self.now += duration


@pytest.mark.parametrize("forgiving, missed", [(False, 6), (True, 2)])
def test_ticks_that_pass_are_skipped_and_counted_but_for_a_first_that_is_forgiven(
    monkeypatch, forgiving, missed
):
    clock = SteppedClock()
    monkeypatch.setattr(tick_schedule, "time", clock)
    ticks = TickSchedule(0.1, forgiving=forgiving)
    for late, due in ((0.45, 0.5), (0.05, 0.6), (0.23, 0.9), (0.0, 1.0)):
        clock.now += late
        ticks.wait()
        assert ticks.elapsed == pytest.approx(due)
    assert ticks.missed == missed
    assert ticks.since(52.5) == pytest.approx(2.5)
