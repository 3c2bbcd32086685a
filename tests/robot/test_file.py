import subprocess
import sys

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import carosac_toolkit as ct
from carosac_toolkit.base.errors import InvalidFile, MissingFile
from carosac_toolkit.robot.differences import differing
from carosac_toolkit.robot.file import parse_robot, robot_text
from carosac_toolkit.robot.robot import Robot

FAULTY = """\
schema: carosac-robot/2
name: bad
descripton: a typo in a key
licence: none
gravity: -9.81
frame:
  exit_points:
    a: {position: [0, 0]}
    b: {position: [1, top, 3]}
    c: {position: [1 kg, 1, 3], pulley: {radius: 50 mm, swivel_axis: [0, 0, 2]}}
    d: {position: [0, 1, 3]}
    d: {position: [0, 1, 4]}
platform:
  mass: -2 kg
  center_of_mass: [0, 0, 0]
  inertia: [0.1, 0.1, 0.3]
  anchor_points: {a: [0, 0, 0], b: [0.1, 0, 0]}
  air_drag: {linear: 0.1}
cable_types:
  rope: {linear_density: 10.55 g/n, youngs_modulus: 60 Gpa, area: 7 mm^2,
         axial_damping: 10, diameter: 2 kg}
  wire: {linear_density: 1 g/m, axial_damping: 10, diameter: 2 mm}
winches:
  w: {speed_max: 1, acceleration_max: 1, lag: -0.1, length_min: 0.1, length_max: 9, run_length: 0}
  v: {speed_max: 1, acceleration_max: 1, lag: 0.1, length_min: 5, length_max: 3, run_length: 0}
chains:
  - {name: one, exit_point: a, anchor_point: a, cable: rope, winch: w}
  - {name: one, exit_point: a, anchor_point: a, cable: roqe, winch: w}
  - {name: two, exit_point: e, anchor_point: b, cable: rope, winch: w}
tension_limits: {min: 600, max: 500}
workspace: {min: [0, 0, 0], max: [1, 1, 1]}
home: {position: [0.5, 0.5, 2]}
provenance:
  frame: measured
  platform: weighed
  cable_types: data sheet
  winches: data sheet
  tension_limits: assumed
  workspace: assumed
  home: assumed
  platfrom.mass: weighed
"""

FOUND = [
    (1, "schema: got 'carosac-robot/2'; allowed: one of 'carosac-robot/1'"),
    (3, "descripton: unknown key; allowed: schema, name, description"),
    (3, "did you mean 'description'"),
    (5, "gravity: got -9.81; allowed: an acceleration in m/s^2 (or mm/s^2), > 0"),
    (5, "gravity: no provenance"),
    (8, "frame.exit_points.a.position: got [0, 0]; allowed: a list of 3 numbers"),
    (9, "frame.exit_points.b.position[1]: got 'top'; allowed: a length in m"),
    (10, "frame.exit_points.c.position[0]: got '1 kg'; allowed: a length in m"),
    (10, "frame.exit_points.c.pulley.swivel_axis: got [0, 0, 2]"),
    (12, "frame.exit_points.d: given twice, first in line 11"),
    (14, "platform.mass: got '-2 kg'; allowed: a mass in kg (or g, t), > 0"),
    (16, "platform.inertia: got [0.1, 0.1, 0.3]; allowed: principal moments"),
    (18, "platform.air_drag.angular: missing; allowed: an angular damping in N*m*s/rad"),
    (20, "cable_types.rope.linear_density: got '10.55 g/n'; allowed: a linear density"),
    (20, "cable_types.rope.youngs_modulus: got '60 Gpa'; allowed: a stress"),
    (20, "did you mean GPa"),
    (21, "cable_types.rope.diameter: got '2 kg'; allowed: a length"),
    (22, "cable_types.wire.axial_stiffness: got nothing; allowed: either axial_stiffness alone"),
    (24, "winches.w.lag: got -0.1; allowed: a time in s"),
    (25, "winches.v.length_min: got 5 m; allowed: length_min < length_max = 3 m"),
    (28, "chains[1].name: got 'one'"),
    (28, "chains[1]: got exit point 'a' and anchor point 'a'"),
    (28, "chains[1].cable: got 'roqe'; allowed: a name in cable_types: rope, wire; did you mean"),
    (29, "chains[2].exit_point: got 'e'; allowed: a name in frame.exit_points: a, b, c, d"),
    (30, "tension_limits.min: got 600 N; allowed: min < max = 500 N"),
    (32, "home.position[2]: got 2 m; allowed: inside the workspace box, from 0 to 1 m"),
    (41, "provenance.platfrom.mass: no such field"),
]


