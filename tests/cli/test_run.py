from __future__ import annotations

import json
import os
import pty
import signal
import subprocess
import sys
import threading
import time
import warnings

import numpy as np
import pytest

from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.cli.main import main
from carosac_toolkit.cli.run_builder import paced
from carosac_toolkit.cli.run_options import Options
from carosac_toolkit.live.hand_target import HandTarget
from carosac_toolkit.live.keyboard import Words, listening
from carosac_toolkit.live.library_noise import without_ads_lines
from carosac_toolkit.live.sequence import with_approach
from carosac_toolkit.recordings.crash_safe import CutRecording, read_run
from carosac_toolkit.trajectories import line
from tests.plc_process import own_address
from tests.robots import simple_robot
from tests.safety.guard.guards import ROBOT, connected

# a slow machine must not end a run: these are about what ends it
AWAY = ("--home", "0.4", "-1.8", "3.0", "--set")
PATIENT = ("driver.guard.overrun_share=1.0", "driver.guard.hang_time=1.5", "driver.cables=catenary")


QUICK = (PATIENT[0], "driver.guard.hang_time=0.8", PATIENT[2])  # where it is to hang


def words(tmp_path, *more, settings=PATIENT):
    chosen = [word for setting in settings for word in ("--set", setting)]
    files = ["--output", str(tmp_path / "run.jsonl"), "--json", str(tmp_path / "run.json")]
    return ["run", "--rate", "25", *files, *chosen, *more]


def numbers(tmp_path):
    return json.loads((tmp_path / "run.json").read_text())


def run_of(tmp_path):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", CutRecording)
        return read_run(tmp_path / "run.jsonl")


def names(run):
    return [name for _, name, _ in run.events]


def at_rest(run):
    """Whether the last commands are the same, and how long the robot was moved."""
    sent = run.recording.command.value
    return np.ptp(sent[-3:], axis=0).max() < 1e-9


def until(condition, why, process=None):
    for _ in range(1200):
        if condition():
            return
        if process is not None and process.poll() is not None:
            raise AssertionError(process.communicate()[0])
        time.sleep(0.05)
    raise AssertionError(f"not in time: {why}")


def moving(tmp_path, rows=5):
    """Whether a run has sent some commands on its way."""
    path = tmp_path / "run.jsonl"
    return path.exists() and path.read_text().partition('"following"')[2].count('"sent"') > rows


@pytest.fixture
def started(tmp_path):
    """Starts `carosac run` in a process and waits until it moves; ends what is left of it."""
    processes = []

    def start(*more, settings=PATIENT):
        chosen = words(tmp_path, *more, settings=settings)
        process = subprocess.Popen(
            [sys.executable, "-m", "carosac_toolkit.cli.main", *chosen],
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, stdin=subprocess.PIPE, text=True,
        )  # fmt: skip
        processes.append(process)
        if "--by-hand" in more:
            process.stdin.write("0.6 -1.7 2.3\n")
            process.stdin.flush()
        until(lambda: moving(tmp_path), "it moves", process)
        return process

    yield start
    for process in processes:
        if process.poll() is None:
            process.kill()
        process.communicate()


@pytest.fixture
def typed(monkeypatch):
    """Has the standard input say some lines; it stays open unless told otherwise."""
    ends = []

    def say(text, *, end=False):
        out, into = os.pipe()
        ends.append(into)
        os.write(into, text.encode())
        monkeypatch.setattr(sys, "stdin", os.fdopen(out))
        if end:
            os.close(ends.pop())

    yield say
    for one in ends:
        os.close(one)


def test_a_run_is_dry_unless_it_is_enabled(tmp_path, capsys):
    assert main(words(tmp_path, "--duration", "0.6")) == 0
    said = capsys.readouterr().out
    assert "dry run: nothing is sent; --enable moves" in said
    run = run_of(tmp_path)
    assert run.recording.command is None
    assert len(run.would_send.time) == 15
    assert np.ptp(run.recording.unstrained_length, axis=0).max() < 2e-3  # noise
    assert numbers(tmp_path)["limited_cycles"]["not_enabled"] == 15
    assert "enabled" not in names(run)


