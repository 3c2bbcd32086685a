"""Calibration with no known position, or with some coordinates of positions only."""

import re
import time
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from benchmarks.unknown_robots import draw_unknown_robot
from calibration.observability import Unobservable
from calibration.robot_update import prior_covariance
from calibration.self_calibration.blunder_tests import settle
from calibration.self_calibration.calibrate import calibrate_motor_angles
from calibration.self_calibration.problem import MotorAngleProblem
from calibration.self_calibration.rivals import Rival, better_rival, fits_better, rival_warning
from calibration.self_calibration.settings import Distance, SelfCalibrationSettings
from calibration.self_calibration.starting_points import starts
from calibration.self_calibration.synthetic import (
    MeasurementNoise,
    draw_robot,
    measure_motor_angles,
)
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.base.rotations import best_rotation, from_rotation_vector
from carosac_toolkit.robot.file import parse_robot, robot_text
from carosac_toolkit.robot.writer import robot_document
from tests.calibration.self_calibration.scenes import EXITS, robots, scene
from tests.calibration.self_calibration.test_calibrate import SILENT, exits
from tests.robots import PER_CABLE, eight_cable_robot

SPAN = float(np.linalg.norm(EXITS[0] - EXITS[1]))
TAPE = Distance(first="a", second="b", length=SPAN, sigma=1e-5)
SHARP = SelfCalibrationSettings(
    line_sigma=1e-5, length_at_zero_sigma=0.5, drum_radius_sigma=5e-3,
    distances=(TAPE,),
)  # fmt: skip


def loose(robot, sigma=0.5):
    return replace(robot, exit_covariance=np.tile(sigma**2 * np.eye(3), (robot.n, 1, 1)))


def turn_to(points, target):
    """Points turned about the origin, and shifted by nothing, to fit others best."""
    return best_rotation(points, target).T


def frame_error(result, truth):
    """Exit points less the true ones, in the frame of the convention, shape (n, 3)."""
    points = truth.exit_points - truth.anchor_points
    before = result.before.exit_points - result.before.anchor_points
    return exits(result) - truth.anchor_points - points @ turn_to(points, before)


def frame_nees(result, truth):
    """Squared error of the exit points in the frame of convention, without the three turns."""
    k = truth.exit_points.size
    value, axes = np.linalg.eigh(result.estimate.covariance[:k, :k])
    along = axes.T @ frame_error(result, truth).ravel()
    assert value[:3].max() < 1e-6 * value[3]  # the turns are out of the covariance
    return float((along[3:] ** 2 / value[3:]).sum())


def test_exact_angles_and_one_distance_give_the_exact_shape():
    before, truth, place, angles = scene(1, 40, noise=SILENT, known=())
    result = calibrate_motor_angles(angles, loose(before, 1.0), SHARP)
    assert np.abs(frame_error(result, truth)).max() < 1e-3
    points = np.vstack([truth.exit_points - truth.anchor_points, place])
    found = np.vstack([exits(result) - truth.anchor_points, result.position])
    assert found == pytest.approx(points @ turn_to(points, found), abs=1e-3)
    assert result.position[0] == pytest.approx(before.home_position, abs=1e-3)
    assert result.warnings == () and result.blunders == ()


def test_a_turned_prior_turns_the_result_and_changes_nothing_else():
    before, _, _, angles = scene(2, 40, known=())
    turn = Rotation.from_rotvec([0.4, -0.3, 0.7]).as_matrix()
    points = before.exit_points - before.anchor_points
    other = replace(before, exit_points=points @ turn.T + before.anchor_points)
    one, two = (calibrate_motor_angles(angles, robot) for robot in (before, other))
    assert two.position == pytest.approx(one.position @ turn.T, abs=2e-4)
    moved = (exits(one) - before.anchor_points) @ turn.T
    assert exits(two) - before.anchor_points == pytest.approx(moved, abs=2e-4)
    assert two.residual == pytest.approx(one.residual, abs=1e-5)


def test_the_scale_is_that_of_the_measured_distance():
    before, _, _, angles = scene(3, 40, noise=SILENT, known=())
    results = [
        calibrate_motor_angles(
            angles, loose(before, 1.0),
            replace(
                SHARP, drum_radius_sigma=0.02,
                distances=(replace(TAPE, length=scale * SPAN),),
            ),
        )
        for scale in (1.0, 1.01)
    ]  # fmt: skip
    sizes = [np.linalg.norm(exits(one)[:, None] - exits(one), axis=2) for one in results]
    off = ~np.eye(4, dtype=bool)
    assert sizes[1][off] / sizes[0][off] == pytest.approx(1.01, abs=2e-4)


