"""The oracles hold what is known about them: conservation, limits, agreement with our statics."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import simpson
from scipy.spatial.transform import Rotation

import carosac_toolkit as ct
from tests import reference as cables
from tests.robots import eight_cable_robot, simple_robot, with_pulleys
from tests.sim_warp import reference

TILTED = Rotation.from_rotvec([0.4, -0.3, 0.9]).as_matrix()
TWIST = np.array([0.3, -0.2, 0.5, 2.0, -3.0, 1.5])


def at_home(robot, offset=(0.0, 0.0, 0.0)):
    found = ct.statics.inverse_kinematics(robot, robot.home_position[None] + [offset])
    assert found.converged[0]
    return found


def without_drag(robot, **changes):
    return replace(robot, drag=0.0, angular_drag=0.0, **changes)


def lopsided(robot):
    """A platform without any symmetry."""
    turn = Rotation.from_rotvec([0.3, 0.5, -0.2]).as_matrix()
    inertia = turn @ np.diag([0.4, 0.6, 0.9]) @ turn.T
    return replace(robot, center_of_mass=np.array([0.05, -0.08, -0.12]), inertia=inertia)


def hanging():
    """A platform on four parallel, light cables: a pendulum that does not turn."""
    robot = eight_cable_robot()
    corners = np.array([[x, y, 0.0] for x in (-0.3, 0.3) for y in (-0.2, 0.2)])
    per_cable = {
        name: getattr(robot, name)[:4]
        for name in (
            "pulley_radius", "swivel_axis", "run_length", "axial_stiffness", "axial_damping",
            "cable_diameter", "tension_min", "tension_max", "speed_max", "acceleration_max",
            "winch_lag", "length_min", "length_max", "exit_friction", "anchor_friction",
            "capstan_friction", "length_hysteresis",
        )
    }  # fmt: skip
    per_cable["axial_stiffness"] = np.full(4, 1e5)
    return without_drag(
        robot,
        cable_names=robot.cable_names[:4],
        exit_points=corners + np.array([0.0, 0.0, 2.0]),
        anchor_points=corners,
        linear_density=np.full(4, 1e-5),
        center_of_mass=np.zeros(3),
        home_position=np.zeros(3),
        **per_cable,
    )


# --- Small motions -----------------------------------------------------------------------------


@pytest.mark.parametrize("robot", [simple_robot(), with_pulleys(simple_robot())])
def test_linear_modes_are_those_of_the_toolkit(robot):
    found = at_home(robot, [0.5, -0.7, 0.4])
    _, shapes = reference.linear_modes(robot, found)
    for cable_mass in (False, True):
        frequency, _ = reference.linear_modes(robot, found, cable_mass=cable_mass)
        expected = ct.modes.natural_frequencies(robot, found, cable_mass=cable_mass)[0]
        assert frequency == pytest.approx(expected, rel=1e-5)
    mass = cables.mass_matrix(robot, found.rotation[0])
    assert shapes.T @ mass @ shapes == pytest.approx(np.eye(6), abs=1e-9)


def test_mass_of_the_cables_slows_every_mode_a_little():
    robot = simple_robot()
    found = at_home(robot)
    bare, laden = (reference.linear_modes(robot, found, cable_mass=m)[0] for m in (False, True))
    extra = robot.linear_density @ found.unstrained_length[0] / 3.0
    assert (laden < bare).all()
    assert laden[0] == pytest.approx(bare[0] * (1.0 - extra / robot.mass / 2.0), rel=2e-3)


# --- Chains of point masses --------------------------------------------------------------------


@pytest.mark.parametrize("run_length", [0.0, 8.0])
@pytest.mark.parametrize("robot", [simple_robot(), lopsided(eight_cable_robot())])
def test_every_node_and_the_platform_are_in_balance(robot, run_length):
    """Forces from the distances of the nodes alone, not from the march."""
    robot = replace(robot, run_length=np.full(robot.n, run_length))
    length = at_home(robot, [0.1, -0.2, 0.15]).unstrained_length[0] * (1.0 + 1e-4)
    n = 6
    rest = reference.string_equilibrium(robot, length, n)
    assert rest.residual < 1e-13
    step = np.diff(rest.nodes, axis=1)
    distance = np.linalg.norm(step, axis=2)
    piece = np.outer(length / n, reference.segment_shares(n))
    strain = rest.tension[:, 0] / robot.axial_stiffness
    held = np.repeat((length / n)[:, None], n, axis=1)  # material that weighs
    held[:, 0] += run_length * strain / (1.0 + strain)
    weight = robot.weight_per_length[:, None] * held
    above = weight[:, 0] / 2.0 * -step[:, 0, 2] / distance[:, 0]  # more at the exit than on average
    tension = robot.axial_stiffness[:, None] * (distance - piece)
    first = piece[:, 0]
    tension[:, 0] = (tension[:, 0] - run_length * above) * first / (first + run_length)
    tension = tension / piece
    assert tension == pytest.approx(rest.tension, abs=1e-6)  # rounding of 1e-15 m times EA / l
    pull = rest.tension[..., None] * step / distance[..., None]  # on the node above, downwards
    nodal = (weight[:, 1:] + weight[:, :-1]) / 2.0
    balance = pull[:, 1:] - pull[:, :-1] - nodal[..., None] * reference.UP
    assert balance == pytest.approx(np.zeros_like(balance), abs=1e-9)
    ends = -pull[:, -1] - weight[:, -1:] / 2.0 * reference.UP
    assert ends == pytest.approx(rest.force, abs=1e-9)
    arm = robot.anchor_points @ rest.rotation.T
    assert rest.nodes[:, -1] == pytest.approx(rest.position + arm, abs=1e-15)
    assert ends.sum(axis=0) == pytest.approx(robot.weight * reference.UP, abs=1e-9)
    center = rest.rotation @ robot.center_of_mass
    moment = np.cross(arm, ends).sum(axis=0) - np.cross(center, robot.weight * reference.UP)
    assert moment == pytest.approx(np.zeros(3), abs=1e-9)


@pytest.mark.parametrize("let_out", [0.0, 0.3])
def test_fine_chains_become_catenaries_with_the_fourth_power_of_the_segments(let_out):
    robot = simple_robot(run_length=np.zeros(4))
    length = at_home(robot, [0.5, -0.7, 0.4]).unstrained_length[0] + [let_out, 0.0, 0.0, 0.0]
    exact = ct.statics.forward_kinematics(robot, length[None])
    chains = {n: reference.string_equilibrium(robot, length, n) for n in (8, 16, 32)}
    miss = [np.linalg.norm(chain.position - exact.position[0]) for chain in chains.values()]
    assert miss[0] < 2e-6
    if let_out:  # taut ones are right to the rounding of the solvers
        assert 12.0 < miss[0] / miss[1] < 30.0
        assert 12.0 < miss[1] / miss[2] < 30.0
    shape = ct.statics.cable_shape(robot, exact, 33)[0]
    tangent = 0.5 * (chains[32].nodes[:, 10:-11] + chains[32].nodes[:, 11:-10])
    between = 0.5 * (shape[:, 10:-11] + shape[:, 11:-10])  # chords there, a little inside
    assert np.abs(tangent - between).max() < (2e-3 if let_out else 2e-5)


def test_cable_behind_the_exit_gives_as_much_in_chains_as_in_catenaries():
    robot = simple_robot()
    length = at_home(robot).unstrained_length[0]
    exact = ct.statics.forward_kinematics(robot, length[None]).position[0]
    chain = reference.string_equilibrium(robot, length, 32).position
    stiff = replace(robot, run_length=np.zeros(4))
    stretch = ct.statics.forward_kinematics(stiff, length[None]).position[0] - exact
    assert np.linalg.norm(stretch) > 1e-3
    assert chain == pytest.approx(exact, abs=2e-7)  # the weight of what the run lets out


# --- Free flight -------------------------------------------------------------------------------


def test_in_free_flight_the_centre_of_mass_falls_and_angular_momentum_stays():
    robot = lopsided(simple_robot())
    start = np.array([1.0, 2.0, 3.0])
    times = np.linspace(0.0, 2.0, 9)
    flight = reference.free_flight(robot, start, TILTED, TWIST, 2.0, times=times)
    center = flight.position + flight.rotation @ robot.center_of_mass
    speed = TWIST[:3] + np.cross(TWIST[3:], TILTED @ robot.center_of_mass)
    fall = -0.5 * robot.gravity * times**2
    line = center[0] + times[:, None] * speed + fall[:, None] * reference.UP
    assert center == pytest.approx(line, abs=1e-10)
    inertia = flight.rotation @ robot.inertia @ flight.rotation.swapaxes(1, 2)
    momentum = np.einsum("kij,kj->ki", inertia, flight.twist[:, 3:])
    assert momentum == pytest.approx(np.tile(momentum[0], (9, 1)), abs=1e-10)
    energy = np.einsum("ki,ki->k", momentum, flight.twist[:, 3:])
    assert energy == pytest.approx(energy[0], abs=1e-10)
    assert np.abs(flight.twist[-1, 3:] - TWIST[3:]).max() > 0.1  # it tumbles


def test_a_spin_about_a_principal_axis_goes_on():
    robot = simple_robot(center_of_mass=np.zeros(3))
    spin = TILTED @ [0.0, 0.0, 4.0]
    flight = reference.free_flight(robot, np.zeros(3), TILTED, [0, 0, 0, *spin], 1.5)
    turned = Rotation.from_rotvec(1.5 * spin).as_matrix() @ TILTED
    assert flight.rotation[0] == pytest.approx(turned, abs=1e-10)
    assert flight.twist[0, 3:] == pytest.approx(spin, abs=1e-10)


def test_twist_is_the_rate_of_the_pose():
    robot = lopsided(simple_robot())
    h = 1e-4
    ahead = reference.free_flight(
        robot, np.zeros(3), TILTED, TWIST, 0.5, times=[0.5 - 2 * h, 0.5 - h, 0.5]
    )
    speed = (ahead.position[2] - ahead.position[0]) / (2 * h)
    turn = Rotation.from_matrix(ahead.rotation[2] @ ahead.rotation[0].T).as_rotvec() / (2 * h)
    assert np.append(speed, turn) == pytest.approx(ahead.twist[1], abs=1e-6)


# --- Motion on cables --------------------------------------------------------------------------


@pytest.mark.parametrize(
    "robot", [simple_robot(), with_pulleys(simple_robot()), eight_cable_robot()]
)
def test_hanging_cables_pull_as_in_our_statics(robot):
    found = at_home(robot, [0.1, 0.2, 0.3])
    anchor = found.position[0] + robot.anchor_points @ found.rotation[0].T
    force = reference.HangingCables(robot).force(found.unstrained_length[0], anchor)
    tension = np.linalg.norm(force, axis=1)
    assert tension == pytest.approx(found.tension[0], rel=1e-8)
    assert force[:, :2] == pytest.approx(found.exit_tension[0, :, :2], rel=1e-7)


def test_hanging_cables_close_after_large_moves_and_when_let_out():
    robot = simple_robot()
    found = at_home(robot)
    hang = reference.HangingCables(robot)
    length, anchor = found.unstrained_length[0], found.position[0] + robot.anchor_points
    for slack, shift in ((0.0, 0.0), (0.5, 0.05), (0.0, 0.01), (3.0, -0.3)):
        goal = anchor + np.array([shift, 0.0, shift])
        force = hang.force(length + slack, goal)
        gap = cables.cable_closure(robot, length + slack, goal, force.astype(np.longdouble))
        assert np.abs(gap).max() < 1e-12


@pytest.mark.parametrize("cable_mass", [False, True])
def test_a_platform_at_rest_stays(cable_mass):
    robot = lopsided(with_pulleys(simple_robot()))
    found = at_home(robot)
    rest = (found.unstrained_length[0], found.position[0], found.rotation[0])
    after = reference.dynamics_oracle(robot, *rest, np.zeros(6), 0.2, cable_mass=cable_mass)
    assert after.position[0] == pytest.approx(found.position[0], abs=1e-9)
    assert np.abs(after.twist).max() < 1e-7
    assert after.tension[0] == pytest.approx(found.tension[0], rel=1e-8)


def test_four_parallel_cables_make_a_pendulum():
    robot = hanging()
    tension = robot.weight / 4.0
    reach = 2.0 * (1.0 + tension / 1e5)
    low, amplitude = 2.0 - reach, 0.01
    rise = reach - np.sqrt(reach**2 - amplitude**2)
    period = 2.0 * np.pi * np.sqrt(reach / robot.gravity)
    swing = reference.dynamics_oracle(
        robot,
        np.full(4, 2.0),
        [amplitude, 0.0, low + rise],
        np.eye(3),
        np.zeros(6),
        period,
        times=period * np.array([0.25, 0.5, 1.0]),
    )
    assert swing.position[:, 0] == pytest.approx(amplitude * np.array([0, -1, 1]), abs=2e-5)
    assert swing.position[:, 1] == pytest.approx(np.zeros(3), abs=1e-9)


@pytest.mark.parametrize("cable_mass", [False, True])
@pytest.mark.parametrize("mode", [1, 4])
def test_a_small_swing_in_a_mode_is_a_cosine_of_its_frequency(mode, cable_mass):
    robot = without_drag(lopsided(simple_robot()))
    found = at_home(robot)
    frequency, shapes = reference.linear_modes(robot, found, cable_mass=cable_mass)
    start = 1e-4 * shapes[:, mode]
    period = 1.0 / frequency[mode]
    swing = reference.dynamics_oracle(
        robot,
        found.unstrained_length[0],
        found.position[0] + start[:3],
        Rotation.from_rotvec(start[3:]).as_matrix() @ found.rotation[0],
        np.zeros(6),
        period,
        times=period * np.array([0.25, 0.5, 1.0]),
        cable_mass=cable_mass,
    )
    moved = swing.position - found.position[0]
    turned = Rotation.from_matrix(swing.rotation @ found.rotation[0].T).as_rotvec()
    share = np.hstack([moved, turned]) @ start / (start @ start)
    assert share == pytest.approx([0.0, -1.0, 1.0], abs=5e-3)


def energy(robot, length, position, rotation, twist):
    """Of platform and cables, the stretch behind the exits included [J]; eyelets only."""
    center = rotation @ robot.center_of_mass
    total = 0.5 * twist @ cables.mass_matrix(robot, rotation) @ twist
    total += robot.weight * (position + center)[2]
    anchor = position + robot.anchor_points @ rotation.T
    force = reference.HangingCables(robot).force(length, anchor)
    w, ea = robot.weight_per_length, robot.axial_stiffness
    free = length.copy()
    for _ in range(20):
        strain = np.linalg.norm(force + np.outer(w * free, reference.UP), axis=1) / ea
        free = length + robot.run_length * strain / (1.0 + strain)
    share, weight = np.polynomial.legendre.leggauss(60)
    s = free[:, None] * (share + 1.0) / 2.0  # material from the anchor
    pull = force[:, None] + (w[:, None] * s)[..., None] * reference.UP
    tension = np.linalg.norm(pull, axis=2)
    stored = tension**2 / (2.0 * ea[:, None])
    climb = pull[..., 2] / tension * (1.0 + tension / ea[:, None])
    stored += w[:, None] * (free[:, None] - s) * climb
    total += (free / 2.0 * (stored @ weight) + w * free * anchor[:, 2]).sum()
    behind = robot.run_length / (1.0 + strain)
    return total + (behind * (ea * strain**2 / 2.0 + w * robot.exit_points[:, 2])).sum()


@pytest.mark.parametrize("drag", [0.0, 3.0])
def test_energy_goes_where_the_drag_takes_it(drag):
    axes = np.array([0.5, 1.0, 2.0])
    robot = replace(
        lopsided(simple_robot()), drag=drag, angular_drag=0.2 * drag, angular_drag_axes=axes
    )
    found = at_home(robot)
    length, times = found.unstrained_length[0], np.linspace(0.0, 0.2, 81)
    twist = np.array([0.2, 0.1, 0.0, 0.2, -0.1, 0.3])
    pose = (found.position[0], found.rotation[0])
    swing = reference.dynamics_oracle(robot, length, *pose, twist, 0.2, times=times)
    held = [
        energy(robot, length, swing.position[k], swing.rotation[k], swing.twist[k])
        for k in (0, 20, 50, 80)
    ]
    center = swing.rotation @ robot.center_of_mass
    speed = swing.twist[:, :3] + np.cross(swing.twist[:, 3:], center)
    spin = np.einsum("kji,kj->ki", swing.rotation, swing.twist[:, 3:])
    power = drag * (speed**2).sum(axis=1) + 0.2 * drag * spin**2 @ axes
    lost = [simpson(power[: k + 1], x=times[: k + 1]) if k else 0.0 for k in (0, 20, 50, 80)]
    assert np.subtract(held, held[0]) == pytest.approx(-np.array(lost), abs=1e-6)
    assert (lost[-1] > 0.05) == (drag > 0.0)


def test_winding_puts_in_the_work_of_the_tension_at_the_exits():
    """Adding dL at the exit costs its stored energy and its weight, and yields T (1 + T / EA)."""
    robot = without_drag(lopsided(simple_robot(run_length=np.zeros(4))))
    found = at_home(robot)
    times = np.linspace(0.0, 0.5, 201)
    rates = 0.2 * np.array([-1.0, -0.6, -0.8, -0.3])

    def length(t):
        return found.unstrained_length[0] + rates * t**3 / 0.5**2

    pose = (found.position[0], found.rotation[0])
    moved = reference.dynamics_oracle(robot, length, *pose, np.zeros(6), 0.5, times=times)
    hang, power = reference.HangingCables(robot), np.empty(len(times))
    w, ea = robot.weight_per_length, robot.axial_stiffness
    for k, t in enumerate(times):
        anchor = moved.position[k] + robot.anchor_points @ moved.rotation[k].T
        force = hang.force(length(t), anchor)
        top = np.linalg.norm(force + np.outer(w * length(t), reference.UP), axis=1)
        gain = top**2 / (2.0 * ea) + w * robot.exit_points[:, 2] - top * (1.0 + top / ea)
        power[k] = gain @ (rates * 3.0 * t**2 / 0.5**2)
    states = (moved.position, moved.rotation, moved.twist)
    first, last = (energy(robot, length(times[k]), *(x[k] for x in states)) for k in (0, -1))
    assert last - first == pytest.approx(simpson(power, x=times), abs=1e-5)
    assert last - first > 5.0
