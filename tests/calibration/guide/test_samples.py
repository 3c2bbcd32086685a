from __future__ import annotations

import errno
from dataclasses import replace

import numpy as np
import pytest

import carosac_toolkit as ct
from calibration.guide.samples import Rest, SampleFile
from calibration.self_calibration.motor_angle_files import holds_motor_angles, load_motor_angles
from carosac_toolkit.base.errors import CarosacError, InvalidField, InvalidFile
from carosac_toolkit.physics.cable.drum import drums_of

ROBOT = ct.load_robot("hangprinter")
LENGTH = np.array([1.6, 1.8, 1.59, 2.35])


def rest(change=0.0, tension=None):
    return Rest(length=LENGTH + change, tension=tension)


@pytest.fixture
def file(tmp_path):
    made = SampleFile(tmp_path / "samples.csv", ROBOT)
    made.start(rest())
    made.add("home", rest(0.01))
    made.add("1", rest([0.1, -0.1, 0.2, 0.0]))
    made.add("check_1", rest(-0.05))
    return made


def test_another_process_reads_the_same(file):
    again = SampleFile(file.path, ROBOT)
    assert again.names == ["home", "1", "check_1"]
    assert np.array(again.motor_angles) == pytest.approx(np.array(file.motor_angles), abs=0.0)
    assert again.reference.length == pytest.approx(file.reference.length, abs=0.0)
    angles = [one.one("x", rest(0.3)).motor_angle for one in (again, file)]
    assert angles[0] == pytest.approx(angles[1], abs=0.0)
    again.add("2", rest(0.2))
    assert SampleFile(file.path, ROBOT).names[-1] == "2"


def test_it_is_a_file_of_motor_angles_with_home_known(file):
    assert holds_motor_angles(file.path)
    angles = load_motor_angles(file.path)
    assert angles.is_known.tolist() == [True, False, False]
    turned = drums_of(ROBOT).motor_angle(LENGTH + 0.01) - drums_of(ROBOT).motor_angle(LENGTH)
    assert angles.motor_angle[0] == pytest.approx(turned)
    assert file.measured().samples == ("home", "1")
    assert file.measured(checks=True).samples == ("check_1",)


def test_a_line_that_was_cut_is_dropped_and_the_file_goes_on(file):
    whole = file.path.read_bytes()
    for cut in range(1, 120, 7):
        file.path.write_bytes(whole[:-cut])
        again = SampleFile(file.path, ROBOT)
        assert again.names[:2] == ["home", "1"]
        again.add("late", rest(0.1))
        names = SampleFile(file.path, ROBOT).names
        assert names == ["home", "1", "late"]


def test_a_file_that_was_cut_before_any_sample_begins_anew(file):
    text = file.path.read_text()
    for cut in ("", text[:30], text[: text.index("sample,") + 5]):
        file.path.write_text(cut)
        again = SampleFile(file.path, ROBOT)
        assert again.reference is None
        again.start(rest())
        again.add("home", rest(0.1))
        assert SampleFile(file.path, ROBOT).names == ["home"]


def test_tensions_are_kept_beside_the_angles(tmp_path):
    pull = np.array([3.0, 4.0, 5.0, 20.0])
    file = SampleFile(tmp_path / "samples.csv", ROBOT)
    file.start(rest(tension=pull))
    file.add("home", rest(tension=pull))
    file.add("1", rest(0.1, tension=2.0 * pull))
    for angles in (load_motor_angles(file.path), SampleFile(file.path, ROBOT).measured()):
        assert angles.tension == pytest.approx(np.array([pull, 2.0 * pull]), abs=0.0)
    assert file.one("2", rest(tension=-pull)).tension.max() == 0.0  # noise of a slack cable


def test_other_files_are_refused(tmp_path, file):
    other = tmp_path / "other.csv"
    other.write_text("sample,motor_a_deg\n0,0\n")
    with pytest.raises(InvalidFile, match="not the samples of a guided calibration"):
        SampleFile(other, ROBOT)
    other.write_text(file.path.read_text().replace('"length_m"', '"lengths"'))
    with pytest.raises(InvalidFile, match="line 1, reference: 'length_m'; allowed: the comment"):
        SampleFile(other, ROBOT)
    other.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InvalidFile, match="no text; allowed: a new file"):
        SampleFile(other, ROBOT)
    with pytest.raises(InvalidFile, match="Is a directory; allowed: a new file"):
        SampleFile(tmp_path, ROBOT)
    with pytest.raises(InvalidField, match=r"SAMPLES: .* a file that can be written"):
        SampleFile(tmp_path / "none" / "samples.csv", ROBOT).start(rest())


def test_samples_with_tensions_and_without_are_not_mixed(tmp_path):
    pull = np.array([3.0, 4.0, 5.0, 20.0])
    for first, second, held in ((pull, None, "hold tensions"), (None, pull, "hold no tensions")):
        file = SampleFile(tmp_path / f"{held}.csv", ROBOT)
        file.start(rest(tension=first))
        file.add("home", rest(tension=first))
        with pytest.raises(CarosacError, match=held):
            file.add("1", rest(tension=second))
        assert SampleFile(file.path, ROBOT).names == ["home"]


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("name", "mine"),
        ("home_position", np.array([0.0, 0.0, 0.1])),
        ("drum_radius", ROBOT.drum_radius * 1.1),
        ("drum_buildup", ROBOT.drum_buildup * 2.0),
        ("drum_gear", ROBOT.drum_gear * 2.0),
        ("drum_advantage", np.full(4, 2.0)),
    ],
)
def test_samples_belong_to_the_robot_that_they_were_measured_with(file, field, value):
    """Motor angles follow from lengths by the drums, and the first sample is at home."""
    with pytest.raises(InvalidFile, match=f"samples of a robot with {field} .* allowed: "):
        SampleFile(file.path, replace(ROBOT, **{field: value}))
    again = SampleFile(file.path, replace(ROBOT, exit_points=ROBOT.exit_points + 0.1))
    assert again.names == file.names  # a better guess changes no sample


def test_a_full_disk_is_told_and_counts_no_sample(file, monkeypatch):
    def full(*arguments):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("os.write", full)
    with pytest.raises(InvalidField, match=r"SAMPLES: .* No space left on device"):
        file.add("2", rest())
    assert file.names == ["home", "1", "check_1"]


def test_what_ends_before_the_first_sample_leaves_no_file(tmp_path):
    path = tmp_path / "samples.csv"
    with pytest.raises(InvalidField, match="--port"), SampleFile.held(path, ROBOT):
        raise InvalidField("--port", "0", "1 to 65535")
    assert not path.exists()
