"""The targets file: what each surveyed point is, known coordinates, and the instrument.

YAML of schema ``carosac-targets/1``; see docs/calibration-tachymeter.md.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from calibration.tachymeter.observations import (
    ARCSEC_RAD,
    SIGHTING_KINDS,
    Instrument,
    ReferencePoint,
)
from calibration.tachymeter.records import MILLIMETRE_M, plain_name, read_lines, shortened_faults
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import InvalidField, InvalidFile, did_you_mean
from carosac_toolkit.base.units import InvalidQuantity, parse_quantity
from carosac_toolkit.base.yaml import Document, FieldPath, format_path, read_yaml
from carosac_toolkit.robot.robot import Robot

TARGETS_SCHEMA = "carosac-targets/1"
_TOP_KEYS = (
    "schema", "instrument", "points", "ignore", "platform_position", "swivel_sigma",
    "prism_constant_set",
)  # fmt: skip
_INSTRUMENT_KEYS = {
    "angle_arcsec": ("angle", ARCSEC_RAD), "distance_mm": ("distance", MILLIMETRE_M),
    "distance_ppm": ("distance_ppm", 1.0), "pointing_mm": ("pointing", MILLIMETRE_M),
    "compensator_arcsec": ("compensator", ARCSEC_RAD),
}  # fmt: skip
_CABLE_KEYS = ("cable", "sighted", "rim_deg", "rim_radius", "side", "prism_constant")
_REFERENCE_KEYS = ("position", "sigma", "prism_constant")


@dataclass(frozen=True, kw_only=True, eq=False)
class SurveyPoint:
    """Meaning of a point of the observations.

    Attributes:
        target: Cable, or name of the reference point.
        cable: True if it is a cable.
        sighted: Sighted part; None: not given.
        rim_deg: [deg]; None: not given.
        rim_radius: [m]; None: that of the groove.
        side: [m].
        prism_constant: Of the prism that stood there [m]; None: not given.
    """

    target: str
    cable: bool
    sighted: str | None = None
    rim_deg: float | None = None
    rim_radius: float | None = None
    side: float = 0.0
    prism_constant: float | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class SurveyTargets:
    """A targets file.

    Attributes:
        path: The file.
        points: By name as in the observations.
        references: By name.
        ignore: Points to pass over.
        instrument: Accuracy.
        platform_position: Platform during the survey, in W [m], shape (3,); None: not given.
        swivel_sigma: [rad].
        prism_constant_set: Constant that the instrument applied, where its file does not say [m].
    """

    path: str
    points: Mapping[str, SurveyPoint]
    references: Mapping[str, ReferencePoint]
    ignore: tuple[str, ...] = ()
    instrument: Instrument = field(default_factory=Instrument)
    platform_position: Array | None = None
    swivel_sigma: float = np.deg2rad(2.0)
    prism_constant_set: float | None = None


def read_targets(path: str, robot: Robot) -> SurveyTargets:
    """Read a targets file.

    Raises:
        MissingFile: There is no such file.
        InvalidFile: All its faults, each with its line.
    """
    document = read_yaml("\n".join(read_lines(path)))
    walk = _Walk(document, path)
    data = document.data
    if document.faults or not isinstance(data, dict):
        faults = [f"line {line}: {what}" for line, what in document.faults]
        raise InvalidFile(path, faults or ["no mapping; see carosac-targets/1 in the docs"])
    walk.unknown((), data, _TOP_KEYS)
    if data.get("schema") != TARGETS_SCHEMA:
        walk.fault(("schema",), f"got {data.get('schema')!r}; allowed: {TARGETS_SCHEMA}")
    points, references = _points(walk, data.get("points"), robot)
    ignore = data.get("ignore") or []
    if not isinstance(ignore, list):
        walk.fault(("ignore",), "allowed: a list of point names")
        ignore = []
    targets = SurveyTargets(
        path=path,
        points=points,
        references=references,
        ignore=tuple(plain_name(_name_of(name)) for name in ignore),
        instrument=_instrument(walk, data.get("instrument")),
        platform_position=walk.vector(("platform_position",), data.get("platform_position")),
        swivel_sigma=walk.number(("swivel_sigma",), data.get("swivel_sigma"), "rad", positive=True)
        or np.deg2rad(2.0),
        prism_constant_set=walk.number(
            ("prism_constant_set",), data.get("prism_constant_set"), "m"
        ),
    )
    if walk.faults:
        raise InvalidFile(
            path, shortened_faults([f"line {n}: {what}" for n, what in sorted(walk.faults)])
        )
    return targets


def _name_of(value: Any) -> str:
    """Return a point name that YAML may have taken for a number."""
    whole = isinstance(value, float) and value.is_integer()
    return str(int(value)) if whole else str(value)


@dataclass
class _Walk:
    """Reads values of a YAML document and collects what is wrong."""

    document: Document
    path: str
    faults: list[tuple[int, str]] = field(default_factory=list)

    def fault(self, where: FieldPath, what: str) -> None:
        """Note a fault."""
        self.faults.append((self.document.line(where), f"{format_path(where)}: {what}"))

    def unknown(self, where: FieldPath, data: Mapping[str, Any], known: Sequence[str]) -> None:
        """Note keys that mean nothing."""
        for key in data:
            if key not in known:
                hint = did_you_mean(key, list(known))
                self.fault((*where, key), f"unknown key; allowed: {', '.join(known)}{hint}")

    def number(
        self, where: FieldPath, value: Any, unit: str, *, positive: bool = False
    ) -> float | None:
        """Read a quantity; None where there is none."""
        if value is None:
            return None
        try:
            number = parse_quantity(value, unit)
        except InvalidQuantity as error:
            self.fault(where, str(error))
            return None
        if positive and number <= 0.0:
            self.fault(where, f"got {value}; allowed: > 0")
            return None
        return number

    def vector(self, where: FieldPath, value: Any) -> Array | None:
        """Read three lengths; None where there are none."""
        if value is None:
            return None
        if not isinstance(value, list) or len(value) != 3:
            self.fault(where, f"got {value!r}; allowed: [x, y, z] in m")
            return None
        numbers = [self.number((*where, i), entry, "m") for i, entry in enumerate(value)]
        coordinates = [number for number in numbers if number is not None]
        if len(coordinates) != 3:
            if None in value:
                self.fault(where, f"got {value!r}; allowed: [x, y, z] in m")
            return None
        return np.array(coordinates)


def _instrument(walk: _Walk, data: Any) -> Instrument:
    """Read the accuracy of the instrument; what is not given keeps its default."""
    if data is None:
        return Instrument()
    if not isinstance(data, dict):
        walk.fault(("instrument",), f"allowed: a mapping of {', '.join(_INSTRUMENT_KEYS)}")
        return Instrument()
    walk.unknown(("instrument",), data, tuple(_INSTRUMENT_KEYS))
    accuracy = {}
    for key, (name, scale) in _INSTRUMENT_KEYS.items():
        value = walk.number(("instrument", key), data.get(key), "1")
        if value is not None:
            accuracy[name] = value * scale
    try:
        return Instrument(**accuracy)
    except InvalidField as error:
        bad = error.field.rpartition(".")[2]
        key = next(key for key, (name, _) in _INSTRUMENT_KEYS.items() if name == bad)
        walk.fault(("instrument", key), f"got {data[key]}; allowed: {error.allowed}")
        return Instrument()


def _points(
    walk: _Walk, data: Any, robot: Robot
) -> tuple[dict[str, SurveyPoint], dict[str, ReferencePoint]]:
    """Read all points."""
    points: dict[str, SurveyPoint] = {}
    references: dict[str, ReferencePoint] = {}
    if not isinstance(data, dict) or not data:
        walk.fault(("points",), "allowed: a mapping from point names to what they are")
        return points, references
    for written, entry in data.items():
        where: FieldPath = ("points", written)
        name = plain_name(written)
        entry = {} if entry is None else entry
        if not isinstance(entry, dict):
            walk.fault(where, "allowed: {cable: ...} or {position: ..., sigma: ...} or {}")
        elif name in points:
            walk.fault(where, "given twice, but for leading zeros")
        elif "cable" in entry:
            point = _cable_point(walk, where, entry, robot)
            points |= {name: point} if point is not None else {}
        elif name in robot.cable_names:
            walk.fault(where, f"a cable's name for a reference point; a cable needs cable: {name}")
        else:
            points[name], references[name] = _reference_point(walk, where, name, entry)
    return points, references


def _cable_point(
    walk: _Walk, where: FieldPath, entry: Mapping[str, Any], robot: Robot
) -> SurveyPoint | None:
    """Read a point on a cable's exit."""
    walk.unknown(where, entry, _CABLE_KEYS)
    cable = _name_of(entry["cable"])
    if cable not in robot.cable_names:
        allowed = (
            f"one of {', '.join(robot.cable_names)}{did_you_mean(cable, list(robot.cable_names))}"
        )
        walk.fault((*where, "cable"), f"got {cable!r}; allowed: {allowed}")
        return None
    sighted = entry.get("sighted")
    if sighted is not None and sighted not in SIGHTING_KINDS:
        walk.fault(
            (*where, "sighted"), f"got {sighted!r}; allowed: one of {', '.join(SIGHTING_KINDS)}"
        )
        return None
    return SurveyPoint(
        target=cable,
        cable=True,
        sighted=sighted,
        rim_deg=walk.number((*where, "rim_deg"), entry.get("rim_deg"), "1"),
        rim_radius=walk.number((*where, "rim_radius"), entry.get("rim_radius"), "m", positive=True),
        side=walk.number((*where, "side"), entry.get("side"), "m") or 0.0,
        prism_constant=walk.number((*where, "prism_constant"), entry.get("prism_constant"), "m"),
    )


def _reference_point(
    walk: _Walk, where: FieldPath, name: str, entry: Mapping[str, Any]
) -> tuple[SurveyPoint, ReferencePoint]:
    """Read a reference point, known or not."""
    walk.unknown(where, entry, (*_REFERENCE_KEYS, "cable"))
    prism = walk.number((*where, "prism_constant"), entry.get("prism_constant"), "m")
    position = walk.vector((*where, "position"), entry.get("position"))
    spread = entry.get("sigma")
    several = isinstance(spread, list)
    sigma = (
        walk.vector((*where, "sigma"), spread) if several
        else walk.number((*where, "sigma"), spread, "m", positive=True)
    )  # fmt: skip
    point = SurveyPoint(target=name, cable=False, prism_constant=prism)
    if (entry.get("position") is None) != (spread is None):
        walk.fault(where, "position and sigma belong together: how well are the coordinates known?")
    elif sigma is not None and np.min(sigma) <= 0.0:
        walk.fault((*where, "sigma"), f"got {spread}; allowed: > 0")
    elif position is not None and sigma is not None:
        return point, ReferencePoint(name, position, np.broadcast_to(sigma, 3))
    return point, ReferencePoint(name)
