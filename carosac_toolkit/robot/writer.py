"""A robot file with other numbers: comments, order and units of the old file stay.

Only what differs is written, and what was written is read back and compared, so that a new file
either is the robot or does not come to be.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from typing import Any

import numpy as np
from ruamel.yaml.comments import CommentedMap, CommentedSeq

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import CarosacError, InvalidField
from carosac_toolkit.base.rotations import from_matrix
from carosac_toolkit.base.yaml import dump_yaml, round_trip
from carosac_toolkit.robot.differences import SAME_VALUE_TOLERANCE, differing, same
from carosac_toolkit.robot.file import parse_file, parse_robot
from carosac_toolkit.robot.model_error import MODEL_ERROR_UNITS
from carosac_toolkit.robot.parameter_names import unit_of
from carosac_toolkit.robot.robot import RigidBody, Robot, combine_bodies
from carosac_toolkit.robot.schema import RobotFile

_SIGNIFICANT_DIGITS = 12  # of written numbers
_CABLE_TYPE_FIELDS = (
    "linear_density", "axial_stiffness", "axial_damping", "exit_friction", "anchor_friction",
    "capstan_friction",
)  # fmt: skip
_WINCH_PATHS: dict[str, tuple[str, ...]] = {
    "drum_radius": ("drum", "radius"), "drum_buildup": ("drum", "buildup"),
    "length_hysteresis": ("length_hysteresis",),
}  # fmt: skip
_SENSOR_PATHS = {
    "length_offset": "sensors.lengths.cables", "length_scale": "sensors.lengths.cables",
    "length_delay": "sensors.lengths.delay",
}  # fmt: skip
_TEXT_FIELDS = ("name", "description", "licence")
_WRITABLE_FIELDS = (
    *_TEXT_FIELDS, *_CABLE_TYPE_FIELDS, *_WINCH_PATHS, "exit_points", "exit_covariance",
    "anchor_points", "run_length", "mass", "center_of_mass", "inertia", "drag", "angular_drag",
    "angular_drag_axes", "cable_drag", "length_offset", "length_scale", "length_delay",
    "pose_rotation", "calibrated", "calibration_covariance", "model_error", "provenance",
)  # fmt: skip


def robot_document(text: str, robot: Robot, *, provenance: str) -> str:
    """Return the text of a robot file with the numbers of another robot.

    Args:
        text: The file that the robot was made from, unchanged parts of which are kept.
        robot: The same cables with other numbers.
        provenance: Source of the new numbers; written to the file for each of them.

    Returns:
        YAML of schema ``carosac-robot/1`` that `parse_robot` turns into `robot`, provenance aside.

    Raises:
        InvalidFile: The old file has faults.
        InvalidField: The robot differs in something that is not calibrated, such as its cables.
    """
    old, file = parse_file(text)
    changed = differing(old, robot)
    for name in changed:
        if name not in _WRITABLE_FIELDS:
            raise InvalidField(name, "another value", "the value of the old robot file")
    writer = _Writer(round_trip().load(text), file, old, robot, provenance)
    writer.write(set(changed))
    written = dump_yaml(writer.document)
    for name in differing(parse_robot(written, source="new robot file"), robot):
        if name != "provenance":
            raise CarosacError(f"new robot file: {name} differs when read back")
    return written


class _Writer:
    """The old document with the new values."""

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
        kinds = self._file.cable_types.values()
        if "linear_density" in changed and any(kind.material_density for kind in kinds):
            changed |= {"axial_stiffness"}  # the old file has it from the density
        for name in sorted(changed.intersection(_TEXT_FIELDS), key=_TEXT_FIELDS.index):
            self.document[name] = getattr(robot, name)
        if changed & {"exit_points", "exit_covariance"}:
            self._exit_points()
        if "anchor_points" in changed:
            self._anchor_points()
        for name in sorted(changed.intersection(_CABLE_TYPE_FIELDS), key=_CABLE_TYPE_FIELDS.index):
            self._in_parts("cable", "cable_types", name, (name,), getattr(robot, name))
        for name, path in _WINCH_PATHS.items():
            if name in changed:
                self._in_parts("winch", "winches", name, path, getattr(robot, name))
        if "run_length" in changed:
            self._run_length()
        self._body(changed)
        self._sensors(changed)
        if "calibrated" in changed or "calibration_covariance" in changed:
            self._calibration()
        self._model_error(changed)

    def _from(self, path: str, but: Sequence[str] = ()) -> None:
        """Record the source of a number.

        Args:
            path: Of the number, or the start of the path of several.
            but: Paths below it whose numbers are those of the old file.
        """
        sources = self.document["provenance"]
        kept = {other: self._source_of(other) for other in but}
        for known in [p for p in sources if _covers(path, p)]:
            del sources[known]
        sources[path] = self._source
        sources.update({other: source for other, source in kept.items() if source is not None})

    def _source_of(self, path: str) -> str | None:
        """Return the source of a number of the old file; None if it is given for its parts."""
        sources = self.document["provenance"]
        covering = [p for p in sources if _covers(p, path)]
        return str(sources[max(covering, key=len)]) if covering else None

    def _exit_points(self) -> None:
        """Write positions and covariances."""
        robot, points = self._robot, self.document["frame"]["exit_points"]
        known = [robot.exit_points]
        if robot.exit_covariance is not None:
            known.append(robot.exit_covariance.reshape(robot.n, 9))
        path = "frame.exit_points"
        self._own_points("exit_point", path, points, np.hstack(known))
        used, kept = set(), list[str]()
        for i, chain in enumerate(self.document["chains"]):
            used.add(name := _key(points, chain["exit_point"]))
            kept += [] if self._moved(i) else [f"{path}.{name}"]
            point = points[name]
            point["position"] = _flow(robot.exit_points[i])
            if robot.exit_covariance is None:
                continue
            point.pop("sigma", None)
            point["covariance"] = _matrix(robot.exit_covariance[i])
            point.fa.set_block_style()
        spare = [f"{path}.{name}" for name in points if name not in used]
        pulleys = [
            f"{path}.{name}.pulley" for name in points if name in used and "pulley" in points[name]
        ]
        self._from(path, but=[*spare, *kept, *pulleys])

    def _moved(self, i: int) -> bool:
        """Return True if anything about an exit point has changed."""
        old, new = self._old, self._robot
        if not same(old.exit_points[i], new.exit_points[i]):
            return True
        if old.exit_covariance is None or new.exit_covariance is None:
            return old.exit_covariance is not new.exit_covariance
        return not same(old.exit_covariance[i], new.exit_covariance[i])

    def _anchor_points(self) -> None:
        robot, points = self._robot, self.document["platform"]["anchor_points"]
        path = "platform.anchor_points"
        self._own_points("anchor_point", path, points, robot.anchor_points)
        used, kept = set(), list[str]()
        for i, chain in enumerate(self.document["chains"]):
            used.add(name := _key(points, chain["anchor_point"]))
            if same(self._old.anchor_points[i], robot.anchor_points[i]):
                kept.append(f"{path}.{name}")
            points[name] = _flow(robot.anchor_points[i])
        spare = [f"{path}.{name}" for name in points if name not in used]
        self._from(path, but=[*spare, *kept])

    def _own_points(self, key: str, path: str, points: CommentedMap, values: Array) -> None:
        """Split a point shared by chains whose numbers now differ.

        Args:
            key: Under which a chain names the point.
            path: Of the points in the file.
            points: By name.
            values: Numbers to write of the point, for each chain, shape (n, k).
        """
        for name, rows in self._users(key).items():
            if len(rows) == 1 or not np.ptp(values[rows], axis=0).any():
                continue
            shared = points.pop(_key(points, name))
            for i in rows:
                own = self._own_name(points, name, i)
                points[own] = copy.deepcopy(shared)
                self._copy_provenance(f"{path}.{name}", f"{path}.{own}")
                self.document["chains"][i][key] = own

    def _users(self, key: str) -> dict[str, list[int]]:
        """Group chains by the part that they name."""
        users: dict[str, list[int]] = {}
        for i, chain in enumerate(self.document["chains"]):
            users.setdefault(str(chain[key]), []).append(i)
        return users

    def _own_name(self, section: CommentedMap, name: str, row: int) -> str:
        """Return a new name for the part of one chain."""
        own = f"{name}_{self._file.chains[row].name}"
        while own in section:
            own += "_"
        return own

    def _run_length(self) -> None:
        """Write the run length of each chain, which counts instead of its winch's."""
        for i, value in enumerate(self._robot.run_length):
            self.document["chains"][i]["run_length"] = _quantity("run_length", value)
            self._from(f"chains[{i}].run_length")
        for name in self._users("winch"):
            self._drop_provenance(f"winches.{name}.run_length")

    def _in_parts(
        self, key: str, section: str, field: str, path: tuple[str, ...], values: Array
    ) -> None:
        """Write a number of each cable that stands in a part, which several chains may share.

        Args:
            key: Under which a chain names the part.
            section: Section of the parts.
            field: Of the robot.
            path: In the part.
            values: One for each chain.
        """
        parts = self.document[section]
        for name, rows in self._users(key).items():
            if np.ptp(values[rows]) <= SAME_VALUE_TOLERANCE * np.abs(values[rows]).max():
                self._set(section, _key(parts, name), field, path, values[rows[0]])
                continue
            part = parts.pop(_key(parts, name))
            for i in rows:
                own = self._own_name(parts, name, i)
                parts[own] = copy.deepcopy(part)
                self.document["chains"][i][key] = own
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
        for path in [p for p in sources if _covers(old, p)]:
            sources[new + path[len(old) :]] = sources[path]

    def _drop_provenance(self, path: str) -> None:
        sources = self.document["provenance"]
        for known in [p for p in sources if _covers(path, p)]:
            del sources[known]

    def _body(self, changed: set[str]) -> None:
        """Write mass, centre and inertia of the platform without its payloads, and its drag."""
        platform, robot = self.document["platform"], self._robot
        if changed & {"mass", "center_of_mass", "inertia"}:
            body, old = _bare(robot, self._file), self._file.platform
            if not same(body.mass, old.mass):
                platform["mass"] = _quantity("mass", body.mass)
                self._from("platform.mass")
            if not same(body.center_of_mass, old.center_of_mass):
                platform["center_of_mass"] = _flow(body.center_of_mass)
                self._from("platform.center_of_mass")
            if not same(body.inertia, old.inertia):
                platform["inertia"] = _matrix(body.inertia)
                self._from("platform.inertia")
        drags = {"drag": "linear", "angular_drag": "angular", "cable_drag": "cables"}
        for name, key in drags.items():
            if name in changed and getattr(robot, name) is None:
                del platform["air_drag"][key]
                self._drop_provenance(f"platform.air_drag.{key}")
            elif name in changed:
                platform["air_drag"][key] = _quantity(name, getattr(robot, name))
                self._from(f"platform.air_drag.{key}")
        if "angular_drag_axes" in changed:
            platform["air_drag"]["angular_axes"] = _flow(robot.angular_drag_axes)
            self._from("platform.air_drag.angular_axes")

    def _sensors(self, changed: set[str]) -> None:
        """Write the sensor parameters."""
        robot = self._robot
        lengths = changed & {"length_offset", "length_scale", "length_delay"}
        if not lengths and "pose_rotation" not in changed:
            return
        if "sensors" not in self.document:  # `provenance` stays last but for the covariance
            at = list(self.document).index("provenance")
            self.document.insert(at, "sensors", CommentedMap())
        sensors = self.document["sensors"]
        if lengths:
            known = "lengths" in sensors
            offset = np.zeros(robot.n) if robot.length_offset is None else robot.length_offset
            scale = np.ones(robot.n) if robot.length_scale is None else robot.length_scale
            cables = CommentedMap()
            for name, at_zero, more in zip(robot.cable_names, offset, scale, strict=True):
                cables[name] = CommentedMap(offset=_number(at_zero), scale=_number(more))
                cables[name].fa.set_flow_style()
            delay = _quantity("length_delay", robot.length_delay or 0.0)
            sensors["lengths"] = CommentedMap(delay=delay, cables=cables)
            for path in {_SENSOR_PATHS[name] for name in lengths} if known else {"sensors.lengths"}:
                self._from(path)
        if "pose_rotation" in changed and robot.pose_rotation is not None:
            turn = _flow(from_matrix(robot.pose_rotation[None])[0])
            sensors["poses"] = CommentedMap(quaternion_wxyz=turn)
            self._from("sensors.poses")

    def _calibration(self) -> None:
        """Write the covariance of all that was estimated."""
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

    def _model_error(self, changed: set[str]) -> None:
        """Write what the model misses, above the provenance."""
        if "model_error" not in changed:
            return
        error, document = self._robot.model_error, self.document
        document.pop("model_error", None)
        self._drop_provenance("model_error")
        if error is None:
            return
        section = CommentedMap(
            {name: _with_unit(getattr(error, name), unit)
             for name, unit in MODEL_ERROR_UNITS.items()}
        )  # fmt: skip
        document.insert(list(document).index("provenance"), "model_error", section)
        self._from("model_error")