def changed(old, new, name="carosac", count=1):
    """A bundled robot's text with one change."""
    text = robot_text(name)
    assert text.count(old) >= 1
    return text.replace(old, new, count)


def faults(text):
    with pytest.raises(ct.InvalidFile) as caught:
        parse_robot(text, source="mine.yaml")
    return caught.value.faults


def test_air_drag_about_each_axis_and_of_cables_is_read():
    drag = "{linear: 0.3 N*s/m, angular: 0.05 N*m*s/rad"
    robot = parse_robot(changed(drag, f"{drag}, angular_axes: [1, 0.5, 2], cables: 0.8 1/s"))
    assert robot.angular_drag_axes == pytest.approx([1.0, 0.5, 2.0])
    assert robot.cable_drag == 0.8
    plain = ct.load_robot("carosac")
    assert (plain.angular_drag_axes == 1.0).all() and plain.cable_drag is None
    found = faults(changed(drag, f"{drag}, angular_axes: [1, -0.5, 2], cables: 0.8 N"))
    assert any("angular_axes[1]: got -0.5; allowed: a pure number, >= 0" in one for one in found)
    assert any(
        "air_drag.cables: got '0.8 N'; allowed: a rate in 1/s; N is a" in one for one in found
    )


def test_all_planted_faults_come_in_one_message_with_their_lines(tmp_path):
    path = tmp_path / "bad.yaml"
    path.write_text(FAULTY)
    with pytest.raises(ct.InvalidFile) as caught:
        ct.load_robot(path)
    message = str(caught.value)
    assert message.startswith(f"{path}: {len(caught.value.faults)} faults\n  line 1: schema")
    for line, text in FOUND:
        hits = [fault for fault in caught.value.faults if text in fault]
        assert hits, text
        assert hits[0].startswith(f"line {line}: "), hits
    assert len(caught.value.faults) == len(FOUND) - 2  # two faults are looked at twice
    lines = [int(fault.split(":")[0].split()[1]) for fault in caught.value.faults]
    assert lines == sorted(lines)


def test_a_misspelt_key_is_one_fault():
    (fault,) = faults(changed("mass: 23.655 kg", "masss: 23.655 kg"))
    assert "platform.masss: unknown key" in fault and "did you mean 'mass'" in fault


