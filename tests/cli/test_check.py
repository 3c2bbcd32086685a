import json
import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from carosac_toolkit.cli.main import main
from carosac_toolkit.robot.bundled_names import list_robots
from carosac_toolkit.robot.file import parse_robot, robot_text
from carosac_toolkit.robot.writer import robot_document


@pytest.mark.parametrize("name", list_robots())
def test_check_describes_every_bundled_robot(name, tmp_path, capsys):
    assert main(["check", name, "--json", str(tmp_path / "x.json")]) == 0
    data = json.loads((tmp_path / "x.json").read_text())
    out = capsys.readouterr().out
    assert data["n"] == len(data["cables"])
    assert data["home"]["feasible"] and data["home"]["stable"]
    assert f"{data['n']}, {data['constraint']}" in out
    for cable in data["cables"]:
        assert cable["tension_min_N"] - 1e-6 <= cable["home_tension_N"] <= cable["tension_max_N"]
        assert f"{cable['home_tension_N']:.2f}" in out
    (line,) = [text for text in out.splitlines() if text.startswith("natural frequencies")]
    assert line.count(", ") == 5 and all(
        name in line for name in data["home"]["natural_directions"]
    )
    assert all(field in out for field in data["provenance"])


def test_escape_sequences_of_a_file_are_shown(tmp_path, capsys):
    text = robot_text("carosac").replace("name: carosac", 'name: carosac\n"\\e[2Jkey": 1', 1)
    file = tmp_path / "robot\x1b[2J.yaml"
    file.write_text(text)
    assert main(["check", str(file)]) == 2
    refusal = capsys.readouterr().err
    assert "\x1b" not in refusal and r"robot\x1b[2J.yaml" in refusal
    file.write_text(robot_text("carosac"))
    assert main(["check", str(file), "--picture", str(tmp_path / "a\x1b[2J.png")]) == 0
    out = capsys.readouterr().out
    assert "\x1b" not in out and r"a\x1b[2J.png" in out


def test_check_draws_a_picture(tmp_path, capsys):
    picture = tmp_path / "robot.png"
    assert main(["check", "carosac", "--picture", str(picture)]) == 0
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert [path.name for path in tmp_path.iterdir()] == ["robot.png"]
    assert f"picture: {picture}" in capsys.readouterr().out


def test_a_robot_that_cannot_hang_at_home_is_a_negative_answer(tmp_path, capsys):
    path = tmp_path / "weak.yaml"
    path.write_text(robot_text("carosac").replace("max: 500 N", "max: 30 N"))
    words = ["check", str(path), "--json", str(tmp_path / "x.json")]
    assert main([*words, "--picture", str(tmp_path / "x.png")]) == 1
    captured = capsys.readouterr()
    assert "cannot stay at its home position:\n  no tensions within the limits" in captured.err
    assert "cable front_left would need 84.5 N at home, its maximum is 30 N" in captured.err
    assert json.loads((tmp_path / "x.json").read_text())["cables"][0]["home_tension_N"] is None
    assert (tmp_path / "x.png").exists()


def with_pulleys(radius):
    """The bundled robot with pulleys fed from below, and a payload."""
    pulley = f"], pulley: {{radius: {radius}, swivel_axis: [0, 0, 1]}}}}\n"
    text = robot_text("carosac").replace("]}\n", pulley, 4)
    payload = "{name: camera, mass: 2 kg, center_of_mass: [0, 0.1, 0], inertia: [1, 2, 3]}"
    text = text.replace("  air_drag:", f"  payloads:\n    - {payload}\n  air_drag:")
    return text.replace("  home: assumed", "  home: assumed\n  platform.payloads: weighed")


