"""Recorded runs of simulated robots, with the truth at each length sample."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

import carosac_toolkit as ct
from carosac_toolkit.drivers.sensors import SensorSettings
from carosac_toolkit.loop.consistency import state_error
from carosac_toolkit.loop.values import Belief, Command, Imu, Stamped, State
from carosac_toolkit.recordings.poses import PoseSamples
from carosac_toolkit.recordings.recording import Recording
from sim_warp.driver import SimDriver, SimDriverSettings

PERIOD = 0.01  # [s]


def swing(
    plant, *, sensors=None, seed=0, wind=0.0, duration=3.0, every=5, suite="lengths+imu+pose"
):
    """Record a quick move that throws the platform into a swing.

    Returns:
        The recording, with every `every`-th length sample and pose, and the truth at each of them.
    """
    driver = SimDriver.build(
        plant,
        SimDriverSettings(
            suite=suite, sensors=sensors or SensorSettings(), cables="catenary",
            wind_force=wind, period=PERIOD,
        ),
        seed=seed,
    )  # fmt: skip
    goal = plant.home_position[None] + np.array([0.25, 0.2, 0.1])
    far = ct.statics.inverse_kinematics(plant, goal).unstrained_length
    near = ct.statics.inverse_kinematics(plant, plant.home_position[None]).unstrained_length
    driver.connect()
    first = driver.measure().unstrained_length
    heard = []
    for k in range(round(duration / PERIOD)):
        measurement = driver.measure()
        heard.append((measurement, driver.truth()))
        share = np.clip((k * PERIOD - 0.3) / 0.8, 0.0, 1.0)
        share = share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
        command = first + share * (far - near)
        driver.command(Command(time=measurement.time, unstrained_length=command))
        driver.wait(PERIOD)
    driver.close()
    return _recording(heard, every)


def _recording(heard, every):
    """What was heard, each by the time at which it was measured."""
    stamps = np.array([m.length_rate.time[0] for m, _ in heard])
    kept = [i for i in range(1, len(heard)) if stamps[i] > stamps[i - 1]][::every]
    angles = {
        name: _stamped([getattr(heard[i][0], name) for i in kept])
        for name in ("swivel_angle", "attitude", "inclination")
        if getattr(heard[0][0], name) is not None
    }
    poses = [heard[i][0].pose for i in kept]
    recording = Recording(
        time=stamps[kept],
        unstrained_length=np.vstack([heard[i][0].unstrained_length for i in kept]),
        imu=_imu([m.imu for m, _ in heard if m.imu is not None]),
        poses=PoseSamples.from_rotation(
            np.array([pose.time[0] for pose in poses]),
            np.vstack([pose.position for pose in poses]),
            np.vstack([pose.rotation for pose in poses]),
        ),
        **angles,
    )
    when = np.array([truth.time[0] for _, truth in heard])
    rows = np.abs(when[:, None] - recording.time).argmin(axis=0)
    assert np.abs(when[rows] - recording.time).max() < 1e-6
    return recording, [heard[row][1] for row in rows]


def _imu(parts):
    """All inertial samples of one robot; None where there are none."""
    if not parts:
        return None
    return Imu(
        time=np.concatenate([part.time[0] for part in parts]),
        angular_rate=np.concatenate([part.angular_rate[0] for part in parts]),
        specific_force=np.concatenate([part.specific_force[0] for part in parts]),
    )


def _stamped(samples):
    """A channel of samples of one robot."""
    return Stamped(
        time=np.concatenate([each.time for each in samples]),
        value=np.vstack([each.value for each in samples]),
    )


def errors_of(smoothed, truths):
    """Truth minus estimate, shape (N, 12)."""
    return _errors(truths, smoothed.position, smoothed.rotation, smoothed.twist)


def _errors(truths, position, rotation, twist):
    truth = State(
        time=np.concatenate([t.time for t in truths]),
        position=np.vstack([t.position for t in truths]),
        rotation=np.vstack([t.rotation for t in truths]),
        twist=np.vstack([t.twist for t in truths]),
    )
    belief = Belief(time=truth.time, position=position, rotation=rotation, twist=twist)
    return state_error(truth, belief)


def filtered(estimator, recording, truths, *, poses=False):
    """Errors of a causal estimator on the same recording, each at its own time, shape (N, 12)."""
    beliefs = []
    for index in range(len(recording.time)):
        measurement = recording.measurement(index)
        if poses:
            pose = recording.pose_at(measurement.time).pose
            measurement = replace(measurement, pose=pose)
        command = Command(time=measurement.time, unstrained_length=measurement.unstrained_length)
        beliefs.append(
            estimator.update(beliefs[-1], command, measurement)
            if beliefs
            else estimator.reset(measurement)
        )
    return _errors(
        truths,
        np.vstack([belief.position for belief in beliefs]),
        np.vstack([belief.rotation for belief in beliefs]),
        np.vstack([belief.twist for belief in beliefs]),
    )


def rms(errors):
    """Of the position [m]."""
    return float(np.sqrt((errors[:, :3] ** 2).sum(axis=1).mean()))
