"""Perceptrons in NumPy: half of the time that onnxruntime takes for one row between other work."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import InvalidField
from learned.approximate_mpc.plan_inputs import INPUT_MAX, UnreadableInputs
from learned.policy_file import OpenedNetwork
from learned.policy_network import Layers

ACTIVATION = "silu"  # of the hidden layers
TRIED = (0.0, 1.0, 1e3)  # numbers on which a network is tried
HALF = np.float32(0.5)


class Perceptron:
    """Layers with silu in between, and tanh at the end, in single precision."""

    def __init__(self, layers: Layers) -> None:
        """Take weight (out, in) and bias (out,) of each layer."""
        *hidden, last = layers
        # silu(h) is h / 2 (1 + tanh(h / 2)): halves are in the weights.
        self._hidden = [(np.ascontiguousarray(HALF * w.T), HALF * b) for w, b in hidden]
        self._last = np.ascontiguousarray(last[0].T), last[1]

    def __call__(self, numbers: Array) -> Array:
        """Return what the network tells, (..., out) from -1 to 1, of numbers (..., in).

        Raises:
            UnreadableInputs: A number is not finite, or far from all that a robot does.
        """
        if not np.abs(numbers).max(initial=0.0) <= INPUT_MAX:
            raise UnreadableInputs(f"{np.abs(numbers).max():g}")
        value = numbers.astype(np.float32)
        for weight, bias in self._hidden:
            value = value @ weight
            value += bias
            value *= 1.0 + np.tanh(value)
        weight, bias = self._last
        return np.asarray(np.tanh(value @ weight + bias), dtype=np.float64)


def perceptron_of(
    path: str | Path, opened: OpenedNetwork, inputs: int, outputs: int, wanted: str
) -> Perceptron:
    """Return the perceptron of a file that is open.

    Args:
        path: Of the file.
        opened: The file.
        inputs: Numbers that it must read.
        outputs: Numbers that it must tell.
        wanted: What the file should be, in words.

    Raises:
        InvalidField: It has other sizes or another activation, or gives no numbers.
    """
    layers = opened.layers
    sizes = (layers[0][0].shape[1], len(layers[-1][1]))
    if sizes != (inputs, outputs):
        raise InvalidField("path", f"{path} of {sizes[0]} to {sizes[1]} numbers",
                           f"{inputs} to {outputs}")  # fmt: skip
    if len(layers) > 1 and opened.activation != ACTIVATION:
        raise InvalidField("path", f"{path} with {opened.activation}", ACTIVATION)
    tell = Perceptron(layers)
    if not all(np.isfinite(tell(np.full(inputs, number))).all() for number in TRIED):
        raise InvalidField("path", f"{path}, which gives no numbers", wanted)
    return tell
