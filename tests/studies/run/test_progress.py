from __future__ import annotations

import io

import numpy as np

from carosac_toolkit.studies.run import progress as module
from carosac_toolkit.studies.run.progress import Progress


class Terminal(io.StringIO):
    def isatty(self):
        return True


def rows(count, status="ok"):
    return [{"status": status}] * count


def test_it_tells_counts_and_time_left(monkeypatch):
    now = [100.0]
    monkeypatch.setattr(module.time, "monotonic", lambda: now[0])
    stream = io.StringIO()
    bar = Progress(30, rows(10), quiet=False, stream=stream)
    now[0] += 40.0
    bar.add([*rows(4), *rows(1, "timed_out")])
    now[0] += 3700.0
    bar.add(rows(15))
    bar.close()
    assert stream.getvalue().splitlines() == [
        "study: 10 of 30 cases are there already",
        "study: 15/30 cases, 0:00:40, 0:02:00 to go, 1 timed out",
        "study: 30/30 cases, 1:02:20, 1 timed out",
    ]


def shown_at(monkeypatch, *, cases, seconds):
    """Numbers of finished cases in the lines of a file, of 1000 that take some seconds each."""
    now = [0.0]
    monkeypatch.setattr(module.time, "monotonic", lambda: now[0])
    stream = io.StringIO()
    bar = Progress(1000, [], quiet=False, stream=stream)
    for _ in range(cases):
        now[0] += seconds
        bar.add(rows(1))
    bar.close()
    return [
        int(line.split("/")[0].removeprefix("study: ")) for line in stream.getvalue().splitlines()
    ]


def test_a_file_gets_a_line_ever_more_rarely(monkeypatch):
    assert shown_at(monkeypatch, cases=1000, seconds=1.0) == [1, 61, 181, 421, 901, 1000]


def test_a_file_is_never_silent_for_longer_than_ten_minutes(monkeypatch):
    shown = shown_at(monkeypatch, cases=999, seconds=60.0)
    assert max(np.diff(shown)) == 10


def test_few_long_cases_tell_how_much_of_them_is_done(monkeypatch):
    now, share = [0.0], [0.2]
    monkeypatch.setattr(module.time, "monotonic", lambda: now[0])
    stream = io.StringIO()
    bar = Progress(3, rows(0), quiet=False, stream=stream, share=lambda: share[0])
    now[0], share[0] = 60.0, 0.5
    bar.add([])
    now[0], share[0] = 160.0, 0.8  # some of the work failed
    bar.add(rows(3, "failed"))
    assert stream.getvalue().splitlines() == [
        "study: 0/3 cases, 0:01:00, 50 %, 0:01:40 to go",
        "study: 3/3 cases, 0:02:40, 80 %, 3 failed",
    ]


def test_a_terminal_gets_one_line_that_changes(monkeypatch):
    now = [0.0]
    monkeypatch.setattr(module.time, "monotonic", lambda: now[0])
    stream = Terminal()
    bar = Progress(2, [], quiet=False, stream=stream)
    for _ in range(2):
        now[0] += 1.0
        bar.add(rows(1))
    bar.close()
    assert stream.getvalue().count("\n") == 1
    assert stream.getvalue().count("\r") == 3


def test_quiet_says_nothing():
    stream = Terminal()
    bar = Progress(2, rows(1), quiet=True, stream=stream)
    bar.add(rows(1))
    bar.say("something")
    bar.close()
    assert stream.getvalue() == ""


def test_the_rest_is_estimated_with_the_first_case_however_soon_it_ends(monkeypatch):
    now = [0.0]
    monkeypatch.setattr(module.time, "monotonic", lambda: now[0])
    stream = io.StringIO()
    bar = Progress(300, rows(0), quiet=False, stream=stream)
    for _ in range(3):
        now[0] += 2.0
        bar.add(rows(1))
    assert stream.getvalue().splitlines() == ["study: 1/300 cases, 0:00:02, 0:09:58 to go"]
