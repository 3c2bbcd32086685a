"""The prediction model against pinocchio, finite differences, energy and statics."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from baselines.mpc import model
from baselines.mpc.geometry import geometry_at
from baselines.mpc.machine_code import CompileError, cache_folder
from baselines.mpc.stage_function import StageFunction
from carosac_toolkit.physics.rest import statics
from tests.robots import eight_cable_robot, simple_robot, with_pulleys

TURN = Rotation.from_rotvec([0.3, -0.2, 0.5]).as_matrix()
STATE = np.concatenate([[0.5, -1.6, 2.4], [0.05, -0.08, 0.1], [0.3, -0.4, 0.2], [0.6, -0.5, 0.9]])
TENSION = np.array([80.0, 95.0, 70.0, 110.0])
DISTURBANCE = np.array([0.1, -0.2, 0.3, 0.5, -0.4, 0.6])


def light(robot):
    """Cables without weight or mass, no air."""
    n = robot.n
    return replace(robot, linear_density=np.full(n, 1e-12), drag=0.0, angular_drag=0.0)


def numbers(robot, *, rotation=TURN, disturbance=None):
    lengths = np.linalg.norm(robot.exit_points - STATE[:3], axis=1)
    return model.parameters(
        robot, rotation=rotation, length=lengths, exits=robot.exit_points,
        disturbance=np.zeros(6) if disturbance is None else disturbance,
    )  # fmt: skip


def evaluate(robot, state, tension, **options):
    out = model.continuous(robot.n)(state, tension, numbers(robot, **options))
    return [np.array(value).squeeze() for value in out]


def stage(compiled="never", stages=1):
    return StageFunction(4, stages, compiled)


def run(function, robot, state, tension, duration, **options):
    function.state[:], function.tension[:] = state, tension
    function.duration[:], function.parameters[:] = duration, numbers(robot, **options)
    function()
    return function


def test_motion_agrees_with_pinocchio():
    import pinocchio as pin

    robot = replace(light(simple_robot()), center_of_mass=[0.03, -0.05, -0.12])
    rotation = model.rotation_of(STATE[3:6]) @ TURN
    velocity, spin = STATE[6:9], STATE[9:]
    platform = pin.Model()
    joint = platform.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "platform")
    body = pin.Inertia(robot.mass, np.array(robot.center_of_mass), np.array(robot.inertia))
    platform.appendBodyToJoint(joint, body, pin.SE3.Identity())
    platform.gravity.linear = np.array([0.0, 0.0, -robot.gravity])
    arm = robot.anchor_points @ rotation.T
    pull = robot.exit_points - STATE[:3] - arm
    pull *= (TENSION / np.linalg.norm(pull, axis=1))[:, None]
    wrench = pin.Force(rotation.T @ pull.sum(0), rotation.T @ np.cross(arm, pull).sum(0))
    outside = pin.StdVec_Force()
    outside.extend([pin.Force.Zero(), wrench])
    q = np.concatenate([STATE[:3], Rotation.from_matrix(rotation).as_quat()])
    v = np.concatenate([rotation.T @ velocity, rotation.T @ spin])
    a = pin.aba(platform, platform.createData(), q, v, np.zeros(6), outside)
    linear = rotation @ (a[:3] + np.cross(v[3:], v[:3]))
    rate = evaluate(robot, STATE, TENSION)[0]
    assert rate[6:9] == pytest.approx(linear, abs=1e-9)
    assert rate[9:] == pytest.approx(rotation @ a[3:], abs=1e-9)


def test_air_brakes_the_turning_about_each_axis_of_the_platform():
    plain = light(replace(simple_robot(), center_of_mass=np.zeros(3)))
    factors = np.array([0.5, 1.0, 2.0])
    airy = replace(plain, angular_drag=0.3, angular_drag_axes=factors)
    rotation = model.rotation_of(STATE[3:6]) @ TURN
    braked = evaluate(airy, STATE, TENSION)[0] - evaluate(plain, STATE, TENSION)[0]
    moment = -0.3 * factors * (rotation.T @ STATE[9:])
    assert braked[9:] == pytest.approx(rotation @ np.linalg.solve(plain.inertia, moment), abs=1e-9)
    assert braked[:9] == pytest.approx(np.zeros(9), abs=1e-9)


def test_rodrigues_parameters_turn_with_the_angular_velocity():
    rate = evaluate(simple_robot(), STATE, TENSION)[0]
    h = 1e-6
    after = Rotation.from_rotvec(h * STATE[9:]).as_matrix() @ model.rotation_of(STATE[3:6])
    assert (model.parameters_of(after) - STATE[3:6]) / h == pytest.approx(rate[3:6], abs=1e-5)


def test_a_disturbance_is_an_acceleration():
    robot = simple_robot()
    without = evaluate(robot, STATE, TENSION)[0]
    disturbed = evaluate(robot, STATE, TENSION, disturbance=DISTURBANCE)[0]
    assert disturbed[9:] - without[9:] == pytest.approx(DISTURBANCE[3:], abs=1e-12)
    center = model.rotation_of(STATE[3:6]) @ TURN @ simple_robot().center_of_mass
    along = disturbed[6:9] - without[6:9] + np.cross(DISTURBANCE[3:], center)
    assert along == pytest.approx(DISTURBANCE[:3], abs=0.05)


def test_path_is_length_and_its_two_derivatives():
    robot, h = simple_robot(), 1e-4
    function = stage()
    paths = [run(function, robot, STATE, TENSION, t).after[0].copy() for t in (-h, h)]
    before, after = (evaluate(robot, s, TENSION)[3].reshape(3, 4) for s in paths)
    here = evaluate(robot, STATE, TENSION)[3].reshape(3, 4)
    assert here[1] == pytest.approx((after[0] - before[0]) / (2 * h), abs=1e-6)
    assert here[2] == pytest.approx((after[1] - before[1]) / (2 * h), abs=1e-5)


def test_jacobians_of_a_stage_are_its_finite_differences():
    robot, function, step = simple_robot(), stage(), 1e-6
    run(function, robot, STATE, TENSION, 0.1, disturbance=DISTURBANCE)
    found = [x[0].copy() for x in (function.by_state, function.by_tension,
                                   function.path_by_state, function.path_by_tension)]  # fmt: skip

    def changed(index, size):
        results = []
        for sign in (1.0, -1.0):
            both = np.concatenate([STATE, TENSION])
            both[index] += sign * size
            run(function, robot, both[:12], both[12:], 0.1, disturbance=DISTURBANCE)
            results.append(np.concatenate([function.after[0], function.path[0]]))
        return (results[0] - results[1]) / (2 * size)

    columns = [changed(k, step if k < 12 else 1e-3) for k in range(16)]
    expected = np.stack(columns, axis=1)
    got = np.block([[found[0], found[1]], [found[2], found[3]]])
    assert got == pytest.approx(expected, abs=2e-6)


def test_energy_is_kept_without_air():
    robot = replace(light(simple_robot()), center_of_mass=[0.03, -0.05, -0.12])
    function = stage()

    def energy(state):
        rotation = model.rotation_of(state[3:6]) @ TURN
        center = rotation @ robot.center_of_mass
        velocity = state[6:9] + np.cross(state[9:], center)
        inertia = rotation @ robot.inertia @ rotation.T
        lengths = evaluate(robot, state, TENSION)[3][:4]
        kinetic = 0.5 * robot.mass * velocity @ velocity + 0.5 * state[9:] @ inertia @ state[9:]
        return kinetic + robot.weight * (state[2] + center[2]) + TENSION @ lengths

    state, start = STATE, energy(STATE)
    for _ in range(100):
        state = run(function, robot, state, TENSION, 0.005).after[0].copy()
    assert np.abs(state[6:]).max() > 0.5
    assert energy(state) == pytest.approx(start, abs=1e-5)


@pytest.mark.parametrize("make", [simple_robot, eight_cable_robot])
def test_statics_are_its_rest_where_cables_are_light_and_stiff(make):
    robot = make()
    robot = replace(light(robot), axial_stiffness=np.full(robot.n, 1e12))
    where = robot.home_position + np.array([0.2, -0.15, 0.1])
    rest = statics.inverse_kinematics(robot, where[None])
    assert rest.converged[0]
    state = np.concatenate([where, np.zeros(9)])
    rate = evaluate(robot, state, rest.tension[0], rotation=rest.rotation[0])[0]
    assert np.abs(rate).max() < 1e-6


def test_half_the_weight_of_the_cables_hangs_at_the_platform():
    robot = simple_robot()
    rest = statics.inverse_kinematics(robot, robot.home_position[None])
    state = np.concatenate([robot.home_position, np.zeros(9)])
    geometry = geometry_at(robot, robot.home_position, rest.rotation[0])
    # Halfway between what it pulls at the exit and at the platform, it pulls along the chord.
    half = 0.5 * robot.weight_per_length * geometry.free
    chord = rest.exit_tension[0] - half[:, None] * [0.0, 0.0, 1.0]
    pull = np.linalg.norm(chord, axis=1)
    sagging = np.abs(evaluate(robot, state, pull, rotation=rest.rotation[0])[0]).max()
    straight = np.abs(evaluate(light(robot), state, rest.tension[0],
                               rotation=rest.rotation[0])[0]).max()  # fmt: skip
    assert sagging < 0.25 * straight


def test_geometry_starts_where_cables_leave_their_pulleys():
    robot = with_pulleys(simple_robot())
    rotation = Rotation.from_rotvec([0.1, 0.2, -0.1]).as_matrix()
    found = geometry_at(robot, robot.home_position, rotation)
    arm = robot.anchor_points @ rotation.T
    reached = found.exits + found.free[:, None] * found.direction
    assert reached == pytest.approx(robot.home_position + arm, abs=1e-12)
    step, h = np.array([0.3, -0.2, 0.4, 0.2, -0.5, 0.3]), 1e-6

    def moved(sign):
        turn = Rotation.from_rotvec(sign * h * step[3:]).as_matrix() @ rotation
        return geometry_at(robot, robot.home_position + sign * h * step[:3], turn).length

    assert found.jacobian @ step == pytest.approx((moved(1) - moved(-1)) / (2 * h), abs=1e-7)


def test_machine_code_gives_what_the_interpreter_gives(tmp_path, monkeypatch):
    from baselines.mpc import stage_function

    monkeypatch.setenv("CAROSAC_CACHE", str(tmp_path))
    stage_function._function.cache_clear()
    compiled, plain = stage("always", 2), stage("never", 2)
    assert compiled.compiled
    assert plain.reason == "setting"
    assert [p.suffix for p in cache_folder().iterdir()] == [".so"]
    for function in (compiled, plain):
        run(function, simple_robot(), STATE, TENSION, 0.1, disturbance=DISTURBANCE)
    for name in ("after", "by_state", "by_tension", "path", "path_by_state", "path_by_tension"):
        assert getattr(compiled, name) == pytest.approx(getattr(plain, name), abs=1e-11)
    stage_function._function.cache_clear()


def test_without_a_compiler_it_says_so_and_goes_on(tmp_path, monkeypatch):
    from baselines.mpc import stage_function

    monkeypatch.setenv("CAROSAC_CACHE", str(tmp_path))
    monkeypatch.setenv("PATH", str(tmp_path))
    stage_function._function.cache_clear()
    assert "no C compiler" in stage("auto").reason
    with pytest.raises(CompileError, match="no C compiler"):
        stage("always")
    stage_function._function.cache_clear()