def test_misspelt_sections_are_one_fault_each_whatever_follows_from_them():
    text = changed("home:", "hom:", count=2)  # with its provenance, which has no such field then
    text = text.replace("tension_limits:", "tension_limit:")
    assert len(faults(text)) == 2
    limits, home = faults(text)
    assert limits.endswith("did you mean 'tension_limits'?")
    assert home.endswith("did you mean 'home', which is missing?")
    (unlike,) = faults(changed("\nprovenance:", "\nquux: 3 m\nprovenance:\n  quux: guessed"))
    assert "quux: unknown key" in unlike


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("lag: 0.05 s", "lag: fast", "winches.winch.lag: got 'fast'; allowed: a time in s"),
        ("size: [4, 4, 4]", "size: [4, -4, 4]", "workspace.size: got y from 0.2 to -3.8 m"),
        ("size: [4, 4, 4]", "max: [4, 4, 4]", "workspace.min: got max and center; allowed: min"),
        ("{min: 5 N, max: 500 N}", "5 N", "tension_limits: got '5 N'; allowed: a mapping with min"),
        ("position: [0.4, -1.8, 2.2]", "position: [0.4, -1.8, 2.2], rpy_deg: [0, 0, 0], "
         "quaternion_wxyz: [1, 0, 0, 0]", "home.rpy_deg: got quaternion_wxyz and rpy_deg"),
        ("position: [0.4, -1.8, 2.2]", "position: [0.4, -1.8, 2.2], quaternion_wxyz: [1, 1, 0, 0]",
         "length 1; its length is 1.41421"),
        ("  home: assumed", "", "home: no provenance"),
        ("inertia: [0.6, 0.6, 0.8]", "inertia: [[1, 0.1, 0], [0, 1, 0], [0, 0, 1]]", "symmetric"),
        ("inertia: [0.6, 0.6, 0.8]", "inertia: [[1, 2, 0], [2, 1, 0], [0, 0, 1]]",
         "positive definite inertia; its smallest moment is -1"),
        ("8.47185]}", "8.47185], sigma: 2 mm}", "sigma or covariance at all exit points"),
        ("8.47185]}", "8.47185], sigma: [1, 2]}", "got [1, 2]; allowed: a length in m"),
        ("8.47185]}", "8.47185], covariance: [[1, 2, 0], [2, 1, 0], [0, 0, 1]]}", "semidefinite"),
        ("run_length: 8 m", "run_length: 8 m\n    drum: {radius: 75 mm}", "drum.buildup: missing"),
        ("run_length: 8 m", "run_length: 8 m\n    length_hysteresis: 2",
         "length_hysteresis[0]: got 2.0 m; allowed: length_hysteresis <= "),
        ("tension_limits: {min: 5 N, max: 500 N}", "", "chains[3].tension_limits: missing"),
        ("axial_stiffness: 0.95 MN", "axial_stiffness: 0.95 MN\n    area: 7 mm^2",
         "axial_stiffness: got axial_stiffness and area"),
        ("chains:\n", "chains: []\nmore:\n", "chains: got an empty list; allowed: at least two"),
        ("description: suspended", "description:\nother: suspended", "description: got nothing"),
        ("mass: 23.655 kg", "mass: 1:30", "platform.mass: got '1:30'"),
        ("axial_damping: 300 N*s", "axial_damping: 300 N*s\n    capstan_friction: 2.1",
         "cable_types.rope.capstan_friction: got 2.1; allowed: a pure number, >= 0, <= 2"),
    ],
)  # fmt: skip
def test_each_fault_says_what_is_allowed(old, new, message):
    assert any(message in fault for fault in faults(changed(old, new))), faults(changed(old, new))


def test_a_single_cable_is_refused_with_the_reason():
    lines = robot_text("carosac").splitlines(keepends=True)
    chains = [line for line in lines if line.startswith("  - {name:")]
    text = "".join(line for line in lines if line not in chains[1:])
    (fault,) = [fault for fault in faults(text) if "chains" in fault]
    assert "chains: got one chain; allowed: at least two: under a single cable a plat" in fault
    assert fault.endswith("turns freely about the cable")


@pytest.mark.parametrize("name", [r"a\e]0;owned\ab", r"a\nwarning: fine", r"gpj\u202eexe"])
def test_a_name_cannot_hold_what_a_terminal_obeys(name):
    (fault,) = faults(changed("\nname: carosac", f'\nname: "{name}"'))
    assert "name: got" in fault and "without control characters" in fault
    assert fault.isprintable()


def test_a_key_at_the_wrong_depth_is_asked_about_its_indentation():
    text = changed("  inertia: [0.6, 0.6, 0.8]\n", "").replace(
        "cable_types:", "inertia: [0.6, 0.6, 0.8]\ncable_types:", 1
    )
    entries = [fault for fault in faults(text) if "inertia: unknown key" in fault]
    assert "platform.inertia is missing: is the indentation right" in entries[0]