def test_a_worse_source_of_the_scale_makes_a_worse_scale():
    before, _, _, angles = scene(4, 40, known=())
    sharp, blunt = (
        calibrate_motor_angles(
            angles, before, SelfCalibrationSettings(distances=(replace(TAPE, sigma=sigma),))
        )
        for sigma in (1e-3, 1.0)
    )
    assert sharp.scale.sigma < 0.4 * blunt.scale.sigma
    assert list(sharp.scale.sources)[:2] == ["measured distances", "lengths at home"]
    assert sharp.scale.sources["measured distances"] == pytest.approx(1e-3 / SPAN, rel=1e-3)
    assert next(iter(blunt.scale.sources)) == "lengths at home"
    assert any("measured distance" in line for line in sharp.sentences())


@pytest.mark.slow
def test_sigmas_without_known_positions_are_honest():
    squares, places = [], []
    runs = 6
    for seed in range(200, 200 + runs):
        before, truth, place, angles = scene(seed, 40, known=())
        result = calibrate_motor_angles(angles, before, SelfCalibrationSettings(line_sigma=1e-3))
        if result.warnings:
            assert "another solution fits almost as well" in result.warnings[0]
            continue
        squares.append(frame_nees(result, truth))
        points = truth.exit_points - truth.anchor_points
        there = place @ turn_to(points, before.exit_points - before.anchor_points)
        error = (result.position - there)[1:] / result.position_sigma[1:]
        places.append((error**2).mean())
    assert len(squares) >= runs - 1
    low, high = chi2.ppf([0.005, 0.995], 9 * len(squares))
    assert low < sum(squares) < high
    assert 0.5 < np.mean(places) < 1.7


def test_a_robot_without_known_positions_calibrates_again_in_any_frame():
    squares = []
    for seed in (21, 22):
        before, truth, place, angles = scene(seed, 40, known=())
        turn = Rotation.from_rotvec([0.2, -0.3, 0.5]).as_matrix()  # another W than that of truth
        points = (before.exit_points - before.anchor_points) @ turn.T + before.anchor_points
        tape = SelfCalibrationSettings(distances=(replace(TAPE, sigma=1e-3),))
        first = calibrate_motor_angles(angles, replace(before, exit_points=points), tape)
        assert np.linalg.eigvalsh(first.estimate.covariance[:12, :12])[2] < 1e-12
        once = parse_robot(robot_document(robot_text("hangprinter"), first.robot, provenance="-"))
        rng = np.random.default_rng(seed)
        noise = MeasurementNoise()
        more = measure_motor_angles(truth, place, np.arange(0), noise, rng)
        second = calibrate_motor_angles(more, once)
        assert second.warnings == () and second.frame.free.shape[1] == 3
        squares.append(frame_nees(second, truth))
        assert second.estimate.sigma[:12].max() < 0.01
        for robot in (once, second.robot):
            known = measure_motor_angles(truth, place, np.arange(6), noise, rng)
            result = calibrate_motor_angles(known, robot)
            assert result.warnings == () and result.blunders == ()
            error = exits(result) - truth.exit_points
            assert np.abs(error).max() < 0.01
            assert np.abs(error.ravel() / result.estimate.sigma[:12]).max() < 4.0
    low, high = chi2.ppf([0.005, 0.995], 9 * len(squares))
    assert low < sum(squares) < high


def test_drawn_robots_may_be_those_of_a_file_without_known_positions():
    before, _, _, angles = scene(23, 40, known=())
    result = calibrate_motor_angles(angles, before)
    settings = SelfCalibrationSettings()
    drawn = draw_robot(result.robot, np.random.default_rng(0), settings).exit_points
    assert np.abs(drawn - result.robot.exit_points).max() < 2.0
    names = result.estimate.names[:12]
    known = prior_covariance(result.robot, names, np.ones(12))
    assert np.linalg.eigvalsh(known)[0] > 0.0
    # each free turn is as uncertain as the prior was
    ray = result.robot.exit_points - before.anchor_points - before.home_position
    about_z = np.cross([0.0, 0.0, 1.0], ray).ravel()
    assert about_z @ np.linalg.solve(known, about_z) == pytest.approx(
        about_z @ about_z / 0.5**2, rel=0.01
    )


