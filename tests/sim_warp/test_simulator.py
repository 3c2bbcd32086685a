"""The simulator as people use it: what it refuses, and how worlds stand beside each other."""

from dataclasses import replace

import numpy as np
import pytest
import warp as wp
from scipy.spatial.transform import Rotation

import carosac_toolkit as ct
from carosac_toolkit.base.errors import InvalidField, MissingFile
from carosac_toolkit.physics.motion.winch import WinchSettings
from carosac_toolkit.robot.file import parse_robot, robot_text
from sim_warp import Simulator, Snapshot
from tests.robots import eight_cable_robot, simple_robot, with_pulleys
from tests.sim_warp.worlds import (
    KICK,
    MODELS,
    assert_same,
    assert_same_snapshots,
    held,
    on_device,
    rows,
)

ALL_MODELS = pytest.mark.parametrize("cables", MODELS)
NOMINAL = {"perturbation": "nominal-1", "segments": 5}


def busy(sim, seconds=0.3):
    """Winches at work, a kick and a slack cable; the same for every world of the same robot."""
    kick = np.repeat(KICK, sim.size, axis=0)
    sim.reset(twist=kick)
    start = held(sim)
    for k in range(round(seconds / 0.1)):
        wave = 0.1 * np.sin(k + np.arange(start.shape[1]))
        wave[0] += 0.2
        sim.step(start + wave, 0.1)
    return sim


# --- What is refused, before anything runs -----------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"worlds": 0}, "worlds: got 0; allowed: a whole number from 1"),
        ({"worlds": 2.0}, "worlds: got 2.0; allowed: a whole number from 1"),
        ({"cables": "ropes"}, "cables: got 'ropes'; allowed: one of .*'particles'.*'xpbd'"),
        ({"segments": 1}, "segments: got 1; allowed: a whole number from 2 to 256"),
        ({"segments": 257}, "segments: got 257; allowed: a whole number from 2 to 256"),
        ({"iterations": 0}, "iterations: got 0; allowed: a whole number from 1"),
        ({"time_step": 0.0}, "time_step: got 0.0 s; allowed: time_step > 0, finite"),
        ({"time_step": np.nan}, "time_step: got nan s; allowed: time_step > 0, finite"),
        ({"cable_drag": -0.1}, "cable_drag: got -0.1 1/s; allowed: cable_drag >= 0, finite"),
        ({"wind_force": -1.0}, "wind_force: got -1.0 N; allowed: wind_force >= 0, finite"),
        ({"wind_time": 0.0}, "wind_time: got 0.0 s; allowed: wind_time > 0, finite"),
        ({"device": "cuda:77"}, r"device: got 'cuda:77'; allowed: one of \['cpu'"),
        ({"perturbation": "storm"}, r"condition: got 'storm'; allowed: one of \['nominal-1'"),
        ({"seed": -1}, "seed: got -1; allowed: a whole number >= 0"),
        ({"seed": 0.5}, "seed: got 0.5; allowed: a whole number >= 0"),
        ({"seed": [1, 2], "worlds": 3}, r"seed: got shape \(2,\); allowed: one number, or 3"),
        (
            {"winch": WinchSettings(believed_drum_buildup=1e-5)},
            "believed_drum_buildup: got 1e-05 m; allowed: None: robot 'simple' has no",
        ),
    ],
)
def test_bad_settings_are_refused_by_name(arguments, message):
    with pytest.raises(InvalidField, match=message):
        Simulator(simple_robot(), **arguments)


@pytest.mark.parametrize(
    ("robots", "message"),
    [
        ("carosac", "robot: got 'carosac'; allowed: a Robot, or one for each world"),
        ([], r"robot: got \[\]; allowed: a Robot"),
        ([simple_robot(), None], r"robot: got \['Robot', 'NoneType'\]; allowed: a Robot, or one"),
        ([simple_robot(), eight_cable_robot()], r"robots\[1\]: got 8 cables; allowed: 4"),
        ([simple_robot(), simple_robot(gravity=1.6)], r"robots\[1\].gravity: got 1.6 m/s"),
    ],
)
def test_robots_of_different_kinds_are_refused(robots, message):
    with pytest.raises(InvalidField, match=message):
        Simulator(robots)