def test_an_enabled_run_goes_where_it_is_told_and_ends_at_rest(tmp_path, capsys):
    more = ("--enable", "--speed", "0.5", "--acceleration", "1.0", "--to", "0.6", "-1.8", "2.3")
    assert main(words(tmp_path, *more)) == 0
    found = numbers(tmp_path)
    assert found["completed"]
    assert found["fault"] is None
    assert found["tracking_rmse_m"] < 0.2
    assert found["position_m"] == pytest.approx([0.6, -1.8, 2.3], abs=0.03)
    said = capsys.readouterr().out
    assert "straight to 0.600 -1.800 2.300 m" in said
    x, y, z = (f"{value:.3f}" for value in found["position_m"])
    assert f"end of the trajectory\nplatform at {x} {y} {z} m\n" in said
    run = run_of(tmp_path)
    assert names(run)[-5:] == ["stop", "stopping", "at_rest", "homed", "disconnected"]
    assert at_rest(run)
    rows = [json.loads(row) for row in (tmp_path / "run.jsonl").read_text().splitlines()]
    sent = [row["unstrained_length"] for row in rows if row.get("row") == "sent"]
    rate = np.abs(np.diff(sent, axis=0) / 0.04).max()  # limits count by commands, one in 40 ms
    assert 0.2 < rate < 1.5 * 0.5 + 1e-6
    assert run.cut is None
    assert found["unrecorded_rows"] == 0


@pytest.mark.parametrize(
    "controller, fault, said, steered",
    [
        ("Raising", "controller", "ZeroDivisionError: a bug", "after the end of the input"),
        ("Exiting", "controller", "controller Exiting: called sys.exit(None)", "by an open input"),
        ("Cancelled", "controller", "CancelledError", "by an open input"),
        ("Interrupting", "controller", "KeyboardInterrupt", "by an open input"),
        ("Far", "command", "from where the winch stands", "by an open input"),
        ("Hanging", "controller", "the controller gave no command for", "by an open input"),
    ],
)
def test_a_controller_that_fails_or_hangs_ends_the_run_and_is_named(
    tmp_path, capsys, controller, fault, said, steered, typed
):
    """Also one that is steered by hand: nobody waits for the input, or for the target."""
    typed("0.6 -1.7 2.3\n", end=steered.startswith("after"))
    more = ("--enable", "--by-hand", "--controller", f"tests.live_controllers:{controller}")
    assert main(words(tmp_path, *more, settings=QUICK)) == 1
    found = numbers(tmp_path)
    assert not found["completed"]
    assert found["fault"] == fault
    assert said in found["reason"]
    run = run_of(tmp_path)
    assert at_rest(run)
    assert "at_rest" in names(run)


def test_a_controller_that_exits_before_anything_moves_is_no_success(tmp_path, capsys):
    more = ("--enable", "--controller", "tests.live_controllers:ExitingEarly")
    assert main(words(tmp_path, *more)) == 2
    assert "controller ExitingEarly: called sys.exit(None)" in capsys.readouterr().err


def test_a_controller_that_cannot_be_interrupted_takes_no_process_along(tmp_path, started):
    more = ("--enable", "--by-hand", "--controller", "tests.live_controllers:Stubborn")
    process = started(*more, settings=QUICK)
    said = process.communicate(timeout=60)[0]
    assert process.returncode == 1
    assert "the controller cannot be interrupted; the process ends" in said
    run = run_of(tmp_path)
    assert at_rest(run)
    assert run.cut is None


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGQUIT])
def test_signals_stop_it_in_good_order(tmp_path, typed, number):
    typed("0.6 -1.7 2.3\n")
    late = []
    before = signal.signal(number, lambda *_: late.append(number))  # tests must not end of it

    def send():
        until(lambda: moving(tmp_path), "it moves")
        os.kill(os.getpid(), number)

    sender = threading.Thread(target=send)
    sender.start()
    try:
        status = main(words(tmp_path, "--enable", "--by-hand"))
    finally:
        sender.join()
        signal.signal(number, before)
    assert not late
    assert status == 128 + number
    run = run_of(tmp_path)
    assert at_rest(run)
    assert names(run)[-4:] == ["stopping", "at_rest", "homed", "disconnected"]
    assert numbers(tmp_path)["reason"] == number.name


