"""Measured natural frequencies: which modes they are of, what they tell, and what is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import carosac_toolkit as ct
from calibration.identification.frequencies import (
    ComparedFrequencies,
    FrequencyTable,
    KnownFrequencies,
    load_frequencies,
)
from calibration.identification.procedure import identify
from calibration.identification.settings import IdentificationSettings
from calibration.identification.synthetic import RunSettings, simulate_run
from calibration.identification.unknowns import choose_coordinates
from carosac_toolkit.base.errors import CarosacError, InvalidField, InvalidFile
from carosac_toolkit.physics.device import lever
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.physics.rest.modes import natural_modes
from carosac_toolkit.recordings.encoders import readings
from carosac_toolkit.robot.parameters import values_of

FEW = IdentificationSettings(
    exit_points=0.0, anchor_points=0.0, length_scale=0.0, length_delay=0.0, mass=0.0,
    linear_density=0.0, axial_damping=0.0, run_length=0.0, drag=0.0, angular_drag=0.0,
    length_hysteresis=0.0, exit_friction=0.0, anchor_friction=0.0, pose_tilt=0.0, iterations=8,
)  # fmt: skip  # what remains: offsets, centre of mass, inertia, axial stiffness
SHARE = 1e-3  # one sigma of a measured frequency


@pytest.fixture(scope="module")
def robot():
    return ct.load_robot("carosac")


@pytest.fixture(scope="module")
def plant(robot):
    """A truth with a centre of mass that a robot file would not know."""
    return replace(
        robot,
        center_of_mass=robot.center_of_mass + np.array([0.01, -0.008, 0.015]),
        inertia=1.3 * robot.inertia,
        axial_stiffness=0.8 * robot.axial_stiffness,
    )


def measured(plant, modes=(1, 2, 3)):
    """What an experimentalist would find at three places, with noise of one part in a thousand."""
    rng = np.random.default_rng(4)
    places = plant.home_position + np.array([[0.0, 0.0, 0.0], [0.5, 0.3, -0.4], [-0.6, 0.2, 0.3]])
    rest = statics.inverse_kinematics(plant, places)
    frequency = natural_modes(plant, rest).frequency[:, np.array(modes) - 1].ravel()
    frequency *= 1.0 + SHARE * rng.standard_normal(len(frequency))
    return FrequencyTable(
        reading=np.repeat(readings(plant, rest.unstrained_length), len(modes), axis=0),
        frequency=frequency,
        sigma=SHARE * frequency,
        mode=np.tile(modes, len(places)),
        shape=np.full((len(frequency), 6), np.nan),
        rows=tuple(f"row {k + 1}" for k in range(len(frequency))),
    )


def select(table, rows):
    names = tuple(np.array(table.rows)[rows])
    columns = ("reading", "frequency", "sigma", "mode", "shape")
    return replace(table, rows=names, **{name: getattr(table, name)[rows] for name in columns})


def by_shape(table, shape):
    return replace(table, mode=np.zeros_like(table.mode), shape=shape)


def test_the_true_robot_has_the_measured_frequencies(plant):
    off = measured(plant).errors(plant)
    assert np.abs(off).max() < 3.0
    assert 0.4 < (off**2).mean() < 2.0


def test_a_shape_finds_its_mode_whatever_its_size_and_sign(plant):
    table = measured(plant, modes=(1, 2, 3, 4, 5, 6))
    rest = statics.forward_kinematics(plant, table.reading)
    shape = natural_modes(plant, rest).shape[np.arange(18), :, table.mode - 1]
    rng = np.random.default_rng(0)
    size = rng.uniform(0.1, 10.0, (18, 1)) * rng.choice([-1.0, 1.0], (18, 1))
    rough = size * shape * (1.0 + 0.05 * rng.standard_normal(shape.shape))
    assert by_shape(table, rough).matched(plant).modelled(plant) == pytest.approx(
        table.modelled(plant)
    )


def test_a_part_of_a_shape_will_do(plant):
    table = measured(plant)
    rest = statics.forward_kinematics(plant, table.reading)
    shape = natural_modes(plant, rest).shape[np.arange(9), :, table.mode - 1]
    shape[:, 2:] = np.nan  # a total station that sees x and y alone
    swings = select(by_shape(table, shape), table.mode <= 2)  # the third is a turn
    found = swings.matched(plant).modelled(plant)
    off = np.abs(found / select(table, table.mode <= 2).modelled(plant) - 1.0)
    assert (off < 1e-9).all()


def test_the_gradient_is_half_the_slope_of_the_cost(robot, plant):
    unknowns = choose_coordinates(robot, FEW)
    known = KnownFrequencies(table=measured(plant), unknowns=unknowns)
    at = 0.1 * np.random.default_rng(1).standard_normal(len(unknowns.prior.names))
    step = 1e-3
    slope = [
        (known.cost(at + step * way) - known.cost(at - step * way)) / (4.0 * step)
        for way in np.eye(len(at))
    ]
    gradient = known.about(at).gradient
    assert known.about(at).cost == pytest.approx(known.cost(at))
    assert gradient == pytest.approx(np.array(slope), abs=1e-3 * np.abs(gradient).max())


def test_frequencies_do_not_tell_what_all_forces_and_masses_have_in_common(robot, plant):
    unknowns = choose_coordinates(robot, IdentificationSettings())
    known = KnownFrequencies(table=measured(plant), unknowns=unknowns)
    line = unknowns.alike / np.linalg.norm(unknowns.alike)
    information = known.about(np.zeros(len(line))).information
    assert line @ information @ line < 1e-6 * np.linalg.eigvalsh(information)[-1]


@pytest.fixture(scope="module")
def run(plant):
    """A short recording, of lengths that are read with errors of their own."""
    return simulate_run(plant, 3, RunSettings(condition="none", moves=2, rate=20.0))


@pytest.fixture(scope="module")
def found(robot, run):
    """Identified from a short recording, without and with frequencies."""
    train = (0, len(run.recording.time))
    return [
        identify(run.recording, robot, FEW, train=train, frequencies=each)
        for each in (None, measured(run.plant))
    ]


def test_measured_frequencies_are_fitted_beside_a_recording(found, run):
    with_them = found[1]
    compared = with_them.frequencies
    assert np.abs(compared.off).max() < 3.0
    before = compared.before - compared.table.frequency
    assert np.abs(before / compared.table.sigma).max() > 10.0
    off = with_them.estimate.value - values_of(run.plant, with_them.estimate.names)
    assert (np.abs(off) < 3.0 * with_them.estimate.sigma).all()


def test_they_tell_what_a_short_recording_does_not(found):
    without, with_them = (each.estimate for each in found)
    row = without.index("inertia.zz")
    assert with_them.sigma[row] < 0.6 * without.sigma[row]
    assert (with_them.sigma < 1.1 * without.sigma).all()


def test_the_estimate_is_where_recording_and_frequencies_pull_alike(found):
    folds = found[1].folds
    parts = [folds.known, *folds.parts]
    pull, information = sum(each.gradient for each in parts), sum(e.information for e in parts)
    free = folds.at > folds.lower
    left = pull[free] @ np.linalg.solve(information[np.ix_(free, free)], pull[free])
    assert left < 0.1 * free.sum()
    as_prior = (folds.known.information @ folds.at - folds.known.gradient)[free]  # about 0
    assert as_prior @ np.linalg.solve(information[np.ix_(free, free)], as_prior) > 10.0 * left


def test_a_result_says_how_well_they_fit(found):
    assert any("9 measured frequencies: off by" in line for line in found[1].sentences())
    assert len(found[1].data()["frequencies"]["after_Hz"]) == 9
    assert found[0].data()["frequencies"] is None


def test_a_frequency_of_another_mode_is_warned_of(found):
    compared = found[1].frequencies
    wrong = replace(compared.table, frequency=1.05 * compared.table.frequency)
    warnings = list(replace(compared, table=wrong).warnings())
    assert len(warnings) == 9
    assert "row 1" in warnings[0] and "another mode" in warnings[0]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda table: replace(table, frequency=2.0 * np.pi * table.frequency), "factor of 3"),
        (lambda table: replace(table, reading=0.2 * table.reading), "where it is 17"),
        (lambda table: replace(table, reading=table.reading[:, :3]), "lengths of 3 cables"),
    ],
)
def test_what_cannot_be_of_this_robot_is_refused(robot, plant, change, words):
    with pytest.raises(InvalidField, match=words):
        change(measured(plant)).matched(robot)


def test_lengths_on_which_it_does_not_hang_are_refused(robot, plant):
    far = replace(robot, length_offset=np.full(4, 20.0))
    with pytest.raises(InvalidField, match="row 1, row 2, row 3: lengths on which robot 'carosac'"):
        measured(plant).matched(far)


def test_a_shape_that_may_be_of_several_modes_is_refused(robot, plant):
    """Unless these are of one frequency."""
    table = measured(plant)
    rest = statics.forward_kinematics(plant, table.reading)
    shape = natural_modes(plant, rest).shape[np.arange(9)]
    moves = shape * np.repeat([1.0, lever(plant)], 3)[:, None]
    unit = shape / np.linalg.norm(moves, axis=1, keepdims=True)
    between = replace(table, frequency=np.full(9, 0.8))  # [Hz]
    mixed = by_shape(between, unit[:, :, 0] + unit[:, :, 1])
    with pytest.raises(InvalidField, match=r"row 1: a shape as much like mode \d, .* Hz, as mode"):
        mixed.matched(robot)
    rough = replace(mixed, sigma=np.full(9, 0.5))
    assert set(rough.matched(robot).mode) <= {1, 2}


def test_what_a_mode_does_beside_what_was_measured_counts(plant):
    """All modes move along x, and one of them mostly does."""
    table = measured(plant)
    swing = np.full((9, 6), np.nan)
    swing[:, 0] = -0.3
    slowest = table.frequency[0]
    table = replace(table, frequency=np.full(9, slowest), sigma=np.full(9, SHARE * slowest))
    assert (by_shape(table, swing).matched(plant).mode == 1).all()


def test_a_shape_keeps_its_mode_and_a_change_of_it_is_warned_of(robot, plant):
    table = measured(plant)
    rest = statics.forward_kinematics(plant, table.reading)
    shape = natural_modes(plant, rest).shape[np.arange(9), :, table.mode - 1]
    matched = by_shape(table, shape).matched(plant)
    assert ComparedFrequencies.of(matched, robot, plant).changed == ()
    other = replace(matched, mode=np.where(np.arange(9) == 4, 1, matched.mode))
    warnings = list(ComparedFrequencies.of(other, robot, plant).warnings())
    assert "row 5: of the identified robot its shape is most like another mode" in warnings[-1]


@pytest.mark.parametrize("place", [1, 2, 3])
def test_frequencies_of_shapes_in_radians_are_refused(plant, place):
    """Also where another mode happens to be near them."""
    table = measured(plant, modes=(place,))
    rest = statics.forward_kinematics(plant, table.reading)
    shape = natural_modes(plant, rest).shape[:, :, place - 1]
    fast = replace(by_shape(table, shape), frequency=2.0 * np.pi * table.frequency)
    with pytest.raises(InvalidField, match="within a factor of 3"):
        fast.matched(plant)


@pytest.mark.parametrize("component", range(6))
def test_what_was_matched_to_a_robot_has_not_changed_with_it(plant, component):
    """One component alone says which mode, or is refused; a warning would never end."""
    table = measured(plant, modes=(1, 2, 3, 4, 5, 6))
    part = np.full((18, 6), np.nan)
    part[:, component] = 1.0
    for row in range(18):
        try:
            matched = select(by_shape(table, part), [row]).matched(plant)
        except InvalidField:
            continue
        assert matched.changed(plant) == []


def test_a_mode_beside_the_shape_of_another_is_refused(plant):
    table = measured(plant)
    rest = statics.forward_kinematics(plant, table.reading)
    shape = natural_modes(plant, rest).shape[np.arange(9), :, table.mode - 1]
    both = replace(table, shape=shape).matched(plant)
    assert (both.mode == table.mode).all()
    other = replace(table, shape=np.roll(shape, 1, axis=0))
    with pytest.raises(InvalidField, match="row 1: mode 1 with a shape most like mode 3"):
        other.matched(plant)


def test_a_search_that_leaves_where_the_robot_hangs_says_so(robot, plant):
    unknowns = choose_coordinates(robot, FEW)
    known = KnownFrequencies(table=measured(plant), unknowns=unknowns)
    far = np.zeros(len(unknowns.prior.names))
    far[: len(unknowns.prior.names)] = [
        400.0 if name.startswith("length_offset") else 0.0 for name in unknowns.prior.names
    ]
    assert known.cost(far) == np.inf
    with pytest.raises(CarosacError, match=r"no longer hangs on the lengths of frequencies, row 1"):
        known.about(far)


def test_a_shape_without_a_mode_has_no_frequency_yet(plant):
    with pytest.raises(InvalidField, match="mode, row 1: got 0"):
        by_shape(measured(plant), np.ones((9, 6))).modelled(plant)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"sigma": np.zeros(9)}, "sigma, row 1: got .0.*> 0, finite"),
        ({"frequency": np.full(9, np.nan)}, "frequency, row 1: got .nan"),
        ({"mode": np.full(9, 7)}, "mode, row 1: got 7; allowed: a mode from 1 to 6, or a shape"),
        ({"mode": np.zeros(9, int)}, "mode, row 1: got 0"),
        ({"mode": np.ones(8, int)}, r"mode: got shape \(8,\)"),
        ({"reading": np.ones(9)}, r"reading: got shape \(9,\)"),
        ({"mode": np.ones(9)}, "mode: got type float64; allowed: integers"),
        ({"shape": np.full((9, 6), np.inf)}, "mode, row 1: got 1"),
        ({"rows": ()}, "rows: got none"),
    ],
)
def test_what_is_no_table_is_refused(plant, change, words):
    with pytest.raises(InvalidField, match=words):
        replace(measured(plant), **change)


LENGTHS = ",".join(f"unstrained_length_{k:02d}_m" for k in range(1, 5))


def write(path, rows, header="frequency_Hz,sigma_Hz,mode"):
    path.write_text("\n".join([f"{LENGTHS},{header}", *rows, ""]))
    return path


def test_a_table_is_read(tmp_path, robot):
    header = "frequency_Hz,sigma_Hz,mode,shape_x_m,shape_yaw_rad"
    rows = ["5.1,5.2,5.3,5.4,0.31,0.002,1,,", "5.1,5.2,5.3,5.4,0.5,0.01,,0.2,-0.4"]
    table = load_frequencies(write(tmp_path / "table.csv", rows, header), robot)
    assert table.reading[1] == pytest.approx([5.1, 5.2, 5.3, 5.4])
    assert table.mode.tolist() == [1, 0]
    assert table.shape[1, [0, 5]] == pytest.approx([0.2, -0.4])
    assert np.isnan(table.shape[1, 1:5]).all()
    assert table.rows[1] == "row 2 (line 3)"


@pytest.mark.parametrize(
    ("rows", "header", "words"),
    [
        (["5,5,5,5,0.3,0.01"], "frequency_Hz,sigma_Hz", "says which modes"),
        (["5,5,5,5,0.3,1"], "frequency_Hz,mode", "'sigma_Hz' is missing"),
        (["5,5,5,5,0.3,0.01,1,2"], "frequency_Hz,sigma_Hz,mode,sway", "'sway': allowed"),
        (["5,5,5,5,0.3,0,1"], "frequency_Hz,sigma_Hz,mode", "got 0.0; allowed: > 0"),
        (["5,5,,5,0.3,0.1,1"], "frequency_Hz,sigma_Hz,mode", "got nothing; allowed: > 0"),
        (["5,5,5,5,0.3,0.01,7"], "frequency_Hz,sigma_Hz,mode", "a mode from 1 to 6, or a shape"),
        (["5,5,5,5,0.3,0.01,1.5"], "frequency_Hz,sigma_Hz,mode", "got mode 1.5"),
        (["5,5,5,5,0.3,0.01,"], "frequency_Hz,sigma_Hz,mode", "got neither"),
        (["5,5,5,5,0.3,0.01,0"], "frequency_Hz,sigma_Hz,shape_x_m", "got neither"),
        ([], "frequency_Hz,sigma_Hz,mode", "no rows"),
    ],
)
def test_a_faulty_table_is_refused_by_line(tmp_path, robot, rows, header, words):
    with pytest.raises(InvalidFile, match=words):
        load_frequencies(write(tmp_path / "table.csv", rows, header), robot)
