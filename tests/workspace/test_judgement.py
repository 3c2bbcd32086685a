"""What belongs to the workspace: each limit where it must show, proofs that hold, by hand."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import carosac_toolkit as ct
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.physics.rest.hold import hold
from carosac_toolkit.workspace import Limit, WorkspaceSettings, box_grid, compute, judge, maps
from carosac_toolkit.workspace.frame import beyond_frame, too_flat
from carosac_toolkit.workspace.judgement import _worse
from tests.robots import eight_cable_robot, simple_robot

STRAIGHT = WorkspaceSettings(sag=False)


def hanging_square(**changes):
    """Four parallel vertical cables of 5 m; anchors and exits at the corners of a square."""
    corners = np.array([[x, y, 0.0] for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))], dtype=float)
    base = simple_robot(
        exit_points=corners + np.array([0.0, 0.0, 8.0]), anchor_points=corners,
        center_of_mass=np.zeros(3), run_length=np.zeros(4),
        workspace_min=np.array([-0.5, -0.5, 2.0]),
        workspace_max=np.array([0.5, 0.5, 4.0]), home_position=np.array([0.0, 0.0, 3.0]),
    )  # fmt: skip
    return replace(base, **changes)


def test_parallel_cables_by_hand():
    robot = hanging_square()
    found = judge(robot, [[0.0, 0.0, 3.0]], settings=STRAIGHT)
    assert found.inside[0] and found.tilt[0] == pytest.approx(0.0, abs=1e-7)
    assert found.margin[0] == pytest.approx(robot.weight / 4.0 - robot.tension_min[0], abs=1e-6)
    # The cables stay parallel: the platform swings without turning, a pendulum of 5 m.
    seen = maps(robot, found, settings=STRAIGHT)
    assert seen.stiffness[0] == pytest.approx(robot.weight / 5.0, rel=1e-4)
    assert abs(seen.softest[0, 2]) < 1e-3
    # Yaw: anchors sqrt(2) m from the axis move as pendulums; softer than roll and pitch.
    assert seen.turning_stiffness[0] == pytest.approx(robot.weight * 2.0 / 5.0, rel=1e-4)
    inertia = robot.inertia[2, 2]
    swing = np.sqrt(9.81 / 5.0) / (2 * np.pi)
    yaw = np.sqrt(robot.weight * 0.4 / inertia) / (2 * np.pi)
    assert seen.frequency[0] == pytest.approx(min(swing, yaw), rel=2e-3)
    assert seen.sag[0] == pytest.approx(0.0, abs=1e-6)


def test_a_top_heavy_platform_on_soft_cables_is_unstable():
    robot = eight_cable_robot()
    soft = replace(
        robot, center_of_mass=np.array([0.0, 0.0, 20.0]), axial_stiffness=np.full(8, 3000.0)
    )
    found = [judge(r, [robot.home_position], settings=STRAIGHT) for r in (robot, soft)]
    assert [Limit(f.limit[0]) for f in found] == [Limit.INSIDE, Limit.UNSTABLE]
    assert found[1].margin[0] > 0.0


@pytest.mark.parametrize(
    ("changes", "settings", "limit", "cables"),
    [
        ({"length_max": np.array([20.0, 20.0, 4.0, 20.0])}, {}, Limit.TOO_LONG, {2}),
        ({"length_min": np.array([1.0, 6.0, 1.0, 1.0])}, {}, Limit.TOO_SHORT, {1}),
        # Opposite cables pull alike: two neighbours carry half the weight, 116 N.
        ({"tension_max": np.array([60.0, 50.0, 500.0, 500.0])}, {}, Limit.OVERLOAD, {0, 1}),
        ({"tension_min": np.array([80.0, 50.0, 5.0, 5.0])}, {}, Limit.SLACK, {0, 1}),
        ({"tension_max": np.full(4, 55.0)}, {}, Limit.TOO_FLAT, {-1}),
        ({}, {"clearance": 2.5}, Limit.COLLISION, {-1}),
    ],
)  # fmt: skip
def test_the_limit_that_decides_is_named(changes, settings, limit, cables):
    found = judge(
        hanging_square(**changes), [[0.0, 0.0, 3.0]], settings=replace(STRAIGHT, **settings)
    )
    assert Limit(found.limit[0]) is limit and found.cable[0] in cables


def test_a_cable_that_hangs_in_a_loop_is_slack_not_too_long_for_its_winch():
    """At the side of SCAMPI's frame the far cable pulls by the weight of its loop alone."""
    robot = ct.load_robot("scampi")
    found = judge(robot, [[-1.82, -6.24, 3.99]])
    line = np.linalg.norm(robot.exit_points[2] - found.rest.position[0])
    assert line < robot.length_max[2] < found.rest.unstrained_length[0, 2]
    assert (Limit(found.limit[0]), found.cable[0]) == (Limit.SLACK, 2)


