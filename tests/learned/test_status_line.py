"""The line that says what a training does now."""

from __future__ import annotations

import io

import pytest

from carosac_toolkit.base.terminal import CLEAR_LINE
from learned.commands import status_line
from learned.commands.status_line import StatusLine


class Clock:
    """Seconds that pass as a test says."""

    now = 100.0

    def monotonic(self):
        return self.now


class Terminal(io.StringIO):
    def isatty(self):
        return True


@pytest.fixture
def clock(monkeypatch):
    clock = Clock()
    monkeypatch.setattr(status_line, "time", clock)
    return clock


def test_a_terminal_has_one_line_that_makes_room_for_others(clock):
    stream = Terminal()
    line = StatusLine(stream)
    for seconds, text in ((0.0, "making the worlds"), (0.1, "hidden"), (0.7, "step 8 of 80")):
        clock.now = 100.0 + seconds
        line.tell(text)
    line.clear()
    line.clear()
    assert stream.getvalue() == (
        f"{CLEAR_LINE}making the worlds, 0 s{CLEAR_LINE}step 8 of 80, 1 s{CLEAR_LINE}"
    )


def test_a_log_has_few_lines_the_first_of_them_within_five_seconds(clock):
    stream = io.StringIO()
    line = StatusLine(stream)
    for k in range(1000):
        clock.now = 100.0 + 0.1 * k
        line.tell(f"step {k} of 1000")
        line.clear()
    lines = stream.getvalue().splitlines()
    assert lines[0] == "step 30 of 1000, 3 s"
    assert len(lines) == 5
