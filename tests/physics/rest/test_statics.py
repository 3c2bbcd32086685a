"""Forward and inverse kinematics: physical truths, an independent solution, honest failures."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import carosac_toolkit as ct
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.loop.values import Pose
from carosac_toolkit.physics.rest import statics
from tests import reference
from tests.robots import eight_cable_robot, simple_robot, with_pulleys

TWO_TURNS = np.tile(np.eye(3), (2, 1, 1))
BUNDLED = ("carosac", "scampi", "ipanema1", "cogiro")


def positions(robot, count, seed=0):
    """Uniform in the workspace box."""
    rng = np.random.default_rng(seed)
    return rng.uniform(robot.workspace_min, robot.workspace_max, (count, 3))


def rest_poses(robot, count, seed=0):
    """Feasible poses of rest."""
    equilibrium = statics.inverse_kinematics(robot, positions(robot, count, seed))
    assert equilibrium.converged.any()
    return equilibrium


def pick(result, keep):
    """Rows of an equilibrium."""
    return replace(result, **{k: getattr(result, k)[keep] for k in vars(result)})


@pytest.mark.parametrize("name", BUNDLED)
def test_lengths_of_a_pose_lead_back_to_it_without_a_guess(name):
    robot = ct.load_robot(name)
    there = rest_poses(robot, 2000)
    share = there.converged.mean()
    assert share >= (0.98 if name == "carosac" else 1.0)
    there = pick(there, there.converged)
    assert there.stable.all()
    back = statics.forward_kinematics(robot, there.unstrained_length)
    distance = np.linalg.norm(back.position - there.position, axis=1)
    assert (back.converged & (distance < 1e-6)).mean() >= 0.999
    # Never a silent wrong answer: what converged elsewhere must be another stable equilibrium.
    assert (back.stable | ~back.converged)[distance >= 1e-6].all()
    assert (back.residual[back.converged] < 1e-9 * robot.weight).all()


@pytest.mark.parametrize(
    "robot",
    [
        simple_robot(),
        with_pulleys(simple_robot()),
        replace(
            with_pulleys(simple_robot(), 0.08),
            swivel_axis=np.tile([0.28, 0.0, 0.96], (4, 1)),
        ),
        eight_cable_robot(),
        with_pulleys(eight_cable_robot(), 0.03),
    ],
    ids=["four", "pulleys", "tilted pulleys", "eight", "eight with pulleys"],
)
def test_agrees_with_an_independent_equilibrium(robot):
    there = rest_poses(robot, 5)
    there = pick(there, there.converged)
    back = statics.forward_kinematics(robot, there.unstrained_length)
    rng = np.random.default_rng(1)
    for k in range(len(there.position)):
        start = there.position[k] + 0.01 * rng.standard_normal(3)
        turn = Rotation.from_rotvec(0.01 * rng.standard_normal(3)).as_matrix()
        answer = reference.equilibrium(
            robot, there.unstrained_length[k], start, turn @ there.rotation[k]
        )
        assert answer.residual < 1e-12
        assert back.position[k] == pytest.approx(answer.position, abs=1e-9)
        assert back.rotation[k] == pytest.approx(answer.rotation, abs=1e-9)
        assert back.tension[k] == pytest.approx(answer.tension, rel=1e-8)


def test_slack_cable_is_reported_and_hangs():
    robot = simple_robot()
    length = rest_poses(robot, 1).unstrained_length + np.array([[0.5, 0.0, 0.0, 0.0]])
    equilibrium = statics.forward_kinematics(robot, length)
    assert equilibrium.converged[0]
    assert equilibrium.slack[0].tolist()[0]
    assert statics.sag(robot, equilibrium)[0, 0] > 0.3
    answer = reference.equilibrium(
        robot, length[0], equilibrium.position[0], equilibrium.rotation[0]
    )
    assert equilibrium.position[0] == pytest.approx(answer.position, abs=1e-9)


def test_batch_equals_loop_bit_for_bit():
    robot = ct.load_robot("carosac")
    where = positions(robot, 20)
    together = statics.inverse_kinematics(robot, where)
    back = statics.forward_kinematics(robot, together.unstrained_length)
    for k in range(20):
        alone = statics.inverse_kinematics(robot, where[k : k + 1])
        assert (alone.unstrained_length[0] == together.unstrained_length[k]).all()
        single = statics.forward_kinematics(robot, together.unstrained_length[k : k + 1])
        assert (single.position[0] == back.position[k]).all()
        assert (single.rotation[0] == back.rotation[k]).all()


def test_light_stiff_cables_tend_to_straight_lines():
    robot = simple_robot()
    where = positions(robot, 50)
    errors = []
    for factor in (1.0, 1e-2, 1e-4, 1e-6):
        ideal = replace(
            robot,
            linear_density=robot.linear_density * factor,
            axial_stiffness=robot.axial_stiffness / factor,
        )
        result = statics.inverse_kinematics(ideal, where)
        result = pick(result, result.converged)
        straight = ct.straight_line.inverse_kinematics(ideal, result.position, result.rotation)
        errors.append(np.abs(straight - result.unstrained_length).max())
    assert errors[0] > 1e-4
    assert errors[1] < 0.02 * errors[0]
    assert errors[3] < 1e-8


def test_wrench_of_the_cables_carries_the_weight_at_tilted_poses():
    robot = with_pulleys(simple_robot())
    result = rest_poses(robot, 30)
    result = pick(result, result.converged)
    shape = statics.cable_shape(robot, result, samples=2000)
    # Tension direction at the anchor from the drawn shape, extrapolated to its end.
    tangent = 1.5 * (shape[:, :, -2] - shape[:, :, -1]) - 0.5 * (shape[:, :, -3] - shape[:, :, -2])
    unit = tangent / np.linalg.norm(tangent, axis=-1, keepdims=True)
    force = result.tension[..., None] * unit
    arm = np.einsum("bij,nj->bni", result.rotation, robot.anchor_points)
    weight = np.array([0.0, 0.0, -robot.weight])
    center = result.rotation @ robot.center_of_mass
    assert np.abs(force.sum(axis=1) + weight).max() < 1e-5 * robot.weight
    moment = np.cross(arm, force).sum(axis=1) + np.cross(center, weight)
    assert np.abs(moment).max() < 1e-5 * robot.weight


def test_power_balance_at_rotated_poses():
    """Work done on the platform by lengths that change equals the change of its potential energy.

    d(weight * height of the mass centre) = sum of T_exit dL at the winch, less what the cables
    keep; with light, stiff cables nothing is kept.
    """
    robot = replace(
        simple_robot(), linear_density=np.full(4, 1e-7), axial_stiffness=np.full(4, 1e10)
    )
    result = rest_poses(robot, 20)
    result = pick(result, result.converged)
    change = 1e-5 * np.random.default_rng(4).standard_normal(result.unstrained_length.shape)
    heights = []
    for sign in (1.0, -1.0):
        moved = statics.forward_kinematics(
            robot, result.unstrained_length + sign * change, guess=result
        )
        heights.append((moved.position + moved.rotation @ robot.center_of_mass)[:, 2])
    gained = robot.weight * (heights[0] - heights[1]) / 2.0
    spent = -(result.tension * change).sum(axis=1)
    assert gained == pytest.approx(spent, abs=1e-5 * np.abs(spent).max())


def test_stiffness_is_the_slope_of_the_equilibrium():
    """A force on the platform moves its rest pose by K^-1; the force is made by more mass."""
    for robot in (with_pulleys(simple_robot()), eight_cable_robot()):
        result = rest_poses(robot, 10)
        result = pick(result, result.converged)
        extra = 1e-5
        poses = []
        for sign in (1.0, -1.0):
            # A point mass at the platform origin: a pure force there.
            mass = robot.mass * (1.0 + sign * extra)
            center = robot.center_of_mass / (1.0 + sign * extra)
            heavier = replace(robot, mass=mass, center_of_mass=center)
            poses.append(
                statics.forward_kinematics(heavier, result.unstrained_length, guess=result)
            )
        move = (poses[0].position - poses[1].position) / 2.0
        spin = (
            Rotation.from_matrix(poses[0].rotation @ poses[1].rotation.swapaxes(1, 2)).as_rotvec()
            / 2.0
        )
        load = np.zeros((len(move), 6))
        load[:, 2] = -extra * robot.weight
        expected = np.linalg.solve(result.stiffness, load[..., None])[..., 0]
        got = np.concatenate([move, spin], axis=1)
        assert got == pytest.approx(expected, abs=1e-6 * np.abs(expected).max())
        asymmetry = np.abs(result.stiffness - result.stiffness.swapaxes(1, 2)).max()
        assert asymmetry < 1e-9 * np.abs(result.stiffness).max()


def test_six_cables_or_more_hold_the_rotation_with_least_squared_tensions():
    robot = replace(eight_cable_robot(), linear_density=np.full(8, 1e-9))
    where = positions(robot, 60, seed=3)
    turn = Rotation.from_rotvec([0.05, -0.03, 0.08]).as_matrix()
    equilibrium = statics.inverse_kinematics(robot, where, np.tile(turn, (60, 1, 1)))
    assert 0.1 < equilibrium.converged.mean() < 0.9
    assert (equilibrium.rotation == turn).all()
    for k in range(60):
        best = reference.tension_distribution_nnls(
            structure(robot, where[k], turn),
            gravity_wrench(robot, turn),
            robot.tension_min,
            robot.tension_max,
        )
        assert (best is not None) == equilibrium.converged[k]
        if best is not None:
            assert equilibrium.tension[k] == pytest.approx(best, abs=1e-5)


def structure(robot, position, rotation):
    """Structure matrix, written out here."""
    arm = robot.anchor_points @ rotation.T
    cable = robot.exit_points - position - arm
    unit = cable / np.linalg.norm(cable, axis=1, keepdims=True)
    return np.concatenate([unit, np.cross(arm, unit)], axis=1).T


def gravity_wrench(robot, rotation):
    """Weight at the platform origin."""
    force = np.array([0.0, 0.0, -robot.weight])
    return np.concatenate([force, np.cross(rotation @ robot.center_of_mass, force)])


def test_fewer_cables_take_the_least_squared_tensions_of_nearby_equilibria():
    robot = simple_robot()
    equilibrium = rest_poses(robot, 6, seed=5)
    rng = np.random.default_rng(6)
    for k in np.flatnonzero(equilibrium.converged):
        total = (equilibrium.tension[k] ** 2).sum()
        for _ in range(4):
            # Other equilibria at the same position: turn about, then restore it by the lengths.
            turn = Rotation.from_rotvec(rng.normal(0.0, [0.02, 0.02, 0.3])).as_matrix()
            other = equilibrium_at(robot, equilibrium.position[k], turn @ equilibrium.rotation[k])
            if other is not None:
                assert (other.tension**2).sum() >= total * (1.0 - 1e-9)


def equilibrium_at(robot, position, rotation):
    """Some equilibrium at a position, by fixed-point correction of straight lengths."""
    length = ct.straight_line.inverse_kinematics(robot, position[None], rotation[None])
    guess = Pose(position=position[None], rotation=rotation[None])
    for _ in range(60):
        equilibrium = statics.forward_kinematics(robot, length, guess=guess)
        if not equilibrium.converged[0]:
            return None
        error = np.linalg.norm(equilibrium.position[0] - position)
        if error < 1e-9:
            return equilibrium
        here = ct.straight_line.inverse_kinematics(
            robot, equilibrium.position, equilibrium.rotation
        )
        wanted = ct.straight_line.inverse_kinematics(robot, position[None], equilibrium.rotation)
        length = length + wanted - here
        guess = equilibrium
    return None


@pytest.mark.parametrize("count", [1, 2, 3, 5, 6, 7, 12])
def test_any_number_of_cables_finds_rest(count):
    rng = np.random.default_rng(count)
    base = simple_robot()
    angle = 2.0 * np.pi * np.arange(count) / count
    ring = np.stack([np.cos(angle), np.sin(angle), np.zeros(count)], axis=1)
    exits = 5.0 * ring + [0.0, 0.0, 8.0] + 0.2 * rng.standard_normal((count, 3))
    anchors = 0.25 * ring + 0.02 * rng.standard_normal((count, 3))
    names = tuple(f"c{i}" for i in range(count))
    per_cable = {
        k: np.resize(getattr(base, k), (count, *getattr(base, k).shape[1:]))
        for k in vars(base)
        if isinstance(getattr(base, k), np.ndarray) and getattr(base, k).shape[:1] == (4,)
    }
    robot = replace(
        base,
        **(per_cable | {"exit_points": exits, "anchor_points": anchors}),
        cable_names=names,
        home_position=np.array([0.0, 0.0, 3.0]),
    )
    length = np.linalg.norm(exits - [0.3, 0.2, 3.0], axis=1)[None] + 0.05
    equilibrium = statics.forward_kinematics(robot, length)
    assert equilibrium.converged[0]
    if count == 1:  # its turning about the plumb line is free, so the pose is not unique
        center = equilibrium.position[0] + equilibrium.rotation[0] @ robot.center_of_mass
        assert center[:2] == pytest.approx(exits[0, :2], abs=1e-6)
        return
    answer = reference.equilibrium(
        robot, length[0], equilibrium.position[0], equilibrium.rotation[0]
    )
    assert answer.residual < 1e-10
    assert answer.position == pytest.approx(equilibrium.position[0], abs=1e-6)


def test_infeasible_is_reported_and_nothing_is_clipped():
    robot = simple_robot()
    beyond = np.array([[9.0, -1.8, 3.0], [0.4, -1.8, 8.3]])
    equilibrium = statics.inverse_kinematics(robot, beyond)
    assert not equilibrium.converged.any()
    assert [statics.STATUS_REASONS[s] for s in equilibrium.status] == [
        statics.STATUS_REASONS[2]
    ] * 2
    assert (equilibrium.position == beyond).all()
    assert not equilibrium.stable[0]
    weak = replace(eight_cable_robot(), tension_max=np.full(8, 12.0), tension_min=np.full(8, 10.0))
    held = statics.inverse_kinematics(weak, weak.home_position[None])
    assert statics.STATUS_REASONS[held.status[0]] == "no tensions within the limits found"


def test_home_of_a_symmetric_robot_is_its_centre():
    robot = replace(
        simple_robot(),
        exit_points=np.array([[-3.0, -4, 6], [3, -4, 6], [3, 4, 6], [-3, 4, 6]]),
        center_of_mass=np.array([0.0, 0.0, -0.1]),
        workspace_min=np.array([-1.0, -1, 1]),
        workspace_max=np.array([1.0, 1, 4]),
        home_position=np.array([0.0, 0.0, 2.0]),
    )
    equilibrium = statics.inverse_kinematics(robot, [[0.0, 0.0, 2.0]])
    assert equilibrium.converged[0] and equilibrium.stable[0]
    assert equilibrium.rotation[0] == pytest.approx(np.eye(3), abs=1e-6)
    assert np.ptp(equilibrium.tension[0]) < 1e-6 * robot.weight


def test_kinematic_solver_check_of_stadium_size():
    """Known numbers of the published solver's own test: inextensible, 122 m cables."""
    exits = np.array([[0.0, 100, 50], [200, 100, 50], [200, 0, 50], [0, 0, 50]])
    anchors = np.array([[-0.1, 0.1, 0], [0.1, 0.1, 0], [0.1, -0.1, 0], [-0.1, -0.1, 0]])
    robot = replace(
        simple_robot(),
        exit_points=exits,
        anchor_points=anchors,
        gravity=9.81,
        mass=353.16 / 9.81,
        center_of_mass=np.zeros(3),
        linear_density=np.full(4, 0.144787774431201 / 9.81),
        axial_stiffness=np.full(4, 1e12),
        run_length=np.zeros(4),
        length_max=np.full(4, 200.0),
        tension_max=np.full(4, 1000.0),
        workspace_min=np.array([50.0, 20, -10]),
        workspace_max=np.array([150.0, 80, 30]),
        home_position=np.array([100.0, 50, 0]),
    )
    equilibrium = statics.inverse_kinematics(robot, [[100.0, 50.0, 0.0]])
    assert equilibrium.converged[0]
    assert equilibrium.unstrained_length[0] == pytest.approx(122.375638, abs=1e-6)
    horizontal = np.linalg.norm(equilibrium.exit_tension[0, :, :2], axis=1)
    assert horizontal == pytest.approx(216.8712, abs=1e-4)
    straight = ct.straight_line.inverse_kinematics(robot, [[100.0, 50.0, 0.0]])
    assert straight[0] == pytest.approx(122.352033, abs=1e-6)
    back = statics.forward_kinematics(robot, equilibrium.unstrained_length)
    assert back.position[0] == pytest.approx([100.0, 50.0, 0.0], abs=1e-6)


