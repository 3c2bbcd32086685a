from __future__ import annotations

import gc
import threading
import time
import weakref

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.physics import device
from carosac_toolkit.physics.cable.straight_line import (
    forward_kinematics,
    inverse_kinematics,
    straight_length,
)
from tests.robots import eight_cable_robot, simple_robot, with_pulleys

ROTATION = Rotation.from_rotvec([0.4, -0.3, 0.2]).as_matrix()  # not identity, on purpose


def positions(robot, count, seed=0):
    rng = np.random.default_rng(seed)
    return rng.uniform(robot.workspace_min, robot.workspace_max, (count, 3))


def tilted_pulleys(robot, radius):
    """Pulleys fed from all sides: no axis is vertical."""
    axis = np.random.default_rng(7).normal(size=(robot.n, 3))
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    return simple_robot(pulley_radius=np.full(robot.n, radius), swivel_axis=axis)


def test_lengths_are_distances_from_exit_point_to_anchor_point():
    robot = simple_robot()
    p = positions(robot, 5)
    anchor = p[:, None, :] + robot.anchor_points @ ROTATION.T
    distance = np.linalg.norm(robot.exit_points - anchor, axis=-1)
    turns = np.tile(ROTATION, (5, 1, 1))
    assert inverse_kinematics(robot, p, turns) == pytest.approx(distance, rel=1e-15)


def test_ipanema_at_its_known_pose_has_eight_equal_lengths():
    corners = [[x, y, z] for z in (2.0, 0.0) for x in (-2.0, 2.0) for y in (-1.5, 1.5)]
    platform = [[np.sign(x) * 0.06, np.sign(y) * 0.06, 0.0] for x, y, _ in corners]
    robot = eight_cable_robot(exit_points=corners, anchor_points=platform)
    lengths = inverse_kinematics(robot, [[0.0, 0.0, 1.0]])
    assert lengths == pytest.approx(np.full((1, 8), 2.6148040079516472), rel=1e-15)


@pytest.mark.parametrize("radius", [0.0, 0.06, 0.5])
def test_direction_is_the_gradient_of_the_length(radius):
    robot = tilted_pulleys(simple_robot(), radius)
    p = positions(robot, 20)
    turns = np.tile(ROTATION, (20, 1, 1))
    step = 1e-5
    slopes = []
    for axis in np.eye(3) * step:
        ahead = inverse_kinematics(robot, p + axis, turns)
        behind = inverse_kinematics(robot, p - axis, turns)
        slopes.append((ahead - behind) / (2 * step))
    gradient = np.stack(slopes, axis=-1)
    # Rounding of 10 m over the step: 2e-15 / 1e-5; truncation: step^2 over a squared distance.
    assert straight_length(robot, p, turns).direction == pytest.approx(gradient, abs=1e-9)


def test_wrapped_cable_leaves_tangentially_and_adds_up():
    robot = tilted_pulleys(simple_robot(), 0.3)
    p = positions(robot, 10)
    cables = straight_length(robot, p)
    anchor = p[:, None, :] + robot.anchor_points
    free = cables.length - 0.3 * cables.wrap
    tangent_point = anchor - free[..., None] * cables.direction
    axis = robot.swivel_axis
    offset = tangent_point - robot.exit_points
    along = (offset * axis).sum(-1)
    outward = (anchor - robot.exit_points) - ((anchor - robot.exit_points) * axis).sum(-1)[
        ..., None
    ] * axis
    e = outward / np.linalg.norm(outward, axis=-1, keepdims=True)
    radial = offset - 0.3 * e  # from the pulley's centre
    assert np.linalg.norm(radial, axis=-1) == pytest.approx(np.full((10, 4), 0.3), rel=1e-12)
    assert (radial * cables.direction).sum(-1) == pytest.approx(np.zeros((10, 4)), abs=1e-14)
    assert along == pytest.approx(0.3 * np.sin(cables.wrap), abs=1e-13)


def test_wrap_of_a_cable_fed_from_below_that_leaves_level_is_a_quarter_turn():
    robot = with_pulleys(simple_robot(anchor_points=np.zeros((4, 3))), 0.1)
    datum = robot.exit_points[0]
    cables = straight_length(robot, [np.add(datum, [3.0, 0.0, 0.1])])
    assert cables.wrap[0, 0] == pytest.approx(np.pi / 2, abs=1e-14)
    assert cables.length[0, 0] == pytest.approx(0.1 * np.pi / 2 + 2.9, rel=1e-14)


