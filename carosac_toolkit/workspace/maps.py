"""Quality of poses: tilt, stiffness, natural frequency, sag, distance of cables."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.loop.values import Pose
from carosac_toolkit.physics.rest.modes import natural_frequencies
from carosac_toolkit.physics.rest.statics import Equilibrium, inverse_kinematics, sag
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.workspace.judgement import (
    SHAPE_CHUNK_POSES,
    Verdicts,
    modelled,
    pick,
    tilt_angle,
)
from carosac_toolkit.workspace.settings import WorkspaceSettings

SAG_SAMPLES = 25  # points along a cable: they miss the largest sag by less than 0.2 %
TENSION_CHOICES = ("widest", "least")


@dataclass(frozen=True, kw_only=True, eq=False)
class Maps:
    """Maps over B poses; NaN where there is no rest.

    Attributes:
        tilt: Angle of the platform's z axis to that at home [rad], shape (B,).
        stiffness: Least stiffness against a force at the platform origin, the platform free to
            turn and the winches held [N/m], shape (B,).
        softest: Unit vector in W along which it is least, shape (B, 3).
        turning_stiffness: Least stiffness against a moment, the platform free to move [N m/rad],
            shape (B,).
        frequency: Lowest natural frequency [Hz], shape (B,).
        sag: Largest distance of a cable from its chord [m], shape (B,).
    """

    tilt: Array
    stiffness: Array
    softest: Array
    turning_stiffness: Array
    frequency: Array
    sag: Array


def maps(
    robot: Robot,
    verdicts: Verdicts,
    *,
    settings: WorkspaceSettings | None = None,
    tensions: str = "widest",
) -> Maps:
    """Compute the maps of poses that were judged.

    Args:
        robot: The robot that was judged.
        verdicts: Its poses.
        settings: The settings that they were judged with.
        tensions: ``widest``: those of the largest margin, as judged. ``least``: the least squared
            tensions within the limits, as `statics.inverse_kinematics` and the controllers have
            them; NaN where that does not converge.

    Returns:
        The maps.
    """
    if tensions not in TENSION_CHOICES:
        raise InvalidField("tensions", repr(tensions), f"one of {list(TENSION_CHOICES)}")
    model = modelled(robot, settings or WorkspaceSettings())
    size = len(verdicts.margin)
    out = {
        "tilt": np.full(size, np.nan), "stiffness": np.full(size, np.nan),
        "softest": np.full((size, 3), np.nan), "turning_stiffness": np.full(size, np.nan),
        "frequency": np.full(size, np.nan), "sag": np.full(size, np.nan),
    }  # fmt: skip
    rows = np.flatnonzero(verdicts.rest.converged)
    for start in range(0, len(rows), SHAPE_CHUNK_POSES):
        part = rows[start : start + SHAPE_CHUNK_POSES]
        rest = pick(verdicts.rest, part)
        if tensions == "least":
            rest = _least(model, rest)
            part, rest = part[rest.converged], pick(rest, np.flatnonzero(rest.converged))
        if len(part):
            for name, value in _of_rest(model, rest).items():
                out[name][part] = value
    return Maps(**out)


def _least(robot: Robot, rest: Equilibrium) -> Equilibrium:
    """Return the same positions with the least squared tensions."""
    if robot.n >= 6:
        return inverse_kinematics(robot, rest.position, rest.rotation)
    guess = Pose(position=rest.position, rotation=rest.rotation)
    return inverse_kinematics(robot, rest.position, guess=guess)


def _of_rest(robot: Robot, rest: Equilibrium) -> dict[str, Array]:
    """Return all maps of equilibria."""
    stiffness, softest = _softest(rest.stiffness, slice(0, 3))
    turning, _ = _softest(rest.stiffness, slice(3, 6))
    return {
        "tilt": tilt_angle(robot, rest.rotation),
        "stiffness": np.where(rest.stable, stiffness, np.nan),
        "softest": np.where(rest.stable[:, None], softest, np.nan),
        "turning_stiffness": np.where(rest.stable, turning, np.nan),
        "frequency": natural_frequencies(robot, rest)[:, 0],
        "sag": sag(robot, rest, samples=SAG_SAMPLES).max(axis=1),
    }


def _softest(stiffness: Array, part: slice) -> tuple[Array, Array]:
    """Return the least stiffness of three coordinates with the others free, and its direction.

    It is the inverse of the largest eigenvalue of that block of the compliance.
    """
    regular = np.abs(np.linalg.det(stiffness)) > 0.0
    safe = np.where(regular[:, None, None], stiffness, np.eye(6))
    compliance = np.linalg.inv(safe)[:, part, part]
    values, vectors = np.linalg.eigh(0.5 * (compliance + compliance.swapaxes(1, 2)))
    direction = vectors[:, :, -1]
    sign = np.sign(direction[np.arange(len(direction)), np.argmax(np.abs(direction), axis=1)])
    return 1.0 / values[:, -1], direction * sign[:, None]
