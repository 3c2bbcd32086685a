"""The network of a policy in its ONNX file, checked before anything runs it.

ONNX can hold any program: loops without end, and constants of any size that are made as the file
is loaded. Only perceptrons of the one form that is written here pass. The check reads the protobuf
by itself, as policies are used where the package onnx is not installed.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from math import prod

import numpy as np
from numpy.typing import NDArray

from carosac_toolkit.base.errors import MALFORMED

ACTIVATION_NAMES = ("relu", "silu")
POLICY_BYTES_MAX = 2**24  # 16 times that of layers (400, 300) and more
LAYERS_MAX = 100
WIDTH_MAX = 100_000  # numbers that a layer takes or gives
_PARTS_MAX = 10_000  # of a message
_FLOAT, _INT = 1, 2  # types of tensors and of attributes
_FLOAT_BYTES = 4

# Fields of onnx.proto that policies have; any other is refused, such as functions, subgraphs and
# data outside of the file.
_VERSION, _PRODUCER, _GRAPH, _OPSET, _METADATA = 1, 2, 7, 8, 14
_NODES, _GRAPH_NAME, _TENSORS, _INPUTS, _OUTPUTS = 1, 2, 5, 11, 12
_TAKES, _GIVES, _OPERATOR, _ATTRIBUTES = 1, 2, 4, 5
_DIMENSIONS, _TYPE, _NAME, _DATA = 1, 2, 8, 9
_OPERATORS = ("Gemm", "Relu", "Sigmoid", "Mul", "Tanh")
_TRANSPOSED = {1: [b"transB"], 3: [1], 20: [_INT]}

Layers = Sequence[tuple[NDArray[np.float32], NDArray[np.float32]]]
"""Weight (out, in) and bias (out,) of each layer."""
Node = tuple[str, list[str], list[str]]
"""Operator, names of its inputs and names of its outputs."""
_Message = dict[int, list[int | bytes]]


class OtherNetwork(Exception):
    """Data that are no ONNX file, or hold another network than one of a policy."""


def network_nodes(count: int, activation: str) -> list[Node]:
    """Return the nodes of a perceptron: ``observation`` to ``action``, tanh behind the last layer.

    Each Gemm multiplies by its weight (out, in) transposed.

    Args:
        count: Number of layers.
        activation: Of the hidden layers: relu or silu.
    """
    nodes: list[Node] = []
    value = "observation"
    for k in range(count):
        linear, gate = f"linear_{k}", f"gate_{k}"
        nodes.append(("Gemm", [value, f"weight_{k}", f"bias_{k}"], [linear]))
        last = k == count - 1
        value = "action" if last else f"hidden_{k}"
        if last or activation == "relu":
            nodes.append(("Tanh" if last else "Relu", [linear], [value]))
        else:  # silu
            nodes.append(("Sigmoid", [linear], [gate]))
            nodes.append(("Mul", [linear, gate], [value]))
    return nodes


def read_network(data: bytes) -> tuple[Layers, str]:
    """Return the layers of a perceptron of `network_nodes`, and its activation.

    Raises:
        OtherNetwork: It is another network, or its weights are not in the file; says what differs.
    """
    try:
        return _read(data)
    except MALFORMED as error:
        detail = str(error) if isinstance(error, ValueError) else "it is damaged"
        raise OtherNetwork(detail) from error


def _read(data: bytes) -> tuple[Layers, str]:
    """Read a model; whatever is wrong raises some error of `MALFORMED`."""
    if len(data) > POLICY_BYTES_MAX:
        raise ValueError(f"more than {POLICY_BYTES_MAX / 1e6:.0f} MB")
    model = _message(data, (_VERSION, _PRODUCER, _GRAPH, _OPSET, _METADATA))
    graph = _part(_only(model, _GRAPH), (_NODES, _GRAPH_NAME, _TENSORS, _INPUTS, _OUTPUTS))
    _only(graph, _INPUTS), _only(graph, _OUTPUTS)
    nodes = [_node(part) for part in graph.get(_NODES, [])]
    tensors = graph.get(_TENSORS, [])
    found = dict(_tensor(part) for part in tensors)
    shapes = {name: values.shape for name, values in found.items()}
    count = len(shapes) // 2
    if not 0 < 2 * count == len(tensors) <= 2 * LAYERS_MAX:
        raise ValueError(f"{len(tensors)} weights and biases")
    activation = [name for name in ACTIVATION_NAMES if nodes == network_nodes(count, name)]
    if not activation:
        raise ValueError("nodes in another order, or of other names")
    width = shapes["weight_0"][1]
    for k in range(count):
        taken, (given,) = width, shapes[f"bias_{k}"]
        if shapes[f"weight_{k}"] != (given, taken) or not 0 < max(taken, given) <= WIDTH_MAX:
            raise ValueError(f"layer {k} does not fit")
        width = given
    layers = [(found[f"weight_{k}"], found[f"bias_{k}"]) for k in range(count)]
    return layers, activation[0]


def _node(part: int | bytes) -> Node:
    """Return a node; of attributes it has the one that the exporter writes, or none."""
    node = _part(part, (_TAKES, _GIVES, _OPERATOR, _ATTRIBUTES))
    names = [[_text(name) for name in node.get(side, [])] for side in (_TAKES, _GIVES)]
    operator = _text(_only(node, _OPERATOR))
    if operator not in _OPERATORS:
        raise ValueError(f"operator {operator!r}")
    attributes = [_part(x, _TRANSPOSED) for x in node.get(_ATTRIBUTES, [])]
    if attributes != ([_TRANSPOSED] if operator == "Gemm" else []):
        raise ValueError(f"attributes of a node {operator}")
    return operator, names[0], names[1]


def _tensor(part: int | bytes) -> tuple[str, NDArray[np.float32]]:
    """Return name and values of a tensor of float32 that lies in the file."""
    tensor = _part(part, (_DIMENSIONS, _TYPE, _NAME, _DATA))
    sizes = tensor.get(_DIMENSIONS, [])
    shape = tuple(size for size in sizes if isinstance(size, int))
    data = _only(tensor, _DATA)
    if not isinstance(data, bytes):
        raise TypeError("a number in place of those of a tensor")
    fits = _only(tensor, _TYPE) == _FLOAT and len(data) == _FLOAT_BYTES * prod(shape)
    if not fits or len(shape) != len(sizes):
        raise ValueError("a tensor that is not as large as its numbers")
    return _text(_only(tensor, _NAME)), np.frombuffer(data, "<f4").reshape(shape)


def _only(message: _Message, field: int) -> int | bytes:
    """Return the one value of a field, as readers differ over several."""
    values = message.get(field, [])
    if len(values) != 1:
        raise ValueError(f"{len(values)} values of field {field}")
    return values[0]


def _text(value: int | bytes) -> str:
    if not isinstance(value, bytes):
        raise TypeError("a number in place of a text")
    return value.decode()


def _part(value: int | bytes, allowed: Collection[int]) -> _Message:
    """Read a message within another."""
    if not isinstance(value, bytes):
        raise TypeError("a number in place of a message")
    return _message(value, allowed)


def _message(data: bytes, allowed: Collection[int]) -> _Message:
    """Return the values of a protobuf message by field, all of which must be allowed ones."""
    message: _Message = {}
    for count, (field, value) in enumerate(_values(data)):
        if field not in allowed or count >= _PARTS_MAX:
            raise ValueError(f"a field {field}, or too many of it")
        message.setdefault(field, []).append(value)
    return message


def _values(data: bytes) -> Iterator[tuple[int, int | bytes]]:
    """Give field numbers and values of a protobuf message: numbers, and what has a length."""
    place = 0
    while place < len(data):
        key, place = _number(data, place)
        value, place = _number(data, place)
        if key & 7 == 0:
            yield key >> 3, value
        elif key & 7 == 2 and place + value <= len(data):
            yield key >> 3, data[place : place + value]
            place += value
        else:
            raise ValueError("cut off, or no protobuf of a policy")


def _number(data: bytes, place: int) -> tuple[int, int]:
    """Return a number of at most 32 bits, and the place behind it."""
    number = 0
    for k in range(5):
        byte = data[place + k]
        number |= (byte & 127) << 7 * k
        if byte < 128:
            if number >= 2**32:
                break
            return number, place + k + 1
    raise ValueError("a number of more than 32 bits")
