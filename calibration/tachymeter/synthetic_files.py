"""Writes surveys as the files an engineer brings home: GSI-8, GSI-16, CSV and a targets file."""

from __future__ import annotations

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
from calibration.tachymeter.observations import ARCSEC_RAD, Instrument, ReferencePoint, Shot, Survey
from calibration.tachymeter.targets import TARGETS_SCHEMA
from carosac_toolkit.base.arrays import Array


def gsi_line(
    shot: Shot, number: int, *, long: bool, unit: GsiUnit = GsiUnit.GON, face: int = 1,
    prism_mm: int | None = 0,
) -> str:  # fmt: skip
    """One block.

    Args:
        shot: What to write.
        number: Block number.
        long: GSI-16 instead of GSI-8.
        unit: Of the angles.
        face: 2 writes it as read in face II.
        prism_mm: Prism constant of word 51, already in the distance; None: no such word.
    """
    hz, v = (shot.hz, shot.v) if face == 1 else (shot.hz - np.pi, 2.0 * np.pi - shot.v)
    name = GsiPointNameWord(shot.target).serialize(gsi16=long)
    words = [f"{name[:2]}{number % 10000:04d}{name[6:]}"]
    words += [
        kind(Angle(float(angle % (2.0 * np.pi)))).serialize(gsi16=long, angleunit=unit)
        for kind, angle in ((GsiHorizontalAngleWord, hz), (GsiVerticalAngleWord, v))
    ]
    distance = GsiSlopeDistanceWord(shot.distance)
    words.append(distance.serialize(gsi16=long, distunit=GsiUnit.DECIMILLI))
    if prism_mm is not None:
        words.append(GsiPPMPrismConstantWord(0, prism_mm).serialize(gsi16=long))
    return ("*" if long else "") + "".join(words)


def write_gsi(
    folder: Path, survey: Survey, *, long: bool, unit: GsiUnit = GsiUnit.GON
) -> list[Path]:
    """Write one GSI file for each set-up, every second shot of a target in face II.

    Args:
        folder: Where they go.
        survey: What to write; names of up to 8 characters with GSI-8.
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


def write_csv(path: Path, survey: Survey, unit: str = "gon") -> Path:
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
        path: Where it goes.
        survey: Points, references and instrument.
        platform_position: Where the platform was in W [m], (3,), which pulleys need.
    """
    lines = [f"schema: {TARGETS_SCHEMA}", *_instrument_lines(survey.instrument)]
    if platform_position is not None:
        lines.append(f"platform_position: {_list(platform_position)}")
        lines.append(f"swivel_sigma: {np.rad2deg(survey.swivel_sigma):.6g} deg")
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
