"""The numbers of a network are inputs of a plan, and what follows from them by the mechanics."""

from __future__ import annotations

from dataclasses import replace
from itertools import accumulate, pairwise

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import carosac_toolkit as ct
from baselines.mpc import model
from carosac_toolkit.physics.rest.structure import structure_matrix
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.robot.similar import similar_robot
from learned.approximate_mpc.plan_inputs import (
    DAMPING,
    PULLED_EVERY,
    PlanInputs,
    PlanNumbers,
    _blocks,
    input_count,
    input_units,
    usual_tension,
)
from tests.robots import hanging

STAGES = 20
NAMES = (
    "usual", "place", "turn", "velocity", "spin", "way", "faster", "center", "push", "moment",
    "usual_place", "along", "length", "free", "turning", "pulls_way", "pulls_faster", "pulls",
    "spinning", "turned", "behind",
)  # fmt: skip


@pytest.fixture(scope="module", params=["carosac", "three cables"])
def told(request):
    """Return a robot, inputs, and the numbers by their names."""
    robot = ct.load_robot("carosac") if request.param == "carosac" else hanging(3)
    rng = np.random.default_rng(5)
    turned = Rotation.from_rotvec([0.3, -0.2, 0.4]).as_matrix()
    inputs = PlanInputs(
        position=robot.home_position + rng.normal(size=3) * 0.1,
        rotation=turned @ robot.home_rotation,
        twist=rng.normal(size=6),
        target=robot.home_position + rng.normal(size=(STAGES + 1, 3)),
        target_velocity=rng.normal(size=(STAGES + 1, 3)),
        center=0.02 * rng.normal(size=3),
        acceleration=rng.normal(size=6),
        usual_tension=robot.weight / robot.n * rng.uniform(0.5, 2.0, robot.n),
        usual_place=rng.normal(size=3),
    )
    reader = PlanNumbers(robot, STAGES)
    numbers = reader.of(inputs)
    assert len(numbers) == input_count(robot, STAGES) == reader.count(STAGES)
    edges = [0, *accumulate(count for _, count in _blocks(robot, STAGES))]
    parts = {name: numbers[a:b] for name, (a, b) in zip(NAMES, pairwise(edges), strict=True)}
    return robot, inputs, parts


def test_inputs_are_told_from_the_platform(told):
    robot, inputs, parts = told
    middle = 0.5 * (robot.workspace_min + robot.workspace_max)
    half = 0.5 * (robot.workspace_max - robot.workspace_min)
    assert parts["place"] * half + middle == pytest.approx(inputs.position)
    turn = model.parameters_of(inputs.rotation @ robot.home_rotation.T)
    assert parts["turn"] == pytest.approx(turn, abs=1e-12)
    twist = np.concatenate([parts["velocity"], parts["spin"]])
    assert twist == pytest.approx(inputs.twist)
    assert parts["way"].reshape(-1, 3) + inputs.position == pytest.approx(inputs.target)
    velocity = parts["faster"].reshape(-1, 3) + inputs.twist[:3]
    assert velocity == pytest.approx(inputs.target_velocity)
    kept = np.concatenate([parts[k] for k in ("center", "push", "moment", "usual_place")])
    told_so = np.concatenate([inputs.center, inputs.acceleration, inputs.usual_place])
    assert kept == pytest.approx(told_so)


def test_usual_tensions_are_read_back(told):
    robot, inputs, parts = told
    numbers = np.concatenate([*parts.values()])
    found = usual_tension(robot, np.stack([numbers, 2.0 * numbers]))
    assert found == pytest.approx(np.stack([inputs.usual_tension, 2.0 * inputs.usual_tension]))


def test_free_and_turning_are_the_accelerations_of_the_centre_of_mass(told):
    """By the wrench of the cables about it, as the structure matrix has it at the origin."""
    robot, inputs, parts = told
    wrench = structure_matrix(robot, inputs.position[None], inputs.rotation[None])[0]
    force, moment = np.split(wrench @ inputs.usual_tension, 2)
    arm = inputs.rotation @ (robot.center_of_mass + inputs.center)
    inertia = inputs.rotation @ robot.inertia @ inputs.rotation.T
    down = np.array([0.0, 0.0, robot.gravity])
    assert parts["free"] == pytest.approx(force / robot.mass - down)
    turning = np.linalg.solve(inertia, moment - np.cross(arm, force))
    assert parts["turning"] == pytest.approx(turning)


