"""Schema ``carosac-robot/1``: sections and fields of a robot file.

A model checks its own fields; `carosac_toolkit.robot.checks` checks them together.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, GetCoreSchemaHandler, model_validator
from pydantic_core import CoreSchema, core_schema

from carosac_toolkit.robot import fields
from carosac_toolkit.robot.fields import (
    FieldFault,
    Reader,
    list_reader,
    quantity_reader,
    unit_length_reader,
)
from carosac_toolkit.robot.robot import CAPSTAN_FRICTION_MAX

ROBOT_SCHEMA = "carosac-robot/1"


@dataclass(frozen=True)
class Reads:
    """Parser of a field and its allowed values, as an annotation.

    Attributes:
        function: From what YAML holds to the value.
        allowed: Accepted values, in words.
    """

    function: Reader
    allowed: str

    def __get_pydantic_core_schema__(
        self, source: Any, handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        """Run the reader before pydantic looks at the value."""
        return core_schema.no_info_before_validator_function(self.function, handler(source))


def _reads(unit: str, bound: str = "", most: float = math.inf) -> Reads:
    return Reads(*quantity_reader(unit, bound, most))


def _direction(meaning: str, count: int) -> Reads:
    return Reads(*unit_length_reader(count, meaning))


Text = Annotated[str, Reads(fields.read_text, "a text")]
Name = Annotated[str, Reads(fields.read_name, fields.NAME_TEXT)]
Coordinate = Annotated[float, _reads("m")]
Distance = Annotated[float, _reads("m", ">= 0")]
Extent = Annotated[float, _reads("m", "> 0")]
Vector = Annotated[
    tuple[Coordinate, Coordinate, Coordinate], Reads(*list_reader("m", 3, "x, y, z"))
]
Factor = Annotated[float, _reads("1", ">= 0")]
AxisFactors = Annotated[
    tuple[Factor, Factor, Factor], Reads(*list_reader("1", 3, "about x, y, z of P"))
]
Direction = Annotated[list[float], _direction("x, y, z", 3)]
Quaternion = Annotated[list[float], _direction("w, x, y, z", 4)]
Degrees = Annotated[float, _reads("1")]
Angles = Annotated[
    tuple[Degrees, Degrees, Degrees], Reads(*list_reader("1", 3, "roll, pitch, yaw in degrees"))
]
Spread = Annotated[list[float], Reads(fields.read_spread, fields.SPREAD_TEXT)]
Covariance = Annotated[list[list[float]], Reads(fields.read_covariance, fields.COVARIANCE_TEXT)]
Inertia = Annotated[list[list[float]], Reads(fields.read_inertia, fields.INERTIA_TEXT)]
Port = Annotated[int, Reads(fields.read_port, fields.PORT_TEXT)]
Sign = Annotated[float, Reads(fields.read_sign, fields.SIGN_TEXT)]
NetId = Annotated[str, Reads(fields.read_net_id, fields.NET_ID_TEXT)]
Mass = Annotated[float, _reads("kg", "> 0")]
Force = Annotated[float, _reads("N", "> 0")]
ForceOrZero = Annotated[float, _reads("N", ">= 0")]


class _Section(BaseModel):
    """A mapping that knows its keys."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class PulleyInput(_Section):
    """A swivelling pulley at an exit point."""

    radius: Extent
    swivel_axis: Direction


class ExitPoint(_Section):
    """Point at which a cable leaves the frame."""

    position: Vector
    pulley: PulleyInput | None = None
    sigma: Spread | None = None
    covariance: Covariance | None = None

    @model_validator(mode="after")
    def _check(self) -> ExitPoint:
        if self.sigma is not None and self.covariance is not None:
            raise FieldFault("sigma", "sigma and covariance", "one of the two")
        return self


class Frame(_Section):
    """The fixed structure."""

    exit_points: dict[str, ExitPoint]


class Payload(_Section):
    """A body fixed to the platform."""

    name: Name
    mass: Mass
    center_of_mass: Vector
    inertia: Inertia


class AirDrag(_Section):
    """Linear air drag of the platform, and of the cables over their mass."""

    linear: Annotated[float, _reads("N*s/m", ">= 0")]
    angular: Annotated[float, _reads("N*m*s/rad", ">= 0")]
    angular_axes: AxisFactors = (1.0, 1.0, 1.0)
    cables: Annotated[float, _reads("1/s", ">= 0")] | None = None


