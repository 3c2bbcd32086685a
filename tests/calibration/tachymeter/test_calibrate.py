from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from calibration.observability import Unobservable
from calibration.tachymeter.calibrate import _pulleys, calibrate_tachymeter
from calibration.tachymeter.observations import READING_NAMES, Instrument, ReferencePoint, Sighting
from calibration.tachymeter.sightings import elevation
from carosac_toolkit.base.errors import InvalidField
from tests.calibration.tachymeter.scenes import EXACT, ROBOT, drawn, pulley_robot


def error(scene, result):
    """Distance of every exit point from the truth [m], (c,)."""
    return np.linalg.norm(result.exit_points - scene.truth.exit_points, axis=1)


def test_exact_readings_give_exact_exit_points_setups_and_no_residuals():
    scene = drawn(1, instrument=EXACT, reference_sigma=1e-9, ties=2)
    result = calibrate_tachymeter(ROBOT, scene.survey)
    assert error(scene, result).max() < 1e-6
    for name, station in result.stations.items():
        assert station.values[:3] == pytest.approx(scene.stations[name][:3], abs=1e-6)
        turn = station.values[3] - scene.stations[name][3]
        assert np.sin(turn) == pytest.approx(0.0, abs=1e-7)
    assert not result.blunders


@pytest.mark.parametrize(
    "sighting", [Sighting("axle"), Sighting("rim", rim_angle=2.0), Sighting("tangent")]
)
def test_exact_readings_of_pulleys_give_the_datum(sighting):
    robot = pulley_robot()
    scene = drawn(
        2, robot, instrument=EXACT, reference_sigma=1e-9, sighting=sighting, swivel_sigma=1e-6
    )
    result = calibrate_tachymeter(robot, scene.survey)
    assert error(scene, result).max() < 1e-5
    plain = replace(
        scene.survey, shots=tuple(replace(s, sighting=Sighting()) for s in scene.survey.shots)
    )
    assert error(scene, calibrate_tachymeter(robot, plain)).max() > 0.02  # the offset matters


def test_the_side_of_an_axle_is_that_of_each_setup():
    robot = pulley_robot()
    scene = drawn(
        3, robot, instrument=EXACT, reference_sigma=1e-9, swivel_sigma=1e-6,
        sighting=Sighting("axle", side=0.04),
    )  # fmt: skip
    pulleys = _pulleys(robot, scene.survey)
    signs = {
        np.sign(elevation(scene.truth.exit_points[i], pulleys[name], station[:3]))
        for i, name in enumerate(robot.cable_names)
        for station in scene.stations.values()
    }
    assert signs == {-1.0, 1.0}
    assert error(scene, calibrate_tachymeter(robot, scene.survey)).max() < 1e-5


def test_a_pulley_seen_edge_on_has_no_side():
    robot = pulley_robot()
    scene = drawn(5, robot, sighting=Sighting("axle", side=0.04), swivel_sigma=0.5)
    with pytest.raises(InvalidField, match="edge-on"):
        calibrate_tachymeter(robot, scene.survey)


def test_unsure_pulleys_make_exit_points_less_sure():
    robot = pulley_robot()
    sigma = [
        calibrate_tachymeter(robot, drawn(4, robot, swivel_sigma=s).survey).exit_sigma.max()
        for s in (1e-3, 0.05)
    ]
    assert sigma[0] < 0.6e-3
    assert sigma[1] > 0.03 * 0.05


def test_a_tilted_reference_frame_is_found():
    scene = drawn(6)
    tilt = np.array([0.004, -0.003, 0.0])
    from scipy.spatial.transform import Rotation

    turn = Rotation.from_rotvec(tilt)
    references = {
        name: ReferencePoint(name, turn.as_matrix().T @ ref.position, ref.sigma)
        for name, ref in scene.survey.references.items()
    }
    survey = replace(scene.survey, references=references)
    level = calibrate_tachymeter(ROBOT, survey)
    assert not level.fits or level.blunders
    result = calibrate_tachymeter(ROBOT, survey, frame_tilt=0.01)
    assert result.fits and not result.blunders
    found = result.estimate.select(["pose_tilt.x", "pose_tilt.y"])
    assert (np.abs(found.value - tilt[:2]) < 4 * found.sigma).all()
    assert error(scene, result).max() < 3e-3