@pytest.mark.parametrize("name", BUNDLED)
def test_a_guess_gives_the_same_answer_faster(name):
    robot = ct.load_robot(name)
    there = rest_poses(robot, 200)
    there = pick(there, there.converged)
    cold = statics.forward_kinematics(robot, there.unstrained_length)
    warm = statics.forward_kinematics(robot, there.unstrained_length, guess=cold)
    assert warm.position == pytest.approx(cold.position, abs=1e-9)
    assert warm.iterations.mean() < cold.iterations.mean()
    pose = Pose(position=cold.position + 0.02, rotation=cold.rotation)
    near = statics.forward_kinematics(robot, there.unstrained_length, guess=pose)
    assert near.position == pytest.approx(cold.position, abs=1e-8)


def test_run_length_softens_and_lengthens():
    """8 m of cable behind the pulley stretch under the same tension as the free span."""
    short = replace(simple_robot(), run_length=np.zeros(4))
    result = rest_poses(short, 20)
    result = pick(result, result.converged)
    long = replace(short, run_length=np.full(4, 8.0))
    same = statics.inverse_kinematics(long, result.position)
    exit_tension = np.linalg.norm(same.exit_tension, axis=-1)
    strain = exit_tension / short.axial_stiffness
    expected = result.unstrained_length - 8.0 * strain / (1.0 + strain)
    assert same.unstrained_length == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda r: statics.forward_kinematics(r, [[1.0, 2.0]]), r"unstrained_length: got shape"),
        (lambda r: statics.forward_kinematics(r, [[1.0, 2.0, np.inf, 3.0]]), r"length\[0, 2\]"),
        (lambda r: statics.forward_kinematics(r, [[9.0, 9.0, -1.0, 9.0]]), r"\[0, 2\]: got -1.0 m"),
        (lambda r: statics.inverse_kinematics(r, [1.0, 2.0, 3.0]), r"position: got shape \(3,\)"),
        (
            lambda r: statics.inverse_kinematics(r, [[1.0, 2.0, 3.0]], np.eye(3)[None]),
            r"rotation: got a rotation; allowed: None: 4 cables leave it free",
        ),
        (
            lambda r: statics.forward_kinematics(
                r, [[9.0] * 4], guess=Pose(position=np.zeros((2, 3)), rotation=TWO_TURNS)
            ),
            r"guess: got 2 poses; allowed: 1, as the batch",
        ),
    ],
)  # fmt: skip
def test_bad_arguments_are_named(call, message):
    with pytest.raises(InvalidField, match=message):
        call(simple_robot())


