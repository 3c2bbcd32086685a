from dataclasses import replace

import numpy as np
import pytest

from calibration.self_calibration.motor_angle_files import (
    holds_motor_angles,
    load_motor_angles,
    write_motor_angles,
)
from carosac_toolkit.base.errors import InvalidField, InvalidFile, MissingFile

GOOD = """# a comment
sample,motor_a_deg,motor_b_deg,known_x_mm,known_y_mm,known_z_mm
0,0,-0.5,-1.5,2,0
first,180,-90,,,
2,1e3,7.25,1,2,3
"""


def loaded(tmp_path, text):
    path = tmp_path / "angles.csv"
    path.write_text(text)
    return load_motor_angles(path)


def faults(tmp_path, text):
    with pytest.raises(InvalidFile) as caught:
        loaded(tmp_path, text)
    return caught.value.faults


def test_degrees_and_millimetres_become_radians_and_metres(tmp_path):
    angles = loaded(tmp_path, GOOD)
    assert angles.samples == ("0", "first", "2") and angles.cables == ("a", "b")
    assert angles.motor_angle[1] == pytest.approx([np.pi, -np.pi / 2], rel=1e-15)
    assert angles.is_known.tolist() == [True, False, True]
    assert angles.known_position[0] == pytest.approx([-1.5e-3, 2e-3, 0.0])
    assert angles.known_sigma is None


def test_radians_metres_numbers_and_own_sigmas_are_read(tmp_path):
    text = (
        "known_z_m,motor_angle_02_rad,motor_angle_01_rad,sample,known_x_m,known_y_m,"
        "known_sigma_x_mm,known_sigma_y_mm,known_sigma_z_mm\n"
        "1.5,2,1,s,0.5,-0.5,1,2,3\n,4,3,t,,,,,\n"
    )
    angles = loaded(tmp_path, text).in_order_of(["left", "right"])
    assert angles.motor_angle.tolist() == [[1.0, 2.0], [3.0, 4.0]]
    assert angles.known_position[0] == pytest.approx([0.5, -0.5, 1.5])
    assert angles.known_sigma[0] == pytest.approx([1e-3, 2e-3, 3e-3])


def test_what_is_written_reads_back_the_same(tmp_path):
    angles = loaded(tmp_path, GOOD)
    for spread in (None, np.full((3, 3), 2e-3)):
        one = replace(angles, known_sigma=spread)
        write_motor_angles(one, tmp_path / "again.csv")
        again = load_motor_angles(tmp_path / "again.csv")
        assert again.samples == one.samples and again.cables == one.cables
        assert np.array_equal(again.motor_angle, one.motor_angle)
        assert np.array_equal(again.known_position, one.known_position)
        assert np.array_equal(again.is_known, one.is_known)
        if spread is not None:
            assert np.array_equal(again.known_sigma[one.is_known], spread[one.is_known])


def test_single_coordinates_may_be_known(tmp_path):
    text = "sample,motor_a_deg,known_z_mm,known_sigma_z_mm\n0,0,0,2\n1,5,,\n2,3,40,1\n"
    angles = loaded(tmp_path, text)
    assert angles.known_axes.tolist() == [
        [False, False, True], [False] * 3, [False, False, True],
    ]  # fmt: skip
    assert angles.is_known.tolist() == [True, False, True]
    assert angles.known_position[2] == pytest.approx([0.0, 0.0, 0.04])
    assert angles.known_sigma[0, 2] == pytest.approx(2e-3)
    write_motor_angles(angles, tmp_path / "again.csv")
    again = load_motor_angles(tmp_path / "again.csv")
    assert np.array_equal(again.known_axes, angles.known_axes)
    assert np.array_equal(again.known_position, angles.known_position)