def test_two_robots_do_not_fill_three_worlds():
    with pytest.raises(InvalidField, match="robot: got 2 robots; allowed: 1 or 3, as worlds"):
        Simulator([simple_robot()] * 2, worlds=3)


def test_a_robot_file_that_does_not_say_how_its_cables_stretch_is_refused(tmp_path):
    text = robot_text("carosac")
    key = next(k for k in ("axial_stiffness", "youngs_modulus") if f"{k}:" in text)
    lines = text.splitlines(keepends=True)
    kept = [line for line in lines if f"{key}:" not in line or line.lstrip().startswith("#")]
    assert len(kept) < len(lines)
    path = tmp_path / "loose.yaml"
    path.write_text("".join(kept))
    assert parse_robot(text).axial_stiffness.all()
    with pytest.raises(ct.InvalidFile, match=r"axial_stiffness: got .*either axial_stiffness"):
        ct.load_robot(path)


def bad_command(worlds, index, value):
    command = np.full((worlds, 4), 9.0)
    command[index] = value
    return command


@pytest.mark.parametrize("call", ["step", "follow"])
@pytest.mark.parametrize(
    ("command", "duration", "message"),
    [
        (np.full(4, 9.0), 0.1, r"unstrained_length_command: got shape \(4,\); allowed: shape"),
        (np.full((2, 5), 9.0), 0.1, r"unstrained_length_command: got shape \(2, 5\)"),
        (np.full((3, 4), 9.0), 0.1, r"unstrained_length_command: got shape \(3, 4\)"),
        (bad_command(2, (1, 2), np.nan), 0.1, r"unstrained_length_command.*nan"),
        (bad_command(2, (1, 2), np.inf), 0.1, r"unstrained_length_command.*inf"),
        (bad_command(2, (1, 2), -9.0), 0.1, r"unstrained_length_command\[1, 2\]: got -9.0 m"),
        (bad_command(2, (1, 2), 0.0), 0.1, r"unstrained_length_command\[1, 2\]: got 0.0 m"),
        (np.full((2, 4), 9.0), 0.0, "duration: got 0.0 s; allowed: duration > 0"),
        (np.full((2, 4), 9.0), np.nan, "duration: got nan s; allowed: duration > 0"),
        (wp.zeros((2, 5), dtype=wp.float64), 0.1, r"command: got shape \(2, 5\)"),
    ],
)
def test_a_bad_command_is_refused_and_nothing_has_moved(call, command, duration, message):
    sim = Simulator(simple_robot(), worlds=2, cables="straight")
    before = sim.save()
    with pytest.raises(InvalidField, match=message.replace("_command", "(_command)?")):
        getattr(sim, call)(command, duration)
    assert_same_snapshots(before, sim.save())


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"position": np.zeros(3)}, r"position: got shape \(3,\)"),
        ({"position": np.zeros((3, 3))}, r"position: got shape \(3, 3\); allowed: 2 rows"),
        ({"position": np.full((2, 3), np.nan)}, "position.*nan"),
        ({"position": [[0.4, -1.8, 2.2], [0.4, -1.8, 99.0]]}, r"position\[1\]: got .*world 1 can"),
        ({"position": [[0.4, -1.8, 99.0]], "worlds": [1]}, r"position\[0\]: got .*of world 1 can"),
        ({"rotation": np.tile(np.eye(3), (2, 1, 1))}, "rotation: .*4 cables leave it free"),
        ({"twist": np.zeros((2, 5))}, r"twist: got shape \(2, 5\)"),
        ({"twist": np.zeros((1, 6))}, r"twist: got shape \(1, 6\); allowed: 2 rows"),
        ({"twist": np.full((2, 6), np.inf)}, "twist.*inf"),
        ({"unstrained_length": np.full((2, 4), -9.0)}, r"unstrained_length\[0, 0\]: got -9.0 m"),
        ({"unstrained_length": np.full((1, 4), 9.0)}, r"unstrained_length: got shape \(1, 4\)"),
        (
            {"unstrained_length": np.full((2, 4), 9.0), "rotation": np.tile(np.eye(3), (2, 1, 1))},
            "position: got None; allowed: a position beside rotation and unstrained_length",
        ),
        (
            {"unstrained_length": np.full((1, 4), 9.0), "position": np.zeros((2, 3))},
            r"unstrained_length: got shape \(1, 4\); allowed: 2 rows",
        ),
        (
            {"unstrained_length": np.full((2, 4), -9.0), "position": np.zeros((2, 3))},
            r"unstrained_length\[0, 0\]: got -9.0 m",
        ),
        ({"worlds": [2]}, r"worlds: got \[2\]; allowed: indices below 2"),
        ({"worlds": [-1]}, r"worlds: got \[-1\]; allowed: indices below 2"),
        ({"worlds": [1, 1]}, r"worlds: got \[1, 1\]; allowed: indices below 2, each once"),
        ({"worlds": [0.5]}, r"worlds: got \[0.5\]; allowed: indices below 2"),
        ({"worlds": []}, r"worlds: got \[\]; allowed: indices below 2"),
        ({"worlds": [True, False, True]}, r"worlds: got .*a mask of shape \(2,\)"),
    ],
)
def test_a_bad_reset_is_refused_and_nothing_has_changed(arguments, message):
    sim = busy(Simulator(simple_robot(), worlds=2, cables="straight"), 0.1)
    before = sim.save()
    with pytest.raises(InvalidField, match=message):
        sim.reset(**arguments)
    assert_same_snapshots(before, sim.save())