def test_wrap_vanishes_straight_ahead_and_passes_half_a_turn_behind_the_pulley():
    robot = with_pulleys(simple_robot(anchor_points=np.zeros((4, 3))), 0.1)
    datum = robot.exit_points[0]
    ahead = straight_length(robot, [np.add(datum, [0.0, 0.0, 2.0])])
    assert ahead.wrap[0, 0] == pytest.approx(0.0, abs=1e-12)
    assert ahead.length[0, 0] == pytest.approx(2.0, rel=1e-14)
    below = straight_length(robot, [np.add(datum, [0.2, 0.0, -5.0])])
    assert below.wrap[0, 0] == pytest.approx(np.pi, abs=1e-12)
    under = straight_length(robot, [np.add(datum, [0.1, 0.0, -5.0])])
    assert under.wrap[0, 0] > np.pi


def test_small_pulley_tends_to_the_eyelet():
    plain = simple_robot()
    p = positions(plain, 10)
    wound = inverse_kinematics(with_pulleys(plain, 1e-8), p)
    assert wound == pytest.approx(inverse_kinematics(plain, p), abs=1e-7)


@pytest.mark.parametrize(
    "robot",
    [
        simple_robot(),
        eight_cable_robot(),
        with_pulleys(simple_robot()),
        tilted_pulleys(simple_robot(), 0.1),
    ],
    ids=["four", "eight", "pulleys", "tilted"],
)
def test_forward_kinematics_inverts_inverse_kinematics_without_a_guess(robot):
    p = positions(robot, 1000)
    turns = np.tile(ROTATION if robot.n == 4 else np.eye(3), (1000, 1, 1))
    fit = forward_kinematics(robot, inverse_kinematics(robot, p, turns), rotation=turns)
    assert fit.converged.all()
    assert np.abs(fit.position - p).max() < 1e-9
    assert fit.residual.max() < 1e-10


def test_random_lengths_reach_the_minimum_that_slsqp_reaches():
    """Lengths that contradict each other: a large residual, where Gauss-Newton fails."""
    robot = simple_robot()
    span = inverse_kinematics(robot, positions(robot, 1000))
    lengths = np.random.default_rng(3).uniform(span.min(), span.max(), (150, 4))
    fit = forward_kinematics(robot, lengths)
    assert fit.converged.all()
    twins = 0
    for target, position, residual in zip(lengths, fit.position, fit.residual, strict=True):

        def cost(p, target=target):
            distance = np.linalg.norm(p + robot.anchor_points - robot.exit_points, axis=1)
            return ((distance - target) ** 2).sum()

        optimum = minimize(
            cost, robot.home_position, method="SLSQP", options={"ftol": 1e-14, "maxiter": 500}
        )
        assert cost(position) == pytest.approx(4 * residual**2, rel=1e-9)
        if np.linalg.norm(optimum.x - position) > 1e-4:  # SLSQP stepped over the exit points' plane
            twins += 1
            assert optimum.x[2] > 8.5 > position[2]
            assert cost(position) == pytest.approx(optimum.fun, rel=0.01, abs=1e-4)
    assert twins <= 4


def test_result_is_a_minimum_to_finite_differences():
    robot = simple_robot()
    lengths = np.random.default_rng(4).uniform(6.0, 12.0, (50, 4))
    fit = forward_kinematics(robot, lengths)
    around = fit.position[:, None, :] + 1e-3 * np.vstack([np.eye(3), -np.eye(3)])
    spans = inverse_kinematics(robot, around.reshape(-1, 3)).reshape(50, 6, 4)
    rms = np.sqrt(((spans - lengths[:, None, :]) ** 2).mean(axis=-1))
    assert (rms > fit.residual[:, None]).all()


def test_start_above_the_exit_points_finds_the_mirrored_twin():
    robot = simple_robot()
    p = np.array([[0.4, -1.8, 2.2]])
    lengths = inverse_kinematics(robot, p)
    twin = forward_kinematics(robot, lengths, guess=[[0.4, -1.8, 14.0]])
    assert twin.converged.all()
    assert twin.position[0, 2] > 8.5
    assert 0.0 < twin.residual[0] < 0.05  # the exit points are not quite in one plane


def test_no_strict_minimum_is_not_called_converged():
    robot = simple_robot()
    line = np.array([[0.0, 0.0, 8.0], [1.0, 0.0, 8.0], [2.0, 0.0, 8.0], [3.0, 0.0, 8.0]])
    ring = simple_robot(exit_points=line, anchor_points=np.zeros((4, 3)))  # free to swing about x
    fit = forward_kinematics(ring, inverse_kinematics(ring, [[1.0, 1.0, 5.0]]))
    assert not fit.converged.any()
    flat = simple_robot(
        exit_points=robot.exit_points * [1, 1, 0] + [0, 0, 8.0], anchor_points=np.zeros((4, 3))
    )
    top = forward_kinematics(flat, [[9.0] * 4], guess=[[0.4, -1.8, 8.0]])  # a ridge, by symmetry
    assert not top.converged.any()
    assert top.residual[0] > 0.1


