"""Signals that wait for the end of a step."""

import signal
import threading

import pytest

from carosac_toolkit.base.delayed_signals import delayed_signals


@pytest.fixture(autouse=True)
def usual():
    """Python's own handler, also where a shell had the tests ignore Ctrl-C."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def test_a_first_one_waits_and_a_second_one_does_not():
    steps = []
    with pytest.raises(KeyboardInterrupt), delayed_signals() as came:
        assert not came()
        signal.raise_signal(signal.SIGINT)
        assert came()
        steps.append("finished")
    assert steps == ["finished"]
    with pytest.raises(KeyboardInterrupt), delayed_signals():
        signal.raise_signal(signal.SIGINT)
        signal.raise_signal(signal.SIGINT)
        pytest.fail("went on")
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_what_others_handle_or_ignore_stays_as_it_is():
    heard = []
    before = signal.signal(signal.SIGTERM, lambda number, _: heard.append(number))
    try:
        with delayed_signals() as came:
            signal.raise_signal(signal.SIGTERM)
            assert heard == [signal.SIGTERM]
            assert not came()
    finally:
        signal.signal(signal.SIGTERM, before)


def test_outside_the_main_thread_nothing_changes():
    def inside():
        with delayed_signals() as came:
            found.append((came(), signal.getsignal(signal.SIGINT)))

    found = []
    thread = threading.Thread(target=inside)
    thread.start()
    thread.join()
    assert found == [(False, signal.default_int_handler)]


def test_where_a_signal_ends_nothing_the_process_ends_all_the_same(monkeypatch, capfd):
    """As in the first process of a container."""
    with pytest.raises(SystemExit) as ended, delayed_signals("wait a second") as came:
        signal.raise_signal(signal.SIGINT)
        monkeypatch.setattr(signal, "raise_signal", lambda number: None)
        assert came()
    assert ended.value.code == 130
    assert "wait a second" in capfd.readouterr().err
