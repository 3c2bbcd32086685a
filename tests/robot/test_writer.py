from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.base.yaml import load_yaml
from carosac_toolkit.robot.bundled_names import list_robots
from carosac_toolkit.robot.differences import differing
from carosac_toolkit.robot.file import parse_robot, robot_text
from carosac_toolkit.robot.model_error import ModelError
from carosac_toolkit.robot.writer import robot_document

SOURCE = "calibrated on a Sunday"


def spread(rng, count, size=3, sigma=1e-3):
    """Random covariances, shape (count, size, size)."""
    root = rng.normal(0.0, sigma, (count, size, size))
    return root @ root.swapaxes(1, 2) + 1e-9 * np.eye(size)


def other_numbers(robot, rng):
    """The robot with another value of everything that a calibration may change."""
    n = robot.n

    def near(value):
        return value * rng.uniform(0.98, 1.02, np.shape(value))

    drums = {}
    if robot.drum_radius is not None:
        drums = {"drum_radius": near(robot.drum_radius), "drum_buildup": near(robot.drum_buildup)}
    mixed = np.array([[2.0, 0.1, 0.0], [0.1, 3.0, -0.1], [0.0, -0.1, 2.5]])
    return replace(
        robot,
        **drums,
        exit_points=robot.exit_points + rng.normal(0.0, 0.01, (n, 3)),
        exit_covariance=spread(rng, n),
        anchor_points=robot.anchor_points + rng.normal(0.0, 0.01, (n, 3)),
        linear_density=near(robot.linear_density),
        axial_stiffness=near(robot.axial_stiffness),
        axial_damping=near(robot.axial_damping),
        exit_friction=rng.uniform(0.01, 0.1, n),
        anchor_friction=rng.uniform(0.01, 0.1, n),
        capstan_friction=rng.uniform(0.01, 0.1, n),
        length_hysteresis=rng.uniform(1e-4, 1e-3, n),
        run_length=robot.run_length + rng.uniform(0.0, 0.1, n),
        mass=1.1 * robot.mass,
        center_of_mass=robot.center_of_mass + rng.normal(0.0, 0.01, 3),
        inertia=mixed * robot.inertia[0, 0],
        drag=0.123,
        angular_drag=0.0456,
        angular_drag_axes=near(np.ones(3)),
        cable_drag=0.321,
        length_offset=rng.normal(0.0, 0.1, n),
        length_scale=near(np.ones(n)),
        length_delay=0.0331,
        pose_rotation=parse_robot(robot_text("carosac")).home_rotation
        @ np.array([[0.8, -0.6, 0.0], [0.6, 0.8, 0.0], [0.0, 0.0, 1.0]]),
        calibrated=("mass", "axial_stiffness", "length_delay"),
        calibration_covariance=spread(rng, 1)[0] * np.outer([1.0, 1e6, 1e-3], [1.0, 1e6, 1e-3]),
        model_error=ModelError(
            mass=0.02,
            length=1.234e-3,
            force=0.05,
            acceleration=6.7e-3,
            position=1.5e-3,
            rotation=3.1e-3,
        ),
        name="other",
        description="other numbers",
    )


@pytest.mark.parametrize("name", list_robots())
def test_every_bundled_robot_comes_back_with_other_numbers(name):
    text = robot_text(name)
    robot = other_numbers(parse_robot(text), np.random.default_rng(0))
    document = robot_document(text, robot, provenance=SOURCE)
    back = parse_robot(document)
    assert differing(back, replace(robot, provenance=back.provenance)) == []
    assert back.exit_points == pytest.approx(robot.exit_points, rel=1e-11)
    assert back.calibration_covariance == pytest.approx(robot.calibration_covariance, rel=1e-11)
    again = robot_document(document, back, provenance="nothing")
    assert again == document  # the same numbers change nothing


