"""MPC's prediction model, evaluated as seldom as one command needs it.

Three CasADi functions run in its virtual machine, in microseconds and without a compiler.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from baselines.mpc import model
from carosac_toolkit.base.arrays import Array

NEWTON_STEPS = 3  # onto lengths that a belief differs from by centimetres: to a micrometre


class FastMotion:
    """Motion of one robot as `baselines.mpc.model` has it.

    States are those of the model about the believed rotation, R_0. Fill `parameters` first.

    Attributes:
        parameters: As `baselines.mpc.model.parameters` returns them.
    """

    def __init__(self, n: int) -> None:
        """Build the functions for n cables."""
        import casadi as ca

        motion = model.continuous(n)
        x, u = ca.SX.sym("x", model.STATE_SIZE), ca.SX.sym("u", n)
        p, h = ca.SX.sym("p", motion.size1_in(2)), ca.SX.sym("h")
        twist, length, rate = ca.SX.sym("twist", 6), ca.SX.sym("l", n), ca.SX.sym("r", n)
        lengths, jacobian, along = _cables(ca, motion, x, p, n)
        innovation = x[6:] - twist
        seen = [lengths, innovation - along @ (jacobian @ innovation)]
        options = {"cse": True}
        look = ca.Function("look", [x, p, twist], [ca.densify(value) for value in seen], options)
        moved = x
        for _ in range(NEWTON_STEPS):
            lengths, _, along = _cables(ca, motion, moved, p, n)
            step = along @ (length - lengths)
            moved = ca.vertcat(moved[:3] + step[:3], moved[3:6] + step[3:] / 4, moved[6:])
        _, jacobian, along = _cables(ca, motion, moved, p, n)
        moved = ca.vertcat(moved[:6], moved[6:] + along @ (rate - jacobian @ moved[6:]))
        base = p[model.parameter_rows(n)["rotation"]]
        turned = ca.vec(model.rotation_expression(ca, moved[3:6], base).T)  # row by row
        project = ca.Function("project", [x, p, length, rate], [ca.densify(moved), turned], options)
        low, high = ca.SX.sym("low", n), ca.SX.sym("high", n)
        wanted = motion(x, u, p)[3][2 * n :]
        allowed = ca.fmin(ca.fmax(wanted, low), high)
        pull = u + ca.solve(ca.jacobian(wanted, u), allowed - wanted)
        after = model.stage(n)(x, pull, p, h)[0]
        path = motion(after, pull, p)[3]
        advance = ca.Function(
            "advance", [x, u, p, h, low, high], [after, path[: 2 * n], pull], options
        )
        self.parameters = np.zeros(p.numel())
        size = model.STATE_SIZE
        self._look = _Buffered(look, [np.zeros(size), self.parameters, np.zeros(6)])
        self._project = _Buffered(
            project, [np.zeros(size), self.parameters, np.zeros(n), np.zeros(n)]
        )
        self._advance = _Buffered(
            advance,
            [np.zeros(size), np.zeros(n), self.parameters, np.zeros(1), np.zeros(n), np.zeros(n)],
        )
        self._n = n

    def look(self, state: Array, twist: Array) -> tuple[Array, Array]:
        """Return straight free lengths (n,) [m] at a state, and what its twist has beyond another.

        The latter (6,) in the ways that the cables leave free.
        """
        lengths, innovation = self._look(state, None, twist)
        return lengths, innovation

    def project(self, state: Array, length: Array, rate: Array) -> tuple[Array, Array]:
        """Return the nearest state whose cables have given straight lengths and rates.

        Args:
            state: A believed one, shape (12,).
            length: Straight, free [m], shape (n,).
            rate: [m/s], shape (n,).

        Returns:
            The state (12,) and its rotation (3, 3).
        """
        moved, turned = self._project(state, None, length, rate)
        return moved, turned.reshape(3, 3)

    def advance(
        self, state: Array, tension: Array, duration: float, low: Array, high: Array
    ) -> tuple[Array, Array, Array, Array]:
        """Return what comes of tensions that are held.

        Args:
            state: Now, shape (12,).
            tension: Wanted [N], shape (n,).
            duration: For which they are held [s].
            low: Least acceleration of lengths that winches have [m/s^2], shape (n,).
            high: Largest, shape (n,).

        Returns:
            The state (12,) then, its lengths [m] and rates [m/s], and the tensions that give no
            more than these accelerations, each (n,).
        """
        after, path, pull = self._advance(state, tension, None, np.array([duration]), low, high)
        return after, path[: self._n], path[self._n :], pull


def _cables(ca: Any, motion: Any, x: Any, p: Any, n: int) -> tuple[Any, Any, Any]:
    """Return lengths (n,), their Jacobian by the twist (n, 6), and the motion of least energy.

    The latter (6, n) per length, as `constrained_motion` has it.
    """
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
    pulled = ca.horzcat(*columns)
    return path[:n], jacobian, ca.solve(jacobian @ pulled, pulled.T).T


class _Buffered:
    """A CasADi function on arrays of its own."""

    def __init__(self, function: Any, inputs: list[Array]) -> None:
        """Take arrays for its inputs; they are filled before each evaluation."""
        self._buffer, self._evaluate = function.buffer()
        self._inputs = inputs
        self._outputs = [np.zeros(function.size1_out(i)) for i in range(function.n_out())]
        for i, array in enumerate(self._inputs):
            self._buffer.set_arg(i, array.data)
        for i, array in enumerate(self._outputs):
            self._buffer.set_res(i, array.data)
        self._function = function

    def __call__(self, *values: Array | None) -> list[Array]:
        """Evaluate at values; None leaves an input as it is."""
        for array, value in zip(self._inputs, values, strict=True):
            if value is not None:
                array[:] = value
        self._evaluate()
        return [array.copy() for array in self._outputs]
