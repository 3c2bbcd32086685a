"""The robot: geometry, masses, cables, winches and limits, as plain arrays."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from carosac_toolkit.base.arrays import Array, frozen_array, set_frozen
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.base.npz import read_npz, write_npz
from carosac_toolkit.robot.hardware import Hardware
from carosac_toolkit.robot.model_error import ModelError
from carosac_toolkit.robot.parameter_names import check_names


class RigidBody(NamedTuple):
    """A rigid body fixed to the platform.

    Attributes:
        mass: [kg].
        center_of_mass: In platform frame P [m], shape (3,).
        inertia: About its own centre of mass, axes of P [kg m^2], shape (3, 3).
    """

    mass: float
    center_of_mass: Array
    inertia: Array


def combine_bodies(bodies: Iterable[RigidBody]) -> RigidBody:
    """Combine platform and payloads into one rigid body (parallel-axis theorem)."""
    parts = list(bodies)
    mass = sum(part.mass for part in parts)
    center = sum((part.mass * part.center_of_mass for part in parts), np.zeros(3)) / mass
    inertia = np.zeros((3, 3))
    for part in parts:
        arm = part.center_of_mass - center
        inertia += part.inertia + part.mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    return RigidBody(mass, center, inertia)


@dataclass(frozen=True, kw_only=True, eq=False)
class Robot:
    """A cable-driven parallel robot with n cables; the world frame W has z up, against gravity.

    Attributes:
        name: Short name.
        cable_names: One name per cable, n of them.
        exit_points: Datum of each cable in W [m], shape (n, 3): with pulley radius 0 the point
            where it leaves the frame, else the tangent point at zero wrap, on the swivel axis.
        exit_covariance: Covariance of each exit point in W [m^2], shape (n, 3, 3); None: unknown.
        pulley_radius: Pulley radius, groove to axle [m], shape (n,); 0 means a fixed eyelet.
        swivel_axis: Unit vector in W along which the cable travels from the winch into the
            pulley, about which the pulley swivels, shape (n, 3); unused where the radius is 0.
        run_length: Cable between winch and datum [m], shape (n,); constant, but it stretches.
        anchor_points: Cable ends on the platform, in platform frame P [m], shape (n, 3).
        linear_density: Mass per unstrained length [kg/m], shape (n,).
        axial_stiffness: EA [N], shape (n,).
        axial_damping: Tension per strain rate [N s], shape (n,).
        exit_friction: Dry moment that resists turning of the cable at its exit: of the pulley about
            its swivel axis, at an eyelet in all directions [N m], shape (n,) or (1,).
        anchor_friction: Dry moment between cable and platform at the anchor [N m], the same shape.
        capstan_friction: Friction coefficient mu of the cable where it wraps its pulley by an angle
            theta: sliding, tensions on both sides have the ratio exp(mu theta); at an eyelet,
            exp(mu) [1], the same shape; at most 2.
        length_hysteresis: By how much less cable a winch has paid out than it has turned for, after
            it has paid out for long; more after winding in [m], the same shape.
        cable_diameter: [m], shape (n,).
        tension_min: Lowest allowed tension at the platform [N], shape (n,).
        tension_max: Highest allowed tension at the platform [N], shape (n,).
        speed_max: Fastest change of unstrained length [m/s], shape (n,).
        acceleration_max: Fastest change of that speed [m/s^2], shape (n,).
        winch_lag: Time constant from commanded to wound length [s], shape (n,).
        length_min: Shortest unstrained length the winch can reach [m], shape (n,).
        length_max: Longest unstrained length the winch can reach [m], shape (n,).
        drum_radius: At unstrained length 0, the cable fully wound in [m], shape (n,); None:
            unknown, lengths are commanded directly.
        drum_buildup: Decrease of the squared drum radius per length of line paid out [m], shape
            (n,); None: unknown.
        drum_gear: Turns of the motor per turn of the drum, shape (n,); None: unknown.
        drum_advantage: Line paid out per change of the cable's length, as by a tackle, shape (n,);
            None: 1.
        mass: Platform with payloads [kg].
        center_of_mass: Of platform with payloads, in P [m], shape (3,).
        inertia: Of platform with payloads, about the centre of mass, axes of P [kg m^2], (3, 3).
        drag: Air drag force per platform speed [N s/m].
        angular_drag: Air drag moment per angular speed [N m s/rad].
        angular_drag_axes: Factors of it about the axes of P [1], shape (3,).
        cable_drag: Air drag force on the cables per mass and speed [1/s]; None: unknown, what is
            usual for a robot of this size.
        gravity: Magnitude of gravity, along -z of W [m/s^2].
        workspace_min: Lower corner of the workspace box of the platform origin in W [m], (3,).
        workspace_max: Upper corner [m], (3,).
        home_position: Platform origin at home in W [m], (3,).
        home_rotation: Rotation from P to W at home, (3, 3).
        length_offset: Reading of the length sensors at unstrained length 0 [m], shape (n,); None:
            0, they were not calibrated.
        length_scale: Change of the reading per unstrained length, shape (n,); None: 1.
        length_delay: By how much their readings lead poses measured at the same time [s]; None: 0.
        pose_rotation: Rotation from the frame of measured poses to W, (3, 3); None: the same frame.
        calibrated: Parameters that a calibration estimated (`carosac_toolkit.robot.parameters`),
            k of them; None: not calibrated.
        calibration_covariance: Their joint covariance, shape (k, k).
        model_error: What the model misses, as a recording told; None: unknown.
        hardware: Connection to the real robot; None: not described.
        description: One line of text.
        licence: Terms under which the numbers may be used.
        provenance: Sources of the numbers, by field of the robot file.
    """

    name: str
    cable_names: tuple[str, ...]
    exit_points: Array
    exit_covariance: Array | None
    pulley_radius: Array
    swivel_axis: Array
    run_length: Array
    anchor_points: Array
    linear_density: Array
    axial_stiffness: Array
    axial_damping: Array
    cable_diameter: Array
    tension_min: Array
    tension_max: Array
    speed_max: Array
    acceleration_max: Array
    winch_lag: Array
    length_min: Array
    length_max: Array
    drum_radius: Array | None
    drum_buildup: Array | None
    mass: float
    center_of_mass: Array
    inertia: Array
    drag: float
    angular_drag: float
    gravity: float
    workspace_min: Array
    workspace_max: Array
    home_position: Array
    home_rotation: Array
    description: str
    licence: str
    provenance: Mapping[str, str]
    exit_friction: Array = field(default_factory=lambda: np.zeros(1))
    anchor_friction: Array = field(default_factory=lambda: np.zeros(1))
    capstan_friction: Array = field(default_factory=lambda: np.zeros(1))
    length_hysteresis: Array = field(default_factory=lambda: np.zeros(1))
    angular_drag_axes: Array = field(default_factory=lambda: np.ones(3))
    cable_drag: float | None = None
    drum_gear: Array | None = None
    drum_advantage: Array | None = None
    length_offset: Array | None = None
    length_scale: Array | None = None
    length_delay: float | None = None
    pose_rotation: Array | None = None
    calibrated: tuple[str, ...] | None = None
    calibration_covariance: Array | None = None
    model_error: ModelError | None = None
    hardware: Hardware | None = None

    def __post_init__(self) -> None:
        """Freeze every array and check every number that the physics needs."""
        self._check_names()
        n = self.n
        for name in _SCALAR_FIELDS:
            object.__setattr__(self, name, _scalar(name, getattr(self, name)))
        set_frozen(self, {name: (n, 3) for name in ("exit_points", "anchor_points", "swivel_axis")})
        for name in DRY_FIELDS:
            if np.shape(getattr(self, name)) == (1,):
                object.__setattr__(self, name, np.repeat(getattr(self, name), n))
        set_frozen(self, {name: (n,) for name in _CABLE_FIELDS + DRY_FIELDS})
        set_frozen(self, {name: (3,) for name in _VECTOR_FIELDS})
        set_frozen(self, {"inertia": (3, 3), "home_rotation": (3, 3)})
        for name, shape in _OPTIONAL_SHAPES.items():
            value = getattr(self, name)
            if value is not None:
                object.__setattr__(self, name, frozen_array(name, value, (n, *shape)))
        for name in ("length_delay", "cable_drag"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, _scalar(name, getattr(self, name)))
        if self.pose_rotation is not None:
            set_frozen(self, {"pose_rotation": (3, 3)})
        self._check_signs()
        self._check_order()
        self._check_matrices()
        self._check_calibration()
        if self.hardware is not None and self.hardware.n != n:
            raise InvalidField("hardware", f"{self.hardware.n} cables", f"{n} cables")

    @property
    def n(self) -> int:
        """Number of cables."""
        return len(self.cable_names)

    @property
    def weight_per_length(self) -> Array:
        """Weight per unstrained length of each cable [N/m], shape (n,)."""
        return self.linear_density * self.gravity

    @property
    def weight(self) -> float:
        """Weight of the platform with payloads [N]."""
        return self.mass * self.gravity

    def to_npz(self, path: str | Path) -> None:
        """Write all fields to one ``.npz`` file, readable with numpy alone."""
        record = asdict(self)
        arrays = {k: v for k, v in record.items() if isinstance(v, np.ndarray)}
        write_npz(path, "__fields__", {k: v for k, v in record.items() if k not in arrays}, arrays)

    @classmethod
    def from_npz(cls, path: str | Path) -> Robot:
        """Read what `to_npz` wrote.

        Raises:
            MissingFile: There is no such file.
            InvalidField: The file was not written by `to_npz`.
        """

        def build(rest: Any, arrays: dict[str, NDArray[Any]]) -> Robot:
            # files older than these
            none = {name: np.zeros(1) for name in DRY_FIELDS} | {"angular_drag_axes": np.ones(3)}
            record = {"hardware": None, "model_error": None, "cable_drag": None}
            record = record | none | rest | arrays
            unknown = set(record) ^ {each.name for each in fields(cls)}
            if unknown:
                allowed = f"the fields of Robot; differing: {sorted(unknown)}"
                raise InvalidField("path", path, allowed)
            hardware, error = Hardware.from_record(record["hardware"]), record["model_error"]
            known = None if error is None else ModelError(**error)
            return cls(**record | {"hardware": hardware, "model_error": known})

        return read_npz(path, "__fields__", "Robot.to_npz", build)

    def _check_names(self) -> None:
        """Refuse cable names that are missing, doubled or no list of texts."""
        names = self.cable_names
        listed = isinstance(names, list | tuple) and all(isinstance(x, str) for x in names)
        if not listed or not names or len(set(names)) != len(names):
            allowed = "at least one cable, all names different"
            raise InvalidField("cable_names", repr(names), allowed)
        object.__setattr__(self, "cable_names", tuple(names))

    def _check_signs(self) -> None:
        """Refuse numbers that must be positive, or not negative."""
        for name in _POSITIVE_FIELDS + _NOT_NEGATIVE_FIELDS:
            value = getattr(self, name)
            if value is None:
                continue
            entries = np.atleast_1d(np.asarray(value, dtype=np.float64))
            strict = name in _POSITIVE_FIELDS
            bad = ~((entries > 0.0) if strict else (entries >= 0.0)) | ~np.isfinite(entries)
            if bad.any():
                index = int(np.argmax(bad))
                where = f"{name}[{index}]" if np.ndim(value) else name
                raise InvalidField(where, entries[index], f"{name} {'>' if strict else '>='} 0")
        much = self.capstan_friction > CAPSTAN_FRICTION_MAX
        if much.any():
            index = int(np.argmax(much))
            allowed = f"capstan_friction <= {CAPSTAN_FRICTION_MAX:g}"
            raise InvalidField(f"capstan_friction[{index}]", self.capstan_friction[index], allowed)

        most = HYSTERESIS_SHARE_MAX * self.length_max
        wide = self.length_hysteresis > most
        if wide.any():
            index = int(np.argmax(wide))
            raise InvalidField(
                f"length_hysteresis[{index}]", f"{self.length_hysteresis[index]} m",
                f"length_hysteresis <= {most[index]:.3g} m, {HYSTERESIS_SHARE_MAX:.0%} of "
                "length_max: is its unit right?",
            )  # fmt: skip

    def _check_order(self) -> None:
        """Refuse limits whose lower end is not below the upper one."""
        for low, high in _ORDERED_FIELDS:
            lower, upper = getattr(self, low), getattr(self, high)
            if (lower >= upper).any():
                index = int(np.argmax(lower >= upper))
                raise InvalidField(f"{low}[{index}]", lower[index], f"{low} < {upper[index]}")

    def _check_matrices(self) -> None:
        """Refuse an inertia, rotation, axis or covariance that cannot exist."""
        moments = np.linalg.eigvalsh(self.inertia)
        symmetric = np.allclose(self.inertia, self.inertia.T, rtol=1e-9, atol=1e-12)
        possible = moments[0] > 0.0 and moments[2] <= (moments[0] + moments[1]) * (1 + 1e-9)
        if not (symmetric and possible):
            raise InvalidField(
                "inertia",
                np.array2string(self.inertia, separator=", ").replace("\n", ""),
                "a symmetric positive definite matrix whose principal moments fulfil "
                "I_max <= sum of the other two",
            )
        for name in ("home_rotation", "pose_rotation"):
            turn = getattr(self, name)
            if turn is None:
                continue
            if not np.allclose(turn @ turn.T, np.eye(3), atol=1e-9) or np.linalg.det(turn) < 0:
                raise InvalidField(name, "not a rotation matrix", "R R^T = 1, det +1")
        length = np.linalg.norm(self.swivel_axis, axis=1)
        bad = (np.abs(length - 1.0) > 1e-9) & (self.pulley_radius > 0.0)
        if bad.any():
            index = int(np.argmax(bad))
            raise InvalidField(f"swivel_axis[{index}]", self.swivel_axis[index], "a unit vector")
        if self.exit_covariance is not None:
            mirrored = self.exit_covariance.swapaxes(1, 2)
            if not np.allclose(self.exit_covariance, mirrored, rtol=1e-9, atol=1e-18):
                raise InvalidField("exit_covariance", "an asymmetric matrix", "symmetric")
            smallest = np.linalg.eigvalsh(self.exit_covariance)[:, 0]
            if (smallest < -1e-15).any():
                index = int(np.argmin(smallest))
                raise InvalidField(
                    f"exit_covariance[{index}]", "a negative variance", "positive semidefinite"
                )

    def _check_calibration(self) -> None:
        """Refuse parameters that the robot does not have, and an invalid covariance."""
        if (self.calibrated is None) != (self.calibration_covariance is None):
            allowed = "calibrated and calibration_covariance, or neither"
            raise InvalidField("calibrated", self.calibrated, allowed)
        if self.calibrated is None:
            return
        check_names(self.cable_names, self.calibrated)
        if "cable_drag" in self.calibrated and self.cable_drag is None:
            raise InvalidField("calibrated", "'cable_drag'", "what the robot has: it has none")
        object.__setattr__(self, "calibrated", tuple(self.calibrated))
        count = len(self.calibrated)
        set_frozen(self, {"calibration_covariance": (count, count)})
        matrix = np.asarray(self.calibration_covariance)
        scale = np.sqrt(np.maximum(np.diag(matrix), np.finfo(float).tiny))
        unit = matrix / np.outer(scale, scale)
        if not np.allclose(unit, unit.T, atol=1e-6) or np.linalg.eigvalsh(unit)[0] < -1e-6:
            allowed = "a symmetric positive semidefinite matrix"
            raise InvalidField("calibration_covariance", "no valid covariance", allowed)


def _scalar(name: str, value: object) -> float:
    """Convert to one number, or raise an error that names the field."""
    if isinstance(value, bool) or not isinstance(value, int | float | np.floating | np.integer):
        raise InvalidField(name, repr(value), "a number")
    return float(value)


_SCALAR_FIELDS = ("mass", "drag", "angular_drag", "gravity")
_CABLE_FIELDS = (
    "pulley_radius", "run_length", "linear_density", "axial_stiffness", "axial_damping",
    "cable_diameter", "tension_min", "tension_max", "speed_max", "acceleration_max", "winch_lag",
    "length_min", "length_max",
)  # fmt: skip
CAPSTAN_FRICTION_MAX = 2.0  # coefficients of cables on pulleys are below 1
HYSTERESIS_SHARE_MAX = 0.02  # of the longest length: more is a wrong unit
DRY_FIELDS = (
    "exit_friction", "anchor_friction", "capstan_friction", "length_hysteresis"
)  # fmt: skip  # 0 where not given
_VECTOR_FIELDS = (
    "center_of_mass", "angular_drag_axes", "workspace_min", "workspace_max", "home_position",
)  # fmt: skip
_OPTIONAL_SHAPES: dict[str, tuple[int, ...]] = {
    "exit_covariance": (3, 3),
    "drum_radius": (),
    "drum_buildup": (),
    "drum_gear": (),
    "drum_advantage": (),
    "length_offset": (),
    "length_scale": (),
}
_POSITIVE_FIELDS = (
    "mass", "gravity", "linear_density", "axial_stiffness", "cable_diameter", "speed_max",
    "acceleration_max", "drum_radius", "drum_gear", "drum_advantage", "length_scale",
)  # fmt: skip
_NOT_NEGATIVE_FIELDS = (
    "pulley_radius", "run_length", "axial_damping", "tension_min", "winch_lag", "length_min",
    "drum_buildup", "drag", "angular_drag", "angular_drag_axes", "cable_drag", *DRY_FIELDS,
)  # fmt: skip
_ORDERED_FIELDS = (
    ("tension_min", "tension_max"),
    ("length_min", "length_max"),
    ("workspace_min", "workspace_max"),
)
