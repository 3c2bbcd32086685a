from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from geocompy.gsi.gsiformat import GsiUnit

from calibration.tachymeter.csv_file import read_csv
from calibration.tachymeter.gsi import read_gsi
from calibration.tachymeter.observations import Instrument, ReferencePoint, Sighting
from calibration.tachymeter.survey_files import read_survey
from calibration.tachymeter.synthetic import write_gsi, write_survey_csv, write_targets
from calibration.tachymeter.targets import read_targets
from carosac_toolkit.base.errors import InvalidFile, MissingFile
from tests.calibration.tachymeter.scenes import ROBOT, drawn, pulley_robot, write

# Words of 8 and of 16 digits, written by hand: point 101, Hz 123.45678 gon, V 98.76543 gon,
# slope distance 12.345 m (mm) and 12.3456 m (1/10 mm), prism constant 34 mm.
GSI8 = "110001+00000101 21.322+12345678 22.322+09876543 31..00+00012345 51....+0000+034 "
GSI16 = (
    "*110001+0000000000000101 21.322+0000000012345678 22.322+0000000009876543 "
    "31..06+0000000000123456 51....+000000000000+034 "
)
HZ, V = 123.45678 * np.pi / 200, 98.76543 * np.pi / 200


def gsi(folder, *lines, name="job.gsi"):
    return write(folder, name, "\r\n".join(lines) + "\r\n")


@pytest.mark.parametrize("line, distance", [(GSI8, 12.345), (GSI16, 12.3456)])
def test_gsi_words_have_the_values_computed_by_hand(tmp_path, line, distance):
    (record,) = read_gsi(gsi(tmp_path, line))
    assert (record.setup, record.point, record.line) == ("job", "101", 1)
    assert (record.hz, record.v) == pytest.approx((HZ, V), rel=1e-12)
    assert record.distance == pytest.approx(distance)
    assert record.prism_set == pytest.approx(0.034)


@pytest.mark.parametrize(
    "hz, v, angle, zenith",
    [
        ("21.323+12345678", "22.323+09876543", np.deg2rad(123.45678), np.deg2rad(98.76543)),
        (
            "21.324+12327244",  # 123 deg 27' 24.4"
            "22.324+09845556",  # 98 deg 45' 55.6"
            np.deg2rad(123 + 27 / 60 + 24.4 / 3600),
            np.deg2rad(98 + 45 / 60 + 55.6 / 3600),
        ),
        ("21.325+12345678", "22.325+15876543", 1234.5678 * np.pi / 3200, 1587.6543 * np.pi / 3200),
        ("21.322-10000000", "22.322+10000000", 1.5 * np.pi, np.pi / 2),  # -100 gon is 300 gon
    ],
)
def test_units_and_signs_of_angles(tmp_path, hz, v, angle, zenith):
    (record,) = read_gsi(gsi(tmp_path, f"110001+00000P-1 {hz} {v} 31..00+00012345"))
    assert (record.hz, record.v) == pytest.approx((angle, zenith), rel=1e-9)
    assert record.point == "P-1"


@pytest.mark.parametrize(
    "word, distance",
    [
        ("31..00+00012345", 12.345),
        ("31..06+00123456", 12.3456),
        ("31..08+01234567", 12.34567),
        ("31..01+00012345", 12.345 * 0.3048),
        ("31..07+00123456", 12.3456 * 0.3048),
    ],
)
def test_units_of_lengths(tmp_path, word, distance):
    (record,) = read_gsi(gsi(tmp_path, f"110001+00000101 21.322+12345678 22.322+09876543 {word}"))
    assert record.distance == pytest.approx(distance, rel=1e-12)


def test_face_two_is_brought_to_face_one(tmp_path):
    # Hz + 200 gon, 400 gon - V
    line = "110002+00000101 21.322+32345678 22.322+30123457 31..00+00012345 "
    (record,) = read_gsi(gsi(tmp_path, line))
    assert (record.hz, record.v) == pytest.approx((HZ, V), rel=1e-9)


def test_coordinates_are_taken_against_the_station_with_target_height(tmp_path):
    station = "110001+00000S01 84..00+00100000 85..00-00050000 86..00+00010000 88..00+00001600 "
    line = "110002+00000101 81..00+00103000 82..00-00046000 83..00+00015000 87..00+00000200 "
    (record,) = read_gsi(gsi(tmp_path, station, line))
    assert record.setup == "job:S01"
    assert record.hz == pytest.approx(np.arctan2(3.0, 4.0))  # east over north
    assert record.distance == pytest.approx(np.sqrt(9 + 16 + 5.2**2))
    assert record.v == pytest.approx(np.arctan2(5.0, 5.2))