def test_the_frame_of_convention_is_told():
    before, _, _, angles = scene(5, 40, known=())
    result = calibrate_motor_angles(angles, before)
    words = " ".join(result.sentences())
    assert "the origin is by convention: sample 0, the reference, is at home" in words
    assert "nothing that was measured tells any turn of the whole set-up" in words
    frame = result.data()["frame"]
    assert frame["free_motions"] == 3 and frame["origin_sample"] == "0"
    assert result.frame.turns.shape == (3, 3)


def test_the_mirror_image_is_told_apart_by_the_exit_points_known_before():
    before, _, _, angles = scene(6, 40, known=())
    result = calibrate_motor_angles(angles, before)
    (rival,) = [one for one in result.rivals if one.mirrored]
    assert rival.cost > 30.0 and not rival.as_good
    assert "the best other solution, its mirror image, is" in " ".join(result.sentences())
    flip = np.array([-1.0, 1.0, 1.0])
    mirrored = calibrate_motor_angles(
        angles, replace(before, exit_points=flip * (before.exit_points - before.anchor_points)
                        + before.anchor_points)
    )  # fmt: skip
    away = mirrored.position * flip - result.position
    assert away == pytest.approx(0.0, abs=2e-3)


def test_exit_points_close_to_a_plane_with_home_leave_the_mirror_image_to_the_workspace():
    before, truth, _, _ = scene(7, 40, known=())
    flat = np.array([[0.02, -1.59, 0.3], [1.29, 1.23, 0.2], [-1.42, 0.74, 0.3], [-1.2, -0.9, 0.2]])
    truth = replace(truth, exit_points=flat + np.array([0.0, 0.0, 0.01]))
    rng = np.random.default_rng(0)
    place = rng.uniform([-0.8, -0.8, 0.2], [0.8, 0.8, 1.6], (60, 3))
    place[0] = 0.0
    angles = measure_motor_angles(truth, place, np.arange(0), MeasurementNoise(line=2e-4), rng)
    span = float(np.linalg.norm(flat[0] - flat[1]))
    sharp = SelfCalibrationSettings(line_sigma=2e-4, distances=(replace(TAPE, length=span),))
    guess = loose(replace(before, exit_points=flat))
    result = calibrate_motor_angles(angles, guess, sharp)
    assert (result.position[1:, 2] > 0.0).all() and result.warnings == ()
    below = replace(guess, workspace_min=np.array([-0.9, -0.9, -1.6]),
                    workspace_max=np.array([0.9, 0.9, 0.0]))  # fmt: skip
    assert (calibrate_motor_angles(angles, below, sharp).position[1:, 2] < 0.0).all()
    both = replace(guess, workspace_min=np.array([-0.9, -0.9, -1.6]))
    (warning,) = calibrate_motor_angles(angles, both, sharp).warnings
    assert warning.startswith("the mirror image fits almost as well")


def test_a_level_floor_gives_the_vertical_and_leaves_the_heading():
    before, truth, place, angles = scene(8, 40, known=())
    known = np.zeros((40, 3), dtype=bool)
    known[:5, 2] = True
    floor = np.zeros((40, 3))
    floor[:5, 2] = place[:5, 2]
    level = replace(angles, is_known=known.any(axis=1), known_axes=known, known_position=floor)
    result = calibrate_motor_angles(level, before)
    assert result.frame.free.shape[1] == 1
    assert abs(result.frame.turns[2, 0]) == pytest.approx(1.0, abs=0.01)
    assert exits(result)[:, 2] == pytest.approx(truth.exit_points[:, 2], abs=0.06)
    assert np.abs(result.position[:, 2] - place[:, 2]).max() < 0.02
    assert "the turn about the vertical" in " ".join(result.sentences())
    assert all(np.isnan(one.error[:2]).all() for one in result.left_out)


