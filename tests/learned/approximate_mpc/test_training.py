"""A small training from beginning to end, killed and gone on with."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import carosac_toolkit as ct
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.base.scaled import resolved
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.robot.condition_file import find_condition
from carosac_toolkit.robot.perturbations import draw_plant
from carosac_toolkit.robot.similar import similar_robot
from learned.approximate_mpc.demonstrations import (
    Demonstrations,
    DemonstrationSettings,
    NoRest,
    draw_drive,
    draw_path,
    draw_resting,
)
from learned.approximate_mpc.plan_inputs import input_count, input_units, usual_tension
from learned.approximate_mpc.plan_network import (
    PlanNetwork,
    write_plan_network,
)
from learned.approximate_mpc.training import DistillationSettings, distill
from learned.policy_controller import find_policy
from learned.policy_file import open_network
from tests.robots import hanging

pytest.importorskip("torch")
SMALL = DistillationSettings(drives=(2, 1), updates=(150, 150), batch=64, hidden=(32,))
SHORT = DemonstrationSettings(condition="nominal-1", nearby=1, speed_max=2.0, acceleration_max=3.0)


@pytest.fixture(scope="module")
def robot():
    small = ct.load_robot("carosac")  # in a small box no path is long
    middle = small.home_position
    return replace(small, workspace_min=middle - 0.5, workspace_max=middle + 0.5)


@pytest.fixture(scope="module")
def folder(robot, tmp_path_factory):
    place = tmp_path_factory.mktemp("distilled")
    told = []
    distill(
        robot, place, settings=SMALL, demonstrations=SHORT,
        report=lambda what, done, of: told.append((what, done, of)),
    )  # fmt: skip
    assert ("round 1 of 2: drives", 2, 2) in told
    return place


def test_mpc_follows_the_path_through_what_commands_a_network(folder):
    """The teacher's tensions, sent as the network's are, are as good as those of `mpc`."""
    first = Demonstrations.load(folder / "drive-0000.npz")
    assert first.error < 0.03
    assert len(first.numbers) == len(first.tension) == len(first.excess) > 50


def _without_time(path):
    return [line.rsplit(",", 1)[0] for line in path.read_text().splitlines()]


def test_the_table_has_the_cpu_time_of_drives_and_regression(folder):
    told = [line.rsplit(",", 1)[1] for line in (folder / "rounds.csv").read_text().splitlines()]
    drives = [Demonstrations.load(path).cpu_time for path in sorted(folder.glob("drive-*.npz"))]
    assert told[0] == "cpu_s"
    assert float(told[1]) > drives[0] + drives[1] > 0.0
    assert float(told[2]) > drives[2]


def test_a_training_that_was_killed_goes_on_as_if_it_had_not(robot, folder):
    whole = (folder / "network.onnx").read_bytes()
    table = _without_time(folder / "rounds.csv")
    for name in ("network.onnx", "round-2.onnx", "drive-0002.npz"):
        (folder / name).unlink()
    distill(robot, folder, settings=SMALL, demonstrations=SHORT)
    assert (folder / "network.onnx").read_bytes() == whole
    assert _without_time(folder / "rounds.csv") == table


def test_another_training_in_the_folder_is_refused(robot, folder):
    with pytest.raises(InvalidField, match="with another training"):
        distill(robot, folder, seed=1, settings=SMALL, demonstrations=SHORT)


def test_tensions_of_a_network_never_leave_their_limits(robot, folder):
    network = PlanNetwork.load(folder / "network.onnx")
    count = input_count(robot, network.settings.stages)
    rng = np.random.default_rng(0)
    for scale in (1.0, 1e2, 1e5):
        tension, _ = network.plan(scale * rng.standard_normal(count))
        assert (tension >= robot.tension_min).all() and (tension <= robot.tension_max).all()
    with pytest.raises(InvalidField, match="plan inputs"):
        network.plan(np.full(count, np.nan))


def test_numpy_runs_a_network_as_onnxruntime_does(robot, folder):
    network = PlanNetwork.load(folder / "network.onnx")
    session = open_network(folder / "network.onnx", "a network").session
    drawn = np.random.default_rng(0).standard_normal((20, input_count(robot, 20)))
    for numbers in (*drawn, *(1e3 * drawn)):
        usual = usual_tension(robot, numbers)
        (told,) = session.run(["action"], {"observation": numbers[None].astype(np.float32)})
        tension, excess = network.plan(numbers)
        wanted = usual + network.description.tension_scale * told[0, : robot.n]
        allowed = np.clip(wanted, robot.tension_min, robot.tension_max)
        assert tension == pytest.approx(allowed, abs=1e-5 * network.description.tension_scale)
        assert excess == pytest.approx(
            network.description.excess_scale * told[0, robot.n :], abs=1e-6
        )


def test_units_of_inputs_are_those_of_carosac_and_grow_with_the_robot(robot):
    same, small = input_units(robot, 20), input_units(similar_robot(robot, 0.1), 20)
    assert same == pytest.approx(np.ones(input_count(robot, 20)))
    assert small[16:19] == pytest.approx(0.1)  # of distances
    assert small[10:13] == pytest.approx(np.sqrt(0.1))  # of velocities, by Froude's law


def test_a_network_is_refused_for_another_robot(robot, folder):
    network = PlanNetwork.load(folder / "network.onnx")
    network.check(robot)
    with pytest.raises(InvalidField, match="other values of mass"):
        network.check(replace(robot, mass=1.1 * robot.mass))
    with pytest.raises(InvalidField, match="3 cables"):
        network.check(hanging(3))


def test_a_file_of_something_else_is_refused(robot, folder, tmp_path):
    with pytest.raises(InvalidField, match="`carosac distill` wrote"):
        PlanNetwork.load(find_policy("carosac-settle"))
    network = PlanNetwork.load(folder / "network.onnx")
    layers = [(np.full((2 * robot.n, 5), 0.1), np.zeros(2 * robot.n))]
    write_plan_network(tmp_path / "small.onnx", layers, network.description)
    with pytest.raises(InvalidField, match="of 5 to 8 numbers"):
        PlanNetwork.load(tmp_path / "small.onnx")


def test_settings_that_make_no_sense_are_refused():
    with pytest.raises(InvalidField, match="as many of both"):
        DistillationSettings(drives=(1, 2), updates=(1,))
    with pytest.raises(InvalidField, match="drives"):
        DistillationSettings(drives=(0,), updates=(1,))
    with pytest.raises(InvalidField, match="elsewhere"):
        DemonstrationSettings(elsewhere=-1)


def test_plants_that_cannot_rest_at_a_start_are_drawn_again():
    """Next to a face of the box two of five cannot; a training must not end there."""
    robot, condition = ct.load_robot("carosac"), find_condition("nominal-1")
    start = np.array([2.37, -1.75, 1.26])

    def rests(plant):
        rest = statics.inverse_kinematics(plant, start[None])
        return bool((rest.converged & rest.stable).all())

    plain = [rests(draw_plant(robot, condition, np.random.default_rng(seed))) for seed in range(12)]
    assert 2 < sum(plain) < 10
    for seed, sound in enumerate(plain):
        plant = draw_resting(robot, condition, start, np.random.default_rng(seed))
        assert rests(plant)
        same = draw_plant(robot, condition, np.random.default_rng(seed))
        assert (plant.mass == same.mass) == sound


def test_a_path_from_where_hardly_any_plant_can_rest_is_drawn_again():
    """On the face of the box, where the robot itself cannot; seed 1 of `carosac` met it."""
    robot, rng = ct.load_robot("carosac"), np.random.default_rng([1, 173, 13])
    settings = resolved(DemonstrationSettings(), Scales(robot).ratios)
    refused = draw_path(robot, settings, rng).sample(np.zeros(1)).position
    assert not statics.inverse_kinematics(robot, refused).converged.all()
    condition = find_condition(settings.condition)
    with pytest.raises(NoRest, match=r"carosac: no plant of 20 can rest at \(2\.390, "):
        draw_resting(robot, condition, refused[0], rng)
    path, plant = draw_drive(robot, settings, np.random.default_rng([1, 173, 13]))
    rest = statics.inverse_kinematics(plant, path.sample(np.zeros(1)).position)
    assert (rest.converged & rest.stable).all()
