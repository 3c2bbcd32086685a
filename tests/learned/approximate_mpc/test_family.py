"""One network for all suspended robots of four cables: what it reads, and how it is trained."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import carosac_toolkit as ct
from baselines.mpc import MpcSettings
from carosac_toolkit import trajectories
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.loop import plugins
from carosac_toolkit.loop.loop import run
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.robot.similar import similar_robot
from carosac_toolkit.safety.settled import settled
from learned.approximate_mpc.controller import ApproximateMpc
from learned.approximate_mpc.family_network import (
    FamilyNetwork,
    write_family_network,
)
from learned.approximate_mpc.family_numbers import COUNT, PLACES, FamilyNumbers, base_of, mirror
from learned.approximate_mpc.family_robots import (
    RANGES,
    RESTING_SHARE,
    draw_robot,
    family_settings,
    outside,
    quantities,
)
from learned.approximate_mpc.family_training import (
    FamilyDrive,
    FamilySettings,
    distill_family,
    drive_settings,
)
from learned.approximate_mpc.model_world import ModelWorld, answers
from learned.approximate_mpc.networks import load_network, network_for
from learned.approximate_mpc.plan_inputs import PlanInputs
from learned.approximate_mpc.plan_network import PlanNetwork
from learned.approximate_mpc.teacher import Teacher

DRIVER = plugins.load("drivers", "simulator")
SMALL = FamilySettings(
    robots=(3, 1, 1), worlds=("model", "model", "simulator"), updates=(60, 60, 60), batch=64,
    hidden=(16,),
)  # fmt: skip
NOT_OF_SIZE = np.delete(np.arange(COUNT), PLACES["robot"].start + np.arange(1, 4))


def some_inputs(robot, seed=0):
    """A state off a path, with speeds and pushes, in sizes of the robot."""
    rng, scales = np.random.default_rng(seed), Scales(robot)
    length, speed = scales.length, scales.length / scales.time
    ahead = np.linspace(0.0, 1.0, MpcSettings().stages + 1)[:, None]
    way = 0.1 * length * rng.standard_normal(3)
    return PlanInputs(
        position=robot.home_position + 0.01 * length * rng.standard_normal(3),
        rotation=Rotation.from_rotvec(0.03 * rng.standard_normal(3)).as_matrix()
        @ robot.home_rotation,
        twist=np.concatenate([
            0.03 * speed * rng.standard_normal(3), 0.05 / scales.time * rng.standard_normal(3),
        ]),
        target=robot.home_position + ahead * way,
        target_velocity=ahead * way / scales.time,
        center=0.002 * length * rng.standard_normal(3),
        acceleration=np.concatenate([
            0.02 * robot.gravity * rng.standard_normal(3),
            0.02 / scales.time**2 * rng.standard_normal(3),
        ]),
        usual_tension=scales.tension * (1.0 + 0.1 * rng.standard_normal(robot.n)),
        usual_place=0.01 * length * rng.standard_normal(3),
    )  # fmt: skip


def moved(robot, inputs, turn, order, flip):
    """Robot and inputs turned and mirrored by `turn` (3, 3), with other numbers of cables."""
    axial = np.linalg.det(turn) * turn

    def body(matrix):  # the platform frame is mirrored, too
        return turn @ matrix @ flip.T

    return replace(
        robot, exit_points=(robot.exit_points @ turn.T)[order],
        anchor_points=(robot.anchor_points @ flip.T)[order],
        center_of_mass=flip @ robot.center_of_mass, inertia=flip @ robot.inertia @ flip.T,
        home_position=turn @ robot.home_position, home_rotation=body(robot.home_rotation),
    ), replace(
        inputs, position=turn @ inputs.position, rotation=body(inputs.rotation),
        twist=np.concatenate([turn @ inputs.twist[:3], axial @ inputs.twist[3:]]),
        target=inputs.target @ turn.T, target_velocity=inputs.target_velocity @ turn.T,
        center=flip @ inputs.center,
        acceleration=np.concatenate([
            turn @ inputs.acceleration[:3], axial @ inputs.acceleration[3:]
        ]),
        usual_tension=inputs.usual_tension[order], usual_place=turn @ inputs.usual_place,
    )  # fmt: skip


def nearest(images, numbers, found):
    """The image of numbers that is nearest to those found."""
    return min(images, key=lambda x: np.abs(x.sign * numbers[x.order] - found).max())


def planned(robot, inputs):
    """First tensions that MPC plans [N], shape (n,)."""
    teacher = Teacher(robot, MpcSettings())
    rest = statics.inverse_kinematics(robot, robot.home_position[None]).tension
    rests = np.broadcast_to(rest, (MpcSettings().stages, robot.n))
    plan = teacher.ask(inputs, rests, np.zeros(robot.n), np.zeros(robot.n), 0.0)
    return plan.tension[0]


@pytest.fixture(scope="module", params=range(3))
def drawn(request):
    return draw_robot(np.random.default_rng(request.param), "drawn")


@pytest.mark.parametrize("name", ["carosac", "scampi", "stadium", "desktop"])
def test_bundled_robots_of_four_cables_above_are_of_the_family(name):
    assert not outside(ct.load_robot(name))


def test_a_drawn_robot_is_of_the_family_and_rests_all_over_its_box(drawn):
    assert not outside(drawn)
    middle = 0.5 * (drawn.workspace_min + drawn.workspace_max)
    share = 0.5 * RESTING_SHARE * np.random.default_rng(1).uniform(-1.0, 1.0, (50, 3))
    places = middle + share * (drawn.workspace_max - drawn.workspace_min)
    rest = statics.inverse_kinematics(drawn, places)
    assert (rest.converged & rest.stable).all()
    assert (rest.tension < 0.61 * drawn.tension_max).all()
    assert (rest.rotation[:, 2, 2] > 0.49).all()  # some tilt by 60 degrees


def test_a_robot_outside_of_the_ranges_is_refused_by_the_quantity():
    robot = ct.load_robot("carosac")
    assert set(quantities(robot)) == set(RANGES)
    assert "strain at rest" in outside(replace(robot, axial_stiffness=1e-3 * robot.axial_stiffness))
    assert "size of the frame [m] 0.1" in outside(similar_robot(robot, 0.01))
    assert "rectangle" in outside(ct.load_robot("hangprinter"))


def test_a_robot_that_cannot_rest_in_its_box_is_refused():
    robot = ct.load_robot("stadium")
    aside = np.array([0.6 * np.ptp(robot.exit_points[:, 0]), 0.0, 0.0])
    beside = replace(
        robot, home_position=robot.home_position + aside,
        workspace_min=robot.workspace_min + aside, workspace_max=robot.workspace_max + aside,
    )  # fmt: skip
    with pytest.raises(InvalidField, match="places of no rest"):
        network_for(beside)


def test_a_pose_that_is_not_finite_is_refused(drawn):
    inputs = some_inputs(drawn)
    lost = replace(inputs, position=np.full(3, np.nan))
    with pytest.raises(InvalidField, match="not finite"):
        FamilyNumbers(drawn).of(lost)


def test_numbers_mean_the_same_whatever_the_size(drawn):
    """All but those that tell the size and the period, which is the same for all robots."""
    large = similar_robot(drawn, 4.0)
    numbers = [FamilyNumbers(robot).of(some_inputs(robot)) for robot in (drawn, large)]
    assert numbers[1][NOT_OF_SIZE] == pytest.approx(numbers[0][NOT_OF_SIZE], abs=1e-6)


def test_numbers_do_not_depend_on_axes_or_on_the_order_of_cables(drawn):
    inputs, turn = some_inputs(drawn), Rotation.from_euler("z", 130, degrees=True).as_matrix()
    order = np.array([2, 0, 3, 1])
    other, seen = moved(drawn, inputs, turn, order, np.eye(3))
    first, second = FamilyNumbers(drawn), FamilyNumbers(other)
    numbers, again = first.of(inputs), second.of(seen)
    # Which end of the longer side is first is a matter of chance.
    image = nearest([mirror(()), mirror((0, 1))], numbers, again)
    assert again == pytest.approx(image.sign * numbers[image.order], abs=1e-6)
    told = np.array([0.1, -0.05, 0.02, 0.07])
    tension = first.tension(numbers, told)
    assert second.tension(again, told[image.cables]) == pytest.approx(tension[order], rel=1e-6)
    assert first.told(numbers, tension) == pytest.approx(told)


@pytest.mark.parametrize("axes", [(0,), (1,), (0, 1)])
def test_mpc_does_in_a_mirror_image_what_it_does_mirrored(drawn, axes):
    inputs, flip = some_inputs(drawn), np.eye(3)
    flip[axes, axes] = -1.0
    other, seen = moved(drawn, inputs, flip, np.arange(4), flip)
    assert planned(other, seen) == pytest.approx(planned(drawn, inputs), rel=1e-4)
    numbers, mirrored = FamilyNumbers(drawn).of(inputs), FamilyNumbers(other).of(seen)
    images = [mirror((0,)), mirror((1,))] if len(axes) == 1 else [mirror(()), mirror((0, 1))]
    image = nearest(images, numbers, mirrored)  # the longer side may be y
    assert mirrored == pytest.approx(image.sign * numbers[image.order], abs=1e-6)
    assert base_of(mirrored) == pytest.approx(base_of(numbers)[image.cables], abs=1e-6)


def followed(robot, plan=None):
    """Distances from a path in MPC's own model (K,) [m], where `plan`, or MPC, gives tensions."""
    settings, rng = drive_settings(robot), np.random.default_rng(0)
    teacher = Teacher(robot, family_settings(robot))
    world = ModelWorld(robot, settings, teacher.settings.period, teacher.grid, rng)
    away = []
    while world.time < world.end:
        inputs = world.look()
        away.append(np.linalg.norm(inputs.position - inputs.target[0]))
        if plan is None:
            rest, habit = world.rest(inputs)
            tension = teacher.ask(inputs, rest, habit, np.zeros(4), world.time).tension[0]
        else:
            tension = plan(inputs)
        world.move(tension)
    return np.array(away)