def test_a_terminal_that_is_closed_stops_it_in_good_order(tmp_path, started):
    """SIGHUP comes, and nobody reads any more what is printed."""
    process = started("--enable", "--by-hand")
    process.stdout.close()
    process.stdout = None
    process.send_signal(signal.SIGHUP)
    process.communicate(timeout=60)
    assert process.returncode == 128 + signal.SIGHUP
    run = run_of(tmp_path)
    assert at_rest(run)
    assert names(run)[-4:] == ["stopping", "at_rest", "homed", "disconnected"]
    assert numbers(tmp_path)["reason"] == "SIGHUP"


def test_after_kill_9_the_recording_is_whole(tmp_path, started):
    process = started("--enable", "--by-hand")
    process.kill()
    process.communicate()
    assert process.returncode == -signal.SIGKILL
    run = run_of(tmp_path)
    assert "following" in names(run)
    assert len(run.recording.command.time) > 5
    assert np.diff(run.recording.time).max() < 1.0


def test_a_target_is_moved_by_lines_of_the_input(tmp_path, capsys, typed):
    typed("nonsense\n0.5 -1.75 2.25\n99 0 0\n", end=True)
    more = ("--enable", "--by-hand", "--speed", "0.5", "--acceleration", "1.0")
    assert main(words(tmp_path, *more)) == 0
    said = capsys.readouterr().err
    assert "input: got 'nonsense'; allowed: arrows" in said
    assert "target 0.500 -1.750 2.250 m" in said
    assert "target: got 99 0 0 m; allowed: [" in said
    assert numbers(tmp_path)["reason"] == "the input has ended"
    assert run_of(tmp_path).believed.value[-1] == pytest.approx([0.5, -1.75, 2.25], abs=0.03)


def test_nothing_is_left_of_a_run_that_could_not_connect(tmp_path, capfd, monkeypatch):
    """And the user reads one message, not what the ADS library says on its own."""
    monkeypatch.chdir(tmp_path)
    ip = own_address()
    more = ["--driver", "ads", "--set", f"driver.inner.ip={ip}", "--duration", "1"]
    assert main(["run", *more]) == 2
    said = capfd.readouterr().err
    assert said.count("\n") == 1
    assert f"PLC {ip}.1.1 at {ip}: cannot connect" in said
    assert list(tmp_path.iterdir()) == []


def test_lines_of_the_ads_library_are_dropped_and_no_others(capfd):
    with without_ads_lines():
        os.write(2, b"2026-11-22T04:07:59+0000 Error: write frame failed with error: Broken pipe\n")
        os.write(2, b"kernel: something\n2026-11-22T04:07:59+0000 Info: conn")
        os.write(2, b"ection closed by remote\nlast")
    os.write(2, b" words\n")
    assert capfd.readouterr().err == "kernel: something\nlast words\n"


def test_bad_input_is_refused_before_anything_moves(tmp_path, capsys):
    for more, said in (
        (("--driver", "replay"), "a driver that moves"),
        (("--controller", "mcp"), "mcp"),
        (("--set", "driver.guard.hang_tim=1"), "hang_tim"),
        (("--set", "driver.cable=1"), "inner.cable"),
        (("--set", "driver.motion=true"), "allowed: --enable"),
        (("--set", "driver.guard.motion=true"), "allowed: --enable"),
        (("--set", "driver.guard.period=0.5"), "allowed: --rate"),
        (("--set", "driver.real_time=false"), "a live run takes the time of the wall"),
        (("--set", "driver.home_anew=true"), "--home-anew"),
        (("--set", "driver.home_change_max=5"), "--home-anew, for a pose that was measured"),
        (("--set", "driver.home_confirmed=true"), "allowed: --home-confirmed"),
        (("--set", "driver.reset_at_once=true"), "allowed: --reset"),
        (("--set", "driver.first_way=1e-3"), "a new home starts slowly and watched"),
        (("--set", "driver.first_speed=1"), "a new home starts slowly and watched"),
        (("--driver", "ads", *AWAY, "driver.first_shift_max=9"), "a new home starts slowly"),
        (("--set", "driver.guard.start_position=[0,0,2]"), "allowed: --home X Y Z"),
        (("--driver", "ads", *AWAY, "driver.motion=true"), "allowed: --enable"),
        (("--driver", "ads", *AWAY, "driver.inner.motion=true"), "allowed: --enable"),
        (("--driver", "ads", *AWAY, "driver.inner.period=1"), "allowed: --rate"),
        (("--driver", "ads", "--enable"), "--home: got none; allowed: --home X Y Z"),
        (("--rate", "0"), "--rate: got 0.0 Hz"),
        (("--speed", "-1"), "--speed"),
        (("--duration", "-3"), "--duration: got -3.0; allowed: > 0, finite"),
        (("--to", "9", "9", "9"), "--to: got 9 9 9 m; allowed: (-1.6, -3.8, 1) to"),
        (("--to", "0.4", "-1.8", "2.2"), "another place than where the platform stands"),
        (("--to", "0", "0", "2", "--by-hand"), "--to: got also --by-hand or --trajectory"),
    ):
        assert main([*words(tmp_path), *more]) == 2
        out, err = capsys.readouterr()
        assert said in err
        assert "\nrecording: " not in out + err
    assert not (tmp_path / "run.json").exists()


