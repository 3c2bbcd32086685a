"""The judge of the fault benchmark sees what it must see, on motions that are known exactly."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from benchmarks import fault_judge, fault_wire
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.plc import blocks

CYCLE_S = 0.005
MACHINE = fault_judge.Machine(np.ones(4), np.full(4, 1.0), np.full(4, 5.0))
START = np.array([0.8, -0.5, 0.3, 0.0])  # [m/s]
DECELERATION = 4.0  # [m/s^2] of the fastest winch


def stopping(factor: Array, extra: Array | float = 0.0) -> fault_judge.SetPoints:
    """Half a second of constant speed, then the speeds at a factor, plus something."""
    factor = np.concatenate([np.ones(100), factor, np.zeros(40)])
    speed = factor[:, None] * START
    speed[100 : 100 + len(np.atleast_1d(extra)), 1] += extra
    length = np.concatenate([np.zeros((1, 4)), np.cumsum(speed * CYCLE_S, axis=0)])
    time = CYCLE_S * np.arange(len(length))
    return fault_judge.SetPoints(time, time, length, np.zeros_like(length, dtype=bool))


def ramp() -> Array:
    """The common ramp at the deceleration of the fastest winch."""
    return np.maximum(0.0, 1.0 - np.arange(1, 60) * CYCLE_S * DECELERATION / START.max())


def test_a_common_ramp_neither_turns_back_nor_spreads():
    stop = fault_judge.judge_stop(stopping(ramp()), 0.49, MACHINE)
    assert stop.reversal == pytest.approx(0.0, abs=1e-9)
    assert stop.spread == pytest.approx(0.0, abs=1e-9)
    assert stop.speed == pytest.approx(0.8, rel=0.03)  # the first interval of the ramp
    assert stop.duration == pytest.approx(0.8 / DECELERATION, abs=2.0 * CYCLE_S)


def test_a_stop_after_a_late_host_begins_where_the_winches_brake_for_good():
    factor = np.concatenate([ramp()[:10], ramp()[10::-1], np.ones(30)])
    points = stopping(np.concatenate([factor, ramp()]))
    turned = points.length.copy()
    turned[:100, 2] += 0.05 * np.arange(100)[::-1] * CYCLE_S  # the path bends meanwhile
    points = fault_judge.SetPoints(points.at, points.time, turned, points.tripped)
    stop = fault_judge.judge_stop(points, 0.3, MACHINE)
    assert stop.spread == pytest.approx(0.0, abs=1e-9)
    assert stop.rest_at - stop.duration == pytest.approx(CYCLE_S * (100 + len(factor)), abs=0.02)


def test_a_stop_from_creeping_takes_a_cycle():
    points = stopping(np.ones(1))
    slow = fault_judge.SetPoints(points.at, points.time, 0.02 * points.length, points.tripped)
    stop = fault_judge.judge_stop(slow, 0.49, MACHINE)
    assert stop.rest_at == pytest.approx(0.505, abs=1e-9)
    assert stop.reversal == stop.spread == pytest.approx(0.0, abs=1e-9)


def test_a_winch_that_drives_back_is_seen_with_its_speed():
    drive_back = np.concatenate([np.zeros(45), np.full(10, 0.2)])  # against -0.5 m/s, once at rest
    stop = fault_judge.judge_stop(stopping(ramp(), drive_back), 0.49, MACHINE)
    assert stop.reversal == pytest.approx(0.2, abs=1e-9)


def test_a_winch_that_stops_alone_leaves_the_common_ramp():
    early = -(1.0 - np.zeros(30)) * START[1] * ramp()[:30]  # at rest at once
    assert fault_judge.judge_stop(stopping(ramp(), early), 0.49, MACHINE).spread > 0.3


def test_set_points_beyond_a_limit_are_named():
    assert fault_judge.judge_limits(stopping(ramp()), MACHINE) == []
    weak = fault_judge.Machine(np.ones(4), np.full(4, 0.7), np.full(4, 3.0))
    messages = fault_judge.judge_limits(stopping(ramp()), weak)
    assert [m.split()[0] for m in messages] == ["speed", "acceleration"]
    assert "1.33" in messages[1]  # 4 m/s^2 of 3
    points = stopping(ramp())
    points.tripped[100:, 0] = True
    (message,) = fault_judge.judge_limits(points, weak)  # of its brake nothing is asked
    assert message.split()[0] == "speed"


def test_commands_without_a_row_are_counted_whatever_the_offset(tmp_path: Path):
    lengths = np.cumsum(np.random.default_rng(0).normal(0.0, 0.01, (50, 4)), axis=0)
    rows = [{"row": "sent", "unstrained_length": list(x + 7.0)} for x in lengths[:-2]]
    file = tmp_path / "run.jsonl"
    file.write_text("\n".join(json.dumps(row) for row in rows) + '\n{"row": "se')
    assert fault_judge.unrecorded(lengths, file) == 2


def test_the_documentation_declares_the_structures_that_are_sent():
    for name, block in (("ST_FromHost", blocks.from_host(4)), ("ST_ToHost", blocks.to_host(4))):
        assert fault_wire.layout(name) == block.dtype