def test_the_x_axis_goes_through_the_named_exit_point():
    before, _, _, angles = scene(9, 40, known=())
    plain = calibrate_motor_angles(angles, before)
    result = calibrate_motor_angles(angles, before, SelfCalibrationSettings(x_through="b"))
    exit_point = exits(result)[1] - before.home_position
    assert exit_point[1] == pytest.approx(0.0, abs=1e-3) and exit_point[0] > 1.0
    k = result.estimate.index("exit_points[b].y")
    assert result.estimate.sigma[k] < 1e-3
    assert result.residual == pytest.approx(plain.residual, abs=1e-4)
    assert "x through exit point b" in " ".join(result.sentences())
    with pytest.raises(InvalidField, match="x_through: got 'e'; allowed: one of"):
        calibrate_motor_angles(angles, before, SelfCalibrationSettings(x_through="e"))
    known = scene(9, 24)[3]
    with pytest.raises(InvalidField, match="allowed: nothing, as what was measured tells the head"):
        calibrate_motor_angles(known, before, SelfCalibrationSettings(x_through="b"))


@pytest.mark.parametrize("size", [0.1, 10.0])
def test_surveyed_exit_points_tell_the_place_at_any_size(size):
    _, truth, place, _ = scene(9, 40, known=())
    field = {name: size * getattr(truth, name) for name in (
        "exit_points", "anchor_points", "home_position", "drum_radius", "workspace_min",
        "workspace_max",
    )}  # fmt: skip
    small = replace(truth, **field, drum_buildup=size * truth.drum_buildup)
    rng = np.random.default_rng(0)
    noise = MeasurementNoise(line=1e-3 * size)
    angles = measure_motor_angles(small, size * place, np.arange(0), noise, rng)
    settings = SelfCalibrationSettings(
        line_sigma=1e-3 * size, length_at_zero_sigma=0.02 * size, drum_radius_sigma=2e-3 * size
    )
    problems = [
        MotorAngleProblem(loose(small, share * size), angles, settings) for share in (0.02, 0.1)
    ]
    assert problems[0].reference is None and problems[1].reference is not None
    words = " ".join(
        calibrate_motor_angles(angles, loose(small, 0.02 * size), settings).sentences()
    )
    assert "the origin is that of the exit points of the robot file" in words


def test_one_known_position_leaves_turns_about_it_free():
    before, _, place, angles = scene(10, 40, known=(3,))
    result = calibrate_motor_angles(angles, before)
    assert result.frame.reference is None and result.frame.free.shape[1] == 3
    assert result.frame.center == pytest.approx(place[3], abs=5e-3)
    assert result.position[3] == pytest.approx(angles.known_position[3], abs=1e-4)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda place: np.where([True, True, False], place, 0.0), "the samples lie in a plane"),
        (lambda place: 0.02 * place, "are too few, or too close together"),
        (lambda place: place[:8], "8 samples have 8 lengths to spare, fewer than the 13"),
    ],
)
def test_flat_crowded_and_few_samples_are_refused_with_the_reason(change, message):
    before, truth, place, _ = scene(11, 40, known=())
    angles = measure_motor_angles(
        truth, change(place), np.arange(0), MeasurementNoise(), np.random.default_rng(0)
    )
    settings = SelfCalibrationSettings(line_sigma=1e-3, length_at_zero_sigma=0.5)
    with pytest.raises(Unobservable, match=message) as caught:
        calibrate_motor_angles(angles, before, settings)
    assert "exit_points[" in str(caught.value) and "Allowed: samples spread" in str(caught.value)
    assert "samples near (" in str(caught.value)


def test_three_cables_have_nothing_to_spare():
    before, truth, place, _ = scene(12, 30, known=())
    per_cable = (
        *PER_CABLE, "cable_names", "exit_points", "anchor_points", "drum_radius", "drum_buildup",
        "drum_gear", "drum_advantage",
    )  # fmt: skip
    before, truth = (
        replace(robot, exit_covariance=None, **{n: getattr(robot, n)[:3] for n in per_cable})
        for robot in (before, truth)
    )
    angles = measure_motor_angles(
        truth, place, np.arange(0), MeasurementNoise(), np.random.default_rng(0)
    )
    with pytest.raises(Unobservable, match="three cables have no length to spare"):
        calibrate_motor_angles(angles, before, SelfCalibrationSettings(line_sigma=1e-3))


def test_a_file_without_reference_is_refused():
    before, truth, place, _ = scene(13, 30, known=())
    angles = measure_motor_angles(
        truth, place, np.arange(0), MeasurementNoise(), np.random.default_rng(0)
    )
    keep = np.arange(30) != 0
    without = replace(
        angles, samples=angles.samples[1:], motor_angle=angles.motor_angle[keep],
        known_position=angles.known_position[keep], is_known=angles.is_known[keep],
    )  # fmt: skip
    with pytest.raises(Unobservable, match="none was taken at the reference, where all motor ang"):
        calibrate_motor_angles(without, before)


