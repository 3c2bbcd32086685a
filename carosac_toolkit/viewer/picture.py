"""Instant of a robot, as the viewer draws it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.physics.cable.lengths import length_at_tension
from carosac_toolkit.physics.cable.shapes import hanging_cables, offset_from_chord
from carosac_toolkit.robot.robot import Robot

CABLE_POINTS = 24  # points of a cable


@dataclass(frozen=True, kw_only=True, eq=False)
class Picture:
    """Drawing data of one instant; n cables.

    Attributes:
        time: [s].
        position: Platform origin in W [m], shape (3,).
        rotation: From P to W, shape (3, 3).
        points: Along each cable in W [m], shape (n, samples, 3).
        tension: At the platform [N], shape (n,); NaN where unknown.
        straight: Cables of unknown shape, drawn straight, shape (n,).
        target: Reference position in W [m], shape (3,), or None.
        believed: Estimated position in W [m], shape (3,), or None.
        held: True if this is the last feasible pose, as the requested one is not.
        status: Status line.
        problem: True if the status reports a problem.
    """

    time: float
    position: Array
    rotation: Array
    points: Array
    tension: Array
    straight: Array
    target: Array | None = None
    believed: Array | None = None
    held: bool = False
    status: str = ""
    problem: bool = False

    @property
    def sag(self) -> Array:
        """Largest distance of each cable from its chord [m], shape (n,)."""
        return np.asarray(np.linalg.norm(offset_from_chord(self.points), axis=-1).max(axis=-1))

    def drawn(self, enlarged: float) -> Array:
        """Return points of the cables with the distance from their chords enlarged [m]."""
        if enlarged == 1.0:
            return self.points
        return self.points + (enlarged - 1.0) * offset_from_chord(self.points)

    @property
    def error(self) -> float:
        """Distance from the target [m]; NaN without one."""
        if self.target is None:
            return float("nan")
        return float(np.linalg.norm(self.position - self.target))


def take_picture(
    robot: Robot, position: Array, rotation: Array, *, time: float = 0.0,
    unstrained_length: Array | None = None, tension: Array | None = None,
    target: Array | None = None, believed: Array | None = None, held: bool = False,
    status: str = "", problem: bool = False, points: Array | None = None,
) -> Picture:  # fmt: skip
    """Compute the shapes of the cables.

    From the first of these that is there: `points` as they are, `unstrained_length`, `tension`.
    A cable that cannot hang so, or of which nothing is known, is drawn straight, and marked.

    Args:
        robot: The robot, n cables.
        position: Platform origin in W [m], shape (3,).
        rotation: From P to W, shape (3, 3).
        time: [s].
        unstrained_length: [m], shape (n,), or None.
        tension: At the platform [N], shape (n,), or None; by default that of the shape.
        target: Reference position in W [m], shape (3,), or None.
        believed: Estimated position in W [m], shape (3,), or None.
        held: As `Picture.held`.
        status: As `Picture.status`.
        problem: As `Picture.problem`.
        points: Points of the cables in W [m], shape (n, samples, 3), if known.
    """
    straight = np.zeros(robot.n, dtype=bool)
    known = tension
    if points is None:
        if unstrained_length is None and tension is not None:
            pose = (position[None], rotation[None])
            unstrained_length = length_at_tension(robot, *pose, tension[None]).unstrained_length[0]
        if unstrained_length is None:
            unstrained_length = np.full(robot.n, np.nan)
        hanging = hanging_cables(
            robot, position[None], rotation[None], unstrained_length[None], samples=CABLE_POINTS
        )
        straight = ~hanging.valid[0]
        points = _straightened(robot, position, rotation, hanging.points[0], straight)
        known = hanging.tension[0] if tension is None else tension
    return Picture(
        time=time, position=position, rotation=rotation, points=points,
        tension=np.full(robot.n, np.nan) if known is None else known, straight=straight,
        target=target, believed=believed, held=held, status=status, problem=problem,
    )  # fmt: skip


def _straightened(
    robot: Robot, position: Array, rotation: Array, points: Array, straight: Array
) -> Array:
    """Put straight lines from exit to anchor where a shape is missing."""
    anchors = position + robot.anchor_points @ rotation.T
    share = np.linspace(0.0, 1.0, points.shape[1])[:, None]
    lines = robot.exit_points[:, None] * (1.0 - share) + anchors[:, None] * share
    return np.asarray(np.where(straight[:, None, None], lines, points))