def test_eight_cables_need_a_home_orientation():
    text = changed(", rpy_deg: [0, 0, 0]", "", name="ipanema1")
    (fault,) = faults(text)
    assert "home: rotation missing; allowed: quaternion_wxyz or rpy_deg, as 8 cables" in fault


@pytest.mark.parametrize("text", ["", "42", "- a", "a: [1", "\ta: 1", "just text"])
def test_what_is_no_robot_file_is_one_clear_fault(text):
    assert len(faults(text)) == 1


def test_files_that_cannot_be_read_say_so(tmp_path):
    with pytest.raises(MissingFile, match="no such file; bundled robots are carosac, cogiro"):
        ct.load_robot(tmp_path / "none.yaml")
    with pytest.raises(ct.InvalidFile, match="cannot be read"):
        ct.load_robot(tmp_path)
    (tmp_path / "binary.yaml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ct.InvalidFile, match="not UTF-8"):
        ct.load_robot(tmp_path / "binary.yaml")
    with pytest.raises(ct.InvalidField, match=r"one of \['carosac', .*did you mean 'cogiro'"):
        ct.load_robot("cogirro")


def test_a_path_and_a_name_give_the_same_robot(tmp_path):
    path = tmp_path / "copy.yaml"
    path.write_text(robot_text("scampi"))
    mine, bundled = ct.load_robot(str(path)), ct.load_robot("scampi")
    assert np.array_equal(mine.exit_points, bundled.exit_points)
    assert mine.provenance == bundled.provenance


@pytest.mark.parametrize("name", ct.list_robots())
def test_bundled_robots_are_whole(name):
    robot = ct.load_robot(name)
    assert robot.name == name
    assert (robot.workspace_min <= robot.home_position).all()
    assert (robot.home_position <= robot.workspace_max).all()
    assert (robot.workspace_max[2] < robot.exit_points[:, 2].max()).all()
    assert robot.description and robot.licence


def test_bundled_robots_are_those_of_the_design():
    assert ct.list_robots() == (
        "carosac", "cogiro", "desktop", "hangprinter", "ipanema1", "scampi", "stadium", "warehouse",
    )  # fmt: skip
    robot = ct.load_robot("carosac")
    assert robot.exit_points[2] == pytest.approx([2.71727, 4.77495, 8.36403])
    assert robot.mass == 23.655
    assert robot.axial_stiffness == pytest.approx(0.95e6)
    assert robot.axial_stiffness == pytest.approx(130e9 * 0.01055 / 1440.0, rel=3e-3)
    assert robot.workspace_min == pytest.approx([-1.6, -3.8, 1.0])
    assert robot.workspace_max == pytest.approx([2.4, 0.2, 5.0])


def straight(name, position):
    robot = ct.load_robot(name)
    return np.linalg.norm(robot.exit_points - (robot.anchor_points + position), axis=1)


def test_ipanema_has_eight_equal_straight_lengths_in_the_middle():
    assert straight("ipanema1", [0.0, 0.0, 1.0]) == pytest.approx(2.6148040079516472, rel=1e-15)


def test_cogiro_has_the_straight_lengths_of_its_source():
    expected = [9.743148, 9.183277, 9.425611, 9.473757, 9.768421, 9.197350, 9.500900, 9.561887]
    assert straight("cogiro", [0.0, 0.0, 2.0]) == pytest.approx(expected, abs=5e-7)


def test_payloads_are_part_of_the_platform():
    payload = (
        "  payloads:\n    - {name: p, mass: 2 kg, center_of_mass: [0.1, 0, -0.5], "
        "inertia: [0.01, 0.01, 0.01]}\n"
    )
    text = changed("  air_drag:", payload + "  air_drag:")
    text = text.replace("  home: assumed", "  home: assumed\n  platform.payloads: weighed")
    robot, bare = parse_robot(text), ct.load_robot("carosac")
    assert robot.mass == pytest.approx(25.655)
    center = (bare.mass * bare.center_of_mass + 2.0 * np.array([0.1, 0.0, -0.5])) / 25.655
    assert robot.center_of_mass == pytest.approx(center)
    reduced = 2.0 * 23.655 / 25.655
    arm = np.array([0.1, 0.0, -0.5]) - bare.center_of_mass
    steiner = reduced * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    assert robot.inertia == pytest.approx(bare.inertia + 0.01 * np.eye(3) + steiner)


def test_pulleys_spread_own_limits_and_rotation_reach_the_robot():
    text = robot_text("carosac").replace(
        "]}\n",
        "], sigma: [1 mm, 2 mm, 3 mm], pulley: {radius: 50 mm, swivel_axis: [0, 0, -1]}}\n",
        4,
    )
    text = text.replace("anchor_point: rear_left, cable: rope, winch: winch}",
                        "anchor_point: rear_left, cable: rope, winch: winch, run_length: 9 m, "
                        "tension_limits: {min: 6, max: 400}}")  # fmt: skip
    text = text.replace("home: {position: [0.4, -1.8, 2.2]}",
                        "home: {position: [0.4, -1.8, 2.2], rpy_deg: [10, 20, 30]}")  # fmt: skip
    text = text.replace("  home: assumed", "  home: assumed\n  chains: assumed")
    robot = parse_robot(text)
    assert robot.pulley_radius == pytest.approx(0.05)
    assert robot.exit_covariance[2] == pytest.approx(np.diag([1e-6, 4e-6, 9e-6]))
    assert robot.run_length == pytest.approx([8, 8, 8, 9])
    assert robot.tension_max == pytest.approx([500, 500, 500, 400])
    expected = Rotation.from_euler("ZYX", [30, 20, 10], degrees=True)
    assert robot.home_rotation == pytest.approx(expected.as_matrix(), abs=1e-15)
    w, x, y, z = np.roll(expected.as_quat(), 1)
    text = text.replace("rpy_deg: [10, 20, 30]", f"quaternion_wxyz: [{w}, {x}, {y}, {z}]")
    assert parse_robot(text).home_rotation == pytest.approx(expected.as_matrix(), abs=1e-12)


def test_stiffness_follows_from_modulus_and_either_area_or_density():
    density = changed("axial_stiffness: 0.95 MN",
                      "youngs_modulus: 130 GPa\n    material_density: 1440 kg/m^3")  # fmt: skip
    density = density.replace("  cable_types.rope.axial_stiffness:", "  cable_types.rope:")
    expected = 130e9 * 0.01055 / 1440.0
    assert parse_robot(density).axial_stiffness == pytest.approx(expected, rel=1e-12)
    area = density.replace("material_density: 1440 kg/m^3", "area: 7 mm^2")
    assert parse_robot(area).axial_stiffness == pytest.approx(910e3, rel=1e-12)


def test_a_robot_loads_without_the_heavy_packages():
    heavy = {"scipy", "warp", "matplotlib", "pyarrow", "osqp", "pinocchio", "casadi", "torch"}
    program = (
        "import sys, carosac_toolkit as ct\n"
        "assert 'numpy' not in sys.modules\n"
        "ct.load_robot('carosac')\n"
        f"print(sorted({heavy!r} & set(sys.modules)))\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "[]"


SENSORS = """sensors:
  lengths:
    delay: 33.1 ms
    cables:
      front_left: {offset: 12 mm, scale: 1.001}
      front_right: {offset: -5 mm, scale: 1}
      rear_right: {offset: 0, scale: 1}
      rear_left: {offset: 0, scale: 0.999}
  poses: {quaternion_wxyz: [0.8, 0, 0, 0.6]}

calibration:
  parameters: [mass, "exit_points[front_left].x"]
  covariance:
    - [0.04]
    - [1e-5, 4e-6]

provenance:
  sensors: a run with motion capture
  calibration: the same
"""


def calibrated_text(old="", new=""):
    """The bundled robot with what a calibration writes, and one thing changed."""
    assert old in SENSORS
    return robot_text("carosac").replace("provenance:\n", SENSORS.replace(old, new, 1))


def test_what_a_calibration_found_reaches_the_robot(tmp_path):
    robot = parse_robot(calibrated_text())
    assert robot.length_offset == pytest.approx([0.012, -0.005, 0.0, 0.0])
    assert robot.length_scale == pytest.approx([1.001, 1.0, 1.0, 0.999])
    assert robot.length_delay == pytest.approx(0.0331)
    assert robot.pose_rotation[:2, 0] == pytest.approx([0.28, 0.96])  # z by twice atan(0.6 / 0.8)
    assert robot.calibrated == ("mass", "exit_points[front_left].x")
    assert robot.calibration_covariance == pytest.approx(np.array([[0.04, 1e-5], [1e-5, 4e-6]]))
    robot.to_npz(tmp_path / "robot.npz")
    assert differing(Robot.from_npz(tmp_path / "robot.npz"), robot) == []


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("      rear_left: {", "      rear_lift: {", "cables.rear_lift: no such chain; allowed: "),
        ("      rear_left: {offset: 0, scale: 0.999}\n", "",
         "sensors.lengths.cables: rear_left missing; allowed: all chains"),
        ("scale: 1}", "scale: 0}", "cables.front_right.scale: got 0; allowed: .*> 0"),
        ("offset: 12 mm", "offset: 12 ms", "cables.front_left.offset: got '12 ms'; allowed: .* m"),
        ("delay: 33.1 ms", "delay: 33.1 mm", "sensors.lengths.delay: got '33.1 mm'"),
        ("[0.8, 0, 0, 0.6]", "[0.8, 0, 0, 0.7]", "sensors.poses.quaternion_wxyz: got"),
        ("    - [1e-5, 4e-6]\n", "", r"rows of \[1\] numbers; allowed: .*rows of 1 to 2 numbers"),
        ("[1e-5, 4e-6]", "[1e-2, 4e-6]", "calibration_covariance: .*positive semidefinite"),
        ("[mass,", "[weight,", "parameter: got 'weight'; allowed: a name such as exit_points"),
        ("[mass,", '["exit_points[front_left].x",', r"parameters\[1\]: .* each parameter once"),
        ("[front_left].x", "[front_lift].x", "allowed: a cable of .*front_left"),
        ("  sensors: a run with motion capture\n", "", "sensors: no provenance"),
        ("  calibration: the same\n", "", "calibration.*: no provenance"),
    ],
)  # fmt: skip
def test_faults_of_a_calibration_are_named(old, new, message):
    with pytest.raises(InvalidFile, match=message):
        parse_robot(calibrated_text(old, new))


