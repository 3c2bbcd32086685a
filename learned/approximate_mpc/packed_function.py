"""Functions of CasADi that are called with arrays, in some microseconds."""

from __future__ import annotations

from typing import Any

import numpy as np

from baselines.mpc.machine_code import with_machine_code
from baselines.mpc.settings import Compiled
from carosac_toolkit.base.arrays import Array

Expressions = tuple[str, list[Any], list[Any]]
"""Name, inputs and outputs of a function."""


class PackedFunction:
    """A CasADi function whose inputs are one vector in memory, and its outputs another."""

    def __init__(
        self, name: str, inputs: list[Any], outputs: list[Any], compiled: Compiled
    ) -> None:
        """Build it of expressions."""
        import casadi as ca

        packed = ca.SX.sym("packed", sum(each.numel() for each in inputs))
        values = ca.densify(ca.vertcat(*outputs))
        values = ca.substitute(values, ca.vertcat(*inputs), packed)
        built = ca.Function(f"{name}_network", [packed], [values], {"cse": True})
        function, _ = with_machine_code(built, compiled)
        self._function = function
        self._buffer, self._evaluate = function.buffer()
        self._input, self._output = np.zeros(packed.numel()), np.zeros(values.numel())
        self._buffer.set_arg(0, self._input.data)
        self._buffer.set_res(0, self._output.data)

    def __call__(self, *values: Array) -> Array:
        """Return the outputs, one after another."""
        np.concatenate(values, out=self._input)
        self._evaluate()
        return self._output.copy()
