from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import carosac_toolkit as ct
from carosac_toolkit.base.errors import CarosacError, InvalidField, InvalidFile
from carosac_toolkit.interchange.caspr import read_caspr
from carosac_toolkit.interchange.completion import complete, robot_and_text
from carosac_toolkit.robot.file import parse_robot
from tests.interchange.models import (
    COGIRO_LENGTHS,
    IPANEMA_LENGTH,
    REST,
    attachment,
    caspr_body,
    caspr_cable,
    caspr_cables,
    geometry,
    rotating_pulley,
    straight_cables,
    write_caspr,
)


def imported(folder, bodies, cables, rest=REST, **options):
    """The robot, after a round trip through its file."""
    draft = read_caspr(*write_caspr(folder, bodies, cables), **options)
    robot, text = robot_and_text(complete(draft, fragment=rest, name="rest.yaml"))
    assert parse_robot(text).provenance == robot.provenance
    return robot


def one_set(cables):
    return caspr_cables({"original": cables})


def test_ipanema_has_the_lengths_that_wirex_publishes(tmp_path):
    robot = imported(tmp_path, caspr_body(), one_set(straight_cables(*geometry("ipanema1"))))
    lengths = ct.straight_line.inverse_kinematics(robot, [[0.0, 0.0, 1.0]])
    assert lengths == pytest.approx(np.full((1, 8), IPANEMA_LENGTH), abs=1e-15)


def test_cogiro_is_the_bundled_one(tmp_path):
    bundled = ct.load_robot("cogiro")
    body = caspr_body(mass=bundled.mass, centre=bundled.center_of_mass, inertia=bundled.inertia)
    robot = imported(tmp_path, body, one_set(straight_cables(*geometry("cogiro"))))
    for name in ("exit_points", "anchor_points", "mass", "center_of_mass", "inertia"):
        assert np.array_equal(getattr(robot, name), getattr(bundled, name)), name
    lengths = ct.straight_line.inverse_kinematics(robot, [[0.0, 0.0, 2.0]])[0]
    assert lengths == pytest.approx(COGIRO_LENGTHS, abs=1e-6)


def test_attachments_to_the_centre_of_mass_are_moved_to_the_origin(tmp_path):
    exits, anchors = geometry("cogiro")
    centre = np.array([0.1, -0.2, 0.3])
    body = caspr_body(centre=centre)
    moved = imported(tmp_path, body, one_set(straight_cables(exits, anchors - centre, ref="com")))
    assert moved.anchor_points == pytest.approx(anchors, abs=1e-15)


def test_inertia_about_the_joint_is_moved_to_the_centre_of_mass(tmp_path):
    # Six point masses: what they have about both points is summed, not derived.
    points = np.array([[1, 2, 0], [0, 1, 1], [2, 0, 1], [1, 1, 3], [0, 0, 0], [2, 2, 2]]) * 0.1
    centre = points.mean(axis=0)

    def inertia(about):
        arms = points - about
        return sum(np.eye(3) * (a @ a) - np.outer(a, a) for a in arms)

    body = caspr_body(mass=6.0, centre=centre, inertia=inertia(np.zeros(3)), ref="joint")
    robot = imported(tmp_path, body, one_set(straight_cables(*geometry("ipanema1"))))
    assert robot.inertia == pytest.approx(inertia(centre), abs=1e-14)


def caspr_pulley_length(exit_point, entry, anchor, radius):
    """Arc and free length as BaseRotatingPulleyAttachment.m computes them."""
    plane = np.cross(entry, anchor - exit_point)
    plane = plane / np.linalg.norm(plane)
    to_axle = np.cross(plane, entry)
    axle = exit_point + radius * to_axle / np.linalg.norm(to_axle)
    rho = radius / np.linalg.norm(anchor - axle)
    leaving = (
        axle + rho**2 * (anchor - axle) - rho * np.sqrt(1 - rho**2) * np.cross(plane, anchor - axle)
    )
    start, end = (exit_point - axle) / radius, (leaving - axle) / radius
    return radius * np.arccos(start @ end) + np.linalg.norm(anchor - leaving)


