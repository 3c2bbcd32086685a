"""The stage function on buffers: compiled to machine code where possible, else interpreted."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np

from baselines.mpc import model
from baselines.mpc.machine_code import with_machine_code
from baselines.mpc.settings import Compiled


class StageFunction:
    """`model.stage` of K stages at once, on arrays that are there already.

    Fill `state`, `tension`, `parameters`, `duration` and call it.

    Attributes:
        compiled: Whether machine code runs.
        reason: Why not, else empty.
        state: (K, 12).
        tension: [N], shape (K, n).
        parameters: (K, number of parameters).
        duration: [s], shape (K,).
        after: State at the end of the stage, shape (K, 12).
        by_state: d after / d state, shape (K, 12, 12).
        by_tension: d after / d tension, shape (K, 12, n).
        path: [length; rate; acceleration] at its start, shape (K, 3 n).
        path_by_state: (K, 3 n, 12).
        path_by_tension: (K, 3 n, n).
    """

    def __init__(self, n: int, stages: int, compiled: Compiled = "auto") -> None:
        """Make one.

        Args:
            n: Cables.
            stages: K.
            compiled: As in `MpcSettings`.

        Raises:
            CompileError: It must be compiled and cannot be.
        """
        function, self.reason = _function(n, stages, compiled)
        self.compiled = not self.reason
        size, rows = model.STATE_SIZE, model.PATH_QUANTITIES * n
        count = sum(model.parameter_names(n).values())
        self.state, self.tension = np.zeros((stages, size)), np.zeros((stages, n))
        self.parameters, self.duration = np.zeros((stages, count)), np.zeros(stages)
        shapes = [(size,), (size, size), (n, size), (rows,), (size, rows), (n, rows)]
        results = [np.zeros((stages, *shape)) for shape in shapes]
        buffer, self._evaluate = function.buffer()
        for i, array in enumerate((self.state, self.tension, self.parameters, self.duration)):
            buffer.set_arg(i, array.data)
        for i, array in enumerate(results):
            buffer.set_res(i, array.data)
        self._keep = (function, buffer)
        self.after, self.path = results[0], results[3]
        turned = (results[i].swapaxes(1, 2) for i in (1, 2, 4, 5))  # CasADi stores columns
        self.by_state, self.by_tension, self.path_by_state, self.path_by_tension = turned

    def __call__(self) -> None:
        """Evaluate all stages."""
        self._evaluate()


@lru_cache(maxsize=16)
def _function(n: int, stages: int, compiled: Compiled) -> tuple[Any, str]:
    """Return the function, and why it is not compiled."""
    function = model.interpreted(n, stages)
    return with_machine_code(function, compiled)