@pytest.mark.parametrize("name", list_robots())
def test_an_unchanged_robot_leaves_every_value_and_comment_of_its_file(name):
    text = robot_text(name)
    document = robot_document(text, parse_robot(text), provenance=SOURCE)
    assert load_yaml(document) == load_yaml(text)
    assert comments(document) == comments(text)
    assert SOURCE not in document


def test_a_drag_of_cables_that_is_no_longer_known_leaves_the_file():
    text = robot_text("carosac")
    plain = parse_robot(text)
    with_drag = robot_document(text, replace(plain, cable_drag=0.8), provenance=SOURCE)
    assert parse_robot(with_drag).cable_drag == 0.8
    without = robot_document(with_drag, plain, provenance=SOURCE)
    assert parse_robot(without).cable_drag is None and "cables: 0.8" not in without


def comments(text):
    return [line.partition("#")[2].strip() for line in text.splitlines() if "#" in line]


COMMENTED = (
    robot_text("carosac")
    .replace("frame:\n", "# the frame\nframe:\n")
    .replace("8.47185]}\n", "8.47185]}  # over the door\n")
    .replace("cable_types:\n", "# the rope came late\ncable_types:\n")
    .replace("winches:\n", "# all alike\nwinches:\n")
)


def rewritten(text, **changes):
    """The text of a robot with other numbers, and as plain data."""
    document = robot_document(text, replace(parse_robot(text), **changes), provenance=SOURCE)
    return document, load_yaml(document)


def test_comments_order_and_all_other_lines_stay():
    robot = parse_robot(COMMENTED)
    document, data = rewritten(
        COMMENTED,
        exit_points=robot.exit_points + 0.01,
        exit_covariance=np.tile(1e-6 * np.eye(3), (4, 1, 1)),
        length_offset=[0.1] * 4, length_scale=[1.0] * 4, length_delay=0.03,
        calibrated=("mass",), calibration_covariance=[[1.0]],
    )  # fmt: skip
    assert comments(document) == comments(COMMENTED)
    keys = list(load_yaml(COMMENTED))
    assert list(data) == [*keys[:-1], "sensors", "provenance", "calibration"]
    kept = document.splitlines()
    for line in COMMENTED.partition("provenance:")[0].splitlines():
        assert line in kept or line.startswith("    front_") or line.startswith("    rear_")


def test_only_what_changed_is_written_and_says_where_it_comes_from():
    text = robot_text("carosac")
    _, data = rewritten(text, mass=25.0)
    old = load_yaml(text)
    assert data["platform"].pop("mass") == "25 kg"
    old["platform"].pop("mass")
    assert data.pop("provenance") == old.pop("provenance") | {"platform.mass": SOURCE}
    assert data == old


def test_a_shared_cable_type_is_split_only_where_its_numbers_differ():
    text = robot_text("carosac")
    (rope,) = load_yaml(text)["cable_types"]
    _, same = rewritten(text, axial_stiffness=[9e5] * 4)
    assert list(same["cable_types"]) == [rope]
    assert same["cable_types"][rope]["axial_stiffness"] == "900000 N"
    robot = parse_robot(text)
    document, split = rewritten(text, axial_stiffness=[8e5, 9e5, 9e5, 9e5])
    assert list(split["cable_types"]) == [f"{rope}_{name}" for name in robot.cable_names]
    assert [chain["cable"] for chain in split["chains"]] == list(split["cable_types"])
    back = parse_robot(document)
    assert back.axial_stiffness.tolist() == [8e5, 9e5, 9e5, 9e5]
    assert np.array_equal(back.linear_density, robot.linear_density)


SHARED = (  # two cables that meet at one anchor point and leave from one exit point
    robot_text("carosac")
    .replace("anchor_point: front_right", "anchor_point: front_left")
    .replace("exit_point: rear_right", "exit_point: front_right")
    .replace("    rear_right: {position: [2.71727, 4.77495, 8.36403]}\n", "")
    .replace("    front_right: [0.21, -0.21, -0.011]\n", "")
)