def test_eight_cables_hold_a_rotation_but_no_matrix_that_is_none():
    sim = Simulator(eight_cable_robot(), cables="straight")
    turned = Rotation.from_rotvec([0.05, -0.04, 0.08]).as_matrix()[None]
    sim.reset(rotation=turned)
    assert sim.state.rotation.numpy() == pytest.approx(turned, abs=1e-9)
    with pytest.raises(InvalidField, match=r"rotation\[0\]: got not a rotation matrix"):
        sim.reset(rotation=2.0 * turned)


# --- Worlds beside each other ------------------------------------------------------------------


@ALL_MODELS
def test_a_batch_is_its_worlds_one_by_one_bit_for_bit(cables):
    batch = busy(Simulator(simple_robot(), worlds=3, seed=[5, 6, 7], cables=cables, **NOMINAL))
    for b in range(3):
        alone = busy(Simulator(simple_robot(), seed=[5 + b], cables=cables, **NOMINAL))
        assert_same(rows(alone.state.numpy(), [0]), rows(batch.state.numpy(), [b]))


@ALL_MODELS
def test_a_permutation_of_worlds_permutes_what_happens(cables):
    robots = [simple_robot(mass=m) for m in (20.0, 23.0, 26.0, 29.0)]
    seeds, order = [3, 1, 4, 2], [2, 0, 3, 1]
    first = busy(Simulator(robots, seed=seeds, cables=cables, **NOMINAL))
    second = busy(
        Simulator(
            [robots[k] for k in order], seed=[seeds[k] for k in order], cables=cables, **NOMINAL
        )
    )
    assert_same(rows(first.state.numpy(), order), rows(second.state.numpy(), slice(None)))
    position = first.state.position.numpy()
    assert len(np.unique(position[:, 0])) == 4  # the worlds do differ


@ALL_MODELS
def test_reset_of_one_world_leaves_the_others_bit_for_bit(cables):
    options = {"worlds": 3, "cables": cables, "seed": 2, **NOMINAL}
    left, part = (busy(Simulator(simple_robot(), **options)) for _ in range(2))
    part.reset([[0.5, -1.5, 2.5]], worlds=[1], twist=KICK)
    others = [0, 2]
    assert_same(rows(left.state.numpy(), others), rows(part.state.numpy(), others))
    assert part.state.time.numpy() == pytest.approx([0.3, 0.0, 0.3], abs=1e-13)
    assert part.state.twist.numpy()[1] == pytest.approx(KICK[0])
    command = held(left)
    left.step(command, 0.1)
    part.step(command, 0.1)
    assert_same(rows(left.state.numpy(), others), rows(part.state.numpy(), others))
    assert not np.array_equal(left.state.position.numpy()[1], part.state.position.numpy()[1])


def test_a_mask_and_indices_reset_the_same_worlds():
    sims = [busy(Simulator(simple_robot(), worlds=3, cables="catenary")) for _ in range(2)]
    sims[0].reset(worlds=[0, 2])
    sims[1].reset(worlds=np.array([True, False, True]))
    assert_same_snapshots(sims[0].save(), sims[1].save())