def test_a_file_of_motor_angles_is_told_from_others(tmp_path):
    path = tmp_path / "file.csv"
    path.write_text(GOOD)
    assert holds_motor_angles(path)
    path.write_text("time_s,length_01_m\n0,1\n")
    assert not holds_motor_angles(path)
    path.write_bytes(b"\xff\xfe\x00motor_a_deg")
    assert not holds_motor_angles(path)
    assert not holds_motor_angles(tmp_path / "none.csv")


def test_all_faults_of_a_file_come_at_once_with_their_lines(tmp_path):
    text = GOOD.replace("180", "18O").replace("1,2,3\n", "1,,3\n") + "2,1,1,,,\n3,4\n,1,1,,,\n"
    assert faults(tmp_path, text) == (
        "line 4: a: got '18O'; allowed: a number",
        "line 7: got 2 cells; allowed: 6, as in the header (is the file cut?)",
        "line 6: sample: got '2', as on line 5; allowed: a new name",
        "line 8: sample: got ''; allowed: a new name",
    )


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("sample,", "name,", "column sample: missing"),
        ("known_z_mm", "known_z_inch", "column 'known_z_inch': unknown; allowed: sample, motor_"),
        ("motor_b_deg", "motor_a_rad", "motor a: two columns"),
        (",known_z_mm", ",known_y_m", "column known_y_m: the same coordinate comes twice"),
        (
            ",known_z_mm",
            ",known_sigma_x_mm",
            "column known_sigma_y_mm: missing; allowed: known",
        ),
        (",known_x_mm", ",known_sigma_x_mm", "column known_x_mm: missing"),
        ("motor_a_deg,motor_b_deg", "known_sigma_x_m,known_sigma_y_m", "no motor angles"),
        ("1e3,", "inf,", "line 5: a: got 'inf'"),
    ],
)
def test_each_fault_is_named(tmp_path, old, new, message):
    assert any(fault.startswith(message) for fault in faults(tmp_path, GOOD.replace(old, new, 1)))


def test_empty_missing_and_binary_files_are_refused(tmp_path):
    assert faults(tmp_path, "sample,motor_a_deg\n")[0].startswith("no samples; allowed: a header")
    with pytest.raises(MissingFile, match="no such file"):
        load_motor_angles(tmp_path / "none.csv")
    path = tmp_path / "binary.csv"
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InvalidFile, match="this is no text file"):
        load_motor_angles(path)


def test_a_sigma_that_is_none_is_refused(tmp_path):
    text = (
        "sample,motor_a_deg,known_x_m,known_y_m,known_z_m,"
        "known_sigma_x_m,known_sigma_y_m,known_sigma_z_m\n0,0,1,1,1,0,1,1\n"
    )
    assert faults(tmp_path, text) == ("line 2: known_sigma_x_m: got <= 0; allowed: > 0",)


def test_motors_are_matched_with_cables_by_name_or_number(tmp_path):
    angles = loaded(tmp_path, GOOD)
    assert angles.in_order_of(["b", "a"]).motor_angle[2] == pytest.approx(np.radians([7.25, 1e3]))
    with pytest.raises(InvalidField, match=r"motors: got \['a', 'b'\]; allowed: the robot's"):
        angles.in_order_of(["left", "right"])


def test_known_positions_can_be_left_out(tmp_path):
    angles = loaded(tmp_path, GOOD)
    assert angles.without_known(["2"]).is_known.tolist() == [True, False, False]
    with pytest.raises(InvalidField, match="sample: got 'x'; allowed: one of"):
        angles.without_known(["x"])


def test_tensions_are_read_by_the_motor_s_name(tmp_path):
    text = "sample,motor_a_deg,motor_b_deg,force_b_n,force_a_n\n0,0,0,3,2\n1,5,7,4,1\n"
    angles = loaded(tmp_path, text)
    assert angles.tension.tolist() == [[2.0, 3.0], [1.0, 4.0]]
    write_motor_angles(angles, tmp_path / "again.csv")
    assert np.array_equal(load_motor_angles(tmp_path / "again.csv").tension, angles.tension)
    assert faults(tmp_path, text.replace("force_b_n", "force_c_n")) == (
        "forces of ['c', 'a']; allowed: one of each motor, or none at all",
    )
    assert faults(tmp_path, text.replace("3,2", "-3,2")) == (
        "line 2: force: got < 0; allowed: >= 0",
    )


