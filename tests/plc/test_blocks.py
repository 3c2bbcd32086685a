from pathlib import Path

import numpy as np
import pytest

from carosac_toolkit.loop.drive_state import DriveState, Fault, fault_of, state_of
from carosac_toolkit.plc import blocks

PAGE = Path(__file__).resolve().parents[2] / "docs" / "plc.md"


@pytest.mark.parametrize("n", [1, 3, 4, 8])
def test_layout_is_the_same_under_every_packing(n):
    every = [blocks.from_host(n), blocks.to_host(n), blocks.machine(n), blocks.control(),
             blocks.diagnosis(n), blocks.truth(n)]  # fmt: skip
    for block in every:
        aligned = np.dtype([(f.name, block.dtype[f.name]) for f in block.fields], align=True)
        assert aligned.itemsize == block.size
        assert all(aligned.fields[f.name][1] == block.dtype.fields[f.name][1] for f in block.fields)
        assert block.size % 8 == 0


def test_values_come_back_as_they_were_packed():
    block = blocks.to_host(3)
    values = {"layout": 1, "cables": 3, "time": 1.5, "length": [1.0, -2.0, 1e-9],
              "drive_status": [0, 1, 3]}  # fmt: skip
    found = block.unpack(block.pack(values))
    assert found["time"] == 1.5 and found["length"].tolist() == [1.0, -2.0, 1e-9]
    assert found["drive_status"].tolist() == [0, 1, 3]
    with pytest.raises(blocks.WrongBlock, match="got 3 bytes"):
        block.unpack(b"abc")


def test_another_layout_is_refused_by_name():
    block = blocks.to_host(4)
    values = block.unpack(block.pack({"layout": 1, "cables": 4}))
    with pytest.raises(blocks.WrongBlock, match=r"ST_ToHost.layout: got 1; allowed: 3"):
        blocks.whole(block, values, 4)


def test_the_docs_list_the_structures_and_numbers_as_they_are():
    text = PAGE.read_text(encoding="utf-8")
    for block in (blocks.from_host(4), blocks.to_host(4), blocks.machine(4)):
        assert block.structured_text() in text
    for fault in Fault:
        if f"| {fault} |" in text:
            assert f"| {fault.number} | {fault} | {fault.meaning} |" in text
    for state in ("connected", "enabled", "following", "stopping", "fault", "estop"):
        assert f"| {DriveState(state).number} | {state} |" in text


def test_numbers_of_states_and_faults_come_back():
    assert all(state_of(s.number) is s for s in DriveState)
    assert all(fault_of(f.number) is f for f in Fault)
    assert state_of(99) is DriveState.FAULT and fault_of(99) is Fault.UNKNOWN
    assert all(f.meaning and f.remedy for f in Fault)