def test_mpc_follows_a_path_in_its_own_model():
    away = followed(ct.load_robot("carosac"))
    assert away[0] > 0.01  # it starts off the path
    assert away[-20:].max() < 0.01


@pytest.mark.parametrize("seed", range(2))
def test_the_bundled_network_follows_as_mpc_does_on_a_robot_it_never_saw(seed):
    robot = draw_robot(np.random.default_rng([2033, seed]), "unseen")
    network = network_for(robot)
    assert isinstance(network, FamilyNetwork)
    away, other = followed(robot, network.tensions(robot)), followed(robot)
    assert away[0] == other[0]
    assert np.sqrt((away**2).mean()) < 1.1 * np.sqrt((other**2).mean())


def test_the_bundled_network_drives_a_plant_of_a_robot_it_never_saw():
    """The whole of it: controller, sensors, estimator and winches, in cables of particles."""
    robot = ct.load_robot("desktop")
    controller = ApproximateMpc.build(robot)
    settings = DRIVER.Settings(suite="lengths+imu", period=controller.period)
    driver = DRIVER.build(robot, settled(settings, robot), seed=0)
    estimator = plugins.load("estimators", "dynamic_estimator").build(robot)
    end = robot.home_position + 0.25 * (robot.workspace_max - robot.home_position)
    path = trajectories.line(robot.home_position, end, speed_max=0.3, acceleration_max=1.0)
    logs = [run(driver, estimator, controller, path, duration=1.5) for _ in range(2)]
    away = np.linalg.norm(logs[0].position - logs[0].reference, axis=2)
    assert np.sqrt((away**2).mean()) < 0.01 * Scales(robot).length
    assert not controller.fallbacks
    assert (logs[0].command == logs[1].command).all()  # a reset forgets all


