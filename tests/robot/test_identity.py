from dataclasses import fields, replace

import numpy as np
import pytest

import carosac_toolkit as ct
from carosac_toolkit.robot.file import parse_robot, robot_path, robot_text
from carosac_toolkit.robot.hardware import AdsAddress, Hardware, ImuSource
from carosac_toolkit.robot.identity import machine_hash
from carosac_toolkit.robot.model_error import ModelError
from carosac_toolkit.robot.robot import Robot
from tests.robots import simple_robot

DRUMS = dict.fromkeys(("drum_radius", "drum_gear", "drum_advantage"), np.full(4, 2.0))
ROBOT = simple_robot(
    **DRUMS, drum_buildup=np.full(4, 1e-4), hardware=Hardware.loopback(4), cable_drag=0.5
)
CALIBRATED = ("calibrated", "calibration_covariance")
OTHER_VALUES = {
    "name": "x", "description": "x", "licence": "x", "provenance": {"x": "y"},
    "calibrated": ("mass",), "calibration_covariance": np.eye(1),
    "exit_covariance": np.broadcast_to(np.eye(3), (4, 3, 3)), "length_offset": np.ones(4),
    "length_scale": np.full(4, 1.1), "length_delay": 0.1, "pose_rotation": np.diag([-1, -1, 1]),
    "model_error": ModelError(
        mass=0.02, length=1e-3, force=0.1, acceleration=1e-3, position=1e-3, rotation=1e-3
    ),
    "home_position": ROBOT.home_position + 0.1, "home_rotation": np.diag([-1.0, -1.0, 1.0]),
}  # fmt: skip


def test_the_hash_is_this_number_on_every_machine_and_for_name_and_path():
    """A hash that moved with the platform or the version would stop every robot."""
    assert machine_hash(ct.load_robot("carosac")) == 0x47630ED250FC627E
    assert machine_hash(ct.load_robot(robot_path("carosac"))) == 0x47630ED250FC627E


def test_comments_order_of_keys_and_units_do_not_change_the_hash():
    text = robot_text("carosac")
    lines = text.replace("mass: 23.655 kg", "mass: 23655 g  # weighed").replace(
        "axial_stiffness: 0.95 MN", "axial_stiffness: 950000"
    ).replace("speed_max: 2.5 m/s", "speed_max: 2500 mm/s").replace(
        "{position: [-1.98747, -8.31966, 8.47185]}",
        "{position: [-1987.47 mm, -831.966 cm, 8.47185]}",
    ).replace("{center: [0.4, -1.8, 3.0], size: [4, 4, 4]}",
              "{max: [2.4, 0.2, 5], min: [-1.6, -3.8, 1]}")  # fmt: skip
    sections = lines.split("\n\n")
    moved = "\n\n".join([*sections[:2], sections[3], sections[2], *sections[4:]])
    assert moved != text
    assert machine_hash(parse_robot(moved)) == machine_hash(ct.load_robot("carosac"))


def test_a_robot_survives_npz_with_its_hash(tmp_path):
    ROBOT.to_npz(tmp_path / "robot.npz")
    assert machine_hash(ct.Robot.from_npz(tmp_path / "robot.npz")) == machine_hash(ROBOT)


@pytest.mark.parametrize("name", [f.name for f in fields(Robot) if f.name != "hardware"])
def test_every_number_of_the_machine_changes_the_hash_and_nothing_else_does(name):
    value = getattr(ROBOT, name)
    if name in OTHER_VALUES:
        pair = CALIBRATED if name in CALIBRATED else (name,)  # a robot has both or neither
        changed = replace(ROBOT, **{x: OTHER_VALUES[x] for x in pair})
        assert machine_hash(changed) == machine_hash(ROBOT)
        return
    if name == "cable_names":
        changed = replace(ROBOT, cable_names=value[::-1])
    elif name == "swivel_axis":
        changed = replace(ROBOT, swivel_axis=-value)
    elif np.ndim(value) == 0:
        changed = replace(ROBOT, **{name: value + 1e-6})
    else:
        one = np.zeros_like(value)
        one.flat[0] = 1e-6
        changed = replace(ROBOT, **{name: value + one})
    assert machine_hash(changed) != machine_hash(ROBOT)


def test_no_drag_is_another_machine_than_the_usual_one():
    plain = replace(ROBOT, cable_drag=None)
    assert machine_hash(replace(ROBOT, cable_drag=0.0)) != machine_hash(plain)
    assert machine_hash(replace(ROBOT, angular_drag_axes=np.zeros(3))) != machine_hash(ROBOT)


def test_of_the_connection_sign_and_scale_count_and_addresses_and_offset_do_not():
    hardware = ROBOT.hardware

    def hashed(**changes):
        return machine_hash(replace(ROBOT, hardware=replace(hardware, **changes)))

    same = machine_hash(ROBOT)
    assert hashed(ads=AdsAddress(ip="192.0.2.1", machine="Main.machine")) == same
    assert hashed(imu=ImuSource(), offset=(1.0, 2.0, 3.0, 4.0)) == same
    assert machine_hash(replace(ROBOT, hardware=None)) == same  # a PLC that counts metres
    assert hashed(sign=(1, 1, -1, 1)) != same
    assert hashed(scale=(1, 1, 1, 1e-3)) != same


def test_chains_in_another_order_are_another_machine():
    turned = replace(ROBOT, **{
        name: getattr(ROBOT, name)[[1, 0, 2, 3]] for name in ("exit_points", "anchor_points")
    })  # fmt: skip
    assert machine_hash(turned) != machine_hash(ROBOT)


def test_rounding_far_below_a_robot_file_does_not_change_the_hash():
    noise = 1.0 + 4e-16 * np.array([-1.0, 1.0, 1.0])
    nudged = replace(
        ROBOT, exit_points=ROBOT.exit_points * noise, mass=np.nextafter(ROBOT.mass, 99.0),
        center_of_mass=ROBOT.center_of_mass + np.array([5e-17, -5e-17, 0.0]),
    )  # fmt: skip
    assert machine_hash(nudged) == machine_hash(ROBOT)
