from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
import warnings

import numpy as np
import pytest

from carosac_toolkit.base.errors import InvalidField, InvalidFile
from carosac_toolkit.drivers.replay import ReplayDriver, ReplaySettings
from carosac_toolkit.loop.values import (
    Belief,
    Command,
    Imu,
    LimitHit,
    Measurement,
    Pose,
    Stamped,
)
from carosac_toolkit.recordings.crash_safe import CrashSafeRecorder, CutRecording, read_run
from carosac_toolkit.recordings.files import load_recording, save_recording
from tests.robots import simple_robot

WRITER = """
import sys, time
import numpy as np
from carosac_toolkit.recordings.crash_safe import CrashSafeRecorder
from carosac_toolkit.loop.values import Measurement
recorder = CrashSafeRecorder(sys.argv[1])
k = 0
while True:
    lengths = np.full((1, 4), 5.0)
    recorder.measured(Measurement(time=np.array([0.01 * k]), unstrained_length=lengths))
    k += 1
    if k % 50 == 0:
        print(k, flush=True)
"""


def measurement(k, **channels):
    rng = np.random.default_rng(k)
    return Measurement(
        time=np.array([0.01 * k]), unstrained_length=8.0 + rng.random((1, 4)), **channels
    )


def full(k):
    rng = np.random.default_rng(100 + k)
    turn = np.array([[[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]])
    when = np.array([0.01 * k - 0.004])
    return measurement(
        k,
        length_rate=Stamped(time=when, value=rng.random((1, 4))),
        tension=Stamped(time=when, value=50.0 + rng.random((1, 4))),
        swivel_angle=Stamped(time=when, value=rng.random((1, 4))),
        attitude=Stamped(time=when, value=np.array([[0.6, 0.0, 0.8 * (-1) ** k, 0.0]])),
        inclination=Stamped(time=when + 1e-3, value=rng.random((1, 2))),
        pose=Pose(position=rng.random((1, 3)), rotation=turn, time=when),
        imu=Imu(
            time=np.array([[0.01 * k - 0.005, 0.01 * k]]),
            angular_rate=rng.random((1, 2, 3)), specific_force=rng.random((1, 2, 3)),
        ),
    )  # fmt: skip


def recorded(path, count=5, make=measurement):
    recorder = CrashSafeRecorder(path, robot="carosac", description="a test")
    for k in range(count):
        recorder.measured(make(k))
    recorder.close()
    return path


def test_every_channel_reads_back_bit_by_bit(tmp_path):
    path = recorded(tmp_path / "run.jsonl", make=full)
    recording = load_recording(path)
    wanted = [full(k) for k in range(5)]
    assert np.array_equal(recording.time, [w.length_rate.time[0] for w in wanted])
    for name, values in (
        ("unstrained_length", [w.unstrained_length[0] for w in wanted]),
        ("length_rate", [w.length_rate.value[0] for w in wanted]),
        *(
            (name, [getattr(w, name).value[0] for w in wanted])
            for name in ("tension", "swivel_angle", "attitude", "inclination")
        ),
    ):
        result = getattr(recording, name)
        assert np.array_equal(getattr(result, "value", result), values)
    assert np.array_equal(recording.poses.position, [w.pose.position[0] for w in wanted])
    assert recording.poses.rotation == pytest.approx(np.stack([w.pose.rotation[0] for w in wanted]))
    assert np.array_equal(recording.imu.time, np.concatenate([w.imu.time[0] for w in wanted]))
    assert np.array_equal(
        recording.imu.specific_force, np.concatenate([w.imu.specific_force[0] for w in wanted])
    )
    assert np.array_equal(recording.inclination.time, [w.inclination.time[0] for w in wanted])
    assert recording.metadata.robot == "carosac"


def test_it_becomes_any_other_recording_and_can_be_replayed(tmp_path):
    recording = load_recording(recorded(tmp_path / "run.jsonl", make=full))
    save_recording(recording, tmp_path / "run.parquet")
    again = load_recording(tmp_path / "run.parquet")
    assert np.array_equal(again.unstrained_length, recording.unstrained_length)
    assert np.array_equal(again.poses.quaternion, recording.poses.quaternion)
    settings = ReplaySettings(recording=str(tmp_path / "run.jsonl"))
    driver = ReplayDriver.build(simple_robot(), settings)
    driver.connect()
    assert driver.measure().unstrained_length == pytest.approx(full(0).unstrained_length)


def test_commands_beliefs_and_events_are_kept(tmp_path):
    recorder = CrashSafeRecorder(tmp_path / "run.jsonl")
    recorder.measured(measurement(0))
    asked = Command(time=np.zeros(1), unstrained_length=np.full((1, 4), 5.0))
    hit = LimitHit(limit="speed", cable=2, asked=3.0, sent=2.5)
    sent = Command(time=np.zeros(1), unstrained_length=np.full((1, 4), 4.5), limited=(hit,))
    recorder.sent(asked, sent, really=True)
    recorder.sent(asked, sent, really=False)
    recorder.sent(
        None, Command(time=np.ones(1), unstrained_length=np.full((1, 4), 4.0)), really=True
    )
    recorder.believed(
        Belief(time=np.zeros(1), position=np.array([[1.0, 2.0, 3.0]]), rotation=np.eye(3)[None])
    )
    recorder.event(0.5, "fault", "closure")
    recorder.close()
    run = read_run(tmp_path / "run.jsonl")
    assert run.recording.command.value.tolist() == [[4.5] * 4, [4.0] * 4]
    assert run.would_send.value.tolist() == [[4.5] * 4]
    assert run.asked.value.tolist() == [[5.0] * 4]
    assert run.believed.value.tolist() == [[1.0, 2.0, 3.0]]
    assert run.events == ((0.5, "fault", "closure"),)
    assert run.limited == ((0.0, "speed", 2, 3.0, 2.5),) * 2
    assert run.cut is None


def test_what_was_measured_before_homing_has_other_offsets_and_is_left_out(tmp_path):
    recorder = CrashSafeRecorder(tmp_path / "run.jsonl")
    for k in range(6):
        if k == 4:
            recorder.event(0.04, "home", "readings changed")
        recorder.measured(measurement(k))
    recorder.close()
    assert load_recording(tmp_path / "run.jsonl").time.tolist() == [0.04, 0.05]


@pytest.mark.parametrize("cut", [1, 20, 60])
def test_a_row_that_was_cut_is_dropped_and_the_reader_says_so(tmp_path, cut):
    path = recorded(tmp_path / "run.jsonl")
    path.write_bytes(path.read_bytes()[:-cut])
    with pytest.warns(CutRecording, match="row 6 was truncated and is dropped"):
        recording = load_recording(path)
    assert len(recording.time) == 4
    assert read_run(path).cut == 6


def test_a_broken_row_in_between_is_a_fault_of_the_file(tmp_path):
    path = recorded(tmp_path / "run.jsonl")
    lines = path.read_text().splitlines()
    path.write_text("\n".join([*lines[:3], lines[3][:40], *lines[4:]]) + "\n")
    with pytest.raises(InvalidFile, match="line 4: not a JSON row"):
        load_recording(path)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('"time":0.02', '"time":1' + "0" * 399),
        ('"time":0.02', '"time":' + "1" * 5000),
        ('"time":0.02', '"time":' + "[" * 5000),
        ('"row":"measured"', '"row":["measured"]'),
        ('"row":"measured"', '"kind":1'),
        ('"metadata":{', '"metadata":[1],"more":{'),
    ],
)
def test_rows_of_another_form_are_a_fault_of_the_file(tmp_path, old, new):
    path = recorded(tmp_path / "run.jsonl")
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    with pytest.raises(InvalidFile, match=r"not a JSON row|do not belong to a run"):
        load_recording(path)