def test_a_robot_gets_its_own_network_or_that_of_the_family():
    carosac = ct.load_robot("carosac")
    assert isinstance(network_for(carosac), PlanNetwork)
    identified = replace(carosac, mass=1.02 * carosac.mass)
    assert isinstance(network_for(identified), FamilyNetwork)
    assert isinstance(network_for(ct.load_robot("stadium")), FamilyNetwork)
    heavy = "'carosac' with other values of mass, unlike .* carosac-mpc, and with largest tension"
    with pytest.raises(InvalidField, match=heavy):
        network_for(replace(carosac, mass=1.5 * carosac.mass))
    with pytest.raises(InvalidField, match=r"exit points off a level rectangle.*carosac distill"):
        network_for(ct.load_robot("hangprinter"))
    with pytest.raises(InvalidField, match=r"8 cables, not 4.*use mpc"):
        network_for(ct.load_robot("cogiro"))


def test_answers_are_those_of_the_states_that_are_given():
    robot, rng = ct.load_robot("carosac"), np.random.default_rng(1)
    settings = replace(drive_settings(robot), nearby=0)
    reader = FamilyNumbers(robot)
    for k, (inputs, tension) in enumerate(answers(robot, settings, MpcSettings(), rng, None)):
        numbers = reader.of(inputs)
        assert reader.tension(numbers, reader.told(numbers, tension)) == pytest.approx(tension)
        if k == 3:
            break


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    pytest.importorskip("torch")
    place = tmp_path_factory.mktemp("family")
    distill_family(place, settings=SMALL)
    return place