def test_a_new_station_in_one_file_is_a_new_setup(tmp_path):
    second = "110003+00000S02 84..00+00100000 85..00-00050000 86..00+00010000 "
    records = read_gsi(gsi(tmp_path, GSI8, second, GSI8, "41....+00000001 42....+00000002 "))
    assert [record.setup for record in records] == ["job", "job:S02"]


@pytest.mark.parametrize("long", [False, True])
@pytest.mark.parametrize("unit", [GsiUnit.GON, GsiUnit.DEG, GsiUnit.DMS, GsiUnit.MIL])
def test_files_that_the_writer_makes_come_back(tmp_path, long, unit):
    scene = drawn(1)
    short = {name: f"P{i}" for i, name in enumerate(ROBOT.cable_names)}
    shots = [replace(s, target=short.get(s.target, s.target)) for s in scene.survey.shots]
    survey = replace(scene.survey, shots=tuple(shots))
    records = [
        r for path in write_gsi(tmp_path, survey, long=long, unit=unit) for r in read_gsi(str(path))
    ]
    found = np.array([[r.hz, r.v, r.distance] for r in records])
    off = found - survey.reading
    off[:, 0] = (off[:, 0] + np.pi) % (2 * np.pi) - np.pi
    assert np.abs(off[:, :2]).max() < 3e-7  # half a digit: 0.05", and 1e-4 mil at most
    assert np.abs(off[:, 2]).max() < 5.1e-5
    assert [r.point for r in records] == [s.target for s in shots]


ANGLES = "21.322+12345678 22.322+09876543"


@pytest.mark.parametrize(
    "lines, match",
    [
        ([GSI8, GSI8[:-9]], r"line 2: cut off or damaged: 7 characters after word 4"),
        ([GSI8, GSI8[:47]], r"line 2: no word 31 \(slope distance\): cut off"),
        ([GSI16[:80]], "line 1: cut off or damaged: .* GSI-16 has words of 23"),
        ([GSI8, GSI8.replace("322+", "324+")], "minutes or seconds over 59"),
        ([GSI8, GSI8.replace("322+", "323+")], "Hz.* in decimal degrees, but line 1 .* gon: mixed"),
        ([GSI8, GSI8.replace("31..00", "31..01")], "slope distance.* in ft, but line 1 .* in m"),
        ([GSI8.replace("31..00", "31..02")], "word 31 .* unit digit '2'; allowed: 0, 6, 8 m"),
        ([GSI8.replace("21.322", "21.32.")], "word 21 .* unit digit"),
        ([GSI8.replace("00012345 51", "00000000 51")], "slope distance .* none was measured"),
        ([GSI8.replace("12345678", "1234567x")], "word 21 .* cannot be read"),
        ([GSI8.replace("21.322", "21X322")], "'21X322.12345678' is no GSI-8 word"),
        ([GSI8.replace("21.322", "3a.322")], "'3a.322.12345678' is no GSI-8 word"),
        ([GSI8.replace("21.322", "²1.322")], "is no GSI-8 word"),
        ([GSI8.replace("322+12345678", "324+12345x78")], "minutes or seconds"),
        (["hello world"], "line 1: cut off or damaged"),
        ([GSI8.replace("110001", "210001")], "a GSI block starts with word 11 or 41"),
        ([f"110001+00000101 {ANGLES} {ANGLES} 31..00+00012345 "], "twice in one block"),
        (["110001+00000101 81..00+00103000 82..00-00046000 83..00+00015000 "], "84 to 86"),
        (["110001+00000101 81..00+00103000 82..00-00046000 "], r"no word 83 \(height\)"),
        (["41....+00000001 "], "no observations"),
    ],
)  # fmt: skip
def test_damaged_gsi_is_refused_with_line_and_reason(tmp_path, lines, match):
    with pytest.raises(InvalidFile, match=match):
        read_gsi(gsi(tmp_path, *lines))


def test_all_faults_come_at_once_and_long_lists_are_cut(tmp_path):
    with pytest.raises(InvalidFile) as caught:
        read_gsi(gsi(tmp_path, *[GSI8[:47]] * 30))
    assert len(caught.value.faults) == 13 and caught.value.faults[-1] == "and 18 more"


def test_missing_empty_and_binary_files_are_refused(tmp_path):
    with pytest.raises(MissingFile):
        read_gsi(str(tmp_path / "none.gsi"))
    with pytest.raises(InvalidFile, match="empty"):
        read_gsi(write(tmp_path, "empty.gsi", "\n"))
    (tmp_path / "binary.gsi").write_bytes(b"\xff\xfe\x00\x80")
    with pytest.raises(InvalidFile, match="not a text file"):
        read_gsi(str(tmp_path / "binary.gsi"))