def test_the_robot_is_homed_where_it_is_said_to_be_and_the_changes_are_told(tmp_path, capsys):
    more = ("--enable", "--duration", "0.3", "--set", "driver.start_position=[0.4, -1.8, 2.6]")
    assert main(words(tmp_path, *more, "--home", "0.4", "-1.8", "2.6")) == 0
    assert "homed: the offsets of the cables changed by" in capsys.readouterr().out
    assert np.abs(numbers(tmp_path)["home_change_m"]).max() < 0.03
    (tmp_path / "run.jsonl").unlink()
    assert main(words(tmp_path, *more, "--home", "0.4", "-1.8", "3.0")) == 2
    said = capsys.readouterr()
    assert "would change by" in said.err
    assert "--home-anew" in said.err
    assert main(words(tmp_path, *more, "--home", "0.4", "x", "3.0")) == 2
    assert "allowed: three numbers: X Y Z" in capsys.readouterr().err


def test_the_way_to_the_start_is_gone_first_with_rests():
    path = line([1.0, 0.0, 2.0], [1.0, 0.5, 2.0], speed_max=0.5, acceleration_max=0.5)
    course = with_approach(path, np.array([0.0, 0.0, 2.0]), rest=1.0, speed_max=0.5,
                           acceleration_max=0.5)  # fmt: skip
    times = np.linspace(0.0, course.duration, 500)
    samples = np.array([course.window(t, 0.0, 0.02).position[0, 0] for t in times])
    assert samples[0] == pytest.approx([0.0, 0.0, 2.0])
    assert samples[-1] == pytest.approx([1.0, 0.5, 2.0])
    assert np.abs(np.diff(samples, axis=0)).max() < 0.5 * (times[1] - times[0]) * 1.001
    ahead = course.window(2.0, 1.0, 0.1)
    each = [course.window(2.0 + 0.1 * k, 0.0, 0.1) for k in range(11)]
    for name in ("position", "velocity", "acceleration"):
        wanted = np.concatenate([getattr(one, name) for one in each], axis=1)
        assert getattr(ahead, name) == pytest.approx(wanted)


@pytest.mark.parametrize("new_home, motion", [(True, True), (False, True), (True, False)])
def test_the_path_is_slow_where_the_guard_watches_a_new_home(new_home, motion):
    """Whatever the options say; a dry run never gets far enough to end it."""
    guard = connected(at_once=False, motion=motion)
    guard.monitor.checks.first_way = new_home
    end = ROBOT.home_position + np.array([0.5, 0.0, 0.0])
    path = line(ROBOT.home_position, end, speed_max=0.5, acceleration_max=1.0)
    followed = paced(path, Options(speed=0.5, acceleration=1.0), guard)
    velocity = np.array([followed.window(0.02 * k, 0.0, 0.02).velocity[0, 0] for k in range(75)])
    if new_home and motion:
        assert np.linalg.norm(velocity, axis=1).max() == pytest.approx(0.05, rel=0.06)
    else:
        assert velocity == pytest.approx(path.sample(0.02 * np.arange(75)).velocity, abs=1e-9)
    guard.close()


