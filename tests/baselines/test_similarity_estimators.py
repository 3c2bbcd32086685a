"""Estimators on a robot in another size: the same beliefs, whatever its size.

What one robot measured is scaled by Froude's law and given to the estimators of the same robot in
another size. Nothing else is in the loop, so what then differs is a constant of an estimator, or of
the physics that it uses.
"""

from __future__ import annotations

import ast
import re
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

import baselines
import carosac_toolkit as ct
from baselines.dynamic_estimator.settings import DynamicEstimatorSettings, settings_for
from baselines.ks_ekf.filter_settings import FilterSettings, filter_settings
from baselines.ks_ekf.settings import KsEkfSettings
from baselines.length_readings import ReadingTolerances, reading_tolerances
from baselines.smoother.settings import SmootherSettings, smoother_settings_for
from benchmarks import similarity as benchmark
from carosac_toolkit.base.scaled import Ratios, Scaled, resolved
from carosac_toolkit.drivers.sensors import SensorSettings
from carosac_toolkit.loop import loop, plugins
from carosac_toolkit.loop.plugin_builder import build_plugin
from carosac_toolkit.loop.values import Command, Imu, Measurement
from carosac_toolkit.physics.motion.cable_drag import cable_drag_of
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.robot.similar import similar_robot, similarity

DURATION_S = 3.0
BAR = 1e-7  # solvers stop somewhere: of distances, rotations, speeds and deviations
ESTIMATORS = ("straight_line", "kinematic_solver", "ks_ekf", "dynamic_estimator")
# Rounding of times, the minute of a unit, and what is longer than any recording.
NOT_OF_A_ROBOT = {"READING_INTERVAL_MIN_S", "TIME_TOLERANCE_S", "MINUTE_S", "WHOLE_RECORDING_S"}
UNIT_SUFFIX = re.compile(r"_(M|S|N|KG|HZ|M_S|RAD_S|(M|RAD|M2|1)_PER_S2?|PER_S)$")
UNIT_IN_TEXT = re.compile(r"\[(?=[^\]]*\b(m|s|N|kg|Hz)\b)[^\]]*\]")
PACKAGES = ("dynamic_estimator", "ks_ekf", "smoother")
SAME_ERRORS = {  # settings of `dynamic_estimator` and of the sensors
    "encoder_bias": "encoder_bias", "encoder_noise": "encoder_noise",
    "position_noise": "position_noise", "load_cell_noise": "tension_noise",
    "load_cell_bias": "tension_bias",
}  # fmt: skip
MODULES = (
    "length_readings", "kinematic_solver", "kinematic_solver_controller", "lookahead",
    "straight_line", "straight_line_controller", "center_of_mass", "solve_record",
)  # fmt: skip


@pytest.fixture(scope="module")
def heard():
    """What a robot measures that moves fast and sways: lengths, IMU and poses."""
    world = benchmark.world_of("carosac", 1.0)
    robot = world.robot
    driver = build_plugin(
        plugins.load("drivers", "simulator"), robot, where="driver", seed=1,
        asked={
            "suite": "lengths+imu+pose", "cables": "catenary", "period": benchmark.PERIOD_S,
            "start_position": tuple(world.path.sample(np.zeros(1)).position[0]),
        },
    )  # fmt: skip
    controller = build_plugin(
        plugins.load("controllers", "straight_line"), robot, where="controller", asked={}
    )
    recorder = Recorder()
    loop.run(driver, recorder, controller, world.path, duration=DURATION_S)
    return recorder.measurements


class Recorder:
    """An estimator that knows nothing, and keeps what it was told."""

    def __init__(self) -> None:
        self.measurements = []

    def reset(self, measurement):
        self.measurements.append(measurement)
        robot = ct.load_robot("carosac")
        return ct.loop.values.Belief(
            time=measurement.time, position=robot.home_position[None],
            rotation=robot.home_rotation[None],
        )  # fmt: skip

    def update(self, belief, command, measurement):
        self.measurements.append(measurement)
        return replace(belief, time=measurement.time)


def scaled(measurement: Measurement, ratios: Ratios, suite: str) -> Measurement:
    """Return what a robot in another size measures."""
    time, speed = ratios.time, ratios.of_unit("m/s")
    rate, pose, imu = measurement.length_rate, measurement.pose, measurement.imu
    return Measurement(
        time=time * measurement.time,
        unstrained_length=ratios.length * measurement.unstrained_length,
        length_rate=None if rate is None else replace(
            rate, time=time * rate.time, value=speed * rate.value
        ),
        pose=None if pose is None or "pose" not in suite else replace(
            pose, position=ratios.length * pose.position,
            time=None if pose.time is None else time * pose.time,
        ),
        imu=None if imu is None or "imu" not in suite else Imu(
            time=time * imu.time, angular_rate=imu.angular_rate / time,
            specific_force=imu.specific_force,
        ),
    )  # fmt: skip


def beliefs(name: str, factor: float, heard, suite: str):
    """What an estimator makes of it, in the units of factor 1: pose, twist and covariance."""
    robot, ratios = similar_robot(ct.load_robot("carosac"), factor), similarity(factor)
    estimator = build_plugin(
        plugins.load("estimators", name), robot, where="estimator",
        asked=benchmark.told_of_sensors(name, ratios),
    )  # fmt: skip
    units = np.repeat([ratios.of_unit(unit) for unit in ("m", "rad", "m/s", "rad/s")], 3)
    found, belief = [], None
    for one in heard:
        measured = scaled(one, ratios, suite)
        if belief is None:
            belief = estimator.reset(measured)
        else:
            command = Command(time=measured.time, unstrained_length=measured.unstrained_length)
            belief = estimator.update(belief, command, measured)
        twist = np.zeros(6) if belief.twist is None else belief.twist[0] / units[6:]
        spread = np.eye(12) if belief.covariance is None else belief.covariance[0]
        found.append((
            belief.position[0] / ratios.length, belief.rotation[0], twist,
            np.sqrt(np.diag(spread)) / units if belief.covariance is not None else np.ones(12),
        ))  # fmt: skip
    return [np.array(column) for column in zip(*found, strict=True)]


