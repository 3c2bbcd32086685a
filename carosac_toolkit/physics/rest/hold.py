r"""Rest with the largest margin: a position held with all tensions as far from limits as they go.

.. math:: s^* = \max s \quad \text{subject to} \quad
    \sum_i \begin{bmatrix} f_i \\ (R b_i) \times f_i \end{bmatrix} + w = 0, \quad
    t_{min} + s \le t_i \le t_{max} - s

over the tensions :math:`t_i` at the platform and, with fewer than six cables, the rotation R; the
forces :math:`f_i` are those of the cables as they hang, w is weight and external wrench. A pose can
be held where :math:`s^* \ge 0`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray

from carosac_toolkit.base.arrays import Array, as_floats, batch, rotations
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.physics import warp_setup
from carosac_toolkit.physics.cable.catenary_kernels import mat66d, vec6d
from carosac_toolkit.physics.device import body_record, check_call, device_robot
from carosac_toolkit.physics.rest import hold_kernels
from carosac_toolkit.physics.rest.platform_kernels import Poses
from carosac_toolkit.physics.rest.statics import (
    EQUILIBRIUM_CLOSURE_MAX,
    EQUILIBRIUM_RESIDUAL_PER_WEIGHT,
    Equilibrium,
)
from carosac_toolkit.physics.rest.tension_margin import scratch
from carosac_toolkit.robot.robot import Robot

CHUNK_POSES = 8192  # poses at a time, in whole lines: what bounds the memory


@dataclass(frozen=True, kw_only=True, eq=False)
class WidestRest:
    """B poses, each with the rest of the largest margin that was found.

    Attributes:
        rest: The equilibria; `converged` where the margin is not negative.
        margin: Least distance of a tension to its limits [N], shape (B,). Negative: by so much all
            limits would have to be widened, cables being continued to first order beyond them. NaN
            where not `solved`, minus infinity where no tensions balance the wrench.
        gap: By how much a neighbouring rest could be better at most, to first order [N], (B,).
        low: Multiplier of each lower limit, N of margin per N of limit, shape (B, n).
        high: The same of each upper limit, shape (B, n); low and high have the sum 1.
        lowest: Lower limits used [N], shape (B, n).
        solved: True if margin and sign are settled, shape (B,); False is a failure to compute, no
            statement on the robot.
    """

    rest: Equilibrium
    margin: Array
    gap: Array
    low: Array
    high: Array
    lowest: Array
    solved: NDArray[np.bool_]


def hold(
    robot: Robot,
    position: ArrayLike,
    rotation: ArrayLike | None = None,
    *,
    wrench: ArrayLike = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    lines: ArrayLike | None = None,
    device: str = "cpu",
) -> WidestRest:
    """Hold positions at rest with the largest margin.

    The lower limit of a hanging cable is its `tension_min` or, if more, 1.3 times the least tension
    with which it can hang there, as in `statics.inverse_kinematics`.

    Args:
        robot: Robot description, n cables.
        position: Platform origin in W [m], shape (B, 3).
        rotation: Rotation from P to W, shape (B, 3, 3); None is the home rotation. With n < 6 it
            must be None: the rotation is solved for.
        wrench: On the platform besides its weight, at its origin, in W [N, N m], shape (6,).
        lines: Start of each line of neighbouring poses in the batch, shape (L,), the first one
            0. Along a line with n < 6 a search begins at the neighbour's answer, which is faster.
        device: Warp device.

    Returns:
        A rest for each pose. With n < 6 its margin is the largest one nearby, no proof that there
        is none elsewhere: where no stable rest is found, searches start from five rotations.
    """
    check_call(robot, device)
    where = batch("position", position, (3,))
    load = as_floats("wrench", wrench)
    if load.shape != (6,):
        raise InvalidField("wrench", f"shape {load.shape}", "shape (6,)")
    if robot.n < 6 and rotation is not None:
        raise InvalidField("rotation", "a rotation", f"None: {robot.n} cables leave it free")
    turn: Array = np.broadcast_to(robot.home_rotation, (len(where), 3, 3))
    if rotation is not None:
        turn = rotations("rotation", rotation, len(where))
    starts = np.arange(len(where)) if lines is None else _starts(lines, len(where))
    parts = [
        _solve(robot, where[a:b], turn[a:b], load, begin, device)
        for a, b, begin in _chunks(starts, len(where))
    ]
    solution = {key: np.concatenate([part[key] for part in parts]) for key in parts[0]}
    return _answer(robot, where, solution)


def _starts(lines: ArrayLike, size: int) -> NDArray[np.int64]:
    """Check the start of each line."""
    starts = np.asarray(lines)
    fits = starts.ndim == 1 and len(starts) > 0 and np.issubdtype(starts.dtype, np.integer)
    if not fits or starts[0] != 0 or (np.diff(starts) <= 0).any() or starts[-1] >= size:
        allowed = f"increasing indices from 0 to below {size}"
        raise InvalidField("lines", np.array2string(starts, threshold=6), allowed)
    return starts.astype(np.int64)


def _chunks(starts: NDArray[np.int64], size: int) -> list[tuple[int, int, NDArray[np.int64]]]:
    """Return first and last pose of each chunk of whole lines, with the bounds of its lines."""
    ends = np.append(starts[1:], size)
    out = []
    first = 0
    for k in range(len(starts)):
        if k + 1 == len(starts) or ends[k + 1] - starts[first] > CHUNK_POSES:
            a, b = int(starts[first]), int(ends[k])
            out.append((a, b, np.append(starts[first : k + 1], b) - a))
            first = k + 1
    return out


def _solve(
    robot: Robot,
    position: Array,
    rotation: Array,
    wrench: Array,
    first: NDArray[np.int64],
    device: str,
) -> dict[str, Array]:
    """Run the kernel on whole lines."""
    warp_setup.load(hold_kernels, device)
    cables, bodies = device_robot(robot, device)
    size, n = len(position), robot.n
    count = n + (3 if n < 6 else 0)
    poses = Poses()
    for name, (shape, kind) in _shapes(size, n, count).items():
        setattr(poses, name, wp.zeros(shape, dtype=kind, device=device))
    poses.position.assign(position)
    poses.rotation.assign(rotation)
    inputs = [
        cables,
        bodies,
        vec6d(*(float(x) for x in wrench)),
        wp.array(first, dtype=int, device=device),
        poses,
        scratch(len(first) - 1, count, device),
    ]
    wp.launch(hold_kernels.hold, len(first) - 1, inputs=inputs, device=device)
    return {name: getattr(poses, name).numpy() for name in _ANSWER_FIELDS}


_ANSWER_FIELDS = (
    "rotation", "tension", "unstrained_length", "q", "lower", "low", "high", "margin", "gap",
    "status", "steps", "stiffness", "residual", "closure", "stable",
)  # fmt: skip


def _shapes(size: int, n: int, count: int) -> dict[str, tuple[Any, Any]]:
    """Return shape and type of each array of `Poses`."""
    per_cable, per_unknown = (size, n), (size, count)
    return {
        "position": (size, wp.vec3d), "rotation": (size, wp.mat33d),
        "tension": (per_cable, wp.float64), "unstrained_length": (per_cable, wp.float64),
        "q": (per_cable, wp.vec3d), "inverse": (per_cable, wp.mat33d),
        "lower": (per_cable, wp.float64), "upper": (per_cable, wp.float64),
        "low": (per_cable, wp.float64), "high": (per_cable, wp.float64),
        "kept": (per_cable, wp.float64), "column": (per_unknown, vec6d),
        "wanted": (per_unknown, wp.float64), "margin": (size, wp.float64),
        "gap": (size, wp.float64), "status": (size, int), "steps": (size, int),
        "stiffness": (size, mat66d), "residual": (size, wp.float64),
        "closure": (size, wp.float64), "stable": (size, int),
    }  # fmt: skip


def _answer(robot: Robot, position: Array, solution: dict[str, Array]) -> WidestRest:
    """Judge the answers of the kernel."""
    status, length = solution["status"], solution["unstrained_length"]
    size = float(body_record(robot)["size"])
    margin = np.where(status == 1, solution["margin"], np.where(status == 2, -np.inf, np.nan))
    held = margin >= 0.0
    hung = solution["closure"] <= EQUILIBRIUM_CLOSURE_MAX * size
    sound = (solution["residual"] <= EQUILIBRIUM_RESIDUAL_PER_WEIGHT * robot.weight) & hung
    failed = (status == 0) | ~hung | (held & ~sound)
    margin = np.where(failed, np.nan, margin)
    rest = Equilibrium(
        position=position,
        rotation=solution["rotation"],
        unstrained_length=length,
        tension=solution["tension"],
        residual=np.where(held, solution["residual"], np.nan),
        gap=np.where(held, solution["closure"], np.nan),
        converged=held & sound,
        stable=held & sound & (solution["stable"] == 1),
        slack=solution["tension"] < robot.tension_min * (1.0 - 1e-9),
        in_winch_range=(length >= robot.length_min) & (length <= robot.length_max),
        stiffness=np.where(held[:, None, None], solution["stiffness"], np.nan),
        exit_tension=solution["q"],
        status=np.where(held & sound, 1, np.where(failed, 0, 2)).astype(np.int32),
        iterations=solution["steps"].astype(np.int32),
    )
    decided = (status == 1)[:, None]
    return WidestRest(
        rest=rest,
        margin=margin,
        gap=np.where(status == 2, 0.0, solution["gap"]),
        low=np.where(decided, solution["low"], 0.0),
        high=np.where(decided, solution["high"], 0.0),
        lowest=solution["lower"],
        solved=~failed,
    )