def test_points_that_cables_share_are_split_only_where_they_come_apart():
    robot = parse_robot(SHARED)
    _, together = rewritten(
        SHARED, anchor_points=robot.anchor_points + 0.01, exit_points=robot.exit_points + 0.01
    )
    assert len(together["platform"]["anchor_points"]) == 3
    assert len(together["frame"]["exit_points"]) == 3
    apart = robot.anchor_points + 0.001 * np.arange(12.0).reshape(4, 3)
    covariance = np.einsum("i,jk->ijk", [1e-6, 2e-6, 3e-6, 4e-6], np.eye(3))
    document, data = rewritten(SHARED, anchor_points=apart, exit_covariance=covariance)
    assert set(data["platform"]["anchor_points"]) == {
        "front_left_front_left", "front_left_front_right", "rear_right", "rear_left",
    }  # fmt: skip
    assert len(data["frame"]["exit_points"]) == 4
    assert parse_robot(document).exit_covariance == pytest.approx(covariance)


def test_a_name_that_looks_like_a_number_is_found():
    text = robot_text("carosac").replace("    front_left: {position", "    1: {position")
    text = text.replace("exit_point: front_left", "exit_point: '1'")
    text = text.replace("  home: assumed", "  home: assumed\n  chains: counted")
    document, _ = rewritten(text, exit_points=parse_robot(text).exit_points + 0.01)
    assert parse_robot(document).exit_points[0, 0] == pytest.approx(-1.97747)


PAYLOAD = (
    robot_text("carosac")
    .replace(
        "  air_drag:",
        "  payloads:\n    - {name: camera, mass: 2 kg, center_of_mass: [0, 0.1, 0.2], "
        "inertia: [0.01, 0.02, 0.02]}\n  air_drag:",
    )
    .replace("  home: assumed", "  home: assumed\n  platform.payloads: weighed")
)


def test_payloads_are_taken_off_the_platform_that_was_estimated_with_them():
    robot = parse_robot(PAYLOAD)
    heavier = robot.mass + 3.0
    document, data = rewritten(PAYLOAD, mass=heavier, center_of_mass=[0.01, 0.02, -0.08])
    back = parse_robot(document)
    assert back.mass == pytest.approx(heavier)
    assert back.center_of_mass == pytest.approx([0.01, 0.02, -0.08])
    assert back.inertia == pytest.approx(robot.inertia)
    bare = float(data["platform"]["mass"].split()[0])
    assert bare == pytest.approx(heavier - 2.0)
    center = (heavier * np.array([0.01, 0.02, -0.08]) - 2.0 * np.array([0, 0.1, 0.2])) / bare
    assert data["platform"]["center_of_mass"] == pytest.approx(center)
    assert data["platform"]["payloads"] == load_yaml(PAYLOAD)["platform"]["payloads"]
    sources = data["provenance"]
    assert sources["platform.payloads"] == "weighed"
    assert sources["platform.inertia"] == SOURCE  # that of the bare platform is another one


@pytest.mark.parametrize("changes", [{"mass": 1.9}, {"inertia": 0.01 * np.eye(3)}])
def test_a_platform_lighter_than_its_payloads_is_refused(changes):
    message = "mass: got .* kg; allowed: a mass and inertia above those of the payloads"
    with pytest.raises(InvalidField, match=message):
        rewritten(PAYLOAD, **changes)


def test_stiffness_takes_the_place_of_modulus_and_density():
    text = robot_text("cogiro")
    robot, kind = parse_robot(text), load_yaml(text)["cable_types"]["steel"]
    assert "youngs_modulus" in kind and "material_density" in kind
    _, data = rewritten(text, axial_stiffness=1.1 * robot.axial_stiffness)
    (steel,) = data["cable_types"].values()
    assert set(kind) - set(steel) == {"youngs_modulus", "material_density"}
    document, _ = rewritten(text, linear_density=1.1 * robot.linear_density)
    assert parse_robot(document).axial_stiffness == pytest.approx(robot.axial_stiffness)


