from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import carosac_toolkit as ct
from carosac_toolkit.base.errors import InvalidFile
from carosac_toolkit.interchange.completion import complete, robot_and_text
from carosac_toolkit.interchange.wirex import read_wirex
from tests.interchange.models import (
    IPANEMA_LENGTH,
    REST,
    WIREX_CABLE,
    WIREX_PLATFORM,
    WIREX_WINCH,
    geometry,
    wirex,
)

BODY = "\nplatform: {mass: 5 kg, center_of_mass: [0, 0, 0], inertia: [1, 1, 1], "
OWN = REST.replace("\nplatform: {", BODY)


def draft_of(folder, text, **options):
    path = folder / "IPAnema.wcrfx"
    path.write_text(text, encoding="utf-8")
    return read_wirex(path, **options)


def imported(folder, text, **options):
    return robot_and_text(complete(draft_of(folder, text, **options), fragment=OWN, name="r"))[0]


def test_ipanema_has_the_lengths_of_wirex_unit_tests(tmp_path):
    text = wirex(*geometry("ipanema1"), radius=0.1)
    robot = imported(tmp_path, text, pulleys=False)
    lengths = ct.straight_line.inverse_kinematics(robot, [[0.0, 0.0, 1.0]])
    assert lengths == pytest.approx(np.full((1, 8), IPANEMA_LENGTH), abs=1e-15)


def wirex_pulley_length(base, axis, anchor, radius):
    """Arc and free length: axle, wrap by the law of cosines, as in Kinematics.cpp."""
    to_anchor = anchor - base
    across = np.cross(np.cross(axis, to_anchor), axis)
    axle = base + radius * across / np.linalg.norm(across)
    a, b = np.linalg.norm(to_anchor), np.linalg.norm(anchor - axle)
    inner = np.arccos((b * b + radius**2 - a * a) / (2 * b * radius))
    touch = np.arccos(radius / b)
    wrap = inner - touch if axis @ to_anchor > 0 else 2 * np.pi - inner - touch
    return wrap * radius + np.sqrt(b * b - radius**2)


def test_pulleys_turn_about_the_third_column_of_their_frame(tmp_path):
    exits, anchors = geometry("ipanema1")
    frames = Rotation.from_rotvec(np.random.default_rng(0).normal(size=(8, 3)) * 0.3).as_matrix()
    robot = imported(tmp_path, wirex(exits, anchors, frames=frames, radius=0.1))
    position, turn = np.array([0.1, 0.2, 1.1]), Rotation.from_rotvec([0.1, 0.2, -0.1])
    lengths = ct.straight_line.inverse_kinematics(robot, position[None], turn.as_matrix()[None])[0]
    expected = [
        wirex_pulley_length(a, frame[:, 2], position + turn.apply(b), 0.1)
        for a, b, frame in zip(exits, anchors, frames, strict=True)
    ]
    assert lengths == pytest.approx(expected, abs=1e-12)


def test_zero_and_partial_numbers_are_missing_not_taken(tmp_path):
    text = wirex(
        *geometry("ipanema1"), platform=WIREX_PLATFORM, cable=WIREX_CABLE, winch=WIREX_WINCH
    )
    draft = draft_of(tmp_path, text)
    missing = {".".join(map(str, path)) for path, _ in complete(draft).missing}
    assert {
        "platform.inertia",
        "winches.Winde.acceleration_max",
        "winches.Winde.length_min",
    } <= missing
    assert {"tension_limits.min", "cable_types.cable.axial_stiffness", "gravity"} <= missing
    known = {"platform.mass", "winches.Winde.speed_max", "tension_limits.max"}
    assert not known & missing
    assert "inertiatensor with Ixx alone" in draft.dropped
    assert any("WireX's defaults" in warning for warning in draft.warnings)
    assert draft.data["cable_types"]["cable"]["diameter"] == 0.006  # the file has a radius


def test_a_modulus_needs_its_area_or_gives_way_to_the_stiffness(tmp_path):
    text = wirex(*geometry("ipanema1"), cable=WIREX_CABLE)
    rest = OWN.replace("axial_stiffness: 120 kN", "area: 2 mm^2")
    robot, _ = robot_and_text(complete(draft_of(tmp_path, text), fragment=rest, name="r"))
    assert robot.axial_stiffness == pytest.approx(110e9 * 2e-6, rel=1e-15)
    assert imported(tmp_path, text).axial_stiffness == pytest.approx(120e3, rel=1e-15)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (wirex([[0, 0, 1]], [[0, 0, 0]], pattern="2T"), "motionpattern: got '2T'; allowed: '3R3T'"),
        (wirex([[0, 0, 1]] * 2, [[0, 0, 0]] * 2, ids=["1", "1"]), "an id of its own"),
        (wirex([], []), "no <chain>"),
        (wirex([[0, 0, 1]], [[0, 0, 0]]).replace(' x="0.0"', ""), "@x: got nothing"),
        (
            wirex([[0, 0, 1]], [[0, 0, 0]], frames=[np.diag([1, 1, 2.0])], radius=0.1),
            "a11 ... a33: got no rotation",
        ),
        (wirex([[0, 0, 1]], [[0, 0, 0]], cable=WIREX_CABLE * 2), "2 cable types"),
        ("<models/>", "0 robots in <models>"),
    ],
)
def test_what_cannot_be_read_is_refused(tmp_path, text, message):
    with pytest.raises(InvalidFile, match=message.replace(".", r"\.")):
        draft_of(tmp_path, text)
