"""A robot file with other numbers: comments, order and units of the old file stay.

Only what differs is written, and what was written is read back and compared, so that a new file
either is the robot or does not come to be.
"""

from __future__ import annotations

import copy
import io
from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any

import numpy as np
from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedMap, CommentedSeq

from carosac_toolkit.arrays import Array
from carosac_toolkit.errors import CarosacError, InvalidField
from carosac_toolkit.parameters import unit_of
from carosac_toolkit.recordings.quaternions import from_matrix
from carosac_toolkit.robot import RigidBody, Robot, combine_bodies
from carosac_toolkit.robot_file import parse_file, parse_robot
from carosac_toolkit.robot_schema import RobotFile

_DIGITS = 12  # significant ones of what is written
_SAME = 1e-9  # relative difference that rounding to them leaves
_IN_CABLE = ("linear_density", "axial_stiffness", "axial_damping")
_IN_DRUM = {"drum_radius": "radius", "drum_buildup": "buildup"}
_TEXTS = ("name", "description", "licence")
_WRITABLE = (
    *_TEXTS, *_IN_CABLE, *_IN_DRUM, "exit_points", "exit_covariance", "anchor_points", "run_length",
    "mass", "center_of_mass", "inertia", "drag", "angular_drag", "length_offset", "length_scale",
    "length_delay", "pose_rotation", "calibrated", "calibration_covariance", "provenance",
)  # fmt: skip


def robot_document(text: str, robot: Robot, *, provenance: str) -> str:
    """The text of a robot file with the numbers of another robot.

    Args:
        text: The file that the robot was made from, unchanged parts of which are kept.
        robot: The same cables with other numbers.
        provenance: Where the other numbers come from; stands in the file for each of them.

    Returns:
        YAML of schema ``carosac-robot/1`` that `parse_robot` turns into `robot`, provenance aside.

    Raises:
        InvalidFile: The old file has faults.
        InvalidField: The robot differs in something that is not calibrated, such as its cables.
    """
    old, file = parse_file(text)
    changed = [
        f.name for f in fields(Robot) if not _same(getattr(old, f.name), getattr(robot, f.name))
    ]
    for name in changed:
        if name not in _WRITABLE:
            raise InvalidField(name, "another value", "the value of the old robot file")
    yaml = YAML()
    yaml.width = 4096
    yaml.indent(mapping=2, sequence=4, offset=2)
    yaml.preserve_quotes = True
    writer = _Writer(yaml.load(text), file, old, robot, provenance)
    writer.write(set(changed))
    stream = io.StringIO()
    yaml.dump(writer.document, stream)
    written = stream.getvalue()
    back = parse_robot(written, source="new robot file")
    for f in fields(Robot):
        if f.name != "provenance" and not _same(getattr(back, f.name), getattr(robot, f.name)):
            raise CarosacError(f"new robot file: {f.name} does not come back as it was written")
    return written