@pytest.fixture(scope="module")
def first(heard):
    """Beliefs at factor 1, by estimator and suite."""
    known = {}

    def get(name, suite):
        if (name, suite) not in known:
            known[name, suite] = beliefs(name, 1.0, heard, suite)
        return known[name, suite]

    return get


@pytest.mark.parametrize("factor", [0.1, 10.0])
@pytest.mark.parametrize("name", ESTIMATORS)
@pytest.mark.parametrize("suite", ["lengths+imu", "lengths+imu+pose", "lengths"])
def test_an_estimator_believes_the_same_of_a_similar_robot(name, factor, suite, heard, first):
    if suite != "lengths" and name in ("straight_line", "kinematic_solver"):
        pytest.skip("reads lengths only")
    before, after = first(name, suite), beliefs(name, factor, heard, suite)
    moved = np.ptp(before[0], axis=0).max()
    culprit = f"a constant in {type_module(name)}, at factor {factor:g}"
    fastest = np.abs(before[2]).max() + 1e-9
    assert np.abs(after[0] - before[0]).max() <= BAR * moved, culprit
    assert np.abs(after[1] - before[1]).max() <= BAR, culprit
    assert np.abs(after[2] - before[2]).max() <= BAR * fastest, culprit
    assert after[3] == pytest.approx(before[3], rel=BAR), culprit


def type_module(name: str) -> str:
    """The module of an estimator."""
    return str(plugins.load("estimators", name).__module__)


@pytest.mark.parametrize(
    ("make", "settings"),
    [
        (settings_for, DynamicEstimatorSettings()),
        (filter_settings, KsEkfSettings()),
        (smoother_settings_for, SmootherSettings()),
    ],
    ids=["dynamic_estimator", "ks_ekf", "smoother"],
)
def test_defaults_are_stated_for_carosac_and_what_the_user_sets_stays(make, settings):
    robot = ct.load_robot("carosac")
    here = make(robot, settings)
    for item in fields(settings):
        value = getattr(settings, item.name)
        if isinstance(value, Scaled):
            assert getattr(here, item.name) == float(value), item.name
    large = make(similar_robot(robot, 10.0), here)  # all of it is stated now
    for item in fields(settings):
        value = getattr(here, item.name)
        if isinstance(value, float):
            assert getattr(large, item.name) == value, item.name


def test_known_sums_are_as_ever_on_carosac():
    here = settings_for(ct.load_robot("carosac"), DynamicEstimatorSettings())
    assert (here.length_bias, here.stretch_noise) == (7e-3, 0.6e-3)
    assert cable_drag_of(ct.load_robot("carosac")) == 0.5
    tolerances = reading_tolerances(ct.load_robot("carosac"), here.encoder_noise)
    assert (tolerances.jitter, tolerances.extrapolation_time) == (5e-3, 0.1)


def test_the_drag_of_cables_fades_as_slowly_as_the_robot_is_large():
    large = similar_robot(ct.load_robot("carosac"), 10.0)
    assert cable_drag_of(large) == pytest.approx(0.5 / np.sqrt(10.0), rel=1e-12)


@pytest.mark.parametrize(
    ("settings", "sensors"),
    [
        (DynamicEstimatorSettings, "dynamic_estimator"),
        (FilterSettings, "ks_ekf"),
        (SmootherSettings, None),
        (ReadingTolerances, None),
    ],
)
def test_each_setting_with_a_unit_scales_or_describes_a_sensor(settings, sensors):
    told = benchmark.TOLD_OF_SENSORS.get(sensors, ())
    stated = settings()
    text = "".join(kind.__doc__ or "" for kind in reversed(settings.__mro__))
    for item in fields(settings):
        value = getattr(stated, item.name)
        described = re.search(rf"^ +{item.name}: (.*?)(?=^ +\w+: |\Z)", text, re.M | re.S)
        has_unit = described is not None and UNIT_IN_TEXT.search(described[1])
        if isinstance(value, float) and value and has_unit and item.name not in told:
            where = f"{settings.__module__}: {item.name} = {value}"
            assert isinstance(value, Scaled), f"{where} has a unit but does not scale"


def test_no_module_of_an_estimator_states_a_size_of_its_own():
    root = Path(baselines.__file__).parent
    files = [root / f"{name}.py" for name in MODULES]
    files += [path for name in PACKAGES for path in sorted((root / name).glob("*.py"))]
    wrong = []
    for path in files:
        for node in ast.parse(path.read_text()).body:
            if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
                name = node.targets[0].id
                if UNIT_SUFFIX.search(name) and name not in NOT_OF_A_ROBOT:
                    wrong.append(f"{path.relative_to(root.parent)}: {name}")
    assert not wrong, f"sizes that do not scale: {wrong}"


def test_estimators_assume_the_errors_that_the_sensors_have_by_default():
    for name in ("desktop", "carosac", "stadium"):
        robot = ct.load_robot(name)
        sensors = resolved(SensorSettings(), Scales(robot).ratios)
        known = settings_for(robot, DynamicEstimatorSettings())
        for mine, theirs in SAME_ERRORS.items():
            assert getattr(known, mine) == getattr(sensors, theirs), (name, mine)
        assert filter_settings(robot, KsEkfSettings()).length_bias == sensors.encoder_bias