def test_a_target_moved_by_hand_is_approached_smoothly_and_stays_in_the_box():
    robot = simple_robot()
    start = np.array(robot.home_position)
    hand = HandTarget(robot, start, speed_max=0.4, acceleration_max=0.5)
    hand.obey("\x1b[C")
    assert hand.target == pytest.approx(start + np.array([0.05, 0.0, 0.0]))
    kept = hand.target
    for word, said in (
        ("99 -1.8 2.2", r"target: got 99 -1.8 2.2 m; allowed: .*, the workspace box; it stays at "),
        ("0.4 -1.8 -5", r"the workspace box; it stays at 0\.450 -1\.800 2\.200 m"),
        ("1 2", "input: got '1 2'; allowed: arrows"),
        ("nan 0 0", "allowed: arrows"),
    ):
        with pytest.raises(InvalidField, match=said):
            hand.obey(word)
        assert (hand.target == kept).all()
    hand.obey(" ".join(str(x) for x in (robot.workspace_max[0], -1.8, 2.2)))
    seen = [hand.window(0.02 * k, 0.2, 0.02) for k in range(1, 600)]
    speed = np.linalg.norm([one.velocity[0, 0] for one in seen], axis=1)
    acceleration = np.linalg.norm([one.acceleration[0, 0] for one in seen], axis=1)
    assert speed.max() < 0.401
    assert acceleration.max() < 0.501
    assert hand.arrived
    assert seen[-1].position[0, 0] == pytest.approx(hand.target, abs=1e-3)
    assert max(one.position[0, :, 0].max() for one in seen) < hand.target[0] + 1e-3
    assert seen[10].position[0, 1] == pytest.approx(seen[11].position[0, 0])  # the window holds
    hand.obey("q")
    assert hand.over


def test_without_a_standard_input_nobody_steers(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(sys, "stdin", None)
    assert main(words(tmp_path, "--by-hand")) == 2
    assert "--by-hand: got none; allowed: a standard input" in capsys.readouterr().err


def test_a_target_outside_the_box_may_only_come_back():
    robot = simple_robot()
    start = robot.workspace_max + np.array([0.1, 0.0, 0.0])
    hand = HandTarget(robot, start, speed_max=0.4, acceleration_max=0.5)
    with pytest.raises(InvalidField, match="it stays at"):
        hand.obey("\x1b[C")
    hand.obey("\x1b[D")
    assert hand.target == pytest.approx(start - np.array([0.05, 0.0, 0.0]))


def test_keys_and_lines_come_in_pieces_of_any_size():
    typed = "u\x1b[A\x1b[A\x1bOC0.6 -1.7,2.37\x7f\r\n1.5d\x1b[5~q\x1b\x1b[B"
    wanted = ["u", "\x1b[A", "\x1b[A", "\x1b[C", "0.6 -1.7,2.3", "d", "\x1b[5~", "q", "\x1b[B"]
    for size in (1, 2, 3, 5, 100):
        words = Words(keys=True)
        pieces = [typed[k : k + size] for k in range(0, len(typed), size)]
        assert [word for piece in pieces for word in words.feed(piece)] == wanted
    words = Words(keys=False)
    assert words.feed("1 2 3\nq") == ["1 2 3"]
    assert words.feed("uit") == []
    assert words.rest() == ["quit"]  # a last line without its end
    assert words.rest() == []


def test_keys_of_a_terminal_are_heard_and_the_end_of_the_input_is_seen():
    leader, follower = pty.openpty()
    heard, ended = [], threading.Event()
    with os.fdopen(follower) as terminal, pytest.MonkeyPatch.context() as patched:
        patched.setattr(sys, "stdin", terminal)
        with listening(heard.append, ended.set):
            os.write(leader, b"\x1b[A\x1b[A0.5 1 2\n")
            for _ in range(500):
                if len(heard) == 3:
                    break
                time.sleep(0.01)
            os.close(leader)
            assert ended.wait(10.0)
    assert heard == ["\x1b[A", "\x1b[A", "0.5 1 2"]


def test_no_thread_is_left_behind(tmp_path):
    handler = signal.getsignal(signal.SIGINT)
    before = set(threading.enumerate())
    assert main(words(tmp_path, "--duration", "0.2", "--enable")) == 0
    assert set(threading.enumerate()) <= before
    assert signal.getsignal(signal.SIGINT) is handler
    assert os.path.exists(tmp_path / "run.jsonl")
