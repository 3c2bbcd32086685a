"""What is learned of the load: against the prediction model with another load, and in the loop."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import carosac_toolkit as ct
from baselines.mpc import Mpc, MpcSettings, model
from baselines.mpc.geometry import geometry_at
from baselines.mpc.unknown_load import (
    CENTER_DEVIATIONS_MAX,
    UNTOLD_TIME_RATIO,
    AccelerationGain,
    PlannedMotion,
    UnknownLoad,
)
from carosac_toolkit import trajectories
from carosac_toolkit.physics.rest.modes import mass_matrix
from carosac_toolkit.physics.rest.structure import constrained_motion
from tests.baselines.mpc.test_controller import live
from tests.robots import simple_robot

PERIOD = 0.02
SHIFT = np.array([0.012, -0.017, 0.008])


def made(robot, center_of_mass=0.02):
    return UnknownLoad(
        robot, period=PERIOD, center_of_mass=center_of_mass, disturbance_time=0.25
    )  # fmt: skip


class Scene:
    """The platform somewhere, moving, with cables that pull."""

    def __init__(self, robot, rng):
        self.rotation = Rotation.from_rotvec(0.3 * rng.normal(size=3)).as_matrix()
        self.position = robot.home_position + 0.3 * rng.normal(size=3)
        self.velocity, self.spin = rng.normal(size=3), rng.normal(size=3)
        self.tension = robot.weight / robot.n * rng.uniform(0.7, 2.0, robot.n)
        self.geometry = geometry_at(robot, self.position, self.rotation)

    def acceleration(self, robot, disturbance=(0.0,) * 6):
        """By the prediction model, shape (6,)."""
        numbers = model.parameters(
            robot, rotation=self.rotation, length=self.geometry.free, exits=self.geometry.exits,
            disturbance=np.array(disturbance),
        )  # fmt: skip
        state = np.concatenate([self.position, np.zeros(3), self.velocity, self.spin])
        rate = model.continuous(robot.n)(state, self.tension, numbers)[0]
        return np.array(rate).ravel()[6:]

    def motion(self, robot):
        return PlannedMotion.of(
            robot, self.geometry, self.tension, rotation=self.rotation, spin=self.spin,
            spin_rate=self.acceleration(robot)[3:],
        )  # fmt: skip

    def free(self, robot):
        """Projection onto the ways that the cables leave, and the mass matrix."""
        mass = mass_matrix(robot, self.rotation[None], self.geometry.length[None])[0]
        jacobian = self.geometry.jacobian
        return np.eye(6) - constrained_motion(mass, jacobian) @ jacobian, mass


def taught(robot, plant, load, steps, disturbance=(0.0,) * 6):
    """What is found where the plant gains speed as its own model says."""
    rng = np.random.default_rng(4)
    for _ in range(steps):
        scene = Scene(robot, rng)
        planned = scene.acceleration(load.robot, load.acceleration)
        gained = PERIOD * (scene.acceleration(plant, disturbance) - planned)
        free, mass = scene.free(load.robot)
        load.learn(free @ gained, free, mass, scene.motion(load.robot))
    return load


def test_the_effect_of_a_shift_is_that_of_the_prediction_model():
    robot = simple_robot()
    rng = np.random.default_rng(2)
    for _ in range(5):
        scene = Scene(robot, rng)
        found = made(robot)._by(scene.motion(robot))
        step = 1e-6
        for axis, way in enumerate(step * np.eye(3)):
            ends = [
                scene.acceleration(replace(robot, center_of_mass=robot.center_of_mass + w))
                for w in (way, -way)
            ]
            wanted = (ends[0] - ends[1]) / (2.0 * step)
            # Left out are air drag, and what it does to the inertia that cables ride along.
            assert found[:, axis] == pytest.approx(wanted, abs=0.03 * np.abs(wanted).max())


def test_the_effect_of_an_acceleration_is_that_of_the_prediction_model():
    robot = replace(simple_robot(), center_of_mass=[0.05, 0.02, -0.3])
    scene = Scene(robot, np.random.default_rng(3))
    found = made(robot)._by(scene.motion(robot))[:, 3:]
    for axis, way in enumerate(np.eye(6)):
        wanted = scene.acceleration(robot, way) - scene.acceleration(robot)
        assert found[:, axis] == pytest.approx(wanted, abs=1e-9)


def test_a_long_rest_makes_nothing_less_known():
    """What no motion shows does not become unknown, so that no gain grows while it rests."""
    robot = simple_robot()
    scene = Scene(robot, np.random.default_rng(5))
    free, mass = scene.free(robot)
    loads = []
    for steps in (500, 5_000):
        load = made(robot)
        load.tell(robot.center_of_mass)
        for _ in range(steps):
            load.learn(np.zeros(6), free, mass, scene.motion(robot))
        loads.append(load)
    turned = Scene(robot, np.random.default_rng(6))
    free, mass = turned.free(robot)
    for load in loads:
        load.learn(free @ np.full(6, 0.01), free, mass, turned.motion(robot))
    moved = [free @ load.acceleration for load in loads]
    assert moved[1] == pytest.approx(moved[0], rel=0.25, abs=1e-3)


def test_a_centre_of_mass_is_told_from_a_force():
    robot = simple_robot()
    plant = replace(robot, center_of_mass=robot.center_of_mass + SHIFT)
    load = taught(robot, plant, made(robot), 400)
    assert load.shift == pytest.approx(SHIFT, abs=1.5e-3)
    assert np.abs(load.acceleration).max() < 0.05
    assert load.robot.center_of_mass == pytest.approx(plant.center_of_mass, abs=1.6e-3)


def test_a_force_is_told_from_a_centre_of_mass():
    robot = simple_robot()
    load = taught(robot, robot, made(robot), 1200, disturbance=(0.3, -0.2, 0, 0, 0, 0))
    assert load.acceleration == pytest.approx([0.3, -0.2, 0, 0, 0, 0], abs=0.02)
    assert np.abs(load.shift).max() < 1.5e-3


def test_a_centre_of_mass_that_is_told_is_not_learned_and_moments_are():
    robot = simple_robot()
    load = made(robot)
    load.tell(robot.center_of_mass + SHIFT)
    assert load.shift == pytest.approx(SHIFT)
    moment = (0.1, 0.2, 0.0, 0.3, -0.4, 0.0)
    taught(robot, load.robot, load, 400, disturbance=moment)
    assert load.shift == pytest.approx(SHIFT)
    rng = np.random.default_rng(6)
    for _ in range(5):  # only what moves the free ways can be seen
        free, _ = Scene(robot, rng).free(load.robot)
        assert free @ load.acceleration == pytest.approx(free @ moment, abs=0.12)
    assert not load.tell(load.robot.center_of_mass)
    assert load.tell(None)  # nobody knows it any more
    assert not load.shift.any() and load.robot is robot
    assert not load.tell(None)


def test_one_gain_learns_an_acceleration_as_the_filter_does():
    robot = replace(simple_robot(), center_of_mass=np.zeros(3))
    load = made(robot)
    load.tell(robot.center_of_mass)
    gain = AccelerationGain(robot, period=PERIOD, disturbance_time=0.25)
    scene, found = Scene(robot, np.random.default_rng(2)), np.zeros(6)
    mass = scene.free(robot)[1]
    for speed in (0.01, 0.02, 0.0, -0.01, *[0.003] * 50):
        gained = speed * np.array([1.0, 0.5, -0.5, 0.0, 0.0, 0.0])
        load.learn(gained, np.eye(6), mass, scene.motion(robot))
        found = found + gain.next(told=True) * gained
        assert found == pytest.approx(load.acceleration, rel=0.03, abs=2e-3)


def test_a_gain_falls_to_that_of_a_first_order_filter():
    robot = simple_robot()
    for told, time in ((True, 0.25), (False, 0.25 * UNTOLD_TIME_RATIO)):
        gain = AccelerationGain(robot, period=PERIOD, disturbance_time=0.25)
        found = [gain.next(told=told) for _ in range(500)]
        assert found[0] > 1.5 * found[-1]
        assert found[-1] == pytest.approx(1.0 / time, rel=0.1)
        gain.reset()
        assert gain.next(told=told) == found[0]


def test_it_stays_where_a_centre_of_mass_can_be():
    robot = simple_robot()
    plant = replace(robot, center_of_mass=robot.center_of_mass + 10.0 * SHIFT)
    load = taught(robot, plant, made(robot, 0.01), 100)
    assert np.abs(load.shift).max() <= CENTER_DEVIATIONS_MAX * 0.01
    fixed = taught(robot, plant, made(robot, 0.0), 20)
    assert not fixed.shift.any() and fixed.acceleration.any()
    load.reset()
    assert not load.shift.any() and not load.acceleration.any() and load.robot is robot


def test_a_wrong_centre_of_mass_does_not_make_a_light_platform_swing():
    """A disturbance that turns with what the cables pull makes it turn ever more."""
    robot = ct.load_robot("scampi")
    plant = replace(robot, center_of_mass=robot.center_of_mass + np.array([-0.015, 0.006, -0.04]))
    path = trajectories.line(
        robot.home_position, robot.home_position + np.array([0.3, -0.9, 0.6]),
        speed_max=2.0, acceleration_max=3.0,
    )  # fmt: skip
    log = live(Mpc.build(robot, MpcSettings(compiled="never")), plant=plant, path=path, rest=2.0)
    calm = log.time > path.duration + 1.0
    assert np.abs(log.twist[calm, 0, 3:]).max() < 0.2
    assert (log.tension[log.time > 0.5] > robot.tension_min).all()
