from __future__ import annotations

import gtsam
import numpy as np
import pytest

from calibration.tachymeter.calibrate import _pulleys, _start
from calibration.tachymeter.model import predict
from calibration.tachymeter.network import Network, tilted
from calibration.tachymeter.observations import (
    ARCSEC_RAD,
    Instrument,
    Sighting,
    cartesian,
    face_one,
    polar,
)
from calibration.tachymeter.sightings import elevation, sighted_point
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.physics.cable.straight_line import straight_length
from tests.calibration.tachymeter.scenes import (
    EXIT,
    PULLEY,
    RADIUS,
    drawn,
    finite_difference,
    pulley_robot,
)

STATION = np.array([0.3, -1.2, 1.6, 2.1, 3e-3, -2e-3])
POINTS = np.array([[2.0, 3.0, 5.0], [-1.0, -4.0, 0.2], [0.35, -1.15, 8.0]])


def test_hz_is_clockwise_from_y_and_v_from_the_zenith():
    level = np.zeros(6)
    points = np.array([[0.0, 2.0, 0.0], [3.0, 0.0, 0.0], [0.0, 0.0, 5.0], [-1.0, -1.0, 0.0]])
    reading = predict(level, points).reading
    half = np.pi / 2
    assert reading[0] == pytest.approx([0.0, half, 2.0])
    assert reading[1] == pytest.approx([half, half, 3.0])
    assert reading[2, 1:] == pytest.approx([0.0, 5.0])
    assert reading[3] == pytest.approx([np.pi * 1.25, half, np.sqrt(2.0)])


def test_turning_a_setup_counter_clockwise_makes_directions_larger():
    turned = np.array([0.0, 0.0, 0.0, 0.1, 0.0, 0.0])
    assert predict(turned, np.array([[0.0, 2.0, 0.0]])).reading[0, 0] == pytest.approx(0.1)


def test_derivatives_by_setup_are_finite_differences_near_the_zenith_too():
    found = predict(STATION, POINTS).by_station
    numeric = finite_difference(lambda s: predict(s, POINTS).reading, STATION)
    assert found == pytest.approx(numeric, rel=1e-6, abs=1e-7)


def test_derivatives_by_point_are_finite_differences():
    found = predict(STATION, POINTS).by_point
    for i, point in enumerate(POINTS):
        numeric = finite_difference(lambda p: predict(STATION, p[None]).reading[0], point)
        assert found[i] == pytest.approx(numeric, rel=1e-6, abs=1e-7)


def test_polar_and_cartesian_undo_each_other():
    assert cartesian(polar(POINTS)) == pytest.approx(POINTS)


def test_face_two_is_the_same_sight():
    assert face_one(0.4 + np.pi, 2 * np.pi - 1.1) == pytest.approx((0.4, 1.1))
    assert face_one(0.4, 1.1) == (0.4, 1.1)


def test_noise_of_hz_grows_as_one_over_sin_v_and_of_distances_with_distance():
    instrument = Instrument(angle=3 * ARCSEC_RAD, distance=1e-3, distance_ppm=100.0, pointing=0.0)
    sigma = instrument.sigma(np.array([[0.0, np.pi / 2, 10.0], [0.0, np.pi / 6, 10.0]]))
    assert sigma[0] == pytest.approx([3 * ARCSEC_RAD, 3 * ARCSEC_RAD, np.hypot(1e-3, 1e-3)])
    assert sigma[1, 0] == pytest.approx(2 * sigma[0, 0])
    assert sigma[1, 1] == sigma[0, 1]


def test_pointing_noise_counts_more_at_short_range():
    instrument = Instrument(angle=1e-9, pointing=1e-3)
    sigma = instrument.sigma(np.array([[0.0, np.pi / 2, 2.0], [0.0, np.pi / 2, 20.0]]))
    assert sigma[:, 0] == pytest.approx([0.5e-3, 0.05e-3])


SIGHTINGS = [
    Sighting("axle"),
    Sighting("axle", side=0.03),
    Sighting("rim", rim_angle=1.9, rim_radius=0.07, side=0.02),
    Sighting("tangent", side=-0.01),
]


@pytest.mark.parametrize("sighting", SIGHTINGS)
def test_derivatives_of_sighted_points_are_finite_differences(sighting):
    found = sighted_point(EXIT, sighting, PULLEY, 0.05, -1.0)
    by_exit = finite_difference(
        lambda e: sighted_point(e, sighting, PULLEY, 0.05, -1.0).point, EXIT
    )
    by_swivel = finite_difference(
        lambda a: sighted_point(EXIT, sighting, PULLEY, a[0], -1.0).point, np.array([0.05])
    )
    # the tangent point moves with the cable's fall seen in the plane without the small turn
    assert found.by_exit == pytest.approx(by_exit, abs=1e-8)
    assert found.by_swivel == pytest.approx(by_swivel[:, 0], abs=1e-8)


def test_axle_is_a_radius_from_the_datum_at_right_angles_to_the_swivel_axis():
    offset = sighted_point(EXIT, Sighting("axle"), PULLEY, 0.0, 1.0).point - EXIT
    assert np.linalg.norm(offset) == pytest.approx(RADIUS)
    assert offset @ PULLEY.axis == pytest.approx(0.0, abs=1e-12)
    assert offset @ (PULLEY.towards - EXIT) > 0.0


