"""A home against what load cells and an IMU read: no false alarm, and errors that are noticed."""

from dataclasses import replace

import numpy as np
import pytest

from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.loop.values import Imu, Measurement, Pose, Stamped, State
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.safety.guard.home_check import SenseErrors, home_evidence
from tests.robots import eight_cable_robot, simple_robot

ERRORS = SenseErrors()
SAMPLES = 10


def home_of(robot, error=(0.0, 0.0, 0.0)):
    position = robot.home_position + np.asarray(error)
    return State(time=np.zeros(1), position=position[None], rotation=robot.home_rotation[None])


def truth_of(robot):
    held = robot.home_rotation[None] if robot.n >= 6 else None
    return statics.inverse_kinematics(robot, robot.home_position[None], held)


def readings(robot, truth, seed, *, cells=True, imu=False, pose=False, errors=ERRORS):
    """Samples of a platform at rest with the stated errors of its sensors."""
    rng = np.random.default_rng(seed)
    mass, scale = 1.0 + errors.mass * rng.standard_normal(), errors.tension_scale
    tension = truth.tension[0] * mass * (1.0 + scale * rng.standard_normal(robot.n))
    tension = tension + errors.tension_bias * rng.standard_normal(robot.n)
    force = robot.gravity * truth.rotation[0, 2]
    force = force + errors.specific_force_bias * rng.standard_normal(3)
    samples = []
    for k in range(SAMPLES):
        time = np.array([0.01 * k])
        cell = tension + errors.tension_noise * rng.standard_normal(robot.n)
        felt = force + errors.specific_force_noise * rng.standard_normal(3)
        samples.append(
            Measurement(
                time=time, unstrained_length=truth.unstrained_length,
                tension=Stamped(time=time, value=cell[None]) if cells else None,
                imu=Imu(time=time[None], angular_rate=np.zeros((1, 1, 3)),
                        specific_force=felt[None, None]) if imu else None,
                pose=Pose(position=truth.position, rotation=truth.rotation, time=time)
                if pose else None,
            )
        )  # fmt: skip
    return samples


@pytest.mark.parametrize("robot", [simple_robot(), eight_cable_robot()], ids=lambda r: r.name)
def test_a_right_home_is_no_false_alarm(robot):
    truth = truth_of(robot)
    found = [
        home_evidence(robot, home_of(robot), readings(robot, truth, seed, imu=True), ERRORS)
        for seed in range(100)
    ]
    assert not any(one.contradicts for one in found)
    rms = np.sqrt(np.mean([one.deviation**2 for one in found]))
    assert 1.0 < rms < 4.0  # of 6 and 9 readings in standard deviations, not of a loose bound


@pytest.mark.parametrize("robot", [simple_robot(), eight_cable_robot()], ids=lambda r: r.name)
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_an_error_of_the_stated_size_is_noticed(robot, axis):
    truth = truth_of(robot)
    sizes = home_evidence(robot, home_of(robot), readings(robot, truth, 0), ERRORS).detectable
    for seed in range(20):
        error = 1.05 * sizes[axis] * np.eye(3)[axis] * (-1) ** seed
        samples = readings(robot, truth, seed)
        assert home_evidence(robot, home_of(robot, error), samples, ERRORS).contradicts


def test_1_m_is_noticed_in_every_direction_and_30_cm_where_the_geometry_shows_it():
    robot = simple_robot()
    truth = truth_of(robot)
    rng = np.random.default_rng(1)
    for seed in range(20):
        way = rng.standard_normal(3)
        samples = readings(robot, truth, seed)
        far = home_of(robot, way / np.linalg.norm(way))
        assert home_evidence(robot, far, samples, ERRORS).contradicts
        assert home_evidence(robot, home_of(robot, [0.3, 0.0, 0.0]), samples, ERRORS).contradicts
    assert 0.3 < home_evidence(robot, home_of(robot), samples, ERRORS).detectable_worst < 1.0


def test_better_cells_notice_less_and_a_light_platform_shows_less():
    robot = simple_robot()
    better = replace(ERRORS, tension_bias=0.1, tension_noise=0.1, tension_scale=1e-3, mass=1e-3)
    light = replace(robot, mass=robot.mass / 5.0)
    worst = [
        home_evidence(one, home_of(one), readings(one, truth_of(one), 1), errors).detectable_worst
        for one, errors in ((robot, better), (robot, ERRORS), (light, ERRORS))
    ]
    assert worst[0] < 0.5 * worst[1] < 0.25 * worst[2]


def test_cables_that_pull_against_each_other_contradict_no_home():
    """The lengths decide on that, and how a home was reached; the position is the same."""
    robot = eight_cable_robot()
    rest = truth_of(robot)
    tight = statics.forward_kinematics(robot, 0.9985 * rest.unstrained_length, guess=rest)
    assert tight.tension.min() > 5.0 * rest.tension.min()
    assert tight.position == pytest.approx(rest.position, abs=0.01)
    samples = readings(robot, tight, 3)
    assert not home_evidence(robot, home_of(robot), samples, ERRORS).contradicts
    assert home_evidence(robot, home_of(robot, [0.0, 0.0, 0.3]), samples, ERRORS).contradicts


def test_an_imu_notices_a_home_whose_rotation_is_some_degrees_wrong():
    robot, angle = eight_cable_robot(), np.radians(6.0)
    c, s = np.cos(angle), np.sin(angle)
    home = replace(home_of(robot), rotation=np.array([[[1, 0, 0], [0, c, -s], [0, s, c]]]))
    samples = readings(robot, truth_of(robot), 1, cells=False, imu=True)
    evidence = home_evidence(robot, home, samples, ERRORS)
    assert evidence.contradicts and evidence.senses == ("IMU",)
    assert evidence.worst.startswith("the specific force along y of the platform in m/s^2 is ")
    assert not home_evidence(robot, home_of(robot), samples, ERRORS).contradicts
    assert evidence.detectable_worst > 10.0  # gravity is everywhere the same
    assert "never along z" in evidence.sensitivity


def test_a_measured_pose_notices_20_cm():
    robot = simple_robot()
    samples = readings(robot, truth_of(robot), 1, cells=False, pose=True)
    evidence = home_evidence(robot, home_of(robot, [0.0, 0.2, 0.0]), samples, ERRORS)
    assert evidence.contradicts and evidence.senses == ("pose measurement",)
    assert evidence.detectable_worst < 0.1
    assert not home_evidence(robot, home_of(robot), samples, ERRORS).contradicts


def test_encoders_alone_and_slack_cables_notice_nothing():
    robot = simple_robot()
    slack = simple_robot(linear_density=np.full(4, 5.0))
    for one, cells in ((robot, False), (slack, True)):
        samples = readings(one, truth_of(one), 1, cells=cells)
        evidence = home_evidence(one, home_of(one), samples, ERRORS)
        assert evidence.senses == () and not evidence.contradicts
        assert evidence.detectable_worst == np.inf
        assert evidence.sensitivity == "encoders alone do not show a wrong home"


def test_a_sensor_without_errors_is_refused():
    with pytest.raises(InvalidField, match="tension_bias: got 0"):
        SenseErrors(tension_bias=0.0)
