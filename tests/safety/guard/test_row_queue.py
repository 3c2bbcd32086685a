"""The queue of the journal: in order, never waiting, bounded, and it counts what it lost."""

import threading

from carosac_toolkit.safety.guard.row_queue import RowQueue


def queue(**changes):
    return RowQueue(**{"lag": 60.0, "threaded": True, "describe": str, **changes})


def test_rows_are_written_in_order_and_all_of_them():
    found = []
    writer = queue()
    for k in range(2000):
        writer.put(found.append, k)
    assert writer.end() == 0
    assert found == list(range(2000))
    assert writer.trouble is None


def test_without_a_clock_a_row_is_written_at_once():
    found = []
    writer = queue(threaded=False)
    writer.put(found.append, 1)
    assert found == [1]
    writer.put(lambda: 1 / 0)
    writer.put(found.append, 2)
    assert writer.trouble == "division by zero"
    assert writer.end() == 2
    assert found == [1]


def test_a_full_queue_is_trouble_and_counted():
    free, began = threading.Event(), threading.Event()
    found = []

    def block():
        began.set()
        free.wait()

    writer = queue(rows_max=10)
    writer.put(block)
    assert began.wait(10.0)
    for k in range(15):
        writer.put(found.append, k)
    assert writer.trouble == "5 rows found no room"
    free.set()
    assert writer.end() == 5
    assert found == list(range(10))


def test_the_end_does_not_wait_for_a_disk_that_hangs():
    free = threading.Event()
    writer = queue()
    writer.put(free.wait)
    writer.put(free.wait)
    assert writer.end(0.05) == 2
    writer.put(free.wait)
    assert writer.end(60.0) == 3  # and does not wait again
    free.set()


def test_a_journal_that_fails_is_asked_no_more():
    writer = queue()
    asked = []

    def fail():
        asked.append(1)
        raise OSError(28, "No space left on device")

    for _ in range(50):
        writer.put(fail)
    assert writer.end() == 50
    assert "No space left" in writer.trouble
    assert asked == [1]