def test_pulls_add_up_to_what_they_are_of(told):
    robot, _, parts = told
    along = parts["along"].reshape(3, -1).T
    assert np.linalg.norm(along, axis=1) == pytest.approx(np.ones(robot.n))
    way = parts["way"].reshape(-1, 3)[::PULLED_EVERY]
    pulls = parts["pulls_way"].reshape(-1, robot.n)
    assert pulls == pytest.approx(
        way @ np.linalg.pinv(along), abs=50.0 * DAMPING * np.abs(pulls).max()
    )  # the least ones
    total = pulls @ along
    assert total == pytest.approx(way, abs=50.0 * DAMPING * np.abs(way).max())
    accelerations = np.stack([parts["push"], parts["free"] + parts["push"]])
    total = parts["pulls"].reshape(-1, robot.n) @ along
    assert total == pytest.approx(accelerations, abs=50.0 * DAMPING * np.abs(accelerations).max())


def test_rates_are_those_of_anchor_points_along_their_cables(told):
    """A spin about the centre of mass carries an anchor point towards its exit."""
    robot, inputs, parts = told
    along = parts["along"].reshape(3, -1).T
    arms = (robot.anchor_points - robot.center_of_mass - inputs.center) @ inputs.rotation.T
    turned = parts["turned"].reshape(2, robot.n)
    for rate, spin in (
        (parts["spinning"], inputs.twist[3:]), (turned[0], parts["turning"]),
        (turned[1], inputs.acceleration[3:]),
    ):  # fmt: skip
        expected = np.einsum("ij,ij->i", np.cross(spin, arms), along)
        assert rate == pytest.approx(expected, rel=1e-9, abs=1e-9)
    assert parts["behind"] == pytest.approx(along @ parts["faster"][:3])


def test_a_robot_of_another_size_has_the_same_numbers_in_its_units(told):
    robot, inputs, parts = told
    small = similar_robot(robot, 0.1)
    length = Scales(small).length / Scales(robot).length
    time = Scales(small).time / Scales(robot).time
    place = small.workspace_min - length * robot.workspace_min
    scaled = replace(
        inputs,
        position=place + length * inputs.position,
        twist=inputs.twist * np.repeat([length / time, 1.0 / time], 3),
        target=place + length * inputs.target,
        target_velocity=length / time * inputs.target_velocity,
        center=length * inputs.center,
        acceleration=inputs.acceleration * np.repeat([length / time**2, 1.0 / time**2], 3),
        usual_tension=small.weight / robot.weight * inputs.usual_tension,
        usual_place=length * inputs.usual_place,
    )
    found = PlanNumbers(small, STAGES).of(scaled)
    expected = np.concatenate([*parts.values()]) * input_units(small, STAGES)
    assert found == pytest.approx(expected / input_units(robot, STAGES), abs=1e-9)


@pytest.mark.parametrize("angle", [0.0, 1.0, 3.0, 3.1412, np.pi])
def test_a_turn_is_told_right_or_refused(angle):
    robot = ct.load_robot("carosac")
    turned = Rotation.from_rotvec([angle, 0.0, 0.0]).as_matrix()
    still = np.zeros((STAGES + 1, 3))
    inputs = PlanInputs(
        position=robot.home_position, rotation=turned @ robot.home_rotation, twist=np.zeros(6),
        target=still, target_velocity=still, center=np.zeros(3), acceleration=np.zeros(6),
        usual_tension=np.ones(robot.n), usual_place=np.zeros(3),
    )  # fmt: skip
    numbers = PlanNumbers(robot, STAGES).of(inputs)
    found = numbers[robot.n + 3 : robot.n + 6]
    if angle == np.pi:
        assert np.isnan(found).all()
    else:
        assert found == pytest.approx([np.tan(angle / 4.0), 0.0, 0.0], abs=1e-6)