class _Writer:
    """The old document, and what is put into it."""

    def __init__(
        self, document: CommentedMap, file: RobotFile, old: Robot, robot: Robot, source: str
    ) -> None:
        self.document = document
        self._file = file
        self._old = old
        self._robot = robot
        self._source = source

    def write(self, changed: set[str]) -> None:
        """Put all that changed into the document."""
        robot = self._robot
        for name in changed.intersection(_TEXTS):
            self.document[name] = getattr(robot, name)
        if changed & {"exit_points", "exit_covariance"}:
            self._exit_points()
        if "anchor_points" in changed:
            self._anchor_points()
        for name in changed.intersection(_IN_CABLE):
            self._in_parts("cable", "cable_types", name, (name,), getattr(robot, name))
        for name, key in _IN_DRUM.items():
            if name in changed:
                self._in_parts("winch", "winches", name, ("drum", key), getattr(robot, name))
        if "run_length" in changed:
            for chain, value in zip(self.document["chains"], robot.run_length, strict=True):
                chain["run_length"] = _quantity("run_length", value)
            self._from("chains")
        self._body(changed)
        self._sensors(changed)
        if "calibrated" in changed or "calibration_covariance" in changed:
            self._calibration()

    def _from(self, path: str) -> None:
        """Say where a number comes from."""
        self.document["provenance"][path] = self._source

    def _exit_points(self) -> None:
        """Positions and covariances."""
        points = self.document["frame"]["exit_points"]
        robot = self._robot
        for i, chain in enumerate(self._file.chains):
            point = points[chain.exit_point]
            point["position"] = _flow(robot.exit_points[i])
            if robot.exit_covariance is None:
                continue
            point.pop("sigma", None)
            point["covariance"] = _matrix(robot.exit_covariance[i])
            point.fa.set_block_style()
        self._from("frame.exit_points")

    def _anchor_points(self) -> None:
        points = self.document["platform"]["anchor_points"]
        for chain, point in zip(self._file.chains, self._robot.anchor_points, strict=True):
            points[chain.anchor_point] = _flow(point)
        self._from("platform.anchor_points")

    def _in_parts(
        self, key: str, section: str, field: str, path: tuple[str, ...], values: Array
    ) -> None:
        """A number of each cable that stands in a part, which several chains may share.

        Args:
            key: Under which a chain names the part.
            section: Where the parts stand.
            field: Of the robot.
            path: In the part.
            values: One for each chain.
        """
        users: dict[str, list[int]] = {}
        for i, chain in enumerate(self.document["chains"]):
            users.setdefault(str(chain[key]), []).append(i)
        for name, rows in users.items():
            if np.ptp(values[rows]) <= _SAME * np.abs(values[rows]).max():
                self._set(section, name, field, path, values[rows[0]])
                continue
            part = self.document[section].pop(name)
            for i in rows:
                chain = self.document["chains"][i]
                own = f"{name}_{chain['name']}"
                self.document[section][own] = copy.deepcopy(part)
                chain[key] = own
                self._copy_provenance(f"{section}.{name}", f"{section}.{own}")
                self._set(section, own, field, path, values[i])
            self._drop_provenance(f"{section}.{name}")

    def _set(self, section: str, name: str, field: str, path: tuple[str, ...], value: Any) -> None:
        """Write one number of a part."""
        part = self.document[section][name]
        for step in path[:-1]:
            part = part[step]
        part[path[-1]] = _quantity(field, value)
        if field == "axial_stiffness":
            for other in ("youngs_modulus", "area", "material_density"):
                part.pop(other, None)
                self._drop_provenance(f"{section}.{name}.{other}")
        self._from(".".join((section, name, *path)))

    def _copy_provenance(self, old: str, new: str) -> None:
        sources = self.document["provenance"]
        for path in [p for p in sources if p == old or p.startswith(old + ".")]:
            sources[new + path[len(old) :]] = sources[path]

    def _drop_provenance(self, path: str) -> None:
        sources = self.document["provenance"]
        for known in [p for p in sources if p == path or p.startswith(path + ".")]:
            del sources[known]

    def _body(self, changed: set[str]) -> None:
        """Mass, centre and inertia of the platform without its payloads, and its drag."""
        platform, robot = self.document["platform"], self._robot
        if changed & {"mass", "center_of_mass", "inertia"}:
            body = _bare(robot, self._file)
            platform["mass"] = _quantity("mass", body.mass)
            platform["center_of_mass"] = _flow(body.center_of_mass)
            platform["inertia"] = _matrix(body.inertia)
            for name in ("mass", "center_of_mass", "inertia"):
                if name in changed:
                    self._from(f"platform.{name}")
        for name, key in (("drag", "linear"), ("angular_drag", "angular")):
            if name in changed:
                platform["air_drag"][key] = _quantity(name, getattr(robot, name))
                self._from("platform.air_drag")

    def _sensors(self, changed: set[str]) -> None:
        """What the sensors read."""
        robot = self._robot
        lengths = changed & {"length_offset", "length_scale", "length_delay"}
        if not lengths and "pose_rotation" not in changed:
            return
        if "sensors" not in self.document:  # `provenance` stays last but for the covariance
            at = list(self.document).index("provenance")
            self.document.insert(at, "sensors", CommentedMap())
        sensors = self.document["sensors"]
        if lengths:
            offset = np.zeros(robot.n) if robot.length_offset is None else robot.length_offset
            scale = np.ones(robot.n) if robot.length_scale is None else robot.length_scale
            cables = CommentedMap()
            for name, at_zero, more in zip(robot.cable_names, offset, scale, strict=True):
                cables[name] = CommentedMap(offset=_number(at_zero), scale=_number(more))
                cables[name].fa.set_flow_style()
            delay = _quantity("length_delay", robot.length_delay or 0.0)
            sensors["lengths"] = CommentedMap(delay=delay, cables=cables)
        if "pose_rotation" in changed and robot.pose_rotation is not None:
            turn = _flow(from_matrix(robot.pose_rotation[None])[0])
            sensors["poses"] = CommentedMap(quaternion_wxyz=turn)
        self._from("sensors")

    def _calibration(self) -> None:
        """What is known of all that was estimated."""
        robot = self._robot
        if robot.calibrated is None or robot.calibration_covariance is None:
            self.document.pop("calibration", None)
            self._drop_provenance("calibration")
            return
        section = self.document.setdefault("calibration", CommentedMap())
        section["parameters"] = list(robot.calibrated)
        rows = enumerate(robot.calibration_covariance)
        section["covariance"] = [_flow(row[: i + 1]) for i, row in rows]
        self._from("calibration")