def test_wrong_kinds_of_arguments_are_named():
    robot = simple_robot()
    with pytest.raises(InvalidField, match=r"robot: got 'carosac'; allowed: a Robot; load_robot"):
        statics.forward_kinematics("carosac", [[9.0] * 4])
    with pytest.raises(InvalidField, match=r"guess: got list; allowed: an Equilibrium, a Pose"):
        statics.forward_kinematics(robot, [[9.0] * 4], guess=[0.0, 0.0, 1.0])
    with pytest.raises(InvalidField, match=r"device: got 'tpu'; allowed: one of \['cpu'"):
        statics.inverse_kinematics(robot, [[0.4, -1.8, 2.2]], device="tpu")


def test_winch_range_is_reported_and_limits_nothing():
    robot = replace(simple_robot(), length_max=np.full(4, 9.15))
    equilibrium = statics.inverse_kinematics(robot, [[0.4, -1.8, 2.2]])
    assert equilibrium.converged[0]
    assert (equilibrium.in_winch_range[0] == (equilibrium.unstrained_length[0] <= 9.15)).all()
    assert equilibrium.in_winch_range.any() and not equilibrium.in_winch_range.all()


def test_a_rotation_that_is_none_is_refused():
    robot = eight_cable_robot()
    with pytest.raises(InvalidField, match=r"rotation\[0\]: got not a rotation matrix"):
        statics.inverse_kinematics(robot, robot.home_position[None], -np.eye(3)[None])


def test_a_narrow_window_between_two_limits_is_found():
    """At the edge of the workspace one cable sits at its limit and its neighbour just inside.

    Solutions there found by an independent search (scipy, straight cables): 59.6 degrees of tilt.
    """
    robot = replace(
        ct.load_robot("carosac"), linear_density=np.full(4, 1e-9), axial_stiffness=np.full(4, 1e12)
    )
    equilibrium = statics.inverse_kinematics(
        robot, [[2.38281903, -2.68838803, 2.80748534], [2.38356982, -3.37925167, 2.62224951]]
    )
    assert equilibrium.converged.tolist() == [True, False]
    assert equilibrium.tension[0] == pytest.approx([5.0, 183.6, 161.5, 5.1], abs=0.05)
    tilt = np.degrees(np.arccos(equilibrium.rotation[0, 2, 2]))
    assert tilt == pytest.approx(59.6, abs=0.05)
