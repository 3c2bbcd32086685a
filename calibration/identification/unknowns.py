"""Coordinates in which a robot is identified: each starts at 0 and has a prior sigma of about 1.

What must stay positive is a factor exp(sigma u). The inertia is varied through the second moments
of the mass, S = 1/2 tr(I) 1 - I, as S -> D L S L^T D with D diagonal and positive, and L triangular
with a diagonal of ones: whatever the coordinates are, a real body can have it. Stiffness and run
length are varied at a constant stiffness of the whole cable at home: EA = k (L + run), where data
often know k alone. Dry friction is varied at a constant ratio to the mass: all forces and masses by
one factor give the same motion, and that factor is a straight line in coordinates, though data
hardly know it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from calibration.estimate import ParameterEstimate
from calibration.identification.settings import IdentificationSettings
from calibration.identification.spread import Spread
from calibration.lengths.unknowns import is_anchored
from calibration.prior import Prior
from calibration.robot_update import prior_covariance
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.base.scaled import resolved
from carosac_toolkit.physics.device import lever
from carosac_toolkit.physics.motion.cable_drag import cable_drag_of
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.robot.parameter_names import field_of, point_names
from carosac_toolkit.robot.parameters import fields_with, frame_turn, values_of
from carosac_toolkit.robot.robot import DRY_FIELDS, Robot

PARAMETER_DERIVATIVE_STEP = 1e-6  # of the coordinates, for the derivatives of parameters
STEP_SHARE_MIN = 0.25  # least share of itself that a step leaves of a factor, or of 1 / EA
_INERTIA_NAMES = ("inertia.xx", "inertia.yy", "inertia.zz")
_PRODUCT_PLACES = {"inertia.xy": (1, 0), "inertia.xz": (2, 0), "inertia.yz": (2, 1)}
_FORCE_FIELDS = (
    "mass",
    "linear_density",
    "axial_stiffness",
    "axial_damping",
    "drag",
    "angular_drag",
)
_FACTOR_FIELDS = (*_FORCE_FIELDS, "angular_drag_axes", "cable_drag")
_NOT_NEGATIVE_FIELDS = (
    "run_length",
    "length_delay",  # estimators cannot look ahead
    *DRY_FIELDS,
)
_FRICTION_FIELDS = ("exit_friction", "anchor_friction")  # in proportion to the mass
_PER_CABLE_FIELDS = (
    "linear_density", "axial_stiffness", "axial_damping", "run_length", "exit_friction",
    "anchor_friction", "capstan_friction",
)  # fmt: skip


@dataclass(frozen=True, kw_only=True, eq=False)
class Coordinates:
    """k coordinates about a robot.

    Attributes:
        robot: The robot at coordinates 0.
        prior: Of the coordinates, under the names of the parameters that they change; the
            inertia's stand for the spread of mass along that axis. The mean is 0.
        scale: Change of a parameter by a coordinate of 1, or logarithm of its factor, shape (k,).
        factor: 1 for a factor, 0 for a change, shape (k,).
        lower: Least coordinates, shape (k,).
        reach: Mean length of the cables at home, straight [m].
        anchored: True if the exit points are held, or known apart from the measured poses. If not,
            they are in the frame of the poses, and turn with it where that is tilted.
    """

    robot: Robot
    prior: Prior
    scale: Array
    factor: Array
    lower: Array
    reach: float
    anchored: bool

    def robot_at(self, coordinates: Array) -> Robot:
        """Return the robot of some coordinates, shape (k,).

        Raises:
            InvalidField: There is no such robot.
        """
        robot, start = self.robot, values_of(self.robot, self.prior.names)
        shares = self.scale * coordinates
        values = np.where(self.factor > 0.0, start * np.exp(shares), start + shares)
        for i, name in enumerate(self.prior.names):
            if field_of(name) == "axial_stiffness":
                values[i] *= self._lengthening(name, values)
            elif field_of(name) in _FRICTION_FIELDS and "mass" in self.prior.names:
                values[i] *= values[self.prior.names.index("mass")] / robot.mass
        of_body = (*_INERTIA_NAMES, *_PRODUCT_PLACES)
        plain = [i for i, name in enumerate(self.prior.names) if name not in of_body]
        changed = fields_with(robot, [self.prior.names[i] for i in plain], values[plain])
        if not self.anchored:
            before = robot.pose_rotation
            turn = frame_turn(before, changed.get("pose_rotation", before))
            changed["exit_points"] = changed.get("exit_points", robot.exit_points) @ turn.T
        if len(plain) == len(self.prior.names):
            return replace(robot, **changed)
        shear, stretch, along = np.eye(3), np.ones(3), _spreads(robot)
        for name, share in zip(self.prior.names, shares, strict=True):
            if name in _INERTIA_NAMES:
                stretch[_INERTIA_NAMES.index(name)] = np.exp(0.5 * share)
            elif name in _PRODUCT_PLACES:
                row, column = _PRODUCT_PLACES[name]
                shear[row, column] = -share / along[column] ** 2
        spread = 0.5 * np.trace(robot.inertia) * np.eye(3) - robot.inertia
        spread = (shear @ spread @ shear.T) * np.outer(stretch, stretch)
        return replace(robot, **changed, inertia=np.trace(spread) * np.eye(3) - spread)

    def as_before(self, coordinates: Array, fields: Sequence[str]) -> Array:
        """Return coordinates (k,) with some fields as the robot file has them."""
        return np.where(self._are_of(fields), np.maximum(0.0, self.lower), coordinates)

    def log_sigma(self, field: str, sigma: Array | None = None) -> float:
        """Return the sigma of the logarithm of a factor of some field; 0 if it is held.

        Args:
            field: Of which coordinates are logarithms of factors, as "axial_stiffness".
            sigma: Of coordinates (k,); None: those of the prior.
        """
        sigmas = self.scale * (self.prior.sigma if sigma is None else sigma)
        return float(np.max(sigmas, where=self._are_of([field]), initial=0.0))

    def multiplied(self, coordinates: Array, field: str, factor: float) -> Array:
        """Return coordinates (k,) where some field is another by a factor."""
        change = np.log(factor) / self.scale
        return np.where(self._are_of([field]), coordinates + change, coordinates)

    def moved(self, at: Array, step: Array) -> Array:
        """Return coordinates after a step to first order, shape (k,).

        Motion changes in proportion to what is a factor, or, as cables stretch by the inverse of
        their EA, to its inverse. Along logarithms it does not: a step is one of what it is
        proportional to.
        """
        share = np.maximum(1.0 + self.power * self.scale * step, STEP_SHARE_MIN)
        return np.where(self.factor > 0.0, at + self.power * np.log(share) / self.scale, at + step)

    @property
    def power(self) -> Array:
        """Power of each parameter to which motion is in proportion, shape (k,): 1, or -1 of EA."""
        return np.where(self._are_of(["axial_stiffness"]), -1.0, 1.0)

    def _are_of(self, fields: Sequence[str]) -> NDArray[np.bool_]:
        """Say which coordinates are of some fields, shape (k,)."""
        return np.array([field_of(name) in fields for name in self.prior.names])

    @cached_property
    def alike(self) -> Array | None:
        """Direction (k,) along which all forces and masses grow by one factor; motion stays as is.

        None where one of them is held.
        """
        forces = [
            name in _INERTIA_NAMES or field_of(name) in _FORCE_FIELDS for name in self.prior.names
        ]
        line = np.where(forces, 1.0 / self.scale, 0.0)
        larger = self.robot_at(line)
        for field in (*_FORCE_FIELDS, *_FRICTION_FIELDS, "inertia"):
            before, after = (np.asarray(getattr(each, field)) for each in (self.robot, larger))
            if not np.allclose(after, np.exp(1.0) * before, rtol=1e-9, atol=0.0):
                return None
        return line

    def _lengthening(self, name: str, values: Array) -> float:
        """Return by which factor the cable of an EA becomes longer with its run."""
        run = name.replace("axial_stiffness", "run_length")
        if run not in self.prior.names:
            return 1.0
        row = self.prior.names.index(run)
        before = float(values_of(self.robot, (run,))[0])
        return float((self.reach + values[row]) / (self.reach + before))

    def estimate(self, coordinates: Array, spread: Spread) -> ParameterEstimate:
        """Return the parameters themselves, with covariance and prior.

        Where they are known along curves, what draws lead to beyond straight lines adds to it.

        Args:
            coordinates: Estimated, shape (k,).
            spread: How far off they may be.
        """

        def values(at: Array) -> Array:
            return values_of(self.robot_at(at), self.prior.names)

        def derivative(at: Array) -> Array:
            steps = PARAMETER_DERIVATIVE_STEP * np.eye(len(at))
            here = values(at)
            columns = [
                (values(at + step) - here) / PARAMETER_DERIVATIVE_STEP for step in steps
            ]  # bounds lie below
            return np.asarray(np.stack(columns, axis=1))

        slope, first = derivative(coordinates), derivative(np.zeros(len(coordinates)))
        joint = slope @ spread.covariance @ slope.T
        if len(spread.draws):
            there = np.array([values(coordinates + draw) for draw in spread.draws])
            curved = there - values(coordinates) - spread.draws @ slope.T
            joint = joint + curved.T @ curved / len(curved)
        return ParameterEstimate(
            names=self.prior.names,
            value=values(coordinates),
            covariance=0.5 * (joint + joint.T),  # symmetric to the last bit
            start=values(np.zeros(len(coordinates))),
            prior_sigma=np.sqrt(np.diag(first @ self.prior.covariance @ first.T)),
            factors=tuple(
                name
                for name, factor in zip(self.prior.names, self.factor, strict=True)
                if factor > 0.0 and name not in _INERTIA_NAMES
            ),
        )


def choose_coordinates(robot: Robot, settings: IdentificationSettings) -> Coordinates:
    """Choose coordinates for all that is not held, with the robot file as their prior.

    Args:
        robot: Start of the search.
        settings: Prior sigmas of all else.

    Raises:
        InvalidField: Everything is held, or a number that would be a factor is 0.
    """
    if settings.cable_drag > 0.0:
        robot = replace(robot, cable_drag=cable_drag_of(robot))
    names, scale = _names(robot, resolved(settings, Scales(robot).ratios))
    factor = np.array(
        [name in _INERTIA_NAMES or field_of(name) in _FACTOR_FIELDS for name in names]
    )
    start = values_of(robot, names) if names else np.zeros(0)
    for name, value, is_factor in zip(names, start, factor, strict=True):
        if is_factor and value <= 0.0:
            allowed = f"> 0, or the setting {field_of(name)} = 0, which holds it"
            raise InvalidField(name, value, allowed)
    if not names:
        raise InvalidField("settings", "all parameters are held", "at least one sigma > 0")
    natural = np.where(factor, start * scale, scale)  # one sigma of the parameters themselves
    lower = np.full(len(names), -np.inf)
    for i, name in enumerate(names):
        if field_of(name) in _NOT_NEGATIVE_FIELDS and start[i] >= 0.0:
            lower[i] = -start[i] / scale[i]
    known = prior_covariance(robot, names, natural) / np.outer(natural, natural)
    coupled = _coupled(robot, names, natural)
    return Coordinates(
        robot=robot,
        prior=Prior(names=names, mean=np.zeros(len(names)), covariance=coupled @ known @ coupled.T),
        scale=scale,
        factor=factor.astype(np.float64),
        lower=lower,
        reach=_reach(robot),
        anchored=is_anchored(robot) or settings.exit_points == 0.0,
    )


def _coupled(robot: Robot, names: tuple[str, ...], natural: Array) -> Array:
    """Return derivatives (k, k) of coordinates by parameters over `natural`, at the robot itself.

    What the robot file knows of a stiffness or a dry moment is of the parameter, not of its ratio
    to what it is varied with.

    Args:
        robot: At coordinates 0.
        names: k parameters.
        natural: Change of each by a coordinate of 1 alone, shape (k,).
    """
    derivative = np.eye(len(names))
    start = values_of(robot, names)
    for i, name in enumerate(names):
        if name not in (robot.calibrated or ()):
            continue
        if field_of(name) in _FRICTION_FIELDS and "mass" in names:
            k, base = names.index("mass"), robot.mass
        elif name.replace("axial_stiffness", "run_length") in names[:i] + names[i + 1 :]:
            k = names.index(name.replace("axial_stiffness", "run_length"))
            base = _reach(robot) + start[k]
        else:
            continue
        derivative[i, k] = -start[i] / natural[i] * natural[k] / base
    return derivative


def group_of(name: str) -> str:
    """Return the setting that says how well a parameter is known before."""
    return "inertia_products" if name in _PRODUCT_PLACES else field_of(name)


def _spreads(robot: Robot) -> Array:
    """Return roots of the second moments of the mass along the axes [kg^(1/2) m], shape (3,)."""
    moments = 0.5 * np.trace(robot.inertia) - np.diag(robot.inertia)
    return np.asarray(np.sqrt(np.maximum(moments, 0.0)))  # none across a thin plate


def _reach(robot: Robot) -> float:
    """Return the mean distance from exit points to home [m]."""
    return float(np.linalg.norm(robot.exit_points - robot.home_position, axis=1).mean())


def _names(robot: Robot, settings: IdentificationSettings) -> tuple[tuple[str, ...], Array]:
    """Return parameters that are not held, and one sigma of each."""
    cables, along = robot.cable_names, _spreads(robot)
    products = {name: float(np.prod(along[[*place]])) for name, place in _PRODUCT_PLACES.items()}
    groups: dict[str, list[str]] = {
        "exit_points": point_names("exit_points", cables),
        "length_offset": [f"length_offset[{c}]" for c in cables],
        "length_scale": [f"length_scale[{c}]" for c in cables],
        "anchor_points": point_names("anchor_points", cables),
        "center_of_mass": [f"center_of_mass.{a}" for a in "xyz"],
        "inertia": list(_INERTIA_NAMES),
        "inertia_products": [name for name, size in products.items() if size > 0.0],
        "mass": ["mass"],
        "drag": ["drag"],
        "angular_drag": ["angular_drag"],
        "angular_drag_axes": [f"angular_drag_axes.{a}" for a in "xyz"],
        "cable_drag": ["cable_drag"],
        "length_delay": ["length_delay"],
        "length_hysteresis": [f"length_hysteresis[{c}]" for c in cables],
        "pose_tilt": ["pose_tilt.x", "pose_tilt.y"],
    }
    for field in _PER_CABLE_FIELDS:
        same = np.ptp(getattr(robot, field)) == 0.0
        groups[field] = [field] if same else [f"{field}[{c}]" for c in cables]
    names: list[str] = []
    scale: list[float] = []
    share = robot.weight / robot.n
    units = {"exit_friction": share * _reach(robot), "anchor_friction": share * lever(robot)}
    for field, members in groups.items():
        sigma = getattr(settings, field) * units.get(field, 1.0)
        if sigma > 0.0:
            names += members
            scale += [sigma * products.get(name, 1.0) for name in members]
    return tuple(names), np.array(scale)