def test_points_pulleys_and_payloads_are_shown(tmp_path, capsys):
    path = tmp_path / "pulleys.yaml"
    path.write_text(with_pulleys("30 cm"))
    words = ["check", str(path), "--json", str(tmp_path / "x.json")]
    assert main([*words, "--picture", str(tmp_path / "x.png")]) == 0
    out = capsys.readouterr().out
    data = json.loads((tmp_path / "x.json").read_text())
    assert "(2.519, -8.388, 8.469)  (0.21, -0.21, -0.011)" in out
    assert "camera                 2  (0, 0.1, 0)" in out
    assert "300  (0, 0, 1)         below" in out
    assert data["payloads"][0]["name"] == "camera" and data["payloads"][0]["mass_kg"] == 2.0
    for cable in data["cables"]:
        assert cable["pulley_radius_m"] == 0.3 and cable["swivel_axis"] == [0.0, 0.0, 1.0]
        assert f"{cable['home_wrap_rad'] * 180.0 / math.pi:.1f}\n" in out
    assert data["problems"] == [] and data["warnings"] == []


def test_dry_friction_is_shown_where_there_is_any(tmp_path, capsys):
    assert main(["check", "carosac"]) == 0
    assert "capstan friction" not in capsys.readouterr().out
    text = robot_text("carosac")
    robot = parse_robot(text)
    rough = replace(
        robot, capstan_friction=np.full(4, 0.15), length_hysteresis=np.array([0.0, 2e-3, 0.0, 0.0])
    )
    (tmp_path / "rough.yaml").write_text(robot_document(text, rough, provenance="a guess"))
    assert main(["check", str(tmp_path / "rough.yaml")]) == 0
    out = capsys.readouterr().out
    assert "hysteresis [mm]" in out
    for name, hysteresis in zip(robot.cable_names, "0200", strict=True):
        row = next(line for line in out.splitlines() if line.startswith(name) and "0.15" in line)
        assert row.split()[1:] == ["0", "0", "0.15", hysteresis]


def test_a_home_out_of_reach_of_the_winches_is_a_negative_answer(tmp_path, capsys):
    path = tmp_path / "short.yaml"
    path.write_text(with_pulleys("30 cm").replace("length_max: 20 m", "length_max: 9.5 m"))
    words = ["check", str(path), "--json", str(tmp_path / "x.json")]
    assert main(words) == 1
    error = capsys.readouterr().err
    assert "cable front_left needs 9.6" in error
    assert "length_min to length_max = 1 to 9.5 m" in error
    data = json.loads((tmp_path / "x.json").read_text())
    assert not data["home"]["feasible"] and len(data["problems"]) == 4


def test_warnings_are_shown_and_leave_the_answer_as_it_is(tmp_path, capsys):
    path = tmp_path / "spare.yaml"
    spare = "    spare: {position: [0, 0, 8]}\nplatform:\n"
    path.write_text(robot_text("carosac").replace("platform:\n", spare, 1))
    assert main(["check", str(path)]) == 0
    assert capsys.readouterr().err.endswith(
        "carosac: warning: frame.exit_points.spare is used by no chain\n"
    )


def test_a_cable_without_a_unit_is_asked_for_it(tmp_path, capsys):
    path = tmp_path / "thick.yaml"
    path.write_text(robot_text("carosac").replace("diameter: 4 mm", "diameter: 3"))
    assert main(["check", str(path)]) == 0
    captured = capsys.readouterr()
    assert "is diameter in mm? A bare number is in metres" in captured.err
    assert "front_left            3000      950" in captured.out


def calibrated(path, names, **changes):
    """Write the bundled robot as a calibration would, every parameter known to its square."""
    text = robot_text("carosac")
    sigma = [0.5e-3 if name != "mass" else 0.2 for name in names]
    robot = replace(
        parse_robot(text),
        **changes,
        calibrated=names or None,
        calibration_covariance=np.diag(np.square(sigma)) if names else None,
    )
    path.write_text(robot_document(text, robot, provenance="a survey"))
    return ["check", str(path), "--json", str(path.with_suffix(".json"))]


