"""What an error looks like whose only cause is known."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import carosac_toolkit as ct
from calibration.identification.open_loop import simulate
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.base.scaled import Scaled
from carosac_toolkit.physics.device import lever
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.recordings.length_path import LengthPath
from carosac_toolkit.recordings.poses import PoseSamples
from carosac_toolkit.recordings.recording import Recording
from carosac_toolkit.robot.parameters import values_of, with_values
from carosac_toolkit.robot.similar import similar_robot
from carosac_toolkit.trajectories.moves import waypoints
from carosac_toolkit.validation.effect_signatures import effect_signatures
from carosac_toolkit.validation.residual_effects import SimulatedRun, residual_effects

ROBOT = ct.load_robot("carosac")
CABLES = ROBOT.cable_names
STEP_S = 0.1
TIME_STEP_S = 1.0 / 140.0


@lru_cache
def lengths(seed=0):
    """Lengths that rest at drawn points for 2.5 s each."""
    rng = np.random.default_rng(seed)
    points = ROBOT.home_position + 0.6 * rng.uniform(-1.0, 1.0, (10, 3))
    path = waypoints(points, speed_max=0.8, acceleration_max=0.8, rest=2.5)
    time = np.arange(0.0, path.duration, STEP_S)
    rest = statics.inverse_kinematics(ROBOT, path.sample(time).position)
    assert rest.converged.all()
    return Recording(time=time, unstrained_length=rest.unstrained_length)


def simulated(recording, time, measured, modelled):
    return SimulatedRun(recording=recording, time=time, measured=measured, modelled=modelled)


def moved(robot, when, seed=0):
    motion = simulate([robot], LengthPath(lengths(seed)), when, time_step=TIME_STEP_S)
    motion = motion.seen_by(ROBOT, [robot])
    return ct.Pose(position=motion.position[:, 0], rotation=motion.rotation[:, 0])


@lru_cache
def modelled(seed):
    return moved(ROBOT, lengths(seed).time[5:-5], seed)


@lru_cache
def signatures(seed):
    """Signatures at the samples of a seed: the same for all plants."""
    path = lengths(seed)
    return effect_signatures(path, ROBOT, path.time[5:-5], modelled(seed))


@pytest.fixture
def shares(monkeypatch):
    """Return what tells the effects for poses of a plant, at stamps with jitter, with noise."""

    def tell(plant, *, seed=0, jitter=0.0, noise=2e-4):
        monkeypatch.setattr(
            "carosac_toolkit.validation.residual_effects.effect_signatures",
            lambda *_: signatures(seed),
        )
        rng = np.random.default_rng(1)
        time = lengths(seed).time[5:-5]
        taken = time + jitter * rng.standard_normal(len(time))
        true = moved(plant, taken, seed)
        position = true.position + noise * rng.standard_normal((len(time), 3))
        turn = Rotation.from_rotvec(noise * rng.standard_normal((len(time), 3))).as_matrix()
        poses = PoseSamples.from_rotation(time, position, true.rotation @ turn)
        measured = ct.Pose(position=position, rotation=poses.rotation)
        recording = replace(lengths(seed), poses=poses)
        return residual_effects(ROBOT, [simulated(recording, time, measured, modelled(seed))])

    return tell


def changed(name, by):
    return with_values(ROBOT, [name], values_of(ROBOT, [name]) + by)


def gravity_tilted(by):
    """The robot whose gravity is tilted in the frame of its exit points and of the poses."""
    turn = Rotation.from_rotvec([by, -0.5 * by, 0.0]).as_matrix()
    return replace(ROBOT, exit_points=ROBOT.exit_points @ turn.T, pose_rotation=turn)


PLANTS = {
    "delay": changed("length_delay", 0.05),
    "sway phase": replace(ROBOT, inertia=1.1 * ROBOT.inertia),
    "damping law": replace(
        ROBOT, anchor_friction=np.full(4, 0.02 * ROBOT.weight / ROBOT.n * lever(ROBOT))
    ),
    "hysteresis": replace(ROBOT, length_hysteresis=np.full(4, 4e-3)),
    "tilt": gravity_tilted(0.01),
    "centre of mass": changed("center_of_mass.x", 0.01),
    "length offset or scale": changed(f"length_scale[{CABLES[1]}]", 4e-3),
}


@pytest.mark.parametrize("seed", [0, 3])
@pytest.mark.parametrize("effect", list(PLANTS))
def test_an_effect_that_is_alone_is_named_and_no_other_before_it(effect, seed, shares):
    found = shares(PLANTS[effect], seed=seed)
    assert found.causes[:1] in ((), (effect,)), found
    assert found.ranges[effect][1] > 0.3 and effect in found.sentence("simulator"), found
    assert sum(found.shares.values()) + found.other == pytest.approx(1.0)
    assert found.other < 0.6


def test_effects_that_resemble_each_other_are_candidates(shares):
    found = shares(PLANTS["sway phase"])
    assert "sway phase" not in found.causes and "sway phase" in found.candidates
    assert "cannot be told apart" in found.sentence("simulator")


def test_jitter_of_stamps_is_told_with_its_size(shares):
    found = shares(ROBOT, jitter=0.01)
    assert next(iter(found.shares)) == "jitter", found.shares
    assert found.jitter == pytest.approx(0.01, rel=0.25)


def test_white_noise_is_the_sensors(shares):
    found = shares(ROBOT, noise=2e-3)
    assert next(iter(found.shares)) == "sensor" and found.shares["sensor"] > 0.8
    assert "sensor" in found.sentence("simulator")


def test_few_samples_tell_nothing():
    time = lengths().time[:20]
    pose = moved(ROBOT, time)
    with pytest.raises(InvalidField, match=r"samples: got 20 .*at least 60 over 15 s"):
        residual_effects(ROBOT, [simulated(lengths(), time, pose, pose)])


def test_a_simulation_without_an_error_has_no_effects():
    time = lengths().time[5:305]
    pose = moved(ROBOT, time)
    found = residual_effects(ROBOT, [simulated(lengths(), time, pose, pose)])
    assert found.rms == 0.0 and found.shares == {} and found.other == 0.0
    assert found.sentence("simulator") == "There is no error of simulator to explain."


def test_a_similar_robot_has_similar_signatures():
    factor = 1.0 / 16.0
    small, faster = similar_robot(ROBOT, factor), np.sqrt(factor)
    path, pose = lengths(), modelled(0)
    time = path.time[5:-5]
    shrunk = Recording(time=faster * path.time, unstrained_length=factor * path.unstrained_length)
    rest = ct.Pose(position=factor * pose.position, rotation=pose.rotation)
    moved_by = 1e-3 * factor * np.sin(time)[:, None] * np.ones(3)
    shifted = ct.Pose(position=rest.position + moved_by, rotation=pose.rotation)
    found = residual_effects(small, [simulated(shrunk, faster * time, shifted, rest)])
    whole = ct.Pose(position=shifted.position / factor, rotation=pose.rotation)
    before = residual_effects(ROBOT, [simulated(path, time, whole, pose)])
    assert found.rms == pytest.approx(factor * before.rms, rel=1e-6)
    assert found.shares == pytest.approx(before.shares, abs=0.02)


SHORT_S = 7.0  # of a run that is too short to tell anything alone


@lru_cache
def short_runs(effect):
    """Eight runs of one plant, each from rest between two points."""
    runs = []
    for seed in range(10, 18):
        path = lengths(seed)
        path = path.slice(0, int(np.searchsorted(path.time, SHORT_S)))
        time = path.time[5:-5]
        poses = [
            simulate([robot], LengthPath(path), time, time_step=TIME_STEP_S).seen_by(ROBOT, [robot])
            for robot in (PLANTS[effect], ROBOT)
        ]
        measured, modelled = (
            ct.Pose(position=each.position[:, 0], rotation=each.rotation[:, 0]) for each in poses
        )
        rng = np.random.default_rng(seed)
        noisy = measured.position + 2e-4 * rng.standard_normal(measured.position.shape)
        runs.append(simulated(path, time, replace(measured, position=noisy), modelled))
    return runs


@pytest.mark.parametrize("effect", ["damping law", "tilt"])
def test_short_runs_tell_together_what_none_tells_alone(effect):
    runs = short_runs(effect)
    with pytest.raises(InvalidField, match="over 15 s, to tell effects apart"):
        residual_effects(ROBOT, runs[:1])
    found = residual_effects(ROBOT, runs)
    assert found.causes[:1] in ((), (effect,)), found
    left = 1.0 - found.shares["start"]  # a decay over seconds looks like another start, in part
    assert found.ranges[effect][1] > 0.3 * left and effect in found.sentence("simulator"), found


def test_a_start_that_is_wrong_in_each_run_is_no_effect_of_the_robot():
    """Sways of any phase, as large as the error by the tilt."""
    rng, runs = np.random.default_rng(2), []
    for run in short_runs("tilt"):
        start = effect_signatures(run.recording, ROBOT, run.time, run.modelled).start
        scale = np.linalg.norm(run.measured.position - run.modelled.position)
        sway = start[:, :3] @ rng.standard_normal(start.shape[2])
        sway *= scale / np.linalg.norm(sway)
        position = run.measured.position + sway
        runs.append(replace(run, measured=replace(run.measured, position=position)))
    found = residual_effects(ROBOT, runs)
    assert found.shares["start"] > 0.2 and "the starts of the recordings" in found.sentence("model")
    assert (*found.causes, *found.candidates)[0] == "tilt" and found.other < 0.3, found


def test_of_many_runs_the_worst_is_used(monkeypatch):
    module = "carosac_toolkit.validation.residual_effects"
    monkeypatch.setattr(f"{module}.DURATION_MAX", Scaled(4.0 * SHORT_S, "s"))
    runs = short_runs("tilt")
    large = replace(runs[3].measured, position=runs[3].modelled.position + np.array([0.5, 0, 0]))
    found = residual_effects(ROBOT, [*runs, replace(runs[3], measured=large)])
    assert found.rms > 0.05