def _same(a: Any, b: Any) -> bool:
    """Whether two fields are the same but for rounding."""
    if a is None or b is None:
        return a is b
    if isinstance(a, str | tuple | Mapping):
        return bool(a == b)
    first, second = np.asarray(a), np.asarray(b)
    if first.shape != second.shape:
        return False
    size = max(float(np.abs(first).max(initial=0.0)), float(np.abs(second).max(initial=0.0)))
    return bool(np.abs(first - second).max(initial=0.0) <= _SAME * size)


def _bare(robot: Robot, file: RobotFile) -> RigidBody:
    """The platform without the payloads of the file."""
    whole = RigidBody(robot.mass, robot.center_of_mass, robot.inertia)
    payloads = [
        RigidBody(p.mass, np.array(p.center_of_mass), np.array(p.inertia))
        for p in file.platform.payloads
    ]
    if not payloads:
        return whole
    load = combine_bodies(payloads)
    bare = combine_bodies([whole, RigidBody(-load.mass, load.center_of_mass, -load.inertia)])
    if bare.mass <= 0.0 or np.linalg.eigvalsh(bare.inertia)[0] <= 0.0:
        allowed = "a mass and inertia above those of the payloads in the robot file"
        raise InvalidField("mass", f"{robot.mass:.6g} kg", allowed)
    return bare


def _number(value: float) -> float:
    return float(f"{value:.{_DIGITS}g}")


def _quantity(field: str, value: float) -> str | float:
    """A number with its unit, as in the bundled files."""
    unit = unit_of(field)
    return _number(value) if unit == "1" else f"{value:.{_DIGITS}g} {unit}"


def _flow(values: Sequence[float] | Array, digits: int = _DIGITS) -> CommentedSeq:
    """A list on one line."""
    found = CommentedSeq([float(f"{value:.{digits}g}") for value in values])
    found.fa.set_flow_style()
    return found


def _matrix(rows: Array) -> CommentedSeq:
    """A matrix on one line."""
    found = CommentedSeq([_flow(row) for row in rows])
    found.fa.set_flow_style()
    return found