def test_a_prior_of_the_exit_points_is_used_where_asked():
    scene = drawn(7)
    known = replace(ROBOT, exit_covariance=np.tile(1e-8 * np.eye(3), (4, 1, 1)),
                    exit_points=scene.truth.exit_points)  # fmt: skip
    free, held = (
        calibrate_tachymeter(known, scene.survey),
        calibrate_tachymeter(known, scene.survey, use_prior=True),
    )
    assert error(scene, held).max() < 0.2e-3 < error(scene, free).max()
    assert held.estimate.prior_sigma == pytest.approx(1e-4)
    assert np.isinf(free.estimate.prior_sigma).all()
    with pytest.raises(InvalidField, match="sigma or covariance"):
        calibrate_tachymeter(ROBOT, scene.survey, use_prior=True)


def test_the_survey_alone_is_judged_whatever_was_known_before():
    scene = drawn(7)
    block = 1e-6 * np.eye(3) + 25e-6 * np.ones((3, 3))  # the axes were known together, not apart
    known = replace(ROBOT, exit_covariance=np.tile(block, (4, 1, 1)),
                    exit_points=scene.truth.exit_points)  # fmt: skip
    free, held = (
        calibrate_tachymeter(known, scene.survey),
        calibrate_tachymeter(known, scene.survey, use_prior=True),
    )
    assert held.observability.rank == 12
    assert held.observability.condition == pytest.approx(free.observability.condition, rel=1e-3)


def test_covariances_are_those_of_the_errors_reference_errors_included():
    nees, count = 0.0, 40
    for seed in range(count):
        scene = drawn(100 + seed, faces=1)
        result = calibrate_tachymeter(ROBOT, scene.survey)
        off = (result.exit_points - scene.truth.exit_points).ravel()
        nees += off @ np.linalg.solve(result.exit_covariance, off)
    low, high = chi2.interval(0.999, 12 * count)
    assert low < nees < high


@pytest.mark.parametrize("column, size", [(0, 0.02), (1, -0.02), (2, 0.5)])
def test_a_blunder_is_named_with_its_size_and_does_no_harm(column, size):
    scene = drawn(8)
    shots = list(scene.survey.shots)
    name = ("hz", "v", "distance")[column]
    shots[25] = replace(shots[25], **{name: getattr(shots[25], name) + size})
    result = calibrate_tachymeter(ROBOT, replace(scene.survey, shots=tuple(shots)))
    (blunder,) = result.blunders
    assert (blunder.shot, blunder.reading, blunder.setup) == (26, READING_NAMES[column], "B")
    assert blunder.target == shots[25].target
    assert blunder.error == pytest.approx(size, rel=0.02)
    assert blunder.sigmas > 10
    assert error(scene, result).max() < 2e-3


def test_a_wrong_reference_coordinate_is_named():
    scene = drawn(9)
    wrong = scene.survey.references["R2"]
    references = {
        **scene.survey.references,
        "R2": ReferencePoint("R2", wrong.position + np.array([0, 0.1, 0]), wrong.sigma),
    }
    result = calibrate_tachymeter(ROBOT, replace(scene.survey, references=references))
    (blunder,) = result.blunders
    assert (blunder.shot, blunder.target, blunder.reading) == (None, "R2", "known y")
    assert blunder.error == pytest.approx(0.1, abs=5e-3)
    assert "known y of reference R2" in blunder.sentence()


def test_two_sets_with_a_twentieth_of_blunders_stay_under_two_millimetres():
    for seed in range(6):
        scene = drawn(20 + seed, blunders=0.05)
        result = calibrate_tachymeter(ROBOT, scene.survey)
        named = {(b.shot, b.reading) for b in result.blunders}
        assert {(i + 1, READING_NAMES[column]) for i, column, _ in scene.wrong} <= named
        assert error(scene, result).max() < 2.5e-3


def test_shots_that_nothing_checks_are_named():
    scene = drawn(10, faces=1)
    one = [s for s in scene.survey.shots if not (s.setup == "B" and s.target == "rear_left")]
    result = calibrate_tachymeter(ROBOT, replace(scene.survey, shots=tuple(one)))
    assert len(result.unchecked) == 1
    assert result.unchecked[0].startswith("rear_left")


def test_noise_beyond_the_stated_accuracy_does_not_fit():
    scene = drawn(11, instrument=Instrument(angle=3e-4, distance=5e-3, pointing=2e-3))
    result = calibrate_tachymeter(ROBOT, replace(scene.survey, instrument=Instrument()))
    assert not result.fits
    assert calibrate_tachymeter(ROBOT, scene.survey).fits