HEADER = "setup,target,hz_gon,v_gon,slope_m"


def test_csv_has_units_in_its_columns(tmp_path):
    header = "setup,target,hz_deg,v_deg,slope_mm,prism_constant_mm"
    text = f"# made by hand\n{header}\nA,101,90,60,5000,-17.5\n"
    (record,) = read_csv(write(tmp_path, "a.csv", text))
    assert (record.hz, record.v, record.distance) == pytest.approx((np.pi / 2, np.pi / 3, 5.0))
    assert record.prism_constant == pytest.approx(-0.0175)
    assert (record.setup, record.point, record.line) == ("A", "101", 3)


def test_csv_may_hold_coordinates_of_the_setups_frame(tmp_path):
    (record,) = read_csv(write(tmp_path, "a.csv", "setup,target,x_m,y_m,z_m\nA,P,3,4,0\n"))
    assert (record.hz, record.v) == pytest.approx((np.arctan2(3, 4), np.pi / 2))
    assert record.distance == pytest.approx(5.0)


@pytest.mark.parametrize(
    "text, match",
    [
        ("setup,target,hz_gon,v_deg,slope_m\n", "line 1: mixed units: hz_gon, v_deg"),
        ("setup,target,hz_gon,hz_deg,v_gon,slope_m\n", "mixed units: hz_gon, hz_deg, v_gon"),
        ("setup,target,hz_gon,v_gon\n", "no column for slope, such as 'slope_m'"),
        ("setup,target,hz,v_gon,slope_m\n", "column 'hz' is unknown"),
        ("target,hz_gon,v_gon,slope_m\n", "no column 'setup'"),
        (f"{HEADER},x_m\n", "both angles and coordinates"),
        (f"{HEADER}\nA,P,1,2\n", "line 2: 4 cells, but the header has 5"),
        (f"{HEADER}\nA,P,1;5,100,3\n", "hz_gon is '1;5'; allowed: a number"),
        (f"{HEADER}\nA,P,1,100,-3\n", "slope distance -3 m"),
        (f"{HEADER}\nA,P,1,0,3\n", "no zenith angle"),
        (f"{HEADER}\nA,,1,100,3\n", "line 2: no target"),
        (f"{HEADER}\nA,P,nan,100,3\n", "finite"),
        (f"{HEADER}\n", "a header, but no observations"),
        ("# nothing\n", "nothing but comments"),
    ],
)
def test_csv_with_faults_is_refused_with_line_and_reason(tmp_path, text, match):
    with pytest.raises(InvalidFile, match=match):
        read_csv(write(tmp_path, "a.csv", text))


TARGETS = """\
schema: carosac-targets/1
instrument: {angle_arcsec: 1, distance_mm: 0.6, distance_ppm: 1, pointing_mm: 0.2}
platform_position: [0.4, -1.8, 2.2]
swivel_sigma: 1 deg
prism_constant_set: 0 mm
ignore: [999]
points:
  "0101": {cable: front_left, sighted: axle, side: 12 mm}
  R1: {position: [1, 2, 0.5], sigma: 1 mm, prism_constant: -34.4 mm}
  R2: {position: [-1, 2, 0.5], sigma: [1 mm, 1 mm, 2 mm]}
  T1: {}
"""


def test_targets_are_read(tmp_path):
    targets = read_targets(write(tmp_path, "t.yaml", TARGETS), pulley_robot())
    assert targets.instrument == Instrument(
        angle=np.pi / 648000, distance=0.6e-3, distance_ppm=1.0, pointing=0.2e-3
    )
    assert targets.points["101"].target == "front_left"
    assert targets.points["101"].side == pytest.approx(0.012)
    assert targets.references["R2"].sigma == pytest.approx([1e-3, 1e-3, 2e-3])
    assert targets.references["T1"].position is None
    assert targets.ignore == ("999",)
    assert targets.swivel_sigma == pytest.approx(np.deg2rad(1.0))


