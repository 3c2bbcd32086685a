"""Differences of two robots beyond the rounding of a robot file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.robot.hardware import Hardware
from carosac_toolkit.robot.model_error import MODEL_ERROR_UNITS, ModelError
from carosac_toolkit.robot.robot import Robot

SAME_VALUE_TOLERANCE = 1e-9  # relative difference that rounding to 12 digits leaves


def differing(a: Robot, b: Robot) -> list[str]:
    """Return the fields in which two robots differ by more than rounding."""
    values = {f.name: (getattr(a, f.name), getattr(b, f.name)) for f in fields(Robot)}
    return [
        name
        for name, (x, y) in values.items()
        if not (_same_covariance(x, y) if name.endswith("covariance") else same(x, y))
    ]


def same(a: Any, b: Any) -> bool:
    """Return True if two fields are equal but for rounding."""
    if a is None or b is None:
        return a is b
    if isinstance(a, ModelError) and isinstance(b, ModelError):
        return all(same(getattr(a, name), getattr(b, name)) for name in MODEL_ERROR_UNITS)
    if isinstance(a, str | Mapping | Hardware) or (isinstance(a, tuple) and isinstance(b, tuple)):
        return bool(a == b)
    first, second = np.asarray(a), np.asarray(b)
    if first.shape != second.shape:
        return False
    size = max(float(np.abs(first).max(initial=0.0)), float(np.abs(second).max(initial=0.0)))
    return bool(np.abs(first - second).max(initial=0.0) <= SAME_VALUE_TOLERANCE * size)


def _same_covariance(a: Array | None, b: Array | None) -> bool:
    """Return True if two covariances are equal but for rounding, each entry by its own units."""
    if a is None or b is None or a.shape != b.shape:
        return a is b
    largest = np.maximum(*(np.diagonal(x, axis1=-2, axis2=-1) for x in (a, b)))
    size = np.sqrt(largest[..., :, None] * largest[..., None, :])
    return bool((np.abs(a - b) <= SAME_VALUE_TOLERANCE * size).all())