@ALL_MODELS
def test_a_reset_world_goes_on_as_a_new_one(cables):
    used, new = (
        Simulator(simple_robot(), seed=8, cables=cables, segments=5, wind_force=3.0)
        for _ in range(2)
    )
    busy(used)
    used.reset()
    assert_same(rows(busy(used).state.numpy(), [0]), rows(busy(new).state.numpy(), [0]))


@ALL_MODELS
def test_the_same_seed_is_the_same_world_and_another_is_another(cables):
    one, same, other = (
        busy(Simulator(simple_robot(), worlds=2, seed=s, cables=cables, **NOMINAL))
        for s in (1, 1, 2)
    )
    assert_same_snapshots(one.save(), same.save())
    assert not np.isclose(one.state.position.numpy(), other.state.position.numpy()).any()


def test_nominal_1_worlds_differ_in_everything_that_it_names():
    sim = Simulator(simple_robot(), worlds=3, cables="straight", perturbation="nominal-1")
    assert len(sim.robots) == sim.size == 3
    for name in (
        "mass", "center_of_mass", "inertia", "axial_stiffness", "linear_density", "exit_points",
        "anchor_points", "winch_lag", "drag", "angular_drag",
    ):  # fmt: skip
        first, second, third = (getattr(robot, name) for robot in sim.robots)
        assert not np.array_equal(first, second) and not np.array_equal(second, third), name
    sim.step(held(sim), 0.1)
    gust = sim.save().arrays["gusts"]["force"]
    assert len(np.unique(gust[:, :2])) == 6
    assert gust[:, 2] == pytest.approx(np.zeros(3))


# --- Failure -----------------------------------------------------------------------------------


@pytest.mark.parametrize("call", ["step", "follow"])
@ALL_MODELS
def test_a_world_asked_for_no_number_is_flagged_and_the_others_go_on(cables, call):
    """Arrays on the device go unchecked, so that this is how a world can be lost."""
    sound, lost = (
        Simulator(simple_robot(), worlds=3, cables=cables, segments=5, wind_force=1.0)
        for _ in range(2)
    )
    start = held(sound)
    command = start - 0.02
    broken = command.copy()
    broken[1, 2] = np.nan
    getattr(sound, call)(on_device(command), 0.1)
    getattr(lost, call)(on_device(broken), 0.1)
    assert lost.state.numpy().failed.tolist() == [False, True, False]
    others = [0, 2]
    assert_same(rows(sound.state.numpy(), others), rows(lost.state.numpy(), others))
    stands = lost.state.numpy()
    assert np.isfinite(stands.position).all() and np.isfinite(stands.rotation).all()
    for sim in (sound, lost):
        sim.step(start, 0.2)
    assert_same(rows(sound.state.numpy(), others), rows(lost.state.numpy(), others))
    after = lost.state.numpy()
    assert after.failed.tolist() == [False, True, False]
    assert after.time[1] == stands.time[1] < after.time[0]
    assert np.array_equal(after.position[1], stands.position[1])
    lost.reset(worlds=[1])
    assert not lost.state.numpy().failed.any()
    lost.step(start, 0.1)
    assert lost.state.time.numpy()[1] == pytest.approx(0.1)
    assert np.isfinite(lost.state.tension.numpy()).all()


@ALL_MODELS
def test_a_cable_wound_into_its_exit_harms_its_world_alone(cables):
    """A command that is allowed and that no robot survives: 200 kN, a hand from the exit."""
    sim = Simulator(simple_robot(), worlds=2, cables=cables, segments=5)
    quiet = Simulator(simple_robot(), cables=cables, segments=5)
    command = held(sim)
    command[1, 2] = 1e-6
    for _ in range(6):
        sim.step(command, 1.0)
        quiet.step(command[:1], 1.0)
    state = sim.state.numpy()
    assert_same(rows(state, [0]), rows(quiet.state.numpy(), [0]))
    assert state.failed[1] or state.time[1] == pytest.approx(6.0)
    assert np.isfinite(state.position).all() and np.isfinite(state.twist).all()


# --- Save and restore --------------------------------------------------------------------------