def test_drums_have_a_gear_all_or_none_and_pay_out_the_longest_cable_through_their_tackle():
    text = robot_text("hangprinter")
    robot = parse_robot(text)
    assert robot.drum_gear.tolist() == [12.75] * 4
    assert robot.drum_advantage.tolist() == [2.0, 2.0, 2.0, 4.0]
    drum = "radius: 79.1999 mm, buildup: 0.06875 mm"
    with pytest.raises(InvalidFile, match=r"winches.d.drum: gear missing; allowed: a gear in all"):
        parse_robot(text.replace(f"{drum}, gear: 12.75", drum))
    with pytest.raises(InvalidFile, match=r"winches.d.drum.gear: got 0; allowed: .*> 0"):
        parse_robot(text.replace(f"{drum}, gear: 12.75", f"{drum}, gear: 0"))
    message = r"winches.d.drum.buildup: .* below radius\^2 / \(advantage \* length_max\)"
    with pytest.raises(InvalidFile, match=message):  # 4 of 5 m are 20 m of line, 1.4 m^2 of squares
        parse_robot(text.replace(drum, drum.replace("0.06875", "0.4")))
    plain = parse_robot(text.replace(", advantage: 4", ""))
    assert plain.drum_advantage.tolist() == [2.0, 2.0, 2.0, 1.0]
