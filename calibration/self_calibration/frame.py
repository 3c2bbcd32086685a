r"""The frame of a self-calibration, and what of it nothing that was measured tells.

Moving exit points and positions alike changes no length. Known coordinates, and the reference at
home, hold some of these six motions :math:`\xi` (three shifts, three turns about home); the others
are free. They are held by convention: with x the exit points, :math:`x_0` and :math:`\Lambda` their
prior and its information and G the motion of the exit points,

.. math:: (G Z)^\top \Lambda (x - x_0) = 0,

where the columns of Z are the free motions: the best fit of the exit points to those of the robot
file. This is where the maximum a posteriori estimate is. Covariances are those in this frame,

.. math:: \Sigma' = P \Sigma P^\top, \qquad P = I - G Z (C G Z)^{-1} C, \qquad
          C = (G Z)^\top \Lambda,

in which the free motions have no uncertainty (an S-transformation). The robot file is read by those
who do not know of the convention, and may be calibrated in another frame. In it, motions M that are
held by convention, those of the reference at home among them, are as uncertain as the prior leaves
them where the shape is known:

.. math:: \Sigma'' = \Sigma' + M (M^\top \Lambda M)^{-1} M^\top.

Where measured tensions tell the vertical better than the robot file does, along every direction,
the frame is the one in which the cables pull straight up: two rows of C are the derivative of that
direction, and the tilts among M are as uncertain as it.

References:
    Baarda, *S-transformations and criterion matrices*, Netherlands Geodetic Commission, 1973.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.self_calibration.problem import MotorAngleProblem
from calibration.self_calibration.reference import Reference
from calibration.self_calibration.rigid_motions import FREE_MOTION_SHARE, HELD_SIGMA_SHARE, moves
from calibration.self_calibration.solver import SampleFit, inverse
from calibration.self_calibration.vertical import Vertical
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.base.rotations import best_rotation

SAME_MOTION = 0.99  # part of a unit motion that a free one must have to be the same
HEADING_SHARE_MIN = 0.05  # of its distance from home that an exit point must be beside home
AXIS_NAMED_MIN = 0.01  # smaller parts of an axis are not named
ELSEWHERE = "known coordinates hold another place than home, about which it may turn"
TILTS = np.eye(6)[:, 3:5]  # turns about x and y through home
TURN_ABOUT_Z = np.eye(6)[:, 5]
TILTED_BY = np.array([[0.0, 1.0], [-1.0, 0.0]])  # direction of z, x and y, by a turn about x and y


@dataclass(frozen=True, kw_only=True, eq=False)
class Frame:
    """Motions of the whole set-up that nothing tells, and the convention that holds them.

    Attributes:
        reference: Sample that is taken to be at home, or None.
        home: Platform origin at home [m], shape (3,).
        by_exit_points: Axes of W along which the exit points of the robot file alone tell the
            place, shape (3,).
        lever: Length by which turns are multiplied to be motions in metres [m].
        free: Free motions, shifts and turns about home times the lever, shape (6, f), orthonormal.
        hold: Motion, along the free ones, by a change of the shared unknowns, shape (f, m).
        move: Change of the shared unknowns by the free motions, shape (m, f).
        heading: Cable whose exit point is on the x axis as seen from above, or None.
        vertical: What measured tensions tell of the vertical, where lengths do not, or None.
        level: True if the tensions make the frame upright; the first two free motions are then the
            tilts that they tell.
        convention: Covariance of the exit points by all motions that are held by convention, as
            far as they were known before [m^2], shape (3 n, 3 n).
    """

    reference: Reference | None
    by_exit_points: NDArray[np.bool_]
    home: Array
    lever: float
    free: Array
    hold: Array
    move: Array
    heading: str | None
    vertical: Vertical | None
    level: bool
    convention: Array

    @property
    def turns(self) -> Array:
        """Free turns, as unit vectors of W, shape (3, t)."""
        return _turns(self.free)

    @property
    def center(self) -> Array:
        """A point in W that all free turns leave where it is [m], shape (3,)."""
        shift, turn = self.free[:3].T, self.free[3:].T / self.lever
        slope = np.concatenate([moves(axis[None], 1.0)[0, :, 3:] for axis in turn])
        # shift + turn x (center - home) = 0; the moves by omega x ray are those of ray by -omega
        return np.asarray(self.home + np.linalg.lstsq(slope, shift.ravel(), rcond=None)[0])

    def aligned(
        self,
        problem: MotorAngleProblem,
        solution: SampleFit,
        towards: Array,
        *,
        mirror: bool = False,
    ) -> SampleFit:
        """Move a solution along the free turns, by any amount, which changes no length.

        Args:
            problem: The samples.
            solution: That is moved.
            towards: Points that its exit points less anchor points are to fit best [m], (n, 3).
            mirror: True for its mirror image, at a plane through the free axis, or through the
                centre where all turns are free.

        Returns:
            The moved solution; the same where the free turns are neither one nor three.
        """
        turns = self.turns
        if turns.shape[1] not in (1, 3) or problem.own == 6:
            return solution
        axis = turns if turns.shape[1] == 1 else np.zeros((3, 1))
        plane = np.eye(3) - axis @ axis.T
        points = problem.points(solution.shared) - self.center
        hold = 30.0 * np.abs(points).max() * axis.T  # a point on the axis stays where it is
        turn = best_rotation(
            np.vstack([points @ plane, hold]),
            np.vstack([(towards - self.center) @ plane, hold]),
            mirror=mirror,
        ).T
        shared = solution.shared.copy()
        shared[problem.exits] = points @ turn + self.center + problem.offsets
        position = (solution.position - self.center) @ turn + self.center
        return replace(solution, shared=shared, position=position)

    def covariance(self, information: Array) -> Array:
        """Return the covariance of the shared unknowns in this frame, shape (m, m).

        Args:
            information: On the shared unknowns, prior included, shape (m, m).
        """
        project = np.eye(len(information)) - self.move @ self.hold
        covariance = project @ inverse(self.held(information)) @ project.T
        return np.asarray(0.5 * (covariance + covariance.T))

    def held(self, information: Array) -> Array:
        """Return information on the shared unknowns (m, m) with the free motions held as well."""
        weight = (HELD_SIGMA_SHARE * self.lever) ** -2
        return np.asarray(information + weight * self.hold.T @ self.hold)

    def position_slope(self, by_shared: Array, position: Array) -> Array:
        """Return by how much positions change in this frame with the shared unknowns.

        Args:
            by_shared: The same before the motion back into the frame, shape (N, 3, m).
            position: [m], shape (N, 3).
        """
        motion = moves(position - self.home, self.lever) @ self.free
        return np.asarray(by_shared - motion @ self.hold)

    def sentences(self) -> list[str]:
        """Return in words what holds the frame."""
        lines = []
        if self.by_exit_points.any():
            lines.append(
                f"{_origin(self.by_exit_points)} is that of the exit points of the robot file"
            )
        if self.reference is not None:
            lines.append(
                f"{_origin(self.reference.axes)} is by convention: sample "
                f"{self.reference.sample}, the reference, is at home"
            )
        if self.vertical is not None:
            lines.append(self._vertical_sentence(self.vertical))
        if self._untold.shape[1]:
            by = "as the exit points of the robot file are turned, which fits them best"
            if self.heading is not None:
                rest = f", the rest {by}" if self._untold.shape[1] > 1 else ""
                by = f"x through exit point {self.heading}{rest}"
            lines.append(
                f"nothing that was measured tells {self._unknown()}: by convention {by}; sigmas "
                "are those in this frame"
            )
        return lines

    @property
    def _untold(self) -> Array:
        """Free motions that tensions do not tell either, shape (6, u)."""
        return self.free[:, 2 * int(self.level) :]

    def _vertical_sentence(self, vertical: Vertical) -> str:
        """Return what the measured tensions tell of the vertical."""
        if vertical.reason:
            return f"the measured tensions do not tell the vertical: {vertical.reason}"
        known = f"{np.degrees(vertical.sigma):.2g} deg"
        if self.level:
            return (
                f"z is upright by the measured tensions, which tell the vertical to {known}, "
                "beside what the exit points are wrong by; sigmas are those in this frame"
            )
        return (
            f"the measured tensions tell the vertical to {known}; the exit points of the robot "
            "file know it better, along one direction at least"
        )

    def _unknown(self) -> str:
        """Name the free motions."""
        turns = _turns(self._untold)
        count, others = turns.shape[1], self._untold.shape[1] - turns.shape[1]
        words = {0: "", 1: f"the turn about {_axis(turns)}", 2: "two turns", 3: "any turn"}[count]
        shift = {0: "", 1: "a shift", 2: "two shifts", 3: "any shift"}[others]
        return " and ".join(part for part in (words, shift) if part) + " of the whole set-up"

    def data(self) -> dict[str, Any]:
        """Return the convention, ready for JSON."""
        reference = self.reference
        return {
            "origin_sample": None if reference is None else reference.sample,
            "origin_axes": []
            if reference is None
            else np.array(["x", "y", "z"])[reference.axes].tolist(),
            "free_turns": self.turns.T,
            "free_motions": self.free.shape[1],
            "x_through": self.heading,
            "vertical": None if self.vertical is None else self.vertical.data(),
            "upright_by_tensions": self.level,
        }


def find_frame(
    problem: MotorAngleProblem,
    shared: Array,
    information: Array,
    vertical: Vertical | None = None,
    *,
    upright: bool = False,
) -> Frame:
    """Find the motions of the whole set-up that the lengths leave free.

    Args:
        problem: The samples.
        shared: Values of the shared unknowns, shape (m,).
        information: On them, of the data alone, positions unknown, shape (m, m).
        vertical: By the measured tensions, if there are any.
        upright: True if the set-up was made upright by them.

    Raises:
        InvalidField: The x axis is to go through an exit point that is above or below home, or the
            data tell the heading.
    """
    lever, home = problem.longest, problem.robot.home_position
    exits = problem.points(shared)
    motion = np.zeros((problem.size, 6))
    motion[problem.exits.ravel()] = moves(exits - home, lever).reshape(-1, 6)
    values, vectors = np.linalg.eigh(motion.T @ information @ motion / problem.robot.n)
    free = vectors[:, values < (FREE_MOTION_SHARE * lever) ** -2]
    heading = problem.settings.x_through
    tilts = bool((np.linalg.norm(free.T @ TILTS, axis=0) > SAME_MOTION).all())
    held = _held(problem, free)
    spread = _spread_before(problem, held)
    tilt = held[3:5].T @ TILTED_BY.T / lever  # of z, by these motions
    if not tilts and vertical is not None:
        elsewhere = float(np.linalg.norm(free[3:5])) > AXIS_NAMED_MIN
        vertical = replace(vertical, reason=ELSEWHERE) if elsewhere else None
    level = vertical is not None and (upright or vertical.known_better_than(tilt.T @ spread @ tilt))
    if heading is not None:
        up = vertical.up if level and vertical is not None else np.array([0.0, 0.0, 1.0])
        _check_heading(problem, heading, exits, free, up)
    named = [*TILTS.T] * level + [TURN_ABOUT_Z] * (heading is not None)
    if named:
        first = np.array(named).T
        axes, size, _ = np.linalg.svd(free - first @ (first.T @ free), full_matrices=False)
        free = np.column_stack([first, axes[:, size > 0.5]])
    move = motion @ free
    hold = move.T @ problem.prior.information
    if level and vertical is not None:
        hold[:2] = vertical.hold
        lean = np.linalg.pinv(tilt.T)  # motions by which z leans in x and y
        rest = np.eye(len(spread)) - lean @ tilt.T
        spread = rest @ spread @ rest.T + lean @ vertical.covariance @ lean.T
    if heading is not None:
        cable = problem.robot.cable_names.index(heading)
        x, y, _ = exits[cable] - home
        row = 2 * int(level)
        hold[row] = 0.0
        hold[row, problem.exits[cable]] = np.array([-y, x, 0.0]) / np.hypot(x, y)
    displaced = (moves(exits - home, lever).reshape(-1, 6)) @ held
    convention = displaced @ spread @ displaced.T
    return Frame(
        reference=problem.reference,
        by_exit_points=np.asarray(
            (problem.reference is None) & ~problem.angles.coordinates_known.any(axis=0)
        ),
        home=home,
        lever=lever,
        free=free,
        hold=np.linalg.solve(hold @ move, hold) if free.shape[1] else hold,
        move=move,
        heading=heading,
        vertical=vertical,
        level=level,
        convention=np.asarray(0.5 * (convention + convention.T)),
    )


def _check_heading(
    problem: MotorAngleProblem, heading: str, exits: Array, free: Array, up: Array
) -> None:
    """Refuse an x axis through an exit point where the heading is known, or this point tells none.

    Upwards is along `up`, which z may not be yet.
    """
    if np.linalg.norm(free.T @ TURN_ABOUT_Z) < SAME_MOTION:
        allowed = "nothing, as what was measured tells the heading"
        if np.linalg.norm(free[5]) > AXIS_NAMED_MIN:
            allowed = (
                "nothing, as the heading is not free about home: known coordinates, or a file, "
                "hold another place"
            )
        raise InvalidField("x_through", repr(heading), allowed)
    ray = exits[problem.robot.cable_names.index(heading)] - problem.robot.home_position
    if np.linalg.norm(np.cross(up, ray)) < HEADING_SHARE_MIN * np.linalg.norm(ray):
        allowed = (
            f"an exit point beside home: that of {heading} is nearly on the vertical through "
            "home, and tells no heading"
        )
        raise InvalidField("x_through", repr(heading), allowed)


def _held(problem: MotorAngleProblem, free: Array) -> Array:
    """Return the motions that are held by convention, shape (6, h)."""
    tied = np.zeros(6, dtype=np.bool_)
    if problem.reference is not None:
        tied[:3] = problem.reference.axes
        tied[3 : problem.own] = problem.known_axes[problem.reference.row, 3:]
    axes, size, _ = np.linalg.svd(np.hstack([free, np.eye(6)[:, tied]]), full_matrices=False)
    return np.asarray(axes[:, size > AXIS_NAMED_MIN])


def _spread_before(problem: MotorAngleProblem, held: Array) -> Array:
    """Return the covariance of motions (6, h), by the robot file, shape (h, h)."""
    block, file = problem.exits.ravel(), problem.file_prior
    rays = problem.points(file.mean) - problem.robot.home_position
    motion = moves(rays, problem.longest).reshape(-1, 6) @ held
    return np.asarray(np.linalg.inv(motion.T @ file.information[np.ix_(block, block)] @ motion))


def _turns(motions: Array) -> Array:
    """Return the turns among motions (6, f), as unit vectors of W, shape (3, t)."""
    axes, size, _ = np.linalg.svd(motions[3:], full_matrices=False)
    return np.asarray(axes[:, size > AXIS_NAMED_MIN])


def mean_distance(exits: Array) -> float:
    """Return the root mean square distance of each exit point from the truth, averaged [m]."""
    return float(np.sqrt(np.diag(exits).reshape(-1, 3).sum(axis=1)).mean())


def _origin(axes: NDArray[np.bool_]) -> str:
    """Name the origin along some axes."""
    names = [name for name, mine in zip("xyz", axes, strict=True) if mine]
    return "the origin" if axes.all() else f"the origin of {' and '.join(names)}"


def _axis(turns: Array) -> str:
    """Name the axis of one turn."""
    axis = turns[:, 0] * np.sign(turns[np.argmax(np.abs(turns[:, 0])), 0])
    if axis[2] > SAME_MOTION:
        return "the vertical"
    return "the axis (" + ", ".join(f"{part:.2f}" for part in axis) + ")"
