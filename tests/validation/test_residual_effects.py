"""An effect that alone makes a simulation err has the largest share."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import carosac_toolkit as ct
from calibration.identification.open_loop import simulate
from carosac_toolkit.base.errors import CarosacError
from carosac_toolkit.physics.device import lever
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.recordings.length_path import LengthPath
from carosac_toolkit.recordings.poses import PoseSamples
from carosac_toolkit.recordings.recording import Recording
from carosac_toolkit.robot.parameters import values_of, with_values
from carosac_toolkit.trajectories.moves import waypoints
from carosac_toolkit.validation.residual_effects import residual_effects

ROBOT = ct.load_robot("carosac")
CABLES = ROBOT.cable_names
STEP_S = 0.1
TIME_STEP_S = 1.0 / 140.0


@lru_cache
def lengths():
    """Lengths that rest at drawn points for 2.5 s each."""
    rng = np.random.default_rng(0)
    points = ROBOT.home_position + 0.6 * rng.uniform(-1.0, 1.0, (14, 3))
    path = waypoints(points, speed_max=0.8, acceleration_max=0.8, rest=2.5)
    time = np.arange(0.0, path.duration, STEP_S)
    rest = statics.inverse_kinematics(ROBOT, path.sample(time).position)
    assert rest.converged.all()
    return Recording(time=time, unstrained_length=rest.unstrained_length)


def moved(robot, when):
    motion = simulate([robot], LengthPath(lengths()), when, time_step=TIME_STEP_S)
    motion = motion.seen_by(ROBOT, [robot])
    return ct.Pose(position=motion.position[:, 0], rotation=motion.rotation[:, 0])


def shares(plant, *, jitter=0.0, noise=2e-4):
    """Return the effects for poses of a plant, measured at stamps with jitter, with noise."""
    rng = np.random.default_rng(1)
    time = lengths().time[5:-5]
    taken = time + jitter * rng.standard_normal(len(time))
    true = moved(plant, taken)
    position = true.position + noise * rng.standard_normal((len(time), 3))
    turn = Rotation.from_rotvec(noise * rng.standard_normal((len(time), 3))).as_matrix()
    poses = PoseSamples.from_rotation(time, position, true.rotation @ turn)
    measured = ct.Pose(position=position, rotation=poses.rotation)
    recording = replace(lengths(), poses=poses)
    return residual_effects(recording, ROBOT, time, measured, moved(ROBOT, time))


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


@pytest.mark.parametrize("effect", list(PLANTS))
def test_an_effect_that_is_alone_has_the_largest_share(effect):
    found = shares(PLANTS[effect])
    assert next(iter(found.shares)) == effect, found.shares
    assert sum(found.shares.values()) + found.other == pytest.approx(1.0)
    assert found.other < 0.6


def test_jitter_of_stamps_is_told_with_its_size():
    found = shares(ROBOT, jitter=0.01)
    assert next(iter(found.shares)) == "jitter", found.shares
    assert found.jitter == pytest.approx(0.01, rel=0.25)


def test_white_noise_is_the_sensors():
    found = shares(ROBOT, noise=2e-3)
    assert next(iter(found.shares)) == "sensor" and found.shares["sensor"] > 0.8
    assert "sensor" in found.sentence("simulator")


def test_few_samples_tell_nothing():
    time = lengths().time[:20]
    pose = moved(ROBOT, time)
    with pytest.raises(CarosacError, match="too few to tell effects apart"):
        residual_effects(lengths(), ROBOT, time, pose, pose)


def test_a_simulation_without_an_error_has_no_effects():
    time = lengths().time[5:405]
    pose = moved(ROBOT, time)
    found = residual_effects(lengths(), ROBOT, time, pose, pose)
    assert found.rms == 0.0 and found.shares == {} and found.other == 0.0
    assert found.sentence("simulator") == "There is no error of simulator to explain."
