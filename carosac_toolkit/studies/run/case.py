"""Case of a study: plain values, and the identity and seeds that follow from them."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import cached_property
from itertools import product as combinations
from types import MappingProxyType
from typing import Any

from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.base.version import __version__
from carosac_toolkit.robot.perturbations import SEEDED_AS

HASHED_AS = {"sensors": "suite"}  # name of before, in identities and seeds: draws stay the same
SEED_BITS = 63  # a signed 64-bit integer holds every seed
TRUTH = "truth"  # the estimator that a simulated driver answers, without error


@dataclass(frozen=True, kw_only=True)
class Case:
    """Run of a study: one loop from start to score.

    A case holds names and numbers, no objects, so that it means the same in another process, on
    another machine and next week. All its randomness comes from its seeds, and each seed depends
    on no more than its purpose needs: cases that differ in the controller alone meet the same
    plant and the same sensor noise. No seed depends on `settings` or on the toolkit's version.

    Attributes:
        robot: Name of a bundled robot, or path of a robot file.
        controller: Name of the controller, or ``module:Class``.
        estimator: Name of the estimator, or ``module:Class``.
        sensors: Sensors that measure, such as ``lengths+imu``.
        trajectory: Name of the trajectory.
        perturbation: Name of the condition that the plant is drawn from.
        seed: Number of the draw of everything random, >= 0.
        settings: All else that decides the result, as JSON values: name of the driver, limits,
            duration [s], settings of controller and estimator. ``timeout`` [s] overrides the
            study's time limit for this case.
    """

    robot: str
    controller: str
    estimator: str
    sensors: str
    trajectory: str
    perturbation: str
    seed: int
    settings: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in CASE_COLUMNS:
            if not isinstance(getattr(self, name), str) or not getattr(self, name):
                raise InvalidField(name, repr(getattr(self, name)), "a name")
        if not isinstance(self.seed, int) or isinstance(self.seed, bool) or self.seed < 0:
            raise InvalidField("seed", repr(self.seed), "a whole number >= 0")
        object.__setattr__(self, "settings", _frozen(self.settings))

    @cached_property
    def identity(self) -> str:
        """Sixteen hexadecimal digits that stand for all fields and the toolkit's version."""
        return _digest({"case": _hashed(self.to_dict()), "toolkit": __version__}).hex()[:16]

    @cached_property
    def plant_seed(self) -> int:
        """Seed of the plant: depends on robot, perturbation and seed only."""
        return self._seed_from("plant", "robot", "perturbation", "seed")

    @cached_property
    def sensor_seed(self) -> int:
        """Seed of the driver, its sensors and wind: depends on robot and seed only."""
        return self._seed_from("sensors", "robot", "seed")

    @cached_property
    def path_seed(self) -> int:
        """Seed of a random trajectory: depends on robot and seed only."""
        return self._seed_from("path", "robot", "seed")

    @cached_property
    def rng_seed(self) -> int:
        """Seed of all other draws, those of controller and estimator: depends on all names."""
        return self._seed_from("case", *CASE_COLUMNS, "seed")

    def to_dict(self) -> dict[str, Any]:
        """Return all fields, as JSON values."""
        return {**{name: getattr(self, name) for name in (*CASE_COLUMNS, "seed")},
                "settings": dict(self.settings)}  # fmt: skip

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Case:
        """Build a case from what `to_dict` returns."""
        return cls(**values)

    def _seed_from(self, purpose: str, *names: str) -> int:
        """Derive the seed for one purpose from some of the fields."""
        values = {name: getattr(self, name) for name in names}
        if "perturbation" in values:
            values["perturbation"] = SEEDED_AS.get(self.perturbation, self.perturbation)
        return int.from_bytes(_digest({"purpose": purpose, **_hashed(values)})[:8], "big") >> (
            64 - SEED_BITS
        )

    def __hash__(self) -> int:
        return hash(self.identity)

    def __reduce__(self) -> tuple[Any, ...]:
        return Case.from_dict, (self.to_dict(),)


CASE_COLUMNS = tuple(item.name for item in fields(Case) if item.name not in ("seed", "settings"))


def product(
    *,
    robots: Sequence[str],
    controllers: Sequence[str],
    estimators: Sequence[str],
    sensors: Sequence[str],
    trajectories: Sequence[str],
    perturbations: Sequence[str],
    seeds: Sequence[int],
    settings: Mapping[str, Any] | None = None,
) -> list[Case]:
    """Return all combinations, the seeds changing fastest, all with the same settings.

    Raises:
        InvalidField: An axis is empty or names a value twice, or a value is not allowed.
    """
    axes: dict[str, Sequence[Any]] = {
        "robots": robots,
        "controllers": controllers,
        "estimators": estimators,
        "sensors": sensors,
        "trajectories": trajectories,
        "perturbations": perturbations,
        "seeds": seeds,
    }
    for axis, values in axes.items():
        if isinstance(values, str) or not values or len(set(values)) < len(values):
            shown = repr(list(values)) if values and not isinstance(values, str) else repr(values)
            raise InvalidField(axis, shown if values else "none", "one or more different values")
    names = (*CASE_COLUMNS, "seed")
    return [
        Case(**dict(zip(names, values, strict=True)), settings=settings or {})
        for values in combinations(*axes.values())
    ]


def canonical(value: Any) -> str:
    """Return the JSON text of a value; equal values have equal texts."""
    return json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False)


def _digest(value: Any) -> bytes:
    """Return the hash of a value."""
    return hashlib.sha256(canonical(value).encode()).digest()


def _hashed(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return fields by the names that identities and seeds are made of."""
    return {HASHED_AS.get(name, name): value for name, value in values.items()}


def _frozen(settings: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return a read-only copy of the settings, which must survive a JSON round trip unchanged."""
    allowed = "JSON values: finite numbers, text, true/false, None, lists, dicts with text keys"
    try:
        copy = json.loads(canonical(dict(settings)))
    except (TypeError, ValueError) as error:
        raise InvalidField("settings", repr(settings), allowed) from error
    if copy != dict(settings):
        raise InvalidField("settings", repr(settings), allowed)
    return MappingProxyType(copy)