def test_batch_equals_loop():
    robot = with_pulleys(simple_robot())
    lengths = np.random.default_rng(5).uniform(6.0, 12.0, (40, 4))
    together = forward_kinematics(robot, lengths)
    for i in range(40):
        alone = forward_kinematics(robot, lengths[i : i + 1])
        assert (alone.position[0] == together.position[i]).all()
        assert alone.iterations[0] == together.iterations[i]


def test_threads_do_not_mix_their_poses():
    robot = simple_robot()
    p = positions(robot, 4)
    lengths = inverse_kinematics(robot, p)
    faults = []

    def work(i):
        for _ in range(200):
            fit = forward_kinematics(robot, lengths[i : i + 1])
            faults.append(np.abs(fit.position[0] - p[i]).max() > 1e-9)

    threads = [threading.Thread(target=work, args=(i,)) for i in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not any(faults)
    assert len(faults) == 800


def test_results_are_copies_and_buffers_die_with_their_robot():
    robot = simple_robot()
    first = inverse_kinematics(robot, [[0.4, -1.8, 2.2]])
    kept = first.copy()
    inverse_kinematics(robot, [[0.4, -1.8, 3.2]])
    assert (first == kept).all()
    ghost = weakref.ref(robot)
    del robot
    gc.collect()
    assert ghost() is None


def test_one_call_is_far_cheaper_than_slsqp():
    robot = simple_robot()
    lengths = inverse_kinematics(robot, positions(robot, 256))
    forward_kinematics(robot, lengths)
    start = time.process_time()
    for _ in range(20):
        forward_kinematics(robot, lengths)
    ours = (time.process_time() - start) / 20 / 256
    start = time.process_time()
    for target in lengths[:10]:

        def cost(p, target=target):
            distance = np.linalg.norm(p + robot.anchor_points - robot.exit_points, axis=1)
            return ((distance - target) ** 2).sum()

        minimize(cost, robot.home_position, method="SLSQP")
    theirs = (time.process_time() - start) / 10
    assert theirs / ours > 100.0  # measured: above 1000


def test_anchor_inside_its_pulley_is_refused_with_its_cable():
    robot = with_pulleys(simple_robot(anchor_points=np.zeros((4, 3))), 0.1)
    inside = robot.exit_points[1] + [0.1, 0.0, 0.0]
    cables = straight_length(robot, [inside])
    assert cables.valid.tolist() == [[True, False, True, True]]
    with pytest.raises(InvalidField, match=r"position\[0\].*'cable2' outside its pulley"):
        inverse_kinematics(robot, [inside])


def test_arguments_of_a_wrong_kind_are_named():
    robot = simple_robot()
    with pytest.raises(InvalidField, match=r"position: got shape \(3,\)"):
        inverse_kinematics(robot, [0.4, -1.8, 2.2])
    with pytest.raises(InvalidField, match=r"length: got shape \(1, 3\); allowed: shape \(B, 4\)"):
        forward_kinematics(robot, [[9.0, 9.0, 9.0]])
    with pytest.raises(InvalidField, match=r"guess: got shape \(2, 3\); allowed: shape \(1, 3\)"):
        forward_kinematics(robot, [[9.0] * 4], guess=[[0.0] * 3] * 2)
    with pytest.raises(InvalidField, match=r"rotation: got shape \(2, 3, 3\)"):
        forward_kinematics(robot, [[9.0] * 4], rotation=np.tile(np.eye(3), (2, 1, 1)))
    with pytest.raises(InvalidField, match=r"rotation\[0\]: got not a rotation matrix"):
        forward_kinematics(robot, [[9.0] * 4], rotation=2.0 * np.eye(3)[None])
    with pytest.raises(InvalidField, match=r"length\[0, 1\]: got nan"):
        forward_kinematics(robot, [[9.0, np.nan, 9.0, 9.0]])


def test_many_batch_sizes_keep_few_buffers():
    robot = simple_robot()
    for size in range(1, 30):
        inverse_kinematics(robot, np.tile(robot.home_position, (size, 1)))
    assert len(device._buffers[robot]) <= device.BUFFER_SETS_MAX
