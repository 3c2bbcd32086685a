"""What an error looks like whose only cause is known."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import carosac_toolkit as ct
from calibration.identification.open_loop import simulate
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.physics.device import lever
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.recordings.length_path import LengthPath
from carosac_toolkit.recordings.poses import PoseSamples
from carosac_toolkit.recordings.recording import Recording
from carosac_toolkit.robot.parameters import values_of, with_values
from carosac_toolkit.robot.similar import similar_robot
from carosac_toolkit.trajectories.moves import waypoints
from carosac_toolkit.validation.effect_signatures import effect_signatures
from carosac_toolkit.validation.residual_effects import residual_effects

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
        return residual_effects(recording, ROBOT, time, measured, modelled(seed))

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
        residual_effects(lengths(), ROBOT, time, pose, pose)


def test_a_simulation_without_an_error_has_no_effects():
    time = lengths().time[5:305]
    pose = moved(ROBOT, time)
    found = residual_effects(lengths(), ROBOT, time, pose, pose)
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
    found = residual_effects(shrunk, small, faster * time, shifted, rest)
    whole = ct.Pose(position=shifted.position / factor, rotation=pose.rotation)
    before = residual_effects(path, ROBOT, time, whole, pose)
    assert found.rms == pytest.approx(factor * before.rms, rel=1e-6)
    assert found.shares == pytest.approx(before.shares, abs=0.02)