def _covers(path: str, other: str) -> bool:
    """Return True if one path is another, or the start of it."""
    return other == path or other.startswith((f"{path}.", f"{path}["))


def _key(mapping: CommentedMap, name: object) -> Any:
    """Return the key of a mapping by its text; a name may look like a number."""
    return next(key for key in mapping if str(key) == str(name))


def _bare(robot: Robot, file: RobotFile) -> RigidBody:
    """Return the platform without the payloads of the file."""
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
    return float(f"{value:.{_SIGNIFICANT_DIGITS}g}")


def _quantity(field: str, value: float) -> str | float:
    """Format a number with its unit, as in the bundled files."""
    return _with_unit(value, unit_of(field))


def _with_unit(value: float, unit: str) -> str | float:
    if unit == "1":
        return _number(value)
    return f"{value:.{_SIGNIFICANT_DIGITS}g} {unit}"


def _flow(values: Sequence[float] | Array, digits: int = _SIGNIFICANT_DIGITS) -> CommentedSeq:
    """Format a list on one line."""
    sequence = CommentedSeq([float(f"{value:.{digits}g}") for value in values])
    sequence.fa.set_flow_style()
    return sequence


def _matrix(rows: Array) -> CommentedSeq:
    """Format a matrix on one line."""
    sequence = CommentedSeq([_flow(row) for row in rows])
    sequence.fa.set_flow_style()
    return sequence