def test_blunders_are_named_without_known_positions():
    before, truth, _, angles = scene(14, 44, known=(), blunders={(9, 0): 0.12, (17, 3): -0.25})
    result = calibrate_motor_angles(angles, before)
    assert {b.sample for b in result.blunders} == {"9", "17"}
    assert np.linalg.norm(frame_error(result, truth), axis=1).max() < 0.06


def test_a_wrong_distance_is_noticed():
    before, _, _, angles = scene(15, 40, known=())
    both = (
        Distance(first="a", second="b", length=SPAN, sigma=1e-3),
        Distance(first="a", second="b", length=SPAN + 0.02, sigma=1e-3),
    )
    result = calibrate_motor_angles(angles, before, SelfCalibrationSettings(distances=both))
    assert len(result.warnings) == 2
    for line in result.warnings:
        assert "m) by everything else, 14." in line and "standard deviations off: is it be" in line


@pytest.mark.parametrize(
    ("change", "source"),
    [
        ({}, "lengths at home"),
        ({"length_at_zero_sigma": 0.3, "drum_radius_sigma": 1e-3}, "drums"),
    ],
)
def test_one_wrong_distance_is_contradicted_by_the_other_sources_of_the_scale(change, source):
    before, _, _, angles = scene(50, 40, known=())
    wrong = replace(TAPE, length=1.05 * SPAN, sigma=1e-3)
    settings = SelfCalibrationSettings(distances=(wrong,), **change)
    found = calibrate_motor_angles(angles, before, settings).warnings
    (warning,) = [line for line in found if line.startswith("the distance a to b is")]
    got, predicted = (float(value) for value in re.findall(r"([\d.]+) m (?:as|\()", warning)[:2])
    assert got == pytest.approx(1.05 * SPAN, abs=1e-3)
    assert predicted == pytest.approx(SPAN, rel=0.02)
    assert f"by the {source}, " in warning


def test_lengths_at_home_and_drums_of_different_scales_are_named():
    before, _, _, angles = scene(50, 40, known=())
    wrong = replace(before, drum_radius=1.1 * before.drum_radius)
    settings = SelfCalibrationSettings(drum_radius_sigma=1e-3)
    (warning,) = [
        line for line in calibrate_motor_angles(angles, wrong, settings).warnings
        if line.startswith("the set-up is")
    ]  # fmt: skip
    assert "% smaller by the lengths at home than by the drums, " in warning
    assert calibrate_motor_angles(angles, before, settings).warnings == ()


def test_samples_that_are_named_help_more_than_samples_at_home():
    before, truth, place, _ = scene(20, 40, known=())
    flat = np.where([True, True, False], place, 0.02 * place)
    rng = np.random.default_rng(0)
    settings = SelfCalibrationSettings(line_sigma=1e-3, length_at_zero_sigma=0.5)
    angles = measure_motor_angles(truth, flat, np.arange(0), MeasurementNoise(), rng)
    with pytest.raises(Unobservable) as caught:
        calibrate_motor_angles(angles, before, settings)
    named = np.array([
        [float(part) for part in words.split(",")]
        for words in re.findall(r"\(([-\d., ]+)\)(?=,| m would)", str(caught.value))
    ])[-3:]  # fmt: skip
    assert named[:, 2].max() > 1.0  # off the plane
    more = np.vstack([flat, named])
    angles = measure_motor_angles(truth, more, np.arange(0), MeasurementNoise(), rng)
    assert calibrate_motor_angles(angles, before, settings).estimate.sigma[:12].max() < 0.1


def test_a_wanted_accuracy_that_is_not_reached_is_a_warning():
    before, _, _, angles = scene(16, 40, known=())
    result = calibrate_motor_angles(angles, before, SelfCalibrationSettings(accuracy=1e-4))
    (warning,) = result.warnings
    assert "not to the 0.1 mm wanted: more samples are needed. Of the workspace, samp" in warning


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: replace(TAPE, second="a"), "distance: got a to a; allowed: two different points"),
        (lambda: replace(TAPE, sigma=0.0), "sigma of the distance a to b: got 0 m"),
        (lambda: replace(TAPE, length=-1.0), "length of the distance a to b: got -1 m"),
    ],
)
def test_distances_that_mean_nothing_are_refused(make, message):
    with pytest.raises(InvalidField, match=message):
        make()