def test_rotating_pulleys_have_the_lengths_of_caspr(tmp_path):
    exits, anchors = geometry("cogiro")
    rng = np.random.default_rng(3)
    entries = rng.normal(size=(8, 3)) * [0.2, 0.2, 1.0] + [0, 0, 2.0]  # of any length
    cables = [
        caspr_cable(str(i), rotating_pulley(a, 0.045, e), attachment(1, b))
        for i, (a, e, b) in enumerate(zip(exits, entries, anchors, strict=True))
    ]
    robot = imported(tmp_path, caspr_body(), one_set(cables))
    position, turn = np.array([0.3, -0.4, 1.2]), Rotation.from_rotvec([0.2, -0.1, 0.3])
    lengths = ct.straight_line.inverse_kinematics(robot, position[None], turn.as_matrix()[None])[0]
    expected = [
        caspr_pulley_length(a, e, position + turn.apply(b), 0.045)
        for a, e, b in zip(exits, entries, anchors, strict=True)
    ]
    assert lengths == pytest.approx(expected, abs=1e-12)
    eyelets = imported(tmp_path, caspr_body(), one_set(cables), pulleys=False)
    assert not eyelets.pulley_radius.any()


def test_home_is_the_initial_pose_in_euler_angles_from_the_parents_location(tmp_path):
    angles = [0.1, -0.2, 0.3]
    joint = 'q_initial="0.1 0.2 0.5 0.1 -0.2 0.3" q_min="-1 -1 0 -3 -3 -3" q_max="1 1 2 3 3 3"'
    body = caspr_body(joint=joint, location=[0.0, 0.0, 1.0])
    without = "\n".join(x for x in REST.splitlines() if not x.startswith(("home", "workspace")))
    cables = one_set(straight_cables(*geometry("ipanema1")))
    robot = imported(tmp_path, body, cables, without)
    assert robot.home_position == pytest.approx([0.1, 0.2, 1.5], abs=1e-15)
    expected = Rotation.from_euler("XYZ", angles).as_matrix()  # capital: about turned axes
    assert robot.home_rotation == pytest.approx(expected, abs=1e-14)
    assert robot.workspace_min == pytest.approx([-1, -1, 1])
    assert robot.workspace_max == pytest.approx([1, 1, 3])


def test_springs_and_limits_are_those_of_each_cable(tmp_path):
    exits, anchors = geometry("ipanema1")
    cables = straight_cables(exits, anchors)
    limits = "<K_cable>{}</K_cable><force_min>1</force_min><force_max>{}</force_max>"
    for i, (stiffness, high) in enumerate([(5e4, 100), (7e4, 200)]):
        cables[i] = caspr_cable(
            f"cable {i + 1}", attachment(0, exits[i]), attachment(1, anchors[i]),
            kind="cable_linear_spring", properties=limits.format(stiffness, high),
        )  # fmt: skip
    draft = read_caspr(*write_caspr(tmp_path, caspr_body(), one_set(cables)))
    kinds = draft.data["cable_types"]
    assert kinds["cable of cable 1"] == {"axial_stiffness": 5e4}
    assert kinds["cable of cable 2"] == {"axial_stiffness": 7e4}
    assert draft.data["chains"][1]["tension_limits"] == {"min": 1.0, "max": 200.0}
    assert draft.data["chains"][2]["tension_limits"] == {"min": 5.0, "max": 720.0}


def test_cable_sets_are_chosen_by_name(tmp_path):
    exits, anchors = geometry("ipanema1")
    both = {"original": straight_cables(exits, anchors), "low": straight_cables(exits - 1, anchors)}
    cables = caspr_cables(both)
    low = imported(tmp_path, caspr_body(), cables, cable_set="low")
    assert np.array_equal(low.exit_points, exits - 1)
    assert "cable set 'low'" in low.provenance["frame.exit_points"]
    with pytest.raises(
        InvalidField, match="--cable-set: got 'high'; allowed: one of original, low"
    ):
        imported(tmp_path, caspr_body(), cables, cable_set="high")


