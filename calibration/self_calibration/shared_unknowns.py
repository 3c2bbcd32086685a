"""The unknowns that all samples share: their places, names and prior."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.prior import Prior
from calibration.robot_update import prior_covariance
from calibration.self_calibration.settings import SelfCalibrationSettings
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.physics.cable.drum import Drums
from carosac_toolkit.robot.parameter_names import point_names
from carosac_toolkit.robot.robot import Robot

ALIKE_RADIUS_SHARE = 3e-4  # of a radius: drums of one make differ by no more


@dataclass(frozen=True, kw_only=True, eq=False)
class SharedUnknowns:
    """Places of the m shared unknowns, and what is known of them before; n cables.

    Attributes:
        exits: Places of the exit points, shape (n, 3).
        radii: Place of each cable's radius error, shape (n,).
        buildups: Place of its build-up, shape (n,).
        zeros: Place of its length at the reference, shape (n,).
        compliances: Place of the error of its compliance, shape (n,); empty without tensions.
        prior: Of all of them.
    """

    exits: NDArray[np.intp]
    radii: NDArray[np.intp]
    buildups: NDArray[np.intp]
    zeros: NDArray[np.intp]
    compliances: NDArray[np.intp]
    prior: Prior


def shared_unknowns(
    robot: Robot,
    drums: Drums,
    radius: Array,
    length: Array,
    settings: SelfCalibrationSettings,
    *,
    soft: bool,
) -> SharedUnknowns:
    """Give each shared unknown its place, its name and its prior.

    Args:
        robot: As known before.
        drums: Its drums.
        radius: Of the drums at the reference [m], shape (n,).
        length: Unstrained lengths at the reference [m], shape (n,).
        settings: Priors.
        soft: True if tensions are measured, so that the compliances are unknown.
    """
    n, cables = robot.n, robot.cable_names
    makes = list(zip(drums.gear, drums.advantage, drums.buildup, strict=True))
    of_make = _alike(drums.radius, radius, makes)
    buildups, of_buildup = _groups(drums.buildup)
    stiff, of_stiffness = _groups(robot.axial_stiffness)
    counts = [3 * n, max(of_make) + 1, len(buildups), n, len(stiff) if soft else 0]
    exits, radii, builds, zeros, soft_ones = np.cumsum([0, *counts[:-1]]).tolist()
    names = (
        *point_names("exit_points", cables),
        *(f"drum_radius[{_joined(cables, of_make, g)}]" for g in range(counts[1])),
        *(f"drum_buildup[{_joined(cables, of_buildup, g)}]" for g in range(counts[2])),
        *(f"length_at_zero[{cable}]" for cable in cables),
        *(f"compliance[{_joined(cables, of_stiffness, g)}]" for g in range(counts[4])),
    )
    mean = [robot.exit_points.ravel(), np.zeros(counts[1]), np.array(buildups), length]
    sigma = np.concatenate(
        [
            np.full(counts[0], settings.exit_sigma),
            np.full(counts[1], settings.drum_radius_sigma),
            settings.drum_buildup_share * np.maximum(buildups, 1e-9),
            np.full(counts[3], settings.length_at_zero_sigma),
            np.full(counts[4], settings.stiffness_share),
        ]
    )
    covariance = np.diag(sigma**2)
    block = slice(0, counts[0])
    covariance[block, block] = prior_covariance(robot, names[block], sigma[block])
    return SharedUnknowns(
        exits=exits + np.arange(counts[0]).reshape(n, 3),
        radii=radii + np.array(of_make),
        buildups=builds + np.array(of_buildup),
        zeros=zeros + np.arange(n),
        compliances=soft_ones + np.array(of_stiffness if soft else [], dtype=np.intp),
        prior=Prior(
            names=names,
            mean=np.concatenate([*mean, np.zeros(counts[4])]),
            covariance=covariance,
        ),
    )


def _alike(empty: Array, reference: Array, makes: Sequence[tuple[float, ...]]) -> list[int]:
    """Group drums of one make: the same radius with all line wound in, or at the reference."""
    group: list[int] = []
    for i in range(len(makes)):
        for j in range(i):
            apart = min(abs(empty[i] - empty[j]), abs(reference[i] - reference[j]))
            same = apart < ALIKE_RADIUS_SHARE * empty[i]
            if makes[i] == makes[j] and same:
                group.append(group[j])
                break
        else:
            group.append(max(group, default=-1) + 1)
    return group


def _groups(values: Array) -> tuple[list[float], list[int]]:
    """Return the different values, and which of them each is."""
    different = sorted(set(values.tolist()))
    return different, [different.index(value) for value in values.tolist()]


def _joined(cables: Sequence[str], group: Sequence[int], g: int) -> str:
    """Return the cables of one group."""
    return ", ".join(name for name, mine in zip(cables, group, strict=True) if mine == g)