@pytest.mark.parametrize(
    ("second", "length", "allowed"),
    [
        ("b", 1e3 * SPAN, r"distance a to b: got 30\d\d\.\d+ m; allowed: 0 to 3\.\d+ m by the le"),
        ("home", 1597.0, r"distance a to home: got 1597 m; allowed: 1\.0\d to 2\.1\d? m by the"),
        ("home", 0.3, r"distance a to home: got 0\.3 m; allowed: "),
    ],
)
def test_a_distance_in_another_unit_is_refused(second, length, allowed):
    _, _, _, angles = scene(17, 10, known=())
    wrong = Distance(first="a", second=second, length=length, sigma=2.0)
    with pytest.raises(InvalidField, match=allowed):
        MotorAngleProblem(robots()[0], angles, SelfCalibrationSettings(distances=(wrong,)))


def test_headings_that_nothing_gives_are_refused_with_the_reason():
    before, _, place, angles = scene(9, 40, known=())
    above = SelfCalibrationSettings(x_through="d")
    with pytest.raises(InvalidField, match="that of d is nearly on the vertical through home"):
        calibrate_motor_angles(angles, before, above)
    known = np.zeros((40, 3), dtype=bool)
    known[:5, 2], known[3] = True, True
    there = np.where(known, place, 0.0)
    aside = replace(angles, is_known=known.any(axis=1), known_axes=known, known_position=there)
    with pytest.raises(InvalidField, match="the heading is not free about home"):
        calibrate_motor_angles(aside, before, SelfCalibrationSettings(x_through="b"))


@pytest.mark.parametrize("value", [0.0, np.inf, np.nan])
def test_standard_deviations_are_positive_and_finite(value):
    for name in ("exit_sigma", "drum_radius_sigma", "length_at_zero_sigma", "accuracy"):
        with pytest.raises(InvalidField, match=f"{name}: got .*; allowed: > 0, finite"):
            SelfCalibrationSettings(**{name: value})


def test_a_distance_to_nothing_is_refused():
    _, _, _, angles = scene(17, 10, known=())
    settings = SelfCalibrationSettings(distances=(replace(TAPE, second="z"),))
    with pytest.raises(InvalidField, match=r"end of a distance: got 'z'; allowed: one of"):
        calibrate_motor_angles(angles, robots()[0], settings)


def test_a_hundred_samples_take_seconds():
    before, _, _, angles = scene(18, 100, known=())
    began = time.process_time()
    calibrate_motor_angles(angles, before)
    assert time.process_time() - began < 10.0


def soft_scene(seed, *, stiffness=1.0, friction=0.0, count=50):
    """Lines held by 5 to 60 N, as in torque mode, of a stiffness that is not what was thought."""
    rng = np.random.default_rng(seed)
    before, truth = robots(rng)
    truth = replace(truth, axial_stiffness=stiffness * truth.axial_stiffness)
    place = scene(seed, count)[2]
    tension = rng.uniform(5.0, 60.0, (count, 4))
    noise = MeasurementNoise(line=2e-4, friction=friction)
    angles = measure_motor_angles(truth, place, np.arange(0), noise, rng, tension=tension)
    return before, truth, angles


def test_measured_tensions_take_the_stretch_out():
    before, truth, angles = soft_scene(1, stiffness=0.7)
    tape = SelfCalibrationSettings(distances=(replace(TAPE, sigma=1e-4),))
    result = calibrate_motor_angles(angles, before, tape)
    blind = calibrate_motor_angles(replace(angles, tension=None), before, tape)
    assert result.line_sigma < 0.5 * blind.line_sigma
    rows = [result.estimate.index(f"axial_stiffness[{cable}]") for cable in "abcd"]
    found = result.estimate.value[rows] / truth.axial_stiffness
    assert found == pytest.approx(1.0, abs=0.1)
    assert "stretch by the measured tensions" in " ".join(result.sentences())
    wanted = replace(tape, accuracy=1e-5)
    (warning,) = calibrate_motor_angles(angles, before, wanted).warnings
    assert "samples near (" in warning
    assert result.robot.axial_stiffness == pytest.approx(result.estimate.value[rows])