@ALL_MODELS
def test_a_restored_simulator_goes_on_bit_for_bit(cables, tmp_path):
    options = {"worlds": 2, "cables": cables, "seed": 4, "segments": 5, "wind_force": 3.0}
    sim, other = (Simulator(simple_robot(), **options) for _ in range(2))
    snapshot = busy(sim).save()
    kept = {name: array.copy() for name, array in snapshot.arrays.items()}
    command = held(sim)
    sim.step(command + 0.05, 0.2)
    assert_same(kept, snapshot.arrays)  # a copy, no view
    path = tmp_path / "worlds.npz"
    snapshot.to_npz(path)
    other.restore(Snapshot.from_npz(path))
    assert_same_snapshots(snapshot, other.save())
    other.step(command + 0.05, 0.2)
    assert_same_snapshots(sim.save(), other.save())
    assert_same(rows(sim.state.numpy(), slice(None)), rows(other.state.numpy(), slice(None)))


def test_a_snapshot_of_another_kind_is_refused_and_nothing_has_changed():
    sim = busy(Simulator(simple_robot(), worlds=2, segments=5))
    before = sim.save()
    for other, message in (
        ({"cables": "catenary"}, "got catenary of 5 segments; allowed: particles of 5 segments"),
        ({"segments": 6}, "got particles of 6 segments; allowed: particles of 5 segments"),
        ({"worlds": 3}, r"snapshot.motion: got shape \(3,\); allowed: shape \(2,\)"),
    ):
        options = {"worlds": 2, "segments": 5, **other}
        with pytest.raises(InvalidField, match=message):
            sim.restore(Simulator(simple_robot(), **options).save())
    fewer = replace(before, arrays={k: v for k, v in before.arrays.items() if k != "gusts"})
    with pytest.raises(InvalidField, match=r"snapshot.gusts: got shape None; allowed: shape \(2,"):
        sim.restore(fewer)
    assert_same_snapshots(before, sim.save())


def test_what_is_no_snapshot_file_is_refused(tmp_path):
    snapshot = Simulator(simple_robot(), cables="straight").save()
    with pytest.raises(MissingFile, match="the folder must exist"):
        snapshot.to_npz(tmp_path / "nowhere" / "a.npz")
    with pytest.raises(MissingFile):
        Snapshot.from_npz(tmp_path / "none.npz")
    path = tmp_path / "b.npz"
    path.write_text("no snapshot")
    with pytest.raises(InvalidField, match=r"allowed: a file written by Snapshot\.to_npz"):
        Snapshot.from_npz(path)
    np.savez(path, other=np.zeros(3))
    with pytest.raises(InvalidField, match=r"allowed: a file written by Snapshot\.to_npz"):
        Snapshot.from_npz(path)


# --- Time and lengths --------------------------------------------------------------------------


@ALL_MODELS
def test_two_half_calls_are_one_call(cables):
    """0.05 s and 0.1 s are whole numbers of the same time step."""
    options = {"cables": cables, "time_step": 1.0 / 120.0, "segments": 5, "wind_force": 2.0}
    whole, halves = (Simulator(simple_robot(), **options) for _ in range(2))
    command = held(whole) + 0.1
    whole.step(command, 0.1)
    halves.step(command, 0.05)
    halves.step(command, 0.05)
    one, two = whole.state.numpy(), halves.state.numpy()
    # Each call divides its own duration: the steps differ by rounding.
    assert one.position == pytest.approx(two.position, abs=1e-12)
    assert one.tension == pytest.approx(two.tension, abs=1e-8)
    assert one.unstrained_length == pytest.approx(two.unstrained_length, abs=1e-13)


@ALL_MODELS
def test_time_goes_by_the_durations_whatever_the_step(cables):
    sim = Simulator(simple_robot(), cables=cables, segments=3)
    command = held(sim)
    durations = (0.1, 1.0 / 3.0, 0.0007, 0.25, 1e-5)
    for duration in durations:
        sim.step(command, duration)
    assert sim.state.time.numpy()[0] == pytest.approx(sum(durations), abs=1e-13)