@pytest.mark.parametrize(
    "old, new, match",
    [
        ("targets/1", "targets/2", "schema: got 'carosac-targets/2'; allowed: carosac-targets/1"),
        ("cable: front_left", "cable: front_lef", "did you mean 'front_left'"),
        ("axle", "hub", "sighted: got 'hub'; allowed: one of centre, axle, rim, tangent"),
        (
            "angle_arcsec: 1",
            "angle_arcsec: 0",
            "instrument.angle_arcsec: got 0.0; allowed: angle > 0",
        ),
        ("angle_arcsec", "angle_deg", "unknown key"),
        (", sigma: 1 mm", "", "points.R1: position and sigma belong together"),
        ("sigma: 1 mm", "sigma: 0 mm", "points.R1.sigma: got 0 mm; allowed: > 0"),
        ("[1, 2, 0.5]", "[1, 2]", r"allowed: \[x, y, z\]"),
        ("1 mm, prism", "1 kg, prism", "kg is a mass"),
        ("T1: {}", "front_left: {}", "a cable needs cable: front_left"),
        ("T1: {}", "T1: {pos: [1, 2, 3]}", "points.T1.pos: unknown key"),
        ("T1: {}", "101: {}", "given twice, but for leading zeros"),
        ("ignore: [999]", "ignore: 999", "a list of point names"),
    ],
)
def test_targets_with_faults_are_refused_with_line_and_reason(tmp_path, old, new, match):
    assert old in TARGETS
    path = write(tmp_path, "t.yaml", TARGETS.replace(old, new))
    with pytest.raises(InvalidFile, match=match) as caught:
        read_targets(path, pulley_robot())
    assert caught.value.faults[0].startswith("line ")


def survey_of(tmp_path, line, targets=TARGETS, robot=None, name="job.gsi"):
    path = write(tmp_path, name, line + "\n")
    return read_survey([path], write(tmp_path, "t.yaml", targets), robot or pulley_robot())


def test_points_get_their_targets_and_sightings(tmp_path):
    (shot,) = survey_of(tmp_path, GSI8).shots
    assert (shot.target, shot.source) == ("front_left", "job.gsi:1")
    assert shot.sighting == Sighting("axle", side=0.012)
    assert shot.distance == pytest.approx(12.345)


def test_the_prism_constant_replaces_that_of_the_instrument(tmp_path):
    (shot,) = survey_of(tmp_path, GSI8.replace("00000101", "000000R1")).shots
    assert shot.distance == pytest.approx(12.345 - 0.0344 - 0.034)
    without = GSI8.replace("00000101", "000000R1").partition("51..")[0]
    (shot,) = survey_of(tmp_path, without).shots
    assert shot.distance == pytest.approx(12.345 - 0.0344)
    silent = TARGETS.replace("prism_constant_set: 0 mm\n", "")
    with pytest.raises(InvalidFile, match="give prism_constant_set"):
        survey_of(tmp_path, without, silent)


@pytest.mark.parametrize(
    "line, targets, match",
    [
        (GSI8.replace("0101", "0102"), TARGETS, "line 1: point '102' is neither in points nor in"),
        (GSI8, TARGETS.replace(", sighted: axle, side: 12 mm", ""), "has a pulley: say what was"),
        (GSI8, TARGETS.replace("platform_position: [0.4, -1.8, 2.2]\n", ""), "platform_position"),
        (GSI8.replace("0000101", "0000999"), TARGETS, "every point of the observations"),
    ],
)
def test_points_that_are_not_clear_are_refused(tmp_path, line, targets, match):
    with pytest.raises(InvalidFile, match=match):
        survey_of(tmp_path, line, targets)


def test_a_pulley_point_on_a_cable_without_pulley_is_refused(tmp_path):
    with pytest.raises(InvalidFile, match="has no pulley in the robot file"):
        survey_of(tmp_path, GSI8, robot=ROBOT)


def test_a_prism_constant_given_twice_is_refused(tmp_path):
    text = f"{HEADER},prism_constant_mm\nA,R1,1,100,3,0\n"
    with pytest.raises(InvalidFile, match="given twice"):
        survey_of(tmp_path, text, name="job.csv")


def test_written_surveys_come_back_whole(tmp_path):
    robot = pulley_robot()
    scene = drawn(2, robot, sighting=Sighting("tangent"))
    targets = write_targets(
        tmp_path / "t.yaml", scene.survey, platform_position=robot.home_position
    )
    survey = read_survey(
        [str(write_survey_csv(tmp_path / "s.csv", scene.survey))], str(targets), robot
    )
    assert survey.reading == pytest.approx(scene.survey.reading, abs=1e-5)
    assert [s.sighting for s in survey.shots] == [s.sighting for s in scene.survey.shots]
    assert [s.target for s in survey.shots] == [s.target for s in scene.survey.shots]
    assert survey.instrument.angle == pytest.approx(scene.survey.instrument.angle, rel=1e-5)
    for name in survey.towards:
        assert survey.towards[name] == pytest.approx(scene.survey.towards[name], abs=1e-6)


def test_a_reference_needs_a_sigma():
    from carosac_toolkit.base.errors import InvalidField

    with pytest.raises(InvalidField, match="position and sigma"):
        ReferencePoint("R1", np.zeros(3))
    with pytest.raises(InvalidField, match="sigma > 0"):
        ReferencePoint("R1", np.zeros(3), np.zeros(3))