def test_friction_in_the_tensions_is_noise_that_is_known():
    squares = []
    for seed in range(300, 304):
        before, truth, angles = soft_scene(seed, friction=0.1)
        result = calibrate_motor_angles(angles, before, SelfCalibrationSettings(line_sigma=2e-4))
        squares.append(frame_nees(result, truth))
    low, high = chi2.ppf([0.005, 0.995], 9 * len(squares))
    assert low < sum(squares) < high


def rigid_scene(seed, count=60, line=1e-4):
    """Eight cables to a box that turns by some 15 degrees per axis."""
    rng = np.random.default_rng(seed)
    robot = eight_cable_robot()
    drums = {
        "drum_radius": np.full(8, 0.08), "drum_buildup": np.full(8, 1e-5),
        "drum_gear": np.full(8, 10.0), "drum_advantage": np.ones(8),
    }  # fmt: skip
    truth = replace(robot, **drums)
    guess = robot.exit_points + rng.normal(0.0, 0.1, (8, 3))
    before = loose(replace(truth, exit_points=guess), 0.1)
    place = rng.uniform(robot.workspace_min, robot.workspace_max, (count, 3))
    turns = rng.normal(0.0, 0.25, (count, 3))
    place[0], turns[0] = robot.home_position, 0.0
    rotation = from_rotation_vector(turns) @ robot.home_rotation
    noise = MeasurementNoise(line=line)
    angles = measure_motor_angles(truth, place, np.arange(0), noise, rng, rotation=rotation)
    return before, truth, place, rotation, angles


@pytest.mark.slow
def test_eight_cables_tell_the_rotations_of_a_platform_too():
    squares = []
    for seed in range(2):
        before, truth, place, rotation, angles = rigid_scene(seed)
        span = float(np.linalg.norm(truth.exit_points[0] - truth.exit_points[1]))
        tape = replace(TAPE, first="cable1", second="cable2", length=span, sigma=1e-4)
        settings = SelfCalibrationSettings(
            line_sigma=1e-4, length_at_zero_sigma=0.1, distances=(tape,)
        )
        result = calibrate_motor_angles(angles, before, settings)
        assert result.warnings == ()
        error = result.estimate.value[:24] - truth.exit_points.ravel()
        covariance = result.estimate.covariance[:24, :24]
        squares.append(float(error @ np.linalg.solve(covariance, error)))
        turned = np.linalg.norm(result.rotation - rotation, axis=(1, 2))
        assert turned.max() < 0.03
        assert np.abs((result.position - place)[1:] / result.position_sigma[1:]).max() < 5.0
        assert result.frame.free.shape[1] == 0  # home fixes the turns as well
    (warning,) = calibrate_motor_angles(angles, before, replace(settings, accuracy=1e-5)).warnings
    assert "samples near (" in warning
    low, high = chi2.ppf([0.005, 0.995], 24 * len(squares))
    assert low < sum(squares) < high


@pytest.mark.parametrize("known", [[5], [5, 9, 20], [0, 3, 7, 11, 20, 31]])
def test_known_positions_do_not_stop_a_platform_from_turning(known):
    before, truth, place, rotation, angles = rigid_scene(0)
    is_known = np.isin(np.arange(len(place)), known)
    there = np.where(is_known[:, None], place, 0.0)
    angles = replace(angles, is_known=is_known, known_position=there)
    span = float(np.linalg.norm(truth.exit_points[0] - truth.exit_points[1]))
    tape = replace(TAPE, first="cable1", second="cable2", length=span, sigma=1e-4)
    settings = SelfCalibrationSettings(length_at_zero_sigma=0.1, distances=(tape,))
    result = calibrate_motor_angles(angles, before, settings)
    assert result.warnings == ()
    assert result.frame.free.shape[1] == (3 if len(known) == 1 else 0)
    found = result.estimate.value[:24].reshape(-1, 3)
    middles = truth.exit_points.mean(axis=0), found.mean(axis=0)
    turn = turn_to(truth.exit_points - middles[0], found - middles[1])
    miss = (truth.exit_points - middles[0]) @ turn - (found - middles[1])
    assert np.linalg.norm(miss, axis=1).max() < 0.01
    if len(known) > 1:
        assert np.linalg.norm(found - truth.exit_points, axis=1).max() < 0.02
        assert np.linalg.norm(result.rotation - rotation, axis=(1, 2)).max() < 0.03


