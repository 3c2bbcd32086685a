"""Surveys drawn from the full measurement model, with noise and blunders, and their files."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from geocompy.data import Angle
from geocompy.gsi.gsiformat import (
    GsiHorizontalAngleWord,
    GsiPointNameWord,
    GsiPPMPrismConstantWord,
    GsiSlopeDistanceWord,
    GsiUnit,
    GsiVerticalAngleWord,
)

from calibration.tachymeter.csv_file import ANGLE_UNITS_RAD
from calibration.tachymeter.model import predict
from calibration.tachymeter.observations import (
    ARCSEC_RAD,
    Instrument,
    ReferencePoint,
    Shot,
    Sighting,
    Survey,
)
from calibration.tachymeter.sightings import SightedPulley, elevation, sighted_point
from calibration.tachymeter.targets import TARGETS_SCHEMA
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.robot.robot import Robot

EXIT_ERROR_M = 0.05  # standard deviation of the robot file, per axis: as measured with a tape
BLUNDER_ANGLE_RAD, BLUNDER_DISTANCE_M = 0.02, 0.5  # gross, but not beyond what a hall allows


@dataclass(frozen=True, kw_only=True)
class SurveyPlan:
    """Settings of a drawn survey.

    Attributes:
        setups: Number of set-ups.
        faces: Shots to each target from each set-up: 2 is once in each face.
        references: Number of reference points with known coordinates.
        ties: Number of reference points without.
        reference_sigma: Of the known coordinates, per axis [m]; drawn too.
        instrument: Its accuracy; noise is drawn from it.
        blunders: Share of shots in which one reading is grossly wrong [1].
        sighting: Sighted part of a cable that has a pulley.
        swivel_sigma: Standard deviation of pulleys from their cables' direction [rad]; drawn too.
    """

    setups: int = 2
    faces: int = 2
    references: int = 6
    ties: int = 0
    reference_sigma: float = 0.5e-3
    instrument: Instrument = field(default_factory=Instrument)
    blunders: float = 0.0
    sighting: Sighting = field(default_factory=lambda: Sighting("axle"))
    swivel_sigma: float = np.deg2rad(2.0)

    def __post_init__(self) -> None:
        """Refuse shares that are none."""
        if not 0.0 <= self.blunders < 1.0:
            raise InvalidField("blunders", self.blunders, "0 <= blunders < 1")


@dataclass(frozen=True, kw_only=True, eq=False)
class DrawnSurvey:
    """A drawn survey and the truth behind it.

    Attributes:
        robot: The robot as its file has it: its exit points are off.
        truth: The robot as it stands.
        survey: The measured survey.
        stations: Set-ups by name, (6,) as in `model.predict`.
        wrong: Blunders as (shot from 0, 0 for Hz, 1 for V, 2 for distance; error), in order.
    """

    robot: Robot
    truth: Robot
    survey: Survey
    stations: dict[str, Array]
    wrong: tuple[tuple[int, int, float], ...]


def draw_survey(
    robot: Robot, rng: np.random.Generator, plan: SurveyPlan | None = None
) -> DrawnSurvey:
    """Draw a survey of a robot.

    The hall is the box of its exit points; set-ups stand in it at eye height, references are spread
    over floor and walls.

    Args:
        robot: Robot of the file; the truth is drawn around it.
        rng: All randomness.
        plan: Settings; None for the defaults.

    Returns:
        The survey with its truth.
    """
    plan = plan or SurveyPlan()
    offset = rng.normal(0.0, EXIT_ERROR_M, (robot.n, 3))
    truth = replace(robot, exit_points=robot.exit_points + offset)
    low, high = truth.exit_points.min(axis=0), truth.exit_points.max(axis=0)
    stations = {chr(65 + i): _draw_station(low, high, i, rng, plan) for i in range(plan.setups)}
    places, references = _draw_references(low, high, rng, plan)
    towards = truth.home_position + truth.anchor_points @ truth.home_rotation.T
    swivel = rng.normal(0.0, plan.swivel_sigma, robot.n)
    shots: list[Shot] = []
    for name, station in stations.items():
        for _ in range(plan.faces):
            for i, cable in enumerate(robot.cable_names):
                sighting = plan.sighting if robot.pulley_radius[i] > 0.0 else Sighting()
                point = truth.exit_points[i]
                if sighting.on_pulley:
                    pulley = SightedPulley(
                        cable=cable, radius=float(robot.pulley_radius[i]),
                        axis=robot.swivel_axis[i], towards=towards[i],
                    )  # fmt: skip
                    side = float(np.sign(elevation(point, pulley, station[:3])))
                    point = sighted_point(point, sighting, pulley, float(swivel[i]), side).point
                shots.append(_shoot(name, station, cable, point, sighting))
            for reference, place in places.items():
                shots.append(_shoot(name, station, reference, place, Sighting()))
    noisy, wrong = _spoil(shots, rng, plan)
    survey = Survey(
        shots=tuple(noisy), references=references, instrument=plan.instrument,
        towards={
            cable: towards[i] for i, cable in enumerate(robot.cable_names)
            if robot.pulley_radius[i] > 0.0
        },
        swivel_sigma=plan.swivel_sigma or np.deg2rad(2.0),
    )  # fmt: skip
    return DrawnSurvey(robot=robot, truth=truth, survey=survey, stations=stations, wrong=wrong)


def _draw_station(
    low: Array, high: Array, index: int, rng: np.random.Generator, plan: SurveyPlan
) -> Array:
    """Draw a set-up in the hall, each in its own part of the longer side."""
    size = high - low
    longer = int(np.argmax(size[:2]))
    share = rng.uniform(0.25, 0.75, 2)
    share[longer] = (index + rng.uniform(0.25, 0.75)) / plan.setups
    place = low[:2] + share * size[:2]
    tilt = rng.normal(0.0, plan.instrument.compensator, 2)
    return np.array([*place, rng.uniform(1.4, 1.7), rng.uniform(-np.pi, np.pi), *tilt])


def _draw_references(
    low: Array, high: Array, rng: np.random.Generator, plan: SurveyPlan
) -> tuple[dict[str, Array], dict[str, ReferencePoint]]:
    """Draw places of the reference points, and what is known of them."""
    places, references = {}, {}
    around = 0.5 * (low + high)[:2]
    for i in range(plan.references + plan.ties):
        angle = 2.0 * np.pi * (i + rng.uniform(0.2, 0.8)) / (plan.references + plan.ties)
        ring = 0.5 * (high - low)[:2] * np.array([np.cos(angle), np.sin(angle)])
        place = np.array([*(around + ring), rng.uniform(0.2, 4.0)])
        known = i < plan.references
        name = f"R{i + 1}" if known else f"T{i + 1 - plan.references}"
        places[name] = place
        sigma = np.full(3, plan.reference_sigma)
        measured = place + rng.normal(0.0, plan.reference_sigma, 3)
        references[name] = ReferencePoint(name, measured, sigma) if known else ReferencePoint(name)
    return places, references


def _shoot(setup: str, station: Array, target: str, point: Array, sighting: Sighting) -> Shot:
    """Return a perfect shot."""
    hz, v, distance = predict(station, point[None]).reading[0]
    return Shot(setup=setup, target=target, hz=hz, v=v, distance=distance, sighting=sighting)


def _spoil(
    shots: list[Shot], rng: np.random.Generator, plan: SurveyPlan
) -> tuple[list[Shot], tuple[tuple[int, int, float], ...]]:
    """Add noise, and blunders to some shots."""
    reading = np.array([[s.hz, s.v, s.distance] for s in shots])
    error = rng.normal(0.0, 1.0, reading.shape) * plan.instrument.sigma(reading)
    wrong = []
    for i in sorted(rng.choice(len(shots), round(plan.blunders * len(shots)), replace=False)):
        column = int(rng.integers(3))
        size = BLUNDER_DISTANCE_M if column == 2 else BLUNDER_ANGLE_RAD
        gross = float(size * rng.choice([-1.0, 1.0]))
        error[i, column] += gross
        wrong.append((int(i), column, gross))
    noisy = reading + error
    noisy[:, 0] %= 2.0 * np.pi
    spoilt = [
        replace(shot, hz=float(h), v=float(v), distance=float(d))
        for shot, (h, v, d) in zip(shots, noisy, strict=True)
    ]
    return spoilt, tuple(wrong)


def gsi_line(
    shot: Shot, number: int, *, long: bool, unit: GsiUnit = GsiUnit.GON, face: int = 1,
    prism_mm: int | None = 0,
) -> str:  # fmt: skip
    """Return one GSI block.

    Args:
        shot: Shot to write.
        number: Block number.
        long: GSI-16 instead of GSI-8.
        unit: Of the angles.
        face: 2 writes it as read in face II.
        prism_mm: Prism constant of word 51, already in the distance; None: no such word.
    """
    hz, v = (shot.hz, shot.v) if face == 1 else (shot.hz - np.pi, 2.0 * np.pi - shot.v)
    name = GsiPointNameWord(shot.target).serialize(gsi16=long)
    words = [
        f"{name[:2]}{number % 10000:04d}{name[6:]}",
        *(
            kind(Angle(float(angle % (2.0 * np.pi)))).serialize(gsi16=long, angleunit=unit)
            for kind, angle in ((GsiHorizontalAngleWord, hz), (GsiVerticalAngleWord, v))
        ),
        GsiSlopeDistanceWord(shot.distance).serialize(gsi16=long, distunit=GsiUnit.DECIMILLI),
    ]
    if prism_mm is not None:
        words.append(GsiPPMPrismConstantWord(0, prism_mm).serialize(gsi16=long))
    return ("*" if long else "") + "".join(words)


def write_gsi(
    folder: Path, survey: Survey, *, long: bool, unit: GsiUnit = GsiUnit.GON
) -> list[Path]:
    """Write one GSI file for each set-up, every second shot of a target in face II.

    Args:
        folder: Folder of the files.
        survey: Survey to write; names of up to 8 characters with GSI-8.
        long: GSI-16 instead of GSI-8.
        unit: Of the angles.
    """
    paths = []
    for setup in survey.setups:
        seen: dict[str, int] = {}
        lines: list[str] = []
        for shot in (shot for shot in survey.shots if shot.setup == setup):
            seen[shot.target] = seen.get(shot.target, 0) + 1
            face = 2 - seen[shot.target] % 2
            lines.append(gsi_line(shot, len(lines) + 1, long=long, unit=unit, face=face))
        paths.append(folder / f"{setup}.gsi")
        paths[-1].write_text("\n".join(lines) + "\n", encoding="ascii")
    return paths


def write_survey_csv(path: Path, survey: Survey, unit: str = "gon") -> Path:
    """Write all set-ups into one CSV file; ``unit`` is that of the angles."""
    lines = [
        "# directions clockwise, zenith angles; one line for each shot",
        f"setup,target,hz_{unit},v_{unit},slope_m,sighted",
    ]
    for shot in survey.shots:
        hz, v = shot.hz / ANGLE_UNITS_RAD[unit], shot.v / ANGLE_UNITS_RAD[unit]
        sighted = shot.sighting.kind if shot.sighting.on_pulley else ""
        lines.append(f"{shot.setup},{shot.target},{hz:.6f},{v:.6f},{shot.distance:.5f},{sighted}")
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def write_targets(path: Path, survey: Survey, *, platform_position: Array | None = None) -> Path:
    """Write the targets file of a survey.

    Args:
        path: The file.
        survey: Points, references and instrument.
        platform_position: Position of the platform in W [m], (3,), which pulleys need.
    """
    lines = [f"schema: {TARGETS_SCHEMA}", *_instrument_lines(survey.instrument)]
    if platform_position is not None:
        lines += [
            f"platform_position: {_list(platform_position)}",
            f"swivel_sigma: {np.rad2deg(survey.swivel_sigma):.6g} deg",
        ]
    lines.append("points:")
    shots = {shot.target: shot for shot in survey.shots}
    for name in survey.targets:
        if name in survey.references:
            lines.append(f"  {name}: {_reference(survey.references[name])}")
        else:
            sighted = shots[name].sighting.kind
            lines.append(f"  {name}: {{cable: {name}, sighted: {sighted}}}")
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def _instrument_lines(instrument: Instrument) -> list[str]:
    return [
        "instrument:",
        f"  angle_arcsec: {instrument.angle / ARCSEC_RAD:.6g}",
        f"  distance_mm: {instrument.distance * 1e3:.6g}",
        f"  distance_ppm: {instrument.distance_ppm:.6g}",
        f"  pointing_mm: {instrument.pointing * 1e3:.6g}",
        f"  compensator_arcsec: {instrument.compensator / ARCSEC_RAD:.6g}",
    ]


def _reference(reference: ReferencePoint) -> str:
    if reference.position is None or reference.sigma is None:
        return "{}"
    sigma = ", ".join(f"{1e3 * s:.6g} mm" for s in reference.sigma)
    return f"{{position: {_list(reference.position)}, sigma: [{sigma}]}}"


def _list(values: Array) -> str:
    return "[" + ", ".join(f"{value:.6f}" for value in values) + "]"
