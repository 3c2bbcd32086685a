"""The reference solutions hold what is known about them: the yardstick is measured first."""

import ast
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tests import reference
from tests.robots import eight_cable_robot, simple_robot, with_pulleys

# span, rise, unstrained length [m], EA [N], weight [N/m] -> H, V_lower, V_upper [N] as published,
# and the digits after the decimal point that were.
KNOWN = [
    (400, 200, 500, 7.51e12, 200, 43694.60462, -22365.58945, 77634.41055, 5),
    (89.9, 59.2, 130, 7.51e8, 881.05, 31373.23488, -26650.3387, 87886.1613, 4),
    (246.22420940032947, 263.55766330843164, 360.6256626239693, 7e8, 3.08735,
     71116.8172, 75567.26582, 76680.64346, 4),
    (246.22420940032947, 263.55766330843164, 360.64566262396926, 7e8, 3.08735,
     46077.27117, 48765.37304, 49878.81243, 5),
    (246.22420940032947, 263.55766330843164, 360.63566262396927, 7e8, 3.08735,
     58377.24142, 61931.00444, 63044.41296, 5),
    (5, 3, 12, 950000, 0.1035, 0.1063352646, -0.463341058, 0.778658942, 9),
]  # fmt: skip


@pytest.mark.parametrize(("span", "rise", "length", "ea", "w", "h", "low", "up", "digits"), KNOWN)
def test_catenary_gives_the_published_tensions(span, rise, length, ea, w, h, low, up, digits):
    horizontal, vertical = reference.catenary(span, rise, length, w, ea)
    unit = 0.51 * 10.0**-digits  # the published figures are rounded
    for result, known in ((horizontal, h), (vertical, low), (vertical + w * length, up)):
        assert result == pytest.approx(known, rel=1e-9, abs=unit)


@pytest.mark.parametrize("case", KNOWN)
def test_catenary_closes_to_extended_precision(case):
    span, rise, length, ea, w = case[:5]
    h, v = reference.catenary(span, rise, length, w, ea)
    ends = reference.catenary_ends(*(np.longdouble(x) for x in (h, v, length, w, ea)))
    stiffness = h / span + ea / length  # rounding H to a double moves the end by this much at most
    slop = 1e-15 * length + 4e-16 * max(abs(h), abs(v)) / stiffness
    assert float(abs(ends[0] - span)) < slop * 1e3
    assert float(abs(ends[1] - rise)) < slop * 1e3


def test_catenary_closed_form_is_the_integral_of_the_cable_equation():
    h, v, w, ea, length = 3.0, -0.8, 0.4, 2.0e3, 7.0

    def tangent(s, _):
        vertical = v + w * s
        tension = np.hypot(h, vertical)
        return np.array([h, vertical]) / tension * (1.0 + tension / ea)

    end = solve_ivp(tangent, (0.0, length), [0.0, 0.0], rtol=1e-12, atol=1e-13).y[:, -1]
    assert end == pytest.approx(reference.catenary_ends(h, v, length, w, ea), abs=1e-11)


def test_end_forces_of_one_cable_close_on_its_exit_point():
    robot = simple_robot(run_length=np.zeros(4))
    anchor = np.array([[0.0, 0.0, 2.0]] * 4)
    chord = robot.exit_points - anchor
    length = np.linalg.norm(chord, axis=1) * np.array([0.9999, 1.0001, 1.01, 1.8])
    force = np.zeros((4, 3))
    for i in range(4):
        flat = np.hypot(*chord[i, :2])
        w, ea = robot.weight_per_length[i], robot.axial_stiffness[i]
        h, v = reference.catenary(flat, chord[i, 2], length[i], w, ea)
        force[i] = [*(h * chord[i, :2] / flat), v]
    gap = reference.cable_closure(robot, length, anchor, force.astype(np.longdouble))
    assert np.abs(gap.astype(float)).max() < 1e-12


def test_equilibrium_balances_and_does_not_depend_on_the_guess():
    robot = simple_robot()
    position = np.array([0.4, -1.8, 2.2])
    anchor = position + robot.anchor_points
    length = np.linalg.norm(robot.exit_points - anchor, axis=1) + np.array([0.0, 3e-3, 0.0, 2e-3])
    first = reference.equilibrium(robot, length, position, np.eye(3))
    turned = reference.random_rotation(np.random.default_rng(1), 0.05)
    second = reference.equilibrium(robot, length, np.add(position, [0.05, -0.04, 0.03]), turned)
    assert first.residual < 1e-14
    assert second.residual < 1e-14
    assert second.position == pytest.approx(first.position, abs=1e-10)
    assert second.rotation == pytest.approx(first.rotation, abs=1e-10)
    assert second.tension == pytest.approx(first.tension, rel=1e-8)