def test_a_training_that_was_killed_goes_on_as_if_it_had_not(folder):
    before = (folder / "network.onnx").read_bytes()
    table = (folder / "rounds.csv").read_text()
    for name in ("drive-0004.npz", "round-3.onnx", "network.onnx"):
        (folder / name).unlink()
    distill_family(folder, settings=SMALL)
    assert (folder / "network.onnx").read_bytes() == before
    assert (folder / "rounds.csv").read_text() == table
    with pytest.raises(InvalidField, match="another training"):
        distill_family(folder, seed=1, settings=SMALL)


def test_drives_in_both_worlds_have_answers(folder):
    for k in range(5):
        drive = FamilyDrive.load(folder / f"drive-{k:04d}.npz")
        assert drive.numbers.shape[1] == COUNT and drive.told.shape[1] == 4
        assert len(drive.numbers) > 20 or drive.lost


def test_a_network_drives_any_robot_of_the_family_and_no_other(folder, tmp_path):
    network = load_network(str(folder / "network.onnx"))
    assert isinstance(network, FamilyNetwork)
    for name in ("carosac", "stadium"):
        robot = ct.load_robot(name)
        network.check(robot)
        tension, excess = network.planner(robot)(some_inputs(robot))
        assert (tension >= robot.tension_min).all() and (tension <= robot.tension_max).all()
        assert np.isfinite(excess).all()
    with pytest.raises(InvalidField, match="exit points off a level rectangle"):
        network.check(ct.load_robot("hangprinter"))
    with pytest.raises(InvalidField, match="8 cables"):
        network.check(ct.load_robot("cogiro"))
    other = replace(network.description, ranges={name: [0.0, 1.0] for name in RANGES})
    layers = [(np.full((4, COUNT), 0.1), np.zeros(4))]
    write_family_network(tmp_path / "other.onnx", layers, other)
    with pytest.raises(InvalidField, match="other ranges"):
        load_network(str(tmp_path / "other.onnx"))
    layers = [(np.full((4, 7), 0.1), np.zeros(4))]
    write_family_network(tmp_path / "small.onnx", layers, network.description)
    with pytest.raises(InvalidField, match="of 7 to 4 numbers"):
        FamilyNetwork.load(tmp_path / "small.onnx")


def test_settings_that_make_no_sense_are_refused():
    with pytest.raises(InvalidField, match="as many of each"):
        FamilySettings(robots=(1,), worlds=("model", "model"), updates=(1,))
    with pytest.raises(InvalidField, match="worlds"):
        FamilySettings(robots=(1,), worlds=("moon",), updates=(1,))