def test_pulleys_and_unused_points_keep_their_source():
    text = robot_text("carosac").replace(
        "8.47185]}\n", "8.47185], pulley: {radius: 0.05, swivel_axis: [0, 0, 1]}}\n"
    )
    text = text.replace("platform:\n", "    spare: {position: [0, 0, 8]}\nplatform:\n", 1)
    source = load_yaml(text)["provenance"]["frame.exit_points"]
    _, data = rewritten(text, exit_points=parse_robot(text).exit_points + 0.01)
    assert data["provenance"]["frame.exit_points"] == SOURCE
    assert data["provenance"]["frame.exit_points.front_left.pulley"] == source
    assert data["provenance"]["frame.exit_points.spare"] == source
    assert data["frame"]["exit_points"]["spare"]["position"] == [0, 0, 8]


def test_a_later_calibration_of_one_sensor_keeps_the_sources_of_the_others():
    first, _ = rewritten(robot_text("carosac"), length_offset=[0.1] * 4, length_scale=[1.0] * 4,
                         length_delay=0.03)  # fmt: skip
    robot = replace(parse_robot(first), length_delay=0.04)
    sources = load_yaml(robot_document(first, robot, provenance="later"))["provenance"]
    assert sources["sensors.lengths"] == SOURCE and sources["sensors.lengths.delay"] == "later"


def test_a_run_that_a_chain_has_of_its_own_has_one_source():
    text = robot_text("scampi")
    runs = [path for path in load_yaml(text)["provenance"] if path.endswith(".run_length")]
    assert runs
    _, data = rewritten(text, run_length=np.full(4, 0.1))
    sources = {path: each for path, each in data["provenance"].items() if "run_length" in path}
    assert sources == {f"chains[{i}].run_length": SOURCE for i in range(4)}


def test_small_covariances_are_noticed_beside_large_ones():
    """A newton and a millimetre in one matrix: each entry counts by its own units."""
    known = {"calibrated": ("axial_stiffness", "exit_points[front_left].x")}
    text, _ = rewritten(robot_text("carosac"), **known,
                        calibration_covariance=np.diag([1e10, 1e-6]))  # fmt: skip
    document, _ = rewritten(text, calibration_covariance=np.diag([1e10, 4e-6]))
    assert parse_robot(document).calibration_covariance[1, 1] == pytest.approx(4e-6)


@pytest.mark.parametrize(
    "changes",
    [
        {"pulley_radius": [0.05] * 4},
        {"cable_names": ("a", "b", "c", "d")},
        {"tension_max": [600.0] * 4},
        {"gravity": 9.8},
    ],
)
def test_what_is_not_calibrated_is_refused(changes):
    (name,) = changes
    with pytest.raises(InvalidField, match=f"{name}: got another value; allowed: the value of the"):
        rewritten(robot_text("carosac"), **changes)


def test_another_robot_is_refused():
    eight = parse_robot(robot_text("cogiro"))
    with pytest.raises(InvalidField, match="allowed: the value of the old robot file"):
        robot_document(robot_text("carosac"), eight, provenance=SOURCE)


def test_the_same_robot_gives_the_same_file():
    """Sources stand in the order of the fields, not in one that changes from run to run."""
    text = robot_text("scampi")
    robot = parse_robot(text)
    fields = (
        "linear_density", "axial_stiffness", "axial_damping", "exit_friction", "anchor_friction",
        "capstan_friction",
    )  # fmt: skip
    other = replace(robot, **{name: 1.1 * getattr(robot, name) + 1e-3 for name in fields})
    sources = load_yaml(robot_document(text, other, provenance=SOURCE))["provenance"]
    changed = [path.split(".")[-1] for path, source in sources.items() if source == SOURCE]
    assert [name for name in changed if name in fields] == list(fields)