@ALL_MODELS
def test_reset_at_lengths_hangs_on_these_lengths_at_rest(cables):
    robot = with_pulleys(simple_robot())
    sim = Simulator(robot, cables=cables, segments=8)
    length = held(sim) + np.array([0.05, 0.1, -0.05, 0.0])
    sim.reset(unstrained_length=length)
    state = sim.state.numpy()
    assert np.array_equal(state.unstrained_length, length)
    assert not state.twist.any() and not state.time.any()
    rest = ct.statics.forward_kinematics(robot, length)
    near = 5e-3 if cables == "straight" else 1e-5  # sag pulls the platform up; 8 segments
    assert state.position == pytest.approx(rest.position, abs=near)
    assert np.abs(state.position - robot.home_position).max() > 0.02


@ALL_MODELS
def test_follow_ends_at_the_lengths_and_step_obeys_the_winches(cables):
    robot = simple_robot()
    followed, stepped = (Simulator(robot, cables=cables, segments=4) for _ in range(2))
    goal = held(followed) + 0.05
    followed.follow(goal, 0.2)
    assert held(followed) == pytest.approx(goal, abs=1e-14)
    start = held(stepped)
    lengths = [start]
    for _ in range(160):  # such drives overshoot a step: they brake too late
        stepped.step(start + 1.0, 0.05)
        lengths.append(held(stepped))
    speed = np.diff(np.array(lengths), axis=0) / 0.05
    assert speed.max() < robot.speed_max[0] * (1.0 + 1e-12)
    assert (np.diff(speed, axis=0) / 0.05).max() < robot.acceleration_max[0] * (1.0 + 1e-9)
    assert lengths[-1] == pytest.approx(start + 1.0, abs=1e-6)


@ALL_MODELS
def test_numpy_and_device_commands_do_the_same(cables):
    one, two = (Simulator(simple_robot(), worlds=2, cables=cables, segments=4) for _ in range(2))
    command = held(one) + 0.03
    one.step(command, 0.1)
    two.step(on_device(command), 0.1)
    assert_same_snapshots(one.save(), two.save())


def test_the_view_of_the_state_follows_and_its_copy_does_not():
    sim = Simulator(simple_robot(), cables="catenary")
    copy, view = sim.state.numpy(), sim.state.position
    assert copy.particles is None
    before = copy.position.copy()
    sim.step(held(sim) - 0.05, 0.2)
    assert np.array_equal(copy.position, before)
    assert np.abs(view.numpy() - before).max() > 1e-3


@pytest.mark.parametrize("cables", MODELS)
def test_the_state_after_a_restore_is_the_one_that_was_saved(cables):
    sim = Simulator(simple_robot(), worlds=2, cables=cables)
    sim.reset(twist=np.repeat(KICK, 2, axis=0))
    hold = held(sim)
    sim.step(hold, 0.1)
    saved, before = sim.save(), sim.state.numpy()
    sim.step(hold - 0.1, 0.2)
    sim.restore(saved)
    assert_same(rows(before, slice(None)), rows(sim.state.numpy(), slice(None)))


def test_more_time_steps_than_can_be_counted_are_refused():
    sim = Simulator(simple_robot())
    with pytest.raises(InvalidField, match=r"duration: got 1000000.0 s; allowed: at most 1e\+06"):
        sim.step(held(sim), 1e6)


def test_a_world_that_has_failed_at_home_does_not_hold_up_the_others():
    robot = simple_robot()
    heavy = replace(robot, mass=400.0)
    sim = Simulator([robot, heavy])
    state = sim.state.numpy()
    assert state.failed.tolist() == [False, True]
    assert state.position[1] == pytest.approx(heavy.home_position)
    sim.step(state.unstrained_length - 0.05, 0.2)
    assert sim.state.numpy().time == pytest.approx([0.2, 0.0])


@pytest.mark.parametrize("cables", ["catenary", "particles"])
def test_worlds_that_are_not_placed_have_failed_until_they_are_reset(cables):
    robot = ct.load_robot("carosac")
    there = robot.home_position + np.array([0.3, -0.2, 0.4])
    late = Simulator(robot, worlds=2, cables=cables, at_home=False)
    late.step(np.tile(robot.length_min, (2, 1)), 0.01)
    assert late.state.numpy().failed.all()
    usual = Simulator(robot, worlds=2, cables=cables)
    for simulator in (late, usual):
        simulator.reset(np.tile(there, (2, 1)))
        simulator.follow(simulator.state.numpy().unstrained_length.copy(), 0.1)
    assert not late.state.numpy().failed.any()
    assert (late.state.numpy().position == usual.state.numpy().position).all()