@pytest.mark.parametrize("known", [(), (0, 1, 2, 3, 4, 5)])
def test_a_platform_that_turns_is_refused_with_what_helps(known):
    before, _, _, angles = scene(19, 40, known=known)
    apart = np.array([[0.1, 0.0, 0.0], [0.0, 0.1, 0.0], [-0.1, 0.0, 0.0], [0.0, 0.0, 0.1]])
    wide = replace(before, anchor_points=apart)
    with pytest.raises(
        Unobservable, match="4 cables have nothing to spare for its rotation"
    ) as one:
        calibrate_motor_angles(angles, wide)
    assert "AHRS, swivel angles or load cells" in str(one.value)
    assert "known position" not in str(one.value)
    if not known:
        held = SelfCalibrationSettings(keeps_rotation=True)
        assert calibrate_motor_angles(angles, wide, held).frame.free.shape[1] == 3


def test_a_drum_without_a_radius_is_refused():
    before, _, _, angles = scene(19, 40)
    problem = MotorAngleProblem(before, angles, SelfCalibrationSettings())
    shared = problem.prior.mean.copy()
    shared[problem.buildups] = -1e-2
    with pytest.raises(Unobservable, match=r"drum of d comes out impossible: .* -0\.01 m"):
        problem.drum_radius(shared)


def test_a_cable_that_is_mostly_slack_is_named():
    case = draw_unknown_robot(np.random.default_rng([77, 1]), cables=5)
    assert calibrate_motor_angles(case.angles, case.before, case.settings).warnings == ()
    angle = case.angles.motor_angle.copy()
    slack = np.random.default_rng(1).uniform(0.003, 0.03, len(angle) - 1) * case.size / 3.0
    angle[1:, 4] += slack / 0.05 * case.before.drum_gear[4]
    result = calibrate_motor_angles(
        replace(case.angles, motor_angle=angle), case.before, case.settings
    )
    assert any("without cable e the line fits to 0." in line for line in result.warnings)


@pytest.mark.parametrize(("spread", "teaches"), [(1.0, True), (0.0, False)])
def test_samples_that_teach_nothing_about_known_exit_points_are_a_warning(spread, teaches):
    _, truth, place, _ = scene(50, 40, known=())
    rng = np.random.default_rng(0)
    angles = measure_motor_angles(
        truth, spread * place, np.arange(0), MeasurementNoise(line=1e-3), rng
    )
    guess = truth.exit_points + rng.normal(0.0, 0.05, (4, 3))
    robot = loose(replace(truth, exit_points=guess), 0.05)
    settings = SelfCalibrationSettings(length_at_zero_sigma=0.05)
    warnings = calibrate_motor_angles(angles, robot, settings).warnings
    assert teaches == (warnings == ())
    assert teaches or warnings[0].startswith("the samples teach hardly anything about the exit p")


def test_exit_points_that_stay_loose_are_warned_of_where_no_accuracy_is_stated():
    case = draw_unknown_robot(np.random.default_rng([31, 1, 24]), cables=8, sampling="home")
    (line,) = calibrate_motor_angles(
        case.angles, case.before, replace(case.settings, accuracy=None)
    ).warnings
    assert "wanted, 1% of the longest cable unless stated" in line


@pytest.mark.parametrize(("cost", "adopted"), [(-5.0, True), (-0.5, False), (5.0, False)])
def test_another_solution_that_fits_better_is_adopted(cost, adopted):
    before, _, _, angles = scene(6, 40, known=())
    settings = SelfCalibrationSettings()
    problem = MotorAngleProblem(before, angles, settings)
    settled = settle(problem, starts(problem)[0], settings)
    rival = Rival(cost=cost, distance=1.0, mirrored=False, outside=0.0, fit=settled.fit)
    assert (better_rival(problem, settled, [rival]) is rival) == adopted
    noisier = replace(settled, trust=replace(settled.trust, line_sigma=2e-3))
    assert fits_better(settled, noisier) and not fits_better(noisier, settled)


def test_a_rival_says_whether_it_fits_better_or_worse():
    before, _, _, angles = scene(6, 40, known=())
    rival = calibrate_motor_angles(angles, before).rivals[0]
    assert "almost as well (2.0 squared standard deviations worse)" in rival_warning(
        replace(rival, cost=2.0)
    )
    assert "as well (0.5 squared standard deviations better)" in rival_warning(
        replace(rival, cost=-0.5)
    )
