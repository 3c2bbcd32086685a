"""``carosac import recording --align``."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from carosac_toolkit.cli.main import main
from carosac_toolkit.loop.values import Stamped
from carosac_toolkit.recordings.files import load_recording, save_recording
from tests.validation.moving import moving_run


@pytest.fixture
def file(tmp_path):
    run = moving_run()
    path = tmp_path / "run.csv"
    save_recording(replace(run, poses=replace(run.poses, time=run.poses.time + 2.0)), path)
    return path


def align(*words):
    return main(["import", "recording", *map(str, words), "--align"])


def test_stamps_are_shifted_and_the_offset_is_printed_and_kept(file, tmp_path, capsys):
    output, numbers = tmp_path / "aligned.parquet", tmp_path / "numbers.json"
    assert align(file, "--robot", "carosac", "--output", output, "--json", numbers) == 0
    assert "+1999.8" in capsys.readouterr().out
    aligned = load_recording(output)
    assert aligned.poses.time == pytest.approx(moving_run().poses.time, abs=1e-3)
    assert aligned.metadata.clock_offsets.startswith("poses +1.99")
    assert aligned.metadata.robot == "carosac"
    clocks = json.loads(numbers.read_text())["clocks"]
    assert set(clocks) == {"poses", "tension", "imu"}
    assert clocks["poses"]["offset_s"] == pytest.approx(2.0, abs=1e-3)
    assert clocks["imu"]["jitter_s"] is None


def test_only_the_named_channels_are_shifted_and_others_are_named(file, tmp_path, capsys):
    output = tmp_path / "aligned.csv"
    words = ("--robot", "carosac", "--align-channels", "poses", "poses", "--output", output)
    assert align(file, *words) == 0
    np.testing.assert_array_equal(load_recording(output).imu.time, moving_run().imu.time)
    assert load_recording(output).metadata.clock_offsets.count("poses") == 1
    assert "Not aligned: tension, imu." in capsys.readouterr().out


def test_a_channel_without_an_offset_is_one_message_and_no_file(tmp_path, capsys):
    run = moving_run()
    still = np.broadcast_to(run.unstrained_length[:1], run.unstrained_length.shape)
    save_recording(replace(run, unstrained_length=still), tmp_path / "still.csv")
    output = tmp_path / "aligned.csv"
    assert align(tmp_path / "still.csv", "--robot", "carosac", "--output", output) == 2
    assert "the clock of channel poses cannot be aligned: the lengths" in capsys.readouterr().err
    assert not output.exists()


def test_angles_that_tell_no_offset_stay_as_they_are_unless_they_are_named(tmp_path, capsys):
    run = moving_run()
    level = Stamped(time=run.poses.time, value=np.zeros((len(run.poses.time), 2)))
    save_recording(replace(run, inclination=level), tmp_path / "level.csv")
    words = (tmp_path / "level.csv", "--robot", "carosac", "--output", tmp_path / "aligned.csv")
    assert align(*words) == 0
    assert "Not aligned: inclination (" in capsys.readouterr().out
    aligned = load_recording(tmp_path / "aligned.csv")
    np.testing.assert_array_equal(aligned.inclination.time, level.time)
    assert align(*words[:-1], tmp_path / "other.csv", "--align-channels", "inclination") == 2
    assert "clock of channel inclination cannot be aligned" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ((), "--robot: got nothing"),
        (("--robot", "carosac", "--align-channels", "length_rate"), "allowed: of ['poses',"),
        (("--robot", "carosac", "--lengths", "/joints"), "its channels are known"),
        (("--robot", "carosac", "--length-unit", "mm"), "--length-unit: got mm; allowed: nothing"),
        (("--robot", "carosac", "--stamps", "receive"), "--stamps: got receive; allowed: nothing"),
        (("--robot", "carosac", "--names", "a", "b"), "--names: got a b; allowed: nothing"),
        (("--robot", "carosac", "--relative"), "--relative: got True; allowed: nothing"),
        (("--robot", "cogiro"), "got 4 cables; allowed: 8 cables"),
    ],
)
def test_what_cannot_be_aligned_is_one_message(file, capsys, words, said):
    assert align(file, *words) == 2
    assert said in capsys.readouterr().err


def test_a_recording_file_is_read_for_its_clocks_only(file, capsys):
    assert main(["import", "recording", str(file)]) == 2
    assert "a bag, or --align or --shift with a recording file" in capsys.readouterr().err


def test_a_stated_offset_is_removed_without_a_robot_and_not_estimated(file, tmp_path, capsys):
    output = tmp_path / "shifted.csv"
    words = ["import", "recording", str(file), "--shift", "poses", "2.0", "--output", str(output)]
    assert main(words) == 0
    assert "poses: +2 s, as stated" in capsys.readouterr().out
    shifted = load_recording(output)
    assert shifted.poses.time == pytest.approx(moving_run().poses.time, abs=1e-9)
    assert shifted.metadata.clock_offsets == "poses +2.000000 s (stated): removed from the stamps"
    both = tmp_path / "both.csv"
    assert align(file, "--shift", "poses", "2.0", "--robot", "carosac", "--output", both) == 0
    assert "poses" not in capsys.readouterr().out.split("channel", 1)[1]
    assert load_recording(both).metadata.clock_offsets.count("poses") == 1


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("attitude", "1.0"), "--shift: got attitude; allowed: of ['poses', 'tension', 'imu']"),
        (("poses", "nan"), "--shift: got poses nan s; allowed: a finite time"),
        (("ahrs", "1.0"), "--shift: got ahrs; allowed: of ['poses', 'tension', 'imu']"),
        (("poses", "1.0", "--shift", "imu", "2.0"), "--shift: got 2 times; allowed: one --shift"),
        (("poses", "1.0", "poses", "2.0"), "--shift: got poses poses; allowed: a channel once"),
        (
            ("poses", "1.0", "--align", "--align-channels", "poses"),
            "--shift: got poses; allowed: a channel that --align-channels does not name",
        ),
    ],
)
def test_what_cannot_be_shifted_is_one_message(file, tmp_path, capsys, words, said):
    output = tmp_path / "shifted.csv"
    words = ["import", "recording", str(file), "--output", str(output), "--shift", *words]
    assert main(words) == 2
    assert said in capsys.readouterr().err
    assert not output.exists()
