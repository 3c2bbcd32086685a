from dataclasses import replace

import numpy as np
import pytest

import carosac_toolkit as ct
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.robot.differences import differing
from carosac_toolkit.robot.file import parse_robot, robot_text
from carosac_toolkit.robot.hardware import AdsAddress, Hardware, ImuSource
from carosac_toolkit.robot.writer import robot_document

SECTION = """
hardware:
  ads: {net_id: 192.168.1.10.1.1, ip: 192.168.1.10, timeout: 80 ms}
  cables:
    front_left: {sign: -1, scale: 1 mm, offset: 12 m}
    front_right: {sign: 1, scale: 1 mm}
    rear_right: {sign: 1, scale: 1 mm}
    rear_left: {sign: 1, scale: 2 mm}
  imu: {source: udp, port: 5005}
"""


def test_the_section_becomes_hardware_and_survives_npz_and_the_writer(tmp_path):
    text = robot_text("carosac") + SECTION
    robot = parse_robot(text)
    hardware = robot.hardware
    assert hardware.sign == (-1, 1, 1, 1) and hardware.scale[3] == pytest.approx(2e-3)
    assert hardware.ads == AdsAddress(net_id="192.168.1.10.1.1", ip="192.168.1.10", timeout=0.08)
    assert hardware.imu == ImuSource(port=5005)
    robot.to_npz(tmp_path / "robot.npz")
    assert differing(ct.Robot.from_npz(tmp_path / "robot.npz"), robot) == []
    written = robot_document(text, replace(robot, mass=24.5), provenance="weighed")
    assert parse_robot(written).hardware == hardware
    assert ct.load_robot("carosac").hardware is None


def test_numbers_and_lengths_are_inverse_to_each_other():
    hardware = parse_robot(robot_text("carosac") + SECTION).hardware
    lengths = np.array([9.0, 8.5, 8.0, 7.5])
    numbers = hardware.number(lengths)
    assert numbers == pytest.approx([3000, 8500, 8000, 3750])
    assert hardware.length(numbers) == pytest.approx(lengths)
    assert hardware.unit == pytest.approx([-1e-3, 1e-3, 1e-3, 2e-3])


def test_faults_of_the_section_come_with_line_field_value_and_what_is_allowed():
    wrong = (
        SECTION.replace("-1,", "2,").replace("192.168.1.10.1.1", "192.168.1")
        .replace("port: 5005", "port: 0").replace("rear_left: {", "rear_lefd: {")
    )  # fmt: skip
    with pytest.raises(ct.InvalidFile) as caught:
        parse_robot(robot_text("carosac") + wrong)
    text = "\n".join(caught.value.faults)
    assert "hardware.ads.net_id: got '192.168.1'; allowed: six numbers" in text
    assert "hardware.cables.front_left.sign: got 2; allowed: 1 or -1" in text
    assert "hardware.imu.port: got 0; allowed: a whole number, 1 to 65535" in text
    with pytest.raises(ct.InvalidFile, match="rear_lefd: no such chain"):
        parse_robot(robot_text("carosac") + SECTION.replace("rear_left: {", "rear_lefd: {"))


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"sign": (1, 1, 0, 1)}, r"hardware.sign\[2\]: got 0.0; allowed: 1 or -1"),
        ({"scale": (1, -1, 1, 1)}, r"hardware.scale\[1\]"),
        ({"offset": (0, 0)}, "hardware.offset: got 2 numbers; allowed: one for each of 4"),
        ({"offset": (0, 0, np.nan, 0)}, r"hardware.offset\[2\]"),
    ],
)
def test_hardware_refuses_what_turns_no_unit_into_metres(change, match):
    with pytest.raises(InvalidField, match=match):
        replace(Hardware.loopback(4), **change)


def test_a_sensor_that_others_could_pretend_to_be_needs_its_address():
    with pytest.raises(InvalidField, match=r"hardware.imu.sender: got none; allowed: the IP"):
        ImuSource(ip="0.0.0.0")
    with pytest.raises(InvalidField, match=r"hardware.imu.sender: got 'sensor'; allowed: an IP"):
        ImuSource(sender="sensor")
    source = ImuSource(ip="192.168.0.2", sender="192.168.0.7")
    assert source.is_sender("192.168.0.7") and not source.is_sender("127.0.0.1")


def test_hardware_is_for_all_cables_of_the_robot():
    with pytest.raises(InvalidField, match="hardware: got 3 cables; allowed: 4 cables"):
        replace(ct.load_robot("carosac"), hardware=Hardware.loopback(3))
