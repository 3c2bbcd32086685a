"""The exchange with a PLC whose connection breaks."""

import threading
import time

import numpy as np
import pytest

from carosac_toolkit.plc.blocks import MACHINE, TO_HOST, TRUTH
from carosac_toolkit.plc.exchange import PlcExchange
from carosac_toolkit.plc.identity import machine_values
from carosac_toolkit.plc.link import LinkError
from tests.plc.test_writing import ROBOT, Program, until

PERIOD = 0.02


class BreakableLink(Program):
    """A PLC whose wire can be cut; `blind`: a new connection does not find the truth."""

    cut = blind = False

    def __init__(self):
        super().__init__()
        self.reads = []

    def has(self, block):
        return super().has(block) or (block == TRUTH and not self.blind)

    def read(self, block, size):
        if block == MACHINE:  # read once a connection, which then breaks again
            return super().read(block, size)
        self.reads.append(time.monotonic())
        if self.cut:
            raise LinkError("cut")
        return super().read(block, size)


@pytest.fixture
def link():
    return BreakableLink()


@pytest.fixture
def exchange(link):
    found = PlcExchange(link, machine_values(ROBOT), period=PERIOD, writing=False)
    found.open()
    yield found
    found.close()


def test_an_emulated_plc_is_still_known_as_one_after_a_reconnect_that_did_not_see_its_truth(
    link, exchange
):
    assert exchange.emulated
    link.blind = link.cut = True
    until(lambda: not exchange._connected)
    link.cut = False
    until(lambda: exchange.counters.reconnects > 0 and exchange.error is None)
    assert exchange.emulated
    exchange.wants_truth = True  # which this connection does not have
    before = exchange.counters.cycles
    until(lambda: exchange.counters.cycles > before + 3)
    assert exchange.error is None


def test_cycles_that_fail_keep_their_period_while_a_call_waits(link, exchange):
    """A busy machine makes a gap short only after a longer one, as ticks stay where they are."""
    link.cut = True
    until(lambda: exchange.error is not None)
    calling = threading.Thread(target=exchange.read, args=(TO_HOST, 8))
    calling.start()
    until(lambda: exchange._calls)
    link.reads.clear()
    until(lambda: len(link.reads) > 8)
    reads = np.array(link.reads)
    link.cut = False
    calling.join()
    assert np.median(np.diff(reads)) > 0.5 * PERIOD
