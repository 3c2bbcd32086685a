from __future__ import annotations

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import carosac_toolkit as ct
from carosac_toolkit.base.errors import InvalidFile
from carosac_toolkit.base.yaml import dump_yaml
from carosac_toolkit.interchange.cdpyr import read_cdpyr
from carosac_toolkit.interchange.completion import complete, robot_and_text
from tests.interchange.models import COGIRO_LENGTHS, REST, cdpyr, geometry


def draft_of(folder, data, suffix=".json", **options):
    path = folder / f"box{suffix}"
    text = json.dumps(data) if suffix == ".json" else dump_yaml(data)
    path.write_text(text, encoding="utf-8")
    return read_cdpyr(path, **options)


CENTRE = REST.replace("platform: {", "platform: {center_of_mass: [0, 0, 0], ")


def imported(folder, data, suffix=".json", **options):
    draft = draft_of(folder, data, suffix, **options)
    return robot_and_text(complete(draft, fragment=CENTRE, name="rest"))[0]


@pytest.mark.parametrize("suffix", [".json", ".yaml"])
def test_chains_by_number_keep_their_lengths(tmp_path, suffix):
    robot = imported(tmp_path, cdpyr(*geometry("cogiro")), suffix)
    lengths = ct.straight_line.inverse_kinematics(robot, [[0.0, 0.0, 2.0]])[0]
    assert lengths == pytest.approx(COGIRO_LENGTHS, abs=1e-6)
    bundled = ct.straight_line.inverse_kinematics(ct.load_robot("cogiro"), [[0.0, 0.0, 2.0]])[0]
    assert np.array_equal(lengths, bundled)
    assert robot.mass == 25.0


def cdpyr_pulley_length(anchor, base, frame, pulley, radius):
    """Free length and arc as cdpyr's kinematics/pulley.py computes them."""
    local = pulley.T @ frame.T @ (anchor - base)
    swivel = np.arctan2(local[1], local[0])
    from_roller = Rotation.from_euler("z", swivel).as_matrix().T @ local - [radius, 0, 0]
    free = np.sqrt(from_roller @ from_roller - radius**2)
    matrix = np.array([[radius, free], [-free, radius]])
    leave = np.linalg.solve(matrix, from_roller[[0, 2]])
    return free + radius * (np.pi - np.arctan2(leave[1], leave[0]))


def test_pulleys_turn_about_z_of_anchor_and_pulley(tmp_path):
    exits, anchors = geometry("cogiro")
    rng = np.random.default_rng(1)
    frames = Rotation.from_rotvec(0.3 * rng.normal(size=(8, 3))).as_matrix()
    turns = Rotation.from_rotvec(0.2 * rng.normal(size=(8, 3))).as_matrix()
    pulleys = [(frame, turn, 0.1) for frame, turn in zip(frames, turns, strict=True)]
    robot = imported(tmp_path, cdpyr(exits, anchors, pulleys=pulleys))
    position, turn = np.array([0.5, 0.2, 1.1]), Rotation.from_rotvec([0.1, 0.2, -0.1])
    lengths = ct.straight_line.inverse_kinematics(robot, position[None], turn.as_matrix()[None])[0]
    expected = [
        cdpyr_pulley_length(position + turn.apply(b), a, *pulley)
        for a, b, pulley in zip(exits, anchors, pulleys, strict=True)
    ]
    assert lengths == pytest.approx(expected, abs=1e-12)


def test_inertia_with_an_offset_centre_needs_its_reference_point(tmp_path):
    data = cdpyr(*geometry("cogiro"))
    data["platforms"][0]["center_of_gravity"] = [0.1, 0.0, 0.2]
    draft = draft_of(tmp_path, data)
    assert ("platform", "inertia") in [path for path, _ in complete(draft).missing]
    own = draft_of(tmp_path, data, inertia_about="center_of_mass")
    about = draft_of(tmp_path, data, inertia_about="origin")
    difference = np.subtract(own.data["platform"]["inertia"], about.data["platform"]["inertia"])
    arm = np.array([0.1, 0.0, 0.2])
    assert difference == pytest.approx(25.0 * (np.eye(3) * (arm @ arm) - np.outer(arm, arm)))


def test_inertia_without_a_centre_is_not_taken_to_be_about_it(tmp_path):
    data = cdpyr(*geometry("cogiro"))
    data["platforms"][0].pop("center_of_gravity", None)
    for about in (None, "origin"):
        draft = draft_of(tmp_path, data, inertia_about=about)
        assert ("platform", "inertia") in [path for path, _ in complete(draft).missing]
    own = draft_of(tmp_path, data, inertia_about="center_of_mass")
    assert "said to be about its centre of mass" in own.provenance["platform.inertia"]


def test_gravity_and_stiffness_are_asked_for(tmp_path):
    missing = [path for path, _ in complete(draft_of(tmp_path, cdpyr(*geometry("cogiro")))).missing]
    assert ("gravity",) in missing and ("cable_types", "cable", "axial_stiffness") in missing
    assert ("cable_types", "cable", "diameter") not in missing


def broken(change):
    data = cdpyr(*geometry("ipanema1"))
    change(data)
    return data


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: d["kinematic_chains"][2].update(cable=8), "[2].cable: got 8; allowed: a number"),
        (lambda d: d["kinematic_chains"][2].update(cable=1.5), "[2].cable: got 1.5"),
        (lambda d: d["kinematic_chains"][1].pop("frame_anchor"), "frame_anchor: got nothing"),
        (lambda d: d["platforms"].append({}), "platforms: got 2; allowed: one"),
        (lambda d: d["platforms"][0].update(motion_pattern="2R3T"), "got '2R3T'; allowed: '3R3T'"),
        (lambda d: d["frame"]["anchors"][0].update(position=[1, 2]), "position: got [1, 2]"),
        (lambda d: d["cables"][0].update(diameter="2 mm"), "diameter: got '2 mm'; allowed: a bare"),
        (lambda d: d.pop("frame"), "frame: got nothing; allowed: a mapping"),
        (lambda d: d["platforms"][0]["inertia"].update(linear=[1, 2, 3]), "a mass times the unit"),
    ],
)
def test_faults_name_their_place(tmp_path, change, message):
    with pytest.raises(InvalidFile) as caught:
        draft_of(tmp_path, broken(change))
    assert message in str(caught.value)


@pytest.mark.parametrize("text", ["{", '{"a": ' * 100_000, "[1, 2]", "null", "\x00"])
def test_no_json_of_cdpyr_is_refused(tmp_path, text):
    path = tmp_path / "x.json"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InvalidFile):
        read_cdpyr(path)
