"""Whatever comes over a wire, the receiver takes it or refuses it, and goes on."""

import zlib

import numpy as np
import pytest

from carosac_toolkit.base.errors import CarosacError
from tests.fuzz.messages import EmulatedWires
from tests.fuzz.mutators import mutated

COUNT = 100  # of each kind; `python -m benchmarks.fuzz` takes thousands


@pytest.fixture(scope="module")
def emulated():
    wires = EmulatedWires()
    yield wires
    wires.close()


@pytest.mark.parametrize("index", range(5))
def test_a_damaged_message_is_taken_or_refused(emulated, index):
    wire = emulated.wires()[index]
    for k in range(COUNT):
        rng = np.random.default_rng([zlib.crc32(wire.name.encode()), k])
        data = mutated(wire.seeds[k % len(wire.seeds)], rng, wire.mutators)
        try:
            wire.take(data)
        except CarosacError as error:
            assert str(error)
    assert emulated.emulator.machine.state is not None
