"""What a command does beside its network, in two CasADi functions.

Compiled to machine code where there is a compiler, else they run in CasADi's virtual machine, in
some tens of microseconds more. Built of the formulas of `baselines.mpc`: its prediction model,
length offsets, excess filter and winch reference.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from baselines.mpc import model
from baselines.mpc.arithmetic import expressions
from baselines.mpc.excess_filter import ExcessFilter
from baselines.mpc.length_offsets import LengthOffsets
from baselines.mpc.settings import Compiled
from baselines.mpc.winch_reference import WinchFormulas, WinchState
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.robot.robot import Robot
from learned.approximate_mpc.packed_function import Expressions, PackedFunction

# All with the Jacobian of the first: on ``carosac`` they meet lengths that are 2 cm off to
# micrometres, and 5 cm off to a tenth of a millimetre.
NEWTON_STEPS = 3
WINCHES = len(WinchState._fields)


class Seen(NamedTuple):
    """What a belief tells beside the lengths that were sent.

    Attributes:
        free: Straight free lengths [m], shape (n,).
        innovation: What the twist has beyond its prediction, in the ways that the cables leave
            free, shape (6,).
        apart: What lengths sent and believed differ by, beside the offsets [m], shape (n,).
        motion_energy: Of the platform's motion against the winches [J].
        offset: Offsets, slack and bounds of the offsets thereafter [m], shape (3, n).
        state: The nearest one whose cables have the lengths and rates that were sent, shape (12,).
        rotation: Its rotation, shape (3, 3).
    """

    free: Array
    innovation: Array
    apart: Array
    motion_energy: float
    offset: Array
    state: Array
    rotation: Array


class Advanced(NamedTuple):
    """What comes of tensions that are held for a period.

    Attributes:
        state: Of the model then, shape (12,).
        tension: That give no more accelerations than winches have [N], shape (n,).
        excess: Sag less stretch then, and its rate [m, m/s], shape (2, n).
        winches: State then.
        held: Whether the command was changed to keep it within limits.
    """

    state: Array
    tension: Array
    excess: Array
    winches: WinchState
    held: bool


class FastMotion:
    """Motion of one robot as `baselines.mpc.model` has it.

    States are those of the model about the believed rotation, R_0. Fill `parameters` first.

    Attributes:
        parameters: As `baselines.mpc.model.parameters` returns them.
    """

    def __init__(
        self,
        robot: Robot,
        *,
        period: float,
        jerk_max: float,
        offsets: LengthOffsets,
        excess: ExcessFilter,
        compiled: Compiled = "never",
    ) -> None:
        """Build the functions.

        Args:
            robot: Of n cables.
            period: Time between two commands [s].
            jerk_max: Of commands [m/s^3].
            offsets: Gives the formulas; values are those of each call.
            excess: The same.
            compiled: As in `MpcSettings`.
        """
        n = self._n = robot.n
        motion = model.continuous(n)
        self._before = PackedFunction(*_before(motion, robot, offsets), compiled)
        self._after = PackedFunction(*_after(motion, robot, period, jerk_max, excess), compiled)
        self.parameters = np.zeros(motion.size1_in(2))

    def look(
        self,
        state: Array,
        predicted: Array,
        offsets: LengthOffsets,
        *,
        sent: Array,
        rate: Array,
    ) -> Seen:
        """Return what a belief tells.

        Args:
            state: A believed one, shape (12,).
            predicted: Twist that was expected, shape (6,).
            offsets: As they are now.
            sent: Lengths that the winches have, straight and free but for offsets [m], shape (n,).
            rate: Of the winches [m/s], shape (n,).
        """
        n = self._n
        told = self._before(
            state, self.parameters, predicted, offsets.offset, offsets.most, sent, rate
        )
        return Seen(
            free=told[:n], innovation=told[n : n + 6], apart=told[n + 6 : 2 * n + 6],
            motion_energy=float(told[2 * n + 6]), offset=told[2 * n + 7 : 5 * n + 7].reshape(3, n),
            state=told[5 * n + 7 : 5 * n + 19], rotation=told[5 * n + 19 :].reshape(3, 3),
        )  # fmt: skip

    def advance(
        self, state: Array, tension: Array, excess: Array, filtered: ExcessFilter,
        surplus: Array, winches: WinchState,
    ) -> Advanced:  # fmt: skip
        """Return what comes of tensions that are held for a period.

        Args:
            state: Now, shape (12,).
            tension: Wanted [N], shape (n,).
            excess: Sag less stretch at its end [m], shape (n,).
            filtered: As it is now.
            surplus: What lengths sent have beyond straight ones and excess [m], shape (n,).
            winches: State now.
        """
        n = self._n
        told = self._after(
            state, self.parameters, tension, excess, filtered.value, filtered.rate, surplus,
            *winches,
        )  # fmt: skip
        rows = told[12:].reshape(-1, n)
        return Advanced(
            state=told[:12], tension=rows[0], excess=rows[1:3],
            winches=WinchState(*rows[3 : 3 + WINCHES]), held=bool(rows[3 + WINCHES].any()),
        )  # fmt: skip


def _before(motion: Any, robot: Robot, offsets: LengthOffsets) -> Expressions:
    """Return what comes before the network."""
    import casadi as ca

    do, n = expressions(), robot.n
    x, p, twist = (ca.SX.sym("s", size) for size in (model.STATE_SIZE, motion.size1_in(2), 6))
    offset, most, sent, rate = (ca.SX.sym("s", n) for _ in range(4))
    lengths, jacobian, pulled = _cables(ca, motion, x, p, n)
    along = _least_energy(ca, jacobian, pulled)
    away = jacobian @ x[6:] - rate
    energy = 0.5 * ca.dot(away, ca.solve(jacobian @ pulled, away))
    innovation = x[6:] - twist
    missing = sent - lengths
    apart = missing - do.within(offset, -most, most)
    learned = offsets.after(offset, most, missing, do)
    moved = x
    for _ in range(NEWTON_STEPS):
        error = sent - learned[0] - learned[1] - motion(moved, ca.SX.zeros(n), p)[3][:n]
        step = along @ error
        moved = ca.vertcat(moved[:3] + step[:3], moved[3:6] + step[3:] / 4, moved[6:])
    _, there, pulled = _cables(ca, motion, moved, p, n)
    missed = _least_energy(ca, there, pulled) @ (rate - there @ moved[6:])
    moved = ca.vertcat(moved[:6], moved[6:] + missed)
    base = p[model.parameter_rows(n)["rotation"]]
    turned = ca.vec(model.rotation_expression(ca, moved[3:6], base).T)  # row by row
    innovation = innovation - along @ (jacobian @ innovation)
    return (
        "before",
        [x, p, twist, offset, most, sent, rate],
        [lengths, innovation, apart, energy, *learned, moved, turned],
    )


def _after(
    motion: Any, robot: Robot, period: float, jerk_max: float, excess: ExcessFilter
) -> Expressions:
    """Return what comes after it."""
    import casadi as ca

    do, n = expressions(), robot.n
    x, p = (ca.SX.sym("s", size) for size in (model.STATE_SIZE, motion.size1_in(2)))
    u, target, value, rate, surplus, *now = (ca.SX.sym("s", n) for _ in range(5 + WINCHES))
    winches = WinchState(*now)
    formulas = WinchFormulas(robot, period=period, jerk_max=jerk_max, arithmetic=do)
    commands = formulas.command_range(winches)
    allowed = formulas.acceleration_range(winches, commands)
    wanted = motion(x, u, p)[3][2 * n :]
    within = do.within(wanted, allowed.low, allowed.high)
    tension = u + ca.solve(ca.jacobian(wanted, u), within - wanted)
    after = model.stage(n)(x, tension, p, period)[0]
    path = motion(after, tension, p)[3]
    moved = excess.after(value, rate, target - value)
    then, cut = formulas.follow(winches, commands, path[:n] + surplus + moved[0], path[n : 2 * n])
    return (
        "after",
        [x, p, u, target, value, rate, surplus, *now],
        [after, tension, *moved, *then, cut],
    )


def _cables(ca: Any, motion: Any, x: Any, p: Any, n: int) -> tuple[Any, Any, Any]:
    """Return lengths (n,), their Jacobian by the twist (n, 6), accelerations per pull (6, n)."""
    path = motion(x, ca.SX.zeros(n), p)[3]
    jacobian = ca.jacobian(path[n : 2 * n], x[6:])
    block = {name: p[rows] for name, rows in model.parameter_rows(n).items()}
    rotation = model.rotation_expression(ca, x[3:6], block["rotation"])
    center = rotation @ block["center"]
    inverse = rotation @ ca.reshape(block["inverse_inertia"], 3, 3) @ rotation.T
    columns = []
    for i in range(n):
        force, moment = jacobian[i, :3].T, jacobian[i, 3:].T
        spin = inverse @ (moment - ca.cross(center, force))
        columns.append(ca.vertcat(force / block["mass"] - ca.cross(spin, center), spin))
    return path[:n], jacobian, ca.horzcat(*columns)


def _least_energy(ca: Any, jacobian: Any, pulled: Any) -> Any:
    """Return the motion of least energy (6, n) per length, as `constrained_motion` has it."""
    return ca.solve(jacobian @ pulled, pulled.T).T