def test_another_file_is_no_run(tmp_path):
    (tmp_path / "other.jsonl").write_text('{"a": 1}\n')
    with pytest.raises(InvalidFile, match="line 1: not a recorded run"):
        load_recording(tmp_path / "other.jsonl")
    (tmp_path / "empty.jsonl").write_text('{"schema": "carosac-run/1", "metadata": {}}\n')
    with pytest.raises(InvalidFile, match="no measurement"):
        load_recording(tmp_path / "empty.jsonl")


def test_nothing_is_written_over(tmp_path):
    path = recorded(tmp_path / "run.jsonl")
    with pytest.raises(InvalidField, match="a new file in an existing folder: File exists"):
        CrashSafeRecorder(path)
    with pytest.raises(InvalidField, match=r"a file name ending in \.jsonl"):
        CrashSafeRecorder(tmp_path / "run.csv")


def test_after_close_nothing_is_written_and_closing_twice_is_safe(tmp_path):
    recorder = CrashSafeRecorder(tmp_path / "run.jsonl")
    recorder.measured(measurement(0))
    recorder.close()
    size = os.path.getsize(recorder.path)
    recorder.measured(measurement(1))
    recorder.close()
    assert os.path.getsize(recorder.path) == size


def test_a_process_that_is_killed_loses_no_row(tmp_path):
    path = tmp_path / "run.jsonl"
    with subprocess.Popen(
        [sys.executable, "-c", WRITER, str(path)], stdout=subprocess.PIPE, text=True
    ) as process:
        told = int(process.stdout.readline())
        time.sleep(0.2)
        process.send_signal(signal.SIGKILL)
        rest = process.stdout.read().split()
    told = int(rest[-1]) if rest else told
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", CutRecording)
        assert len(load_recording(path).time) >= told