def test_rim_at_zero_angle_is_the_exit_point_and_at_half_a_turn_two_radii_away():
    at = sighted_point(EXIT, Sighting("rim", rim_angle=0.0), PULLEY, 0.3, 1.0).point
    far = sighted_point(EXIT, Sighting("rim", rim_angle=np.pi), PULLEY, 0.3, 1.0).point
    assert at == pytest.approx(EXIT)
    assert np.linalg.norm(far - EXIT) == pytest.approx(2 * RADIUS)


def test_tangent_point_is_where_the_statics_see_the_cable_leave_the_pulley():
    robot = pulley_robot()
    position = np.array([[0.6, -2.0, 2.5]])
    cables = straight_length(robot, position)
    for i, name in enumerate(robot.cable_names):
        pulley = _pulley(robot, i, position[0] + robot.anchor_points[i])
        tangent = sighted_point(robot.exit_points[i], Sighting("tangent"), pulley, 0.0, 1.0).point
        axle = sighted_point(robot.exit_points[i], Sighting("axle"), pulley, 0.0, 1.0).point
        free = pulley.towards - tangent
        assert np.linalg.norm(tangent - axle) == pytest.approx(RADIUS), name
        assert free / np.linalg.norm(free) == pytest.approx(cables.direction[0, i]), name
        arc = RADIUS * cables.wrap[0, i]
        assert np.linalg.norm(free) + arc == pytest.approx(cables.length[0, i]), name


def _pulley(robot, i, towards):
    from calibration.tachymeter.sightings import SightedPulley

    return SightedPulley(
        cable=robot.cable_names[i], radius=RADIUS, axis=robot.swivel_axis[i], towards=towards
    )


def test_side_is_towards_the_instrument():
    station = np.array([1.0, 0.0, 1.5])
    side = float(np.sign(elevation(EXIT, PULLEY, station)))
    middle = sighted_point(EXIT, Sighting("axle"), PULLEY, 0.0, side).point
    face = sighted_point(EXIT, Sighting("axle", side=0.03), PULLEY, 0.0, side).point
    assert np.linalg.norm(face - middle) == pytest.approx(0.03)
    assert np.linalg.norm(station - face) < np.linalg.norm(station - middle)


def test_a_cable_along_the_swivel_axis_tells_no_direction():
    above = PULLEY.towards + 0.0
    pulley = type(PULLEY)(cable="c", radius=RADIUS, axis=np.array([0, 0, 1.0]), towards=above)
    with pytest.raises(InvalidField, match="off the swivel axis"):
        sighted_point(above + np.array([0, 0, 3.0]), Sighting("axle"), pulley, 0.0, 1.0)


def test_tilted_points_turn_rigidly_with_the_right_derivative():
    point, tilt = np.array([1.0, 2.0, 3.0]), np.array([0.02, -0.05])
    turned, slope = tilted(point, tilt)
    assert np.linalg.norm(turned) == pytest.approx(np.linalg.norm(point))
    assert slope == pytest.approx(finite_difference(lambda t: tilted(point, t)[0], tilt), abs=1e-8)


def test_jacobian_of_the_whole_network_is_its_finite_difference():
    robot = pulley_robot()
    scene = drawn(3, robot, sighting=Sighting("tangent"), faces=1, ties=1)
    survey = scene.survey
    pulleys = _pulleys(robot, survey)
    network = Network(
        survey=survey, sides=(1.0,) * len(survey.shots), pulleys=pulleys, frame_tilt=0.01,
        exit_prior={"front_left": (EXIT, 1e-4 * np.diag([1.0, 2.0, 3.0]))},
    )  # fmt: skip
    places = dict(zip(robot.cable_names, scene.truth.exit_points, strict=True))
    rng = np.random.default_rng(0)
    for name, reference in survey.references.items():
        places[name] = rng.normal(0, 3, 3) if reference.position is None else reference.position
    values = _start(network, scene.stations, places)
    jacobian, residual = network.dense(values)
    assert len(residual) == len(network.sigma) + network.prior_rows
    for name, key in network.keys.items():
        columns = network.columns[name]
        for k in range(columns.stop - columns.start):
            step = 1e-6
            sides = []
            for sign in (1.0, -1.0):
                moved = gtsam.Values(values)
                vector = np.array(values.atVector(key))
                vector[k] += sign * step
                moved.update(key, vector)
                sides.append(network.dense(moved)[1])
            numeric = (sides[0] - sides[1]) / (2 * step)
            scale = np.abs(numeric).max()
            assert jacobian[:, columns.start + k] == pytest.approx(numeric, abs=2e-6 * scale), name


@pytest.mark.parametrize(
    "arguments",
    [
        {"kind": "hub"},
        {"kind": "rim"},
        {"kind": "axle", "rim_angle": 1.0},
        {"kind": "axle", "rim_radius": 1.0},
        {"kind": "centre", "side": 0.01},
    ],
)
def test_sightings_that_mean_nothing_are_refused(arguments):
    with pytest.raises(InvalidField):
        Sighting(**arguments)


def test_accuracies_that_are_none_are_refused():
    with pytest.raises(InvalidField, match=r"instrument\.angle: got 0"):
        Instrument(angle=0.0)
    with pytest.raises(InvalidField, match=r"instrument\.pointing"):
        Instrument(pointing=-1.0)