def test_a_setup_without_known_points_is_placed_through_common_ones():
    scene = drawn(12, ties=2)
    shots = [s for s in scene.survey.shots if not (s.setup == "B" and s.target.startswith("R"))]
    result = calibrate_tachymeter(ROBOT, replace(scene.survey, shots=tuple(shots)))
    assert error(scene, result).max() < 4e-3


def test_cables_that_nobody_sighted_are_left_alone():
    scene = drawn(13)
    shots = [s for s in scene.survey.shots if s.target != "rear_left"]
    result = calibrate_tachymeter(ROBOT, replace(scene.survey, shots=tuple(shots)))
    assert result.unmeasured == ("rear_left",)
    assert result.exit_points.shape == (3, 3)


def test_a_survey_without_known_points_says_what_is_missing():
    scene = drawn(14)
    ties = {name: ReferencePoint(name) for name in scene.survey.references}
    with pytest.raises(Unobservable, match="no sighted point has known coordinates"):
        calibrate_tachymeter(ROBOT, replace(scene.survey, references=ties))


def test_one_known_point_gives_no_heading():
    scene = drawn(14)
    refs = dict(scene.survey.references)
    refs |= {name: ReferencePoint(name) for name in refs if name != "R1"}
    with pytest.raises(Unobservable, match=r"only R1 has known .* heading"):
        calibrate_tachymeter(ROBOT, replace(scene.survey, references=refs))


def test_known_points_above_each_other_give_no_heading():
    scene = drawn(14, references=2)
    refs = dict(scene.survey.references)
    first = refs["R1"].position
    refs["R2"] = ReferencePoint("R2", first + np.array([0.01, 0.0, 2.0]), refs["R2"].sigma)
    with pytest.raises(Unobservable, match="one vertical line"):
        calibrate_tachymeter(ROBOT, replace(scene.survey, references=refs))


def test_known_points_in_one_level_line_are_enough_for_levelled_instruments():
    scene = drawn(15, references=3)
    refs = scene.survey.references
    shots = [s for s in scene.survey.shots if s.target != "R3"]
    result = calibrate_tachymeter(ROBOT, replace(scene.survey, shots=tuple(shots), references=refs))
    assert error(scene, result).max() < 5e-3


def test_a_setup_that_nothing_ties_is_refused_by_name():
    scene = drawn(16)
    shots = [s for s in scene.survey.shots if s.setup == "A" or s.target == "R1"]
    with pytest.raises(Unobservable, match="set-up B shares only R1"):
        calibrate_tachymeter(ROBOT, replace(scene.survey, shots=tuple(shots)))


def test_targets_and_sightings_must_fit_the_robot():
    scene = drawn(17)
    shots = scene.survey.shots

    def refused(match, **changes):
        spoilt = (replace(shots[0], **changes), *shots[1:])
        with pytest.raises(InvalidField, match=match):
            calibrate_tachymeter(ROBOT, replace(scene.survey, shots=spoilt))

    refused("a cable .* or a reference point", target="Q9")
    refused("has no pulley in the robot file", sighting=Sighting("axle"))
    refused("only a cable has a pulley", target="R1", sighting=Sighting("axle"))
    robot = pulley_robot()
    survey = replace(drawn(17, robot).survey, towards={})
    with pytest.raises(InvalidField, match="platform_position"):
        calibrate_tachymeter(robot, survey)


def test_swapped_targets_are_named():
    scene = drawn(0)
    names = list(ROBOT.cable_names)
    names[0], names[1] = names[1], names[0]
    result = calibrate_tachymeter(replace(ROBOT, cable_names=tuple(names)), scene.survey)
    first, second = result.misplaced()
    assert first.startswith(f"{names[0]} is ") and f"the file has {names[1]}" in first
    assert second.startswith(f"{names[1]} is ") and f"the file has {names[0]}" in second
    assert calibrate_tachymeter(ROBOT, scene.survey).misplaced() == []


def test_more_set_ups_make_exit_points_surer():
    sigma = [
        calibrate_tachymeter(ROBOT, drawn(18, setups=count).survey).exit_sigma.mean()
        for count in (1, 2, 4)
    ]
    assert (np.diff(sigma) < 0.0).all()