LOG = """# torque mode, mover dragged
motor_pos_samp = np.array([
    [0, -0.07, 0.0],
    [-4834.89, 7431.31, 1309.72, ],
    [9, 8, 7],
])
xyz_of_samp = np.array([[0, 0, 0], [nan, np.nan, 100.5]])
"""


def test_what_a_hangprinter_answers_is_read(tmp_path):
    angles = loaded(tmp_path, LOG)
    assert holds_motor_angles(tmp_path / "angles.csv")
    assert angles.cables == ("01", "02", "03") and angles.samples == ("0", "1", "2")
    assert angles.motor_angle[1] == pytest.approx(np.radians([-4834.89, 7431.31, 1309.72]))
    assert angles.known_axes.tolist() == [[True] * 3, [False, False, True], [False] * 3]
    assert angles.known_position[1, 2] == pytest.approx(0.1005)
    bare = loaded(tmp_path, "[0, 0],\n[1, 2],\n")
    assert bare.motor_angle[1] == pytest.approx(np.radians([1.0, 2.0]))
    assert not bare.is_known.any()


def test_faults_of_a_log_come_with_their_lines(tmp_path):
    assert faults(tmp_path, LOG.replace("1309.72, ", "1309.72, x")) == (
        "line 4: got 'x'; allowed: a number",
        "line 4: got 4 numbers; allowed: 3 angles, as in the first list",
    )
    assert faults(tmp_path, "[1, 2]\n[nan, 2]\n[]\n") == (
        "line 2: got 'nan'; allowed: a number",
        "line 3: got 0 numbers; allowed: 2 angles, as in the first list",
    )
    more = "motor_pos_samp = [[1, 2]]\nxyz_of_samp = [[1, 2, 3], [4, 5, 6]]\n"
    assert faults(tmp_path, more)[0].startswith("xyz_of_samp: got 2 lists; allowed: at most 1")


@pytest.mark.parametrize(
    ("line", "fault"),
    [
        ("[9, 8, 7", "line 3: got '[9, 8, 7'; allowed: complete lists, such as"),
        ("9, 8, 7],", "line 3: got '9, 8, 7],'; allowed: complete lists, such as"),
        ("9, 8, 7", "line 3: got '9, 8, 7'; allowed: complete lists, such as"),
        ("Error: M569.3: timeout", "line 3: got 'Error: M569.3: timeout'; allowed: complete"),
        ("[9,, 8, 7]", "line 3: got ''; allowed: a number"),
        ("force_samp = [[5, 5, 5]]", "line 3: got the array 'force_samp'; allowed: motor_pos_samp"),
    ],
)
def test_no_line_of_a_log_is_passed_over_or_made_up(tmp_path, line, fault):
    found = faults(tmp_path, f"[0, 0, 0]\n[1, 2, 3]\n{line}\n[4, 5, 6]\n")
    assert found[0].startswith(fault)


def test_comments_imports_and_questions_in_a_log_are_no_samples(tmp_path):
    text = LOG.replace("    [9, 8, 7],", "    [9, 8, 7],  # [1, 1, 1]\n    # [2, 2, 2],")
    angles = loaded(tmp_path, f"import numpy as np\n{text}")
    assert np.degrees(angles.motor_angle)[2:] == pytest.approx(np.array([[9.0, 8.0, 7.0]]))
    assert holds_motor_angles(tmp_path / "angles.csv")
    asked = loaded(tmp_path, "M569.3 P40.0:41.0\n[0, 0]\nM569.3 P40.0:41.0\n[1, 2]\n")
    assert np.degrees(asked.motor_angle) == pytest.approx(np.array([[0.0, 0.0], [1.0, 2.0]]))