def test_equilibrium_of_stiff_light_cables_keeps_their_straight_lengths():
    robot = simple_robot(linear_density=np.full(4, 1e-6), axial_stiffness=np.full(4, 1e12))
    position = np.array([0.4, -1.8, 2.2])
    length = np.linalg.norm(robot.exit_points - position - robot.anchor_points, axis=1)
    length[3] += 0.01
    equilibrium = reference.equilibrium(robot, length, position, np.eye(3))
    anchor = equilibrium.position + robot.anchor_points @ equilibrium.rotation.T
    taut = equilibrium.tension > 1.0
    assert taut.all()  # three would hold it: it tilts until the long cable carries too
    assert equilibrium.residual < 1e-12
    distance = np.linalg.norm(robot.exit_points - anchor, axis=1)
    assert distance == pytest.approx(length, abs=1e-8)


@pytest.mark.parametrize("make", [simple_robot, eight_cable_robot])
def test_equilibrium_over_pulleys_closes_and_tends_to_eyelets(make):
    robot = make(run_length=np.full(make().n, 3.0))
    position = np.add(robot.home_position, [0.1, -0.05, 0.07])
    length = np.linalg.norm(robot.exit_points - position - robot.anchor_points, axis=1)
    length = length * 0.9999 if robot.n == 8 else length + 1e-3
    plain = reference.equilibrium(robot, length, position, np.eye(3))
    tiny = reference.equilibrium(with_pulleys(robot, 1e-9), length, position, np.eye(3))
    assert plain.residual < 1e-13
    assert tiny.residual < 1e-13
    assert tiny.position == pytest.approx(plain.position, abs=1e-6)
    wound = with_pulleys(robot, 0.06)
    longer = length + np.array([0.06 * np.pi / 2] * robot.n)
    real = reference.equilibrium(wound, longer, position, np.eye(3))
    assert real.residual < 1e-12


def test_run_length_adds_its_stretch():
    robot = eight_cable_robot()
    position = robot.home_position
    length = np.linalg.norm(robot.exit_points - position - robot.anchor_points, axis=1) * 0.9995
    running = replace(robot, run_length=np.full(8, 5.0))
    soft = reference.equilibrium(running, length, position, np.eye(3))
    strain = soft.tension / robot.axial_stiffness
    hard = reference.equilibrium(robot, length + 5.0 * strain, position, np.eye(3))
    assert hard.tension == pytest.approx(soft.tension, rel=1e-3)  # strain at the exit differs a bit


def test_tensions_of_osqp_and_of_least_distance_programming_agree():
    rng = np.random.default_rng(4)
    robot = eight_cable_robot()
    lower, upper = np.full(8, 5.0), np.full(8, 500.0)
    result = 0
    for _ in range(30):
        position = rng.uniform(robot.workspace_min, robot.workspace_max)
        arm = robot.anchor_points @ reference.random_rotation(rng, 0.1).T
        cable = robot.exit_points - position - arm
        unit = cable / np.linalg.norm(cable, axis=1, keepdims=True)
        structure = np.hstack([unit, np.cross(arm, unit)]).T
        wrench = np.array([0.0, 0.0, -robot.weight, 0.0, 0.0, 0.0])
        one = reference.tension_distribution_osqp(structure, wrench, lower, upper)
        two = reference.tension_distribution_nnls(structure, wrench, lower, upper)
        assert (one is None) == (two is None)
        if one is not None:
            result += 1
            assert one == pytest.approx(two, abs=1e-7)
            assert np.abs(structure @ two + wrench).max() < 1e-10
    assert result > 10


def test_mass_matrix_gives_kinetic_energy_of_the_centre_of_mass():
    rng = np.random.default_rng(5)
    robot = eight_cable_robot()
    turn = reference.random_rotation(rng, 1.0)
    twist = rng.normal(size=6)
    arm = turn @ robot.center_of_mass
    speed = twist[:3] + np.cross(twist[3:], arm)
    spin = turn.T @ twist[3:]
    energy = 0.5 * robot.mass * speed @ speed + 0.5 * spin @ robot.inertia @ spin
    mass = reference.mass_matrix(robot, turn)
    assert 0.5 * twist @ mass @ twist == pytest.approx(energy, rel=1e-12)


def test_bias_wrench_is_newton_and_euler_at_the_platform_origin():
    rng = np.random.default_rng(6)
    robot = eight_cable_robot()
    turn = reference.random_rotation(rng, 1.0)
    twist = rng.normal(size=6)
    omega, arm = twist[3:], turn @ robot.center_of_mass
    inertia = turn @ robot.inertia @ turn.T
    force = robot.mass * np.cross(omega, np.cross(omega, arm))
    moment = np.cross(omega, inertia @ omega) + np.cross(arm, force)
    expected = np.concatenate([force, moment])
    assert reference.bias_wrench(robot, turn, twist) == pytest.approx(expected, abs=1e-12)


def test_reference_uses_none_of_our_physics():
    tree = ast.parse(Path(reference.__file__).read_text())
    modules = [n.module or "" for n in ast.walk(tree) if isinstance(n, ast.ImportFrom)]
    modules += [a.name for n in ast.walk(tree) if isinstance(n, ast.Import) for a in n.names]
    ours = {m for m in modules if m.startswith("carosac_toolkit")}
    assert ours == {"carosac_toolkit.robot.robot"}
