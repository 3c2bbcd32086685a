"""Coordinates of the search: whatever they are, there is such a robot."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
from scipy.stats import norm

import carosac_toolkit as ct
from benchmarks.calibration_oscillations import errors_along_curves
from calibration.identification.settings import IdentificationSettings
from calibration.identification.spread import Spread
from calibration.identification.unknowns import choose_coordinates, group_of
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.robot.parameters import values_of


@pytest.fixture(scope="module")
def unknowns():
    return choose_coordinates(ct.load_robot("carosac"), IdentificationSettings())


def test_coordinates_of_zero_are_the_robot_itself(unknowns):
    robot = unknowns.robot_at(np.zeros(len(unknowns.prior.names)))
    before = values_of(unknowns.robot, unknowns.prior.names)
    assert values_of(robot, unknowns.prior.names) == pytest.approx(before, rel=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_every_point_within_three_sigmas_is_a_body_that_can_be(unknowns, seed):
    rng = np.random.default_rng(seed)
    point = np.maximum(3.0 * rng.standard_normal(len(unknowns.prior.names)), unknowns.lower)
    robot = unknowns.robot_at(point)  # its constructor refuses an impossible inertia
    moments = np.linalg.eigvalsh(robot.inertia)
    assert moments[2] < moments[0] + moments[1]
    assert robot.mass > 0.0 and (robot.axial_stiffness > 0.0).all()


def test_a_skew_inertia_stays_possible():
    robot = ct.load_robot("carosac")
    robot = replace(robot, inertia=robot.inertia + 0.1 * (1.0 - np.eye(3)))
    unknowns = choose_coordinates(robot, IdentificationSettings())
    point = np.zeros(len(unknowns.prior.names))
    for axis, share in zip("xyz", (3.0, -3.0, 2.0), strict=True):
        point[unknowns.prior.names.index(f"inertia.{axis * 2}")] = share
    assert np.linalg.eigvalsh(unknowns.robot_at(point).inertia)[0] > 0.0


def test_products_of_inertia_are_free_where_they_are_asked_for():
    robot = ct.load_robot("carosac")
    unknowns = choose_coordinates(robot, IdentificationSettings(inertia_products=0.15))
    names = unknowns.prior.names
    row = names.index("inertia.xz")
    small, far = np.zeros(len(names)), np.zeros(len(names))
    small[row] = 1e-4
    turned = unknowns.robot_at(small).inertia - robot.inertia
    moments = 0.5 * np.trace(robot.inertia) - np.diag(robot.inertia)  # of the mass along the axes
    assert turned[0, 2] == pytest.approx(1e-4 * 0.15 * np.sqrt(moments[0] * moments[2]))
    assert np.abs(turned - turned[0, 2] * np.eye(3)[[2, 1, 0]] * [1, 0, 1]).max() < 1e-7
    far[[names.index(f"inertia.{pair}") for pair in ("xy", "xz", "yz")]] = (6.0, -5.0, 7.0)
    least, middle, largest = np.linalg.eigvalsh(unknowns.robot_at(far).inertia)
    assert 0.0 < least and largest < least + middle


def test_a_thin_plate_has_no_products_across_it():
    robot = ct.load_robot("carosac")
    plate = replace(robot, inertia=np.diag([0.4, 0.4, 0.8]))
    unknowns = choose_coordinates(plate, IdentificationSettings(inertia_products=0.15))
    products = [name for name in unknowns.prior.names if name[-2:] in ("xy", "xz", "yz")]
    assert products == ["inertia.xy"]


def test_a_delay_stays_at_or_above_zero(unknowns):
    """An estimator cannot look ahead, and refuses a robot that asks for it."""
    row = unknowns.prior.names.index("length_delay")
    robot = unknowns.robot_at(np.maximum(np.full(len(unknowns.lower), -3.0), unknowns.lower))
    assert unknowns.lower[row] == 0.0 and robot.length_delay == 0.0


def test_run_length_moves_at_a_constant_stiffness_of_the_whole_cable(unknowns):
    point = np.zeros(len(unknowns.prior.names))
    point[unknowns.prior.names.index("run_length")] = 1.5
    robot, changed = unknowns.robot, unknowns.robot_at(point)
    assert changed.run_length[0] > robot.run_length[0]
    before = robot.axial_stiffness / (unknowns.reach + robot.run_length)
    after = changed.axial_stiffness / (unknowns.reach + changed.run_length)
    assert after == pytest.approx(before)


def test_all_forces_and_masses_by_one_factor_are_a_straight_line(unknowns):
    """Motion does not tell the factor: a curve would make sigmas of what it does tell wrong."""
    names = unknowns.prior.names
    point = np.zeros(len(names))
    for name in ("exit_friction", "anchor_friction"):
        point[names.index(name)] = 1.2
    robot, larger = unknowns.robot_at(point), unknowns.robot_at(point + unknowns.alike)
    forces = ("linear_density", "axial_stiffness", "axial_damping", "drag", "angular_drag")
    for field in ("mass", "inertia", *forces, "exit_friction", "anchor_friction"):
        before, after = getattr(robot, field), getattr(larger, field)
        assert np.asarray(after) == pytest.approx(np.e * np.asarray(before), rel=1e-9)
    assert larger.run_length == pytest.approx(robot.run_length)


def test_drags_that_are_factors_belong_to_no_force():
    settings = IdentificationSettings().with_candidates(["cable_drag", "angular_drag_axes"])
    chosen = choose_coordinates(ct.load_robot("carosac"), settings)
    point = np.zeros(len(chosen.prior.names))
    point[chosen.prior.names.index("cable_drag")] = 1.0
    point[chosen.prior.names.index("angular_drag_axes.y")] = -1.0
    robot = chosen.robot_at(point)
    assert robot.cable_drag == pytest.approx(0.5 * np.e)  # of what is usual for `carosac`
    assert robot.angular_drag_axes == pytest.approx([1.0, np.exp(-0.5), 1.0])
    larger = chosen.robot_at(point + chosen.alike)
    assert larger.cable_drag == robot.cable_drag
    assert larger.angular_drag_axes == pytest.approx(robot.angular_drag_axes)


@pytest.mark.parametrize("held", ["mass", "linear_density", "drag"])
def test_there_is_no_such_line_where_a_force_or_mass_is_held(held):
    robot = ct.load_robot("carosac")
    assert choose_coordinates(robot, IdentificationSettings(**{held: 0.0})).alike is None


def test_what_the_file_knows_of_coupled_parameters_is_their_prior():
    robot = replace(ct.load_robot("carosac"), exit_friction=np.full(4, 0.2))
    names = ("mass", "axial_stiffness", "run_length", "exit_friction")
    sigma = np.array([0.5, 4e3, 0.3, 0.01])
    known = np.outer(sigma, sigma) * (0.6 + 0.4 * np.eye(4))
    robot = replace(robot, calibrated=names, calibration_covariance=known)
    unknowns = choose_coordinates(robot, IdentificationSettings())
    none = np.zeros(len(unknowns.prior.names))
    estimate = unknowns.estimate(none, Spread.straight(unknowns.prior.covariance)).select(names)
    assert estimate.covariance == pytest.approx(known, rel=1e-4)


def test_the_covariance_of_the_robot_file_is_the_prior():
    robot = ct.load_robot("carosac")
    block = np.array([[4e-6, 1e-6, 0.0], [1e-6, 9e-6, 0.0], [0.0, 0.0, 1e-6]])
    robot = replace(robot, exit_covariance=np.tile(block, (4, 1, 1)))
    unknowns = choose_coordinates(robot, IdentificationSettings())
    none = np.zeros(len(unknowns.prior.names))
    estimate = unknowns.estimate(none, Spread.straight(unknowns.prior.covariance))
    assert estimate.covariance[:3, :3] == pytest.approx(block, rel=1e-6)
    assert estimate.prior_sigma[:3] == pytest.approx([2e-3, 3e-3, 1e-3], rel=1e-6)


def test_sigmas_of_factors_are_shares_of_their_value(unknowns):
    none = np.zeros(len(unknowns.prior.names))
    estimate = unknowns.estimate(none, Spread.straight(unknowns.prior.covariance))
    mass = estimate.index("mass")
    assert estimate.prior_sigma[mass] == pytest.approx(0.05 * unknowns.robot.mass, rel=1e-4)


SIGMAS = [
    each.name for each in fields(IdentificationSettings)
    if each.name not in ("rate", "iterations", "time_step")
]  # fmt: skip


@pytest.mark.parametrize("field", SIGMAS)
def test_a_sigma_of_zero_holds_a_parameter(field):
    robot = ct.load_robot("carosac")
    all_free = IdentificationSettings().with_candidates(SIGMAS)
    every = choose_coordinates(robot, all_free).prior.names
    held = choose_coordinates(robot, all_free.without([field])).prior.names
    gone = set(every) - set(held)
    assert gone and {group_of(name) for name in gone} == {field}


def test_a_factor_cannot_begin_at_zero():
    robot = replace(ct.load_robot("carosac"), drag=0.0)
    with pytest.raises(InvalidField, match=r"drag: got 0.0; allowed: > 0, or the setting drag = 0"):
        choose_coordinates(robot, IdentificationSettings())


def test_settings_refuse_what_is_no_sigma():
    with pytest.raises(InvalidField, match="inertia"):
        IdentificationSettings(inertia=-1.0)
    with pytest.raises(InvalidField, match="rate"):
        IdentificationSettings(rate=0.0)


def test_a_step_of_stiffness_changes_its_inverse_in_proportion(unknowns):
    row = unknowns.prior.names.index("axial_stiffness")
    step = np.zeros(len(unknowns.prior.names))
    before = 1.0 / unknowns.robot.axial_stiffness
    for size in (-1.2, -0.3, 0.4):
        step[row] = size
        moved = unknowns.robot_at(unknowns.moved(np.zeros(len(step)), step))
        expected = before * (1.0 - unknowns.scale[row] * size)
        assert 1.0 / moved.axial_stiffness == pytest.approx(expected)
    step[row] = 5.0
    moved = unknowns.robot_at(unknowns.moved(np.zeros(len(step)), step))
    assert (moved.axial_stiffness > 0.0).all()


@pytest.mark.parametrize("name", ["desktop", "stadium"])
def test_prior_lengths_grow_with_the_robot(name, unknowns):
    robot = ct.load_robot(name)
    other = choose_coordinates(robot, IdentificationSettings())
    ratio = Scales(robot).ratios.length
    for field in ("center_of_mass.x", "run_length", "anchor_points"):
        mine, its = (
            next(
                scale for name, scale in zip(each.prior.names, each.scale, strict=True)
                if name.startswith(field)
            )
            for each in (unknowns, other)
        )  # fmt: skip
        assert its == pytest.approx(ratio * mine)


def test_the_covariance_of_parameters_along_a_curve_is_that_of_where_draws_lead(unknowns):
    """What is beyond a draw counts beside it: of a factor exp(s z), e^(s z) - 1 - s z does."""
    names, none = unknowns.prior.names, np.zeros(len(unknowns.prior.names))
    mass, share = names.index("mass"), 0.3
    sigma = share / unknowns.scale[mass]
    half = sigma * norm.ppf((np.arange(400) + 0.5) / 400)
    draws = np.zeros((len(half), len(names)))
    draws[:, mass] = half
    covariance = np.zeros((len(names), len(names)))
    covariance[mass, mass] = sigma**2
    spread = Spread(covariance=covariance, draws=draws)
    estimate = unknowns.estimate(none, spread)
    growth = np.exp(0.5 * share**2)  # of the mean of a log-normal variable
    beyond = growth**4 - 2.0 * growth + 1.0 + share**2 - 2.0 * share**2 * growth
    variance = estimate.sigma**2
    expected = share**2 + beyond
    assert variance[mass] / unknowns.robot.mass**2 == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize("name", ["axial_stiffness", "run_length", "mass", "drag"])
def test_the_benchmark_scores_errors_along_the_curves_of_the_coordinates(unknowns, name):
    """Far apart as well: there errors are what a covariance along straight lines is of."""
    names = unknowns.prior.names
    at, true = np.full(len(names), 1.5), np.full(len(names), 0.1)
    estimate = unknowns.estimate(at, Spread.straight(unknowns.prior.covariance))
    values = values_of(unknowns.robot_at(true), names)
    row, step = names.index(name), 1e-6 * (at - true)
    straight = 1e6 * (estimate.value - values_of(unknowns.robot_at(at - step), names))[row]
    off = errors_along_curves(estimate, values, unknowns.reach)[row]
    assert off == pytest.approx(straight, rel=1e-4)
    if name != "run_length":
        assert abs(estimate.value[row] - values[row] - straight) > 0.01 * abs(straight)


def test_some_fields_are_again_as_the_file_has_them(unknowns):
    at = np.random.default_rng(3).uniform(0.1, 0.5, len(unknowns.prior.names))
    again = unknowns.as_before(at, ("axial_stiffness", "axial_damping"))
    held = np.array([name.startswith("axial_") for name in unknowns.prior.names])
    assert held.sum() == 2 and not again[held].any() and (again[~held] == at[~held]).all()
    assert unknowns.robot_at(again).axial_damping == pytest.approx(unknowns.robot.axial_damping)


def test_cables_are_stiffened_by_a_factor(unknowns):
    at = np.zeros(len(unknowns.prior.names))
    stiff = unknowns.robot_at(unknowns.multiplied(at, "axial_stiffness", 1.7))
    assert stiff.axial_stiffness == pytest.approx(1.7 * unknowns.robot.axial_stiffness)
    assert unknowns.log_sigma("axial_stiffness") == pytest.approx(np.log(2.0), rel=0.02)