class Platform(_Section):
    """The moving body without its payloads."""

    mass: Mass
    center_of_mass: Vector
    inertia: Inertia
    anchor_points: dict[str, Vector]
    air_drag: AirDrag
    payloads: list[Payload] = []


class CableType(_Section):
    """A kind of cable."""

    linear_density: Annotated[float, _reads("kg/m", "> 0")]
    axial_stiffness: Force | None = None
    youngs_modulus: Annotated[float, _reads("Pa", "> 0")] | None = None
    area: Annotated[float, _reads("m^2", "> 0")] | None = None
    material_density: Annotated[float, _reads("kg/m^3", "> 0")] | None = None
    axial_damping: Annotated[float, _reads("N*s", ">= 0")]
    exit_friction: Annotated[float, _reads("N*m", ">= 0")] = 0.0
    anchor_friction: Annotated[float, _reads("N*m", ">= 0")] = 0.0
    capstan_friction: Annotated[float, _reads("1", ">= 0", CAPSTAN_FRICTION_MAX)] = 0.0
    diameter: Extent

    @model_validator(mode="after")
    def _check(self) -> CableType:
        ways = (
            "either axial_stiffness alone, or youngs_modulus with one of area (load-bearing, not "
            "pi d^2/4 of a rope) and material_density (then area = linear_density/material_density)"
        )
        names = ("axial_stiffness", "youngs_modulus", "area", "material_density")
        present = tuple(name for name in names if getattr(self, name) is not None)
        if present not in (names[:1], (names[1], names[2]), (names[1], names[3])):
            raise FieldFault("axial_stiffness", " and ".join(present) or "nothing", ways)
        return self

    @property
    def stiffness(self) -> float:
        """EA [N]."""
        if self.axial_stiffness is not None:
            return self.axial_stiffness
        area = self.area
        if area is None:
            area = self.linear_density / (self.material_density or float("nan"))
        return (self.youngs_modulus or float("nan")) * area


class Drum(_Section):
    """A winch drum; the squared radius falls by `buildup` per length of line paid out."""

    radius: Extent
    buildup: Distance
    gear: Annotated[float, _reads("1", "> 0")] | None = None
    advantage: Annotated[float, _reads("1", "> 0")] | None = None


class WinchInput(_Section):
    """A kind of winch."""

    speed_max: Annotated[float, _reads("m/s", "> 0")]
    acceleration_max: Annotated[float, _reads("m/s^2", "> 0")]
    lag: Annotated[float, _reads("s", ">= 0")]
    length_min: Distance
    length_max: Extent
    run_length: Distance
    length_hysteresis: Distance = 0.0
    drum: Drum | None = None

    @model_validator(mode="after")
    def _check(self) -> WinchInput:
        if self.length_min >= self.length_max:
            allowed = f"length_min < length_max = {self.length_max:g} m"
            raise FieldFault("length_min", f"{self.length_min:g} m", allowed)
        return self


class TensionLimits(_Section):
    """Allowed tension at the platform."""

    min: ForceOrZero
    max: Force

    @model_validator(mode="after")
    def _check(self) -> TensionLimits:
        if self.min >= self.max:
            raise FieldFault("min", f"{self.min:g} N", f"min < max = {self.max:g} N")
        return self


class ChainInput(_Section):
    """One cable: which parts it joins, by name."""

    name: Name
    exit_point: Name
    anchor_point: Name
    cable: Name
    winch: Name
    run_length: Distance | None = None
    tension_limits: TensionLimits | None = None


class Box(_Section):
    """A box of positions of the platform origin, by corners or by centre and size."""

    min: Vector | None = None
    max: Vector | None = None
    center: Vector | None = None
    size: Vector | None = None

    @model_validator(mode="after")
    def _check(self) -> Box:
        present = tuple(n for n in ("min", "max", "center", "size") if getattr(self, n) is not None)
        if present not in (("min", "max"), ("center", "size")):
            raise FieldFault(
                "min", " and ".join(present) or "nothing", "min and max, or center and size"
            )
        for axis, low, high in zip("xyz", *self.corners, strict=True):
            if low >= high:
                field = "min" if self.min is not None else "size"
                raise FieldFault(
                    field, f"{axis} from {low:g} to {high:g} m", "min < max on each axis"
                )
        return self

    @property
    def corners(self) -> tuple[list[float], list[float]]:
        """Lower and upper corner [m]."""
        if self.min is not None and self.max is not None:
            return list(self.min), list(self.max)
        pairs = list(zip(self.center or (), self.size or (), strict=True))
        return [c - 0.5 * s for c, s in pairs], [c + 0.5 * s for c, s in pairs]