def test_tilt_is_limited():
    robot = ct.load_robot("carosac")
    place = [[-1.5, -3.7, 1.2]]
    tilt = judge(robot, place).tilt[0]
    assert tilt > np.radians(5.0)
    bounds = (tilt - 1e-3, tilt + 1e-3)
    limits = [judge(robot, place, settings=WorkspaceSettings(tilt_max=x)).limit[0] for x in bounds]
    assert limits == [Limit.TILT, Limit.INSIDE]


def test_what_a_proof_rules_out_no_search_finds():
    robot = ct.load_robot("carosac")
    rng = np.random.default_rng(0)
    lower, upper = robot.exit_points.min(axis=0) - 1.0, robot.exit_points.max(axis=0) + 1.0
    where = rng.uniform([*lower[:2], 7.5], upper, (150, 3))
    out, flat = beyond_frame(robot, where), too_flat(robot, where)
    assert out.any() and flat.any() and not (out | flat).all()
    found = hold(robot, where[out | flat][:40])
    assert not found.rest.converged.any()
    inside = robot.workspace_min + rng.random((50, 3)) * (robot.workspace_max - robot.workspace_min)
    assert not beyond_frame(robot, inside).any() and not too_flat(robot, inside).any()


def test_far_away_a_proof_decides_where_the_search_fails():
    robot = ct.load_robot("ipanema1")
    far = [[100.0, 100.0, 100.0], [0.0, 300.0, 1.0]]
    assert np.isnan(hold(robot, far).margin).any()
    found = judge(robot, far)
    assert [Limit(x) for x in found.limit] == [Limit.NO_PULL] * 2
    assert np.isneginf(found.margin).all() and (found.cable == -1).all()
    near = judge(robot, [robot.home_position + np.array([3.0, 0.0, 0.0])])
    assert -1e4 < near.margin[0] < 0.0 and near.limit[0] != Limit.NO_PULL


def test_of_two_wrenches_the_worse_decides_and_a_proof_beats_a_failure_to_compute():
    robot = ct.load_robot("carosac")
    rest = hold(robot, np.repeat(robot.home_position[None], 9, axis=0))
    none, unknown = -np.inf, np.nan
    one = np.array([none, none, none, unknown, unknown, unknown, 2.0, 2.0, 2.0])
    other = np.array([none, unknown, 1.0, none, unknown, 1.0, none, unknown, 1.0])
    expected = [none, none, none, none, unknown, unknown, none, unknown, 1.0]
    found = _worse(replace(rest, margin=one), replace(rest, margin=other)).margin
    assert found == pytest.approx(expected, nan_ok=True)


def test_no_pose_that_inverse_kinematics_can_hold_is_called_infeasible():
    robot = ct.load_robot("scampi")
    edge = [[-1.67151, -8.13983, 2.67828], [0.3649, -8.13983, 1.41957], [0.77238, 4.58494, 3.937]]
    rng = np.random.default_rng(7)
    lower, upper = robot.exit_points.min(axis=0), robot.exit_points.max(axis=0)
    others = rng.uniform([*lower[:2], 2.0], upper, (60, 3))
    where = np.concatenate([np.array(edge), others])
    other = ct.statics.inverse_kinematics(robot, where)
    assert other.converged[:3].all()
    found = judge(robot, where)
    assert (found.margin >= 0.0)[other.converged & other.stable].all()
    kept = found.rest.converged
    tension = found.rest.tension
    margin = np.minimum(tension - robot.tension_min, robot.tension_max - tension)
    assert (found.margin[kept] <= margin.min(axis=1)[kept] + 1e-5).all()