NAMES = (
    "exit_points[rear_left].x", "exit_points[rear_left].y", "exit_points[rear_left].z",
    "anchor_points[front_left].z", "length_offset[front_left]", "length_offset[rear_left]",
    "length_scale[front_left]", "length_delay", "pose_tilt.x", "mass", "center_of_mass.z",
)  # fmt: skip
SENSORS = {
    "length_offset": [0.0123, 0.0, 0.0, -0.1],
    "length_scale": [1.002, 1.0, 1.0, 1.0],
    "length_delay": 0.0331,
    "pose_rotation": Rotation.from_euler("zx", [30.0, 0.2], degrees=True).as_matrix().T,
}


def test_what_was_calibrated_is_shown_with_its_sigma(tmp_path, capsys):
    pose = Rotation.from_rotvec([2e-3, 0.0, 0.0]) * Rotation.from_rotvec([0.0, 0.0, 0.5])
    changes = SENSORS | {"pose_rotation": pose.as_matrix()}
    assert main(calibrated(tmp_path / "x.yaml", NAMES, **changes)) == 0
    out = capsys.readouterr().out
    assert "calibrated  11 parameters" in out
    assert "rear_left        -1796.74 +- 0.50  4833.46 +- 0.50  8370.07 +- 0.50" in out
    assert "front_left         -11.00 +- 0.50" in out
    assert "front_left   12.30 +- 0.50    1.00200 +- 0.00050" in out
    assert "rear_left    -100.00 +- 0.50  -" in out
    for line in (
        "length_delay      33.10 +- 0.50 ms", "pose_tilt.x       2.00 +- 0.50 mrad",
        "mass              23.66 +- 0.20 kg", "center_of_mass.z  -120.00 +- 0.50 mm",
        "lengths     read as scale * unstrained length + offset, before poses by 33.1 ms",
        "poses       in a frame turned by 28.65 deg about z, 2.00 mrad about x and",
        "calibration: a survey",
    ):  # fmt: skip
        assert line in out
    data = json.loads((tmp_path / "x.json").read_text())
    assert list(data["calibration"]) == list(NAMES)
    assert data["calibration"]["length_delay"] == {
        "value": 0.0331, "sigma": pytest.approx(5e-4), "unit": "s",
    }  # fmt: skip
    assert data["sensors"]["length_offset_m"] == SENSORS["length_offset"]
    assert data["sensors"]["length_delay_s"] == 0.0331
    assert data["sensors"]["pose_tilt_rad"] == pytest.approx([2e-3, 0.0], abs=1e-12)
    assert data["sensors"]["pose_turn_rad"] == pytest.approx(0.5)


def test_sensors_without_a_covariance_are_shown_by_their_numbers(tmp_path, capsys):
    assert main(calibrated(tmp_path / "x.yaml", (), **SENSORS)) == 0
    out = capsys.readouterr().out
    assert "calibrated  no\n" in out
    assert "front_left          12.3  1.002" in out and "rear_left           -100      1" in out
    data = json.loads((tmp_path / "x.json").read_text())
    assert data["calibration"] == {}


def test_one_number_for_cables_that_came_to_differ_has_no_value(tmp_path, capsys):
    words = calibrated(
        tmp_path / "x.yaml", ("axial_stiffness",), axial_stiffness=[8e5, 9e5, 9e5, 9e5]
    )
    assert main(words) == 0
    assert "one number for cables that differ, +- 5e-07 kN" in capsys.readouterr().out
    data = json.loads((tmp_path / "x.json").read_text())
    assert data["calibration"]["axial_stiffness"]["value"] is None


def test_a_robot_that_was_not_calibrated_says_nothing_of_it(tmp_path, capsys):
    assert main(["check", "carosac", "--json", str(tmp_path / "x.json")]) == 0
    out = capsys.readouterr().out
    assert "calibrated" not in out and "\nposes" not in out
    data = json.loads((tmp_path / "x.json").read_text())
    assert data["calibration"] == {} and data["sensors"] is None