LINK = '<link_rigid num="2" name="arm"><joint type="REVOLUTE_XY"/><physical/></link_rigid>'
BOMB = """<!DOCTYPE cables [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;">
<!ENTITY c "&b;&b;&b;&b;&b;&b;&b;&b;">]><cables>&c;</cables>"""
LEAK = '<!DOCTYPE cables [<!ENTITY x SYSTEM "file:///etc/hostname">]><cables>&x;</cables>'


@pytest.mark.parametrize(
    ("bodies", "cables", "message"),
    [
        (caspr_body(more=LINK), "", "2 links \\(box, arm\\); allowed: one rigid link"),
        (caspr_body().replace("SPATIAL_EULER_XYZ", "PLANAR_XY"), "", "got 'PLANAR_XY'; allowed"),
        (caspr_body().replace("<mass>25.0</mass>", ""), "", "physical/mass: got nothing"),
        (caspr_body(), BOMB, "XML with entities of its own or external ones; refused"),
        (caspr_body(), LEAK, "XML with entities of its own or external ones; refused"),
        (caspr_body(), "<cables", "not XML"),
        (caspr_body(), "<cables/>", "no <cable_set>"),
        (caspr_body(mass=float("nan")), "", "physical/mass: got 'nan'; allowed: a bare number"),
    ],
)
def test_what_is_no_platform_on_cables_is_refused(tmp_path, bodies, cables, message):
    text = cables or one_set(straight_cables(*geometry("ipanema1")))
    with pytest.raises(CarosacError, match=message):
        read_caspr(*write_caspr(tmp_path, bodies, text))


def test_all_faults_of_the_cables_come_at_once(tmp_path):
    good = attachment(0, [0, 0, 1]), attachment(1, [0, 0, 0])
    screw = "<screw_base_rotating_pulley/>"
    cables = [
        caspr_cable("a", attachment(0, "1 m 2 m 3 m"), good[1]),
        caspr_cable("b", *good, properties="<force_max>7,5</force_max>"),
        caspr_cable("b", *good),
        caspr_cable("c", good[0], good[1] + attachment(1, [1, 1, 1])),
        caspr_cable("d", screw, good[1]),
        caspr_cable("e", *good, ref="cog"),
        caspr_cable("f", attachment(0, [1, 2]), good[1]),
        caspr_cable("g", good[0], attachment(2, [1, 2, 3])),
        caspr_cable("h", rotating_pulley([0, 0, 1], -0.1, [0, 0, 0]), good[1]),
    ]
    with pytest.raises(InvalidFile) as caught:
        read_caspr(*write_caspr(tmp_path, caspr_body(), one_set(cables)))
    for said in (
        "cable 'a'/location: got '1 m 2 m 3 m'; allowed: 3 bare numbers in m",
        "cable 'b'/force_max: got '7,5'",
        "cable 'b'@name: got 'b'; allowed: a name of its own",
        "cable 'c'/attachments: got 3 attachments",
        "cable 'd'/attachments: got <screw_base_rotating_pulley>",
        "cable 'e'@attachment_reference: got 'cog'; allowed: 'joint' or 'com'",
        "cable 'f'/location: got '1.0 2.0'",
        "cable 'g'/attachments: got <attachment> at link 2",
        "cable 'h'/cable_entry_vector: got 0 0 0; allowed: a direction",
    ):
        assert said in str(caught.value)


def test_points_kilometres_away_are_probably_in_millimetres(tmp_path):
    exits, anchors = geometry("ipanema1")
    cables = one_set(straight_cables(1000 * exits, 1000 * anchors))
    draft = read_caspr(*write_caspr(tmp_path, caspr_body(), cables))
    assert "is the file in mm?" in draft.warnings[0]