def test_a_pose_that_withstands_a_box_of_wrenches_withstands_all_in_it():
    robot = eight_cable_robot()
    rng = np.random.default_rng(4)
    where = rng.uniform(robot.workspace_min, robot.workspace_max, (20, 3))
    asked = replace(STRAIGHT, force=(40.0, 60.0, 30.0), moment=(3.0, 0.0, 2.0))
    assert asked.wrenches().shape == (32, 6)
    worst = judge(robot, where, settings=asked).margin
    light = replace(robot, linear_density=1e-9 * robot.linear_density)
    reached = []
    for _ in range(10):
        wrench = rng.uniform(-1.0, 1.0, 6) * [*asked.force, *asked.moment]
        reached.append(hold(light, where, wrench=wrench).margin)
    assert (np.min(reached, axis=0) >= worst - 1e-6).all()
    assert (worst < judge(robot, where, settings=STRAIGHT).margin).all()


def test_sag_changes_margins_by_the_weight_of_cables_and_light_ones_are_straight():
    robot = eight_cable_robot()
    where = np.random.default_rng(1).uniform(robot.workspace_min, robot.workspace_max, (20, 3))
    straight = judge(robot, where, settings=STRAIGHT).margin
    light = replace(robot, linear_density=1e-6 * robot.linear_density)
    assert judge(light, where).margin == pytest.approx(straight, abs=1e-3)
    heavy = replace(robot, linear_density=10.0 * robot.linear_density)
    change = np.abs(judge(heavy, where).margin - straight)
    assert (change > 1e-2).all()
    assert (change < heavy.weight_per_length.sum() * 4.0).all()


def test_several_orientations_count_by_the_worst():
    robot = ct.load_robot("ipanema1")
    turns = Rotation.from_euler("xyz", [[0, 0, 0], [25, 0, 0]], degrees=True).as_matrix()
    grid = box_grid(robot.workspace_min, robot.workspace_max, 60)
    both = compute(robot, grid, settings=STRAIGHT, orientations=list(turns))
    each = [compute(robot, grid, settings=STRAIGHT, orientations=[turn]) for turn in turns]
    inside = [region.verdicts.inside for region in each]
    assert (both.verdicts.inside == (inside[0] & inside[1])).all()
    assert 0 < both.verdicts.inside.sum() < inside[0].sum()
    where_both = both.verdicts.inside
    margins = np.min([region.verdicts.margin for region in each], axis=0)
    assert both.verdicts.margin[where_both] == pytest.approx(margins[where_both])


def test_mirror_images_have_the_same_margin():
    robot = ct.load_robot("ipanema1")
    place = np.array([[0.7, 0.5, 0.8], [-0.7, 0.5, 0.8], [0.7, -0.5, 0.8], [-0.7, -0.5, 0.8]])
    found = judge(robot, place)
    assert found.margin == pytest.approx(found.margin[0], abs=1e-6)
    assert found.distance == pytest.approx(found.distance[0], abs=1e-6)


def test_an_anchor_on_its_exit_point_has_no_cable():
    robot = eight_cable_robot()
    place = robot.exit_points[0] - robot.anchor_points[0]
    found = judge(robot, [place, robot.home_position])
    assert [Limit(x) for x in found.limit] == [Limit.NO_PULL, Limit.INSIDE]


def test_volume_of_a_box_in_the_workspace_is_its_volume():
    robot = ct.load_robot("carosac")
    region = compute(robot, box_grid(robot.workspace_min, robot.workspace_max, 200))
    assert region.share == 1.0 and region.unknown == 0
    assert "positions in the box" in region.sentence()
    assert region.volume == pytest.approx(64.0)


def test_bad_settings_are_named():
    with pytest.raises(InvalidField, match="force"):
        WorkspaceSettings(force=(-1.0, 0.0, 0.0))
    with pytest.raises(InvalidField, match="clearance"):
        WorkspaceSettings(clearance=float("nan"))
    with pytest.raises(InvalidField, match="tilt_max"):
        WorkspaceSettings(tilt_max=4.0)
    robot = ct.load_robot("carosac")
    with pytest.raises(InvalidField, match="leave it free"):
        judge(robot, [robot.home_position], np.eye(3)[None])
    with pytest.raises(InvalidField, match="tensions"):
        maps(robot, judge(robot, [robot.home_position]), tensions="most")
