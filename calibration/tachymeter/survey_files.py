"""From the files of a survey to a `Survey`: each point is looked up in the targets file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from calibration.tachymeter.csv_file import read_csv
from calibration.tachymeter.gsi import read_gsi
from calibration.tachymeter.observations import SIGHTING_KINDS, Shot, Sighting, Survey
from calibration.tachymeter.records import LineFault, Record, shortened_faults
from calibration.tachymeter.targets import SurveyPoint, SurveyTargets, read_targets
from carosac_toolkit.base.errors import InvalidField, InvalidFile, did_you_mean
from carosac_toolkit.robot.robot import Robot


def read_survey(paths: Sequence[str], targets_path: str, robot: Robot) -> Survey:
    """Read observations and say what each of them sights.

    Args:
        paths: GSI and CSV files; a name that ends in .csv is CSV. Set-ups of different files are
            different ones, unless both are CSV and name the same.
        targets_path: The targets file.
        robot: Its cables may be sighted.

    Returns:
        The survey.

    Raises:
        InvalidField: A file is given twice, or set-ups of two files are called alike.
        MissingFile, InvalidFile: A file is missing or has faults; all of a file in one message.
    """
    _check_twice(paths)
    targets = read_targets(targets_path, robot)
    shots: list[Shot] = []
    owners: dict[str, str] = {}
    for path in paths:
        records = read_csv(path) if _is_csv(path) else read_gsi(path)
        _check_setups(owners, path, records)
        shots += _shots(path, records, targets, robot)
    if not shots:
        raise InvalidFile(targets_path, ["ignore: every point of the observations is in it"])
    towards = {}
    if targets.platform_position is not None:
        anchors = targets.platform_position + robot.anchor_points @ robot.home_rotation.T
        towards = dict(zip(robot.cable_names, anchors, strict=True))
    return Survey(
        shots=tuple(shots), references=targets.references, instrument=targets.instrument,
        towards=towards, swivel_sigma=targets.swivel_sigma,
    )  # fmt: skip


def _check_twice(paths: Sequence[str]) -> None:
    """Refuse a file that would count twice."""
    places: dict[Path, str] = {}
    for path in paths:
        place = Path(path).resolve()
        if place in places:
            raise InvalidField("FILE", f"'{path}'", f"each file once; '{places[place]}' is it too")
        places[place] = path


def _check_setups(owners: dict[str, str], path: str, records: list[Record]) -> None:
    """Refuse set-ups of two files that are called alike, unless both are CSV."""
    for name in {record.setup for record in records}:
        other = owners.setdefault(name, path)
        if other != path and not (_is_csv(path) and _is_csv(other)):
            allowed = f"set-ups called otherwise than in '{other}', which has a '{name}' too"
            raise InvalidField("FILE", f"'{path}'", f"{allowed}: rename the file")


def _is_csv(path: str) -> bool:
    return Path(path).suffix.lower() == ".csv"


def _shots(path: str, records: list[Record], targets: SurveyTargets, robot: Robot) -> list[Shot]:
    """Look up the points of a file."""
    shots, faults = [], []
    for record in records:
        if record.point in targets.ignore:
            continue
        point = targets.points.get(record.point)
        try:
            if point is None:
                raise LineFault(
                    f"point '{record.point}' is neither in points nor in ignore of {targets.path}"
                    + did_you_mean(record.point, list(targets.points))
                )
            shots.append(_shot(record, point, targets, robot))
        except (InvalidField, LineFault) as fault:
            faults.append(f"line {record.line}: {fault}")
    if faults:
        raise InvalidFile(path, shortened_faults(faults))
    return shots


def _shot(record: Record, point: SurveyPoint, targets: SurveyTargets, robot: Robot) -> Shot:
    """Return one observation with its target."""
    return Shot(
        setup=record.setup,
        target=point.target,
        hz=record.hz,
        v=record.v,
        distance=record.distance + _prism(record, point, targets),
        sighting=_sighting(record, point, targets, robot),
        source=record.source,
    )


def _sighting(record: Record, point: SurveyPoint, targets: SurveyTargets, robot: Robot) -> Sighting:
    """Return what was sighted; a pulley leaves no default."""
    kind = record.sighted or point.sighted
    pulley = point.cable and robot.pulley_radius[robot.cable_names.index(point.target)] > 0.0
    if kind is None and pulley:
        raise LineFault(
            f"cable {point.target} has a pulley: say what was sighted, one of "
            f"{', '.join(SIGHTING_KINDS)}, at points.{record.point} of {targets.path}"
        )
    if kind not in (None, "centre") and not pulley:
        what = "has no pulley in the robot file" if point.cable else "is no cable"
        raise LineFault(f"sighted: {kind}, but {point.target} {what}; allowed: centre")
    if kind not in (None, "centre") and targets.platform_position is None:
        raise LineFault(
            f"sighted: {kind} needs to know where the pulley of {point.target} pointed: give "
            f"platform_position, where the platform was during the survey, in {targets.path}"
        )
    rim = record.rim_deg if record.rim_deg is not None else point.rim_deg
    return Sighting(
        kind=kind or "centre",
        rim_angle=None if rim is None else float(np.deg2rad(rim)),
        rim_radius=point.rim_radius,
        side=point.side,
    )


def _prism(record: Record, point: SurveyPoint, targets: SurveyTargets) -> float:
    """Return what is still to be added to a slope distance [m]."""
    if record.prism_constant is not None and point.prism_constant is not None:
        raise LineFault(
            f"prism constant given twice: prism_constant_mm here, and points.{record.point} of "
            f"{targets.path}"
        )
    if record.prism_constant is not None:
        return record.prism_constant
    if point.prism_constant is None:
        return 0.0
    applied = record.prism_set if record.prism_set is not None else targets.prism_constant_set
    if applied is None:
        raise LineFault(
            f"point '{record.point}' has a prism_constant in {targets.path}, but nothing says "
            "which one the instrument has added already (no word 51 or 58): give "
            "prism_constant_set there"
        )
    return point.prism_constant - applied
