"""Statistics of a run name what made its cycles late."""

import io
import time

from carosac_toolkit.live.statistics import Statistics
from carosac_toolkit.loop.loop import run
from tests.safety.guard.guards import PERIOD, guarded
from tests.safety.guard.test_guard import Holding, path

SLOW_CYCLES = (20, 30, 40)


class Slow(Holding):
    def command(self, belief, reference):
        if self.calls in SLOW_CYCLES:
            time.sleep(4.0 * PERIOD)
        return super().command(belief, reference)


def test_a_late_cycle_is_counted_by_the_stage_that_took_longest():
    guard = guarded(real_time=True, overrun_share=1.0, hang_time=60.0, warm_up=1)
    statistics = Statistics(guard, io.StringIO())
    run(guard, Holding(), Slow(), path(), duration=1.5, watch=statistics)
    data = statistics.data()
    assert data["late_cycles_by_stage"]["controller"] >= len(SLOW_CYCLES)
    assert sum(data["late_cycles_by_stage"].values()) == data["late_cycles"]
    assert data["jitter_max_s"] > 2.0 * PERIOD
    assert "controller" in statistics.timing()