class Home(_Section):
    """The home pose; rpy_deg means R = Rz(yaw) Ry(pitch) Rx(roll)."""

    position: Vector
    quaternion_wxyz: Quaternion | None = None
    rpy_deg: Angles | None = None

    @model_validator(mode="after")
    def _check(self) -> Home:
        if self.quaternion_wxyz is not None and self.rpy_deg is not None:
            raise FieldFault("rpy_deg", "quaternion_wxyz and rpy_deg", "one of the two")
        return self


class LengthSensor(_Section):
    """Length sensor of a cable: reading = scale * unstrained length + offset."""

    offset: Coordinate
    scale: Annotated[float, _reads("1", "> 0")]


class LengthSensors(_Section):
    """The length sensors, by chain."""

    delay: Annotated[float, _reads("s")]
    cables: dict[str, LengthSensor]


class PoseSensor(_Section):
    """Motion capture or the like; the rotation is from its frame to W."""

    quaternion_wxyz: Quaternion


class SensorsInput(_Section):
    """Sensor parameters estimated by a calibration."""

    lengths: LengthSensors | None = None
    poses: PoseSensor | None = None


class ModelErrorInput(_Section):
    """What the model and the measured poses miss, one sigma; see `ModelError`."""

    length: Distance
    force: ForceOrZero
    mass: Annotated[float, _reads("1", ">= 0")]
    acceleration: Annotated[float, _reads("m/s^2/sqrt(Hz)", ">= 0")]
    position: Extent
    rotation: Annotated[float, _reads("rad", "> 0")]


class Calibration(_Section):
    """Parameters that were estimated, and the lower triangle of their covariance."""

    parameters: list[Text]
    covariance: list[list[Annotated[float, _reads("1")]]]

    @model_validator(mode="after")
    def _check(self) -> Calibration:
        count = len(self.parameters)
        if [len(row) for row in self.covariance] != list(range(1, count + 1)):
            got = f"rows of {[len(row) for row in self.covariance]} numbers"
            allowed = f"the lower triangle, rows of 1 to {count} numbers, one for each parameter"
            raise FieldFault("covariance", got, allowed)
        return self


class Ads(_Section):
    """A TwinCAT PLC."""

    net_id: NetId
    ip: Text
    port: Port = 851
    timeout: Annotated[float, _reads("s", "> 0")] = 0.05
    from_host: Text = "CaRoSaC.from_host"
    to_host: Text = "CaRoSaC.to_host"
    machine: Text = "CaRoSaC.machine"


class AdsCable(_Section):
    """Cable as the PLC counts it: unstrained length = sign * scale * number + offset."""

    sign: Sign
    scale: Extent
    offset: Coordinate = 0.0


class ImuInput(_Section):
    """An inertial sensor that sends to this host."""

    source: Literal["udp"]
    ip: Text = "127.0.0.1"
    port: Port
    sender: Text | None = None


class HardwareInput(_Section):
    """Connection to the real robot."""

    ads: Ads
    cables: dict[str, AdsCable]
    imu: ImuInput | None = None


class RobotFile(_Section):
    """The whole file."""

    schema_name: Literal["carosac-robot/1"] = Field(alias="schema")
    name: Name
    description: Text
    licence: Text
    gravity: Annotated[float, _reads("m/s^2", "> 0")]
    frame: Frame
    platform: Platform
    cable_types: dict[str, CableType]
    winches: dict[str, WinchInput]
    chains: list[ChainInput]
    tension_limits: TensionLimits | None = None
    workspace: Box
    home: Home
    sensors: SensorsInput | None = None
    calibration: Calibration | None = None
    model_error: ModelErrorInput | None = None
    hardware: HardwareInput | None = None
    provenance: dict[str, Text]
