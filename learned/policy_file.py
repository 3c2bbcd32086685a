"""A trained policy as one ONNX file that says what it was trained for."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, asdict, dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from carosac_toolkit.base.arrays import Array, batch
from carosac_toolkit.base.errors import MALFORMED, InvalidField, MissingFile
from carosac_toolkit.base.extras import require
from carosac_toolkit.base.files import replacing
from carosac_toolkit.base.numbers import check_positive, check_whole
from carosac_toolkit.robot.robot import Robot
from learned.policy_network import (
    ACTIVATION_NAMES,
    POLICY_BYTES_MAX,
    WIDTH_MAX,
    Layers,
    OtherNetwork,
    network_nodes,
    read_network,
)
from learned.policy_probe import check_probe, make_probe
from learned.settings_data import environment_settings

if TYPE_CHECKING:
    from onnx import ModelProto

POLICY_SCHEMA = "carosac-policy/1"
METADATA_PREFIX = "carosac."  # of the names of our metadata
ONNX_OPSET = 17
OBSERVATION_MAX = 1e15  # of an observation: float32 networks are far from overflowing there
ACTION_MAX = 1.0 + 1e-6  # of tanh in float32
TRIED_ROWS, TRIED_SCALE = 8, 1e3  # observations on which a network is tried, and their multiples
ONNX_IR_VERSION = 8  # goes with the opset
POLICY_FILE_NAME = "an ONNX file that `carosac train` wrote"


@dataclass(frozen=True, kw_only=True, eq=False)
class PolicyDescription:
    """Description of what a policy was trained for, and how.

    Attributes:
        preset: Name of the preset it was trained with.
        robot: The nominal robot it was trained for.
        observation: Names of the parts of the observation, in their order.
        action: Name of what an action in [-1, 1] stands for.
        period: Time between two actions [s]; None: each set-point settles.
        settings: All settings of environment and training, as JSON holds them.
        seed: Seed of the training.
        steps: Environment steps it was trained for.
        commit: Commit of the code that trained it.
        scores: What an evaluation found, by name with its unit.
        probe: Results of fixed observations and actions where it was trained, see
            `learned.policy_probe`; None: computed when it is written.
    """

    preset: str
    robot: Robot
    observation: tuple[str, ...]
    action: str
    period: float | None
    settings: dict[str, Any]
    seed: int
    steps: int
    commit: str
    scores: dict[str, float]
    probe: dict[str, Any] | None = None

    def __post_init__(self) -> None:
        """Refuse what a file could not give back as it was."""
        names = self.observation
        if not isinstance(names, list | tuple) or not all(isinstance(x, str) for x in names):
            raise InvalidField("observation", repr(names), "names of the parts of an observation")
        object.__setattr__(self, "observation", tuple(names))
        for name in ("preset", "action", "commit"):
            if not isinstance(getattr(self, name), str):
                raise InvalidField(name, repr(getattr(self, name)), "text")
        if self.period is not None:
            check_positive("period", self.period, "s")
        for name in ("seed", "steps"):
            check_whole(name, getattr(self, name), 0)
            object.__setattr__(self, name, int(getattr(self, name)))
        for name in ("settings", "scores"):
            object.__setattr__(self, name, _plain(name, getattr(self, name)))
        if self.probe is not None:
            object.__setattr__(self, "probe", _plain("probe", self.probe))


class Policy:
    """A policy read from a file: a map from observations to actions, without memory.

    Attributes:
        description: What it was trained for.
        observation_size: Numbers in an observation.
        action_size: Numbers in an action.
    """

    def __init__(self, session: Any, description: PolicyDescription) -> None:
        self.description = description
        self.observation_size = int(session.get_inputs()[0].shape[1])
        self.action_size = int(session.get_outputs()[0].shape[1])
        self._session = session

    @classmethod
    def load(cls, path: str | Path) -> Policy:
        """Read a policy with onnxruntime alone, to run on one core.

        Raises:
            MissingFile: There is no such file.
            InvalidField: It is no policy that `write_policy` wrote, or one of another version, that
                would not do here what it did where it was trained.
            MissingExtra: onnxruntime is not installed.
        """
        if Path(path).is_dir():
            allowed = f"{POLICY_FILE_NAME}: policy.onnx in the folder of a stage"
            raise InvalidField("path", f"the folder {path}", allowed)
        session = open_network(path, POLICY_FILE_NAME).session
        try:
            sides = {
                "observation": {one.name: one.shape for one in session.get_inputs()},
                "action": {one.name: one.shape for one in session.get_outputs()},
            }
            record = read_record(
                path, session.get_modelmeta().custom_metadata_map, POLICY_SCHEMA,
                [f.name for f in fields(PolicyDescription)],
                wanted=POLICY_FILE_NAME, command="carosac train",
            )  # fmt: skip
            description = PolicyDescription(**record)
            settings = environment_settings(description.settings)
            check_probe(description.probe, description.robot, settings)
        except MALFORMED as error:
            got = f"{path} with damaged metadata: {error}"
            raise InvalidField("path", got, POLICY_FILE_NAME) from error
        for name, shapes in sides.items():
            if set(shapes) != {name} or not _is_batch(shapes[name]):
                raise InvalidField(
                    "path", f"{path} with {shapes}", f"{POLICY_FILE_NAME}: {name} (batch, d)"
                )
        policy = cls(session, description)
        policy._try(path)
        return policy

    def act(self, observation: ArrayLike) -> Array:
        """Choose an action for each observation.

        Args:
            observation: As `description.observation` names it, shape (B, observation_size).

        Returns:
            Actions in [-1, 1] [-], shape (B, action_size).

        Raises:
            InvalidField: A wrong size, or a number that is not finite or too large, in the
                observation or in the action.
        """
        values = np.asarray(observation)
        if values.ndim != 2 or values.shape[1] != self.observation_size or len(values) == 0:
            batch("observation", observation, (self.observation_size,))  # says what is wrong
        if not np.abs(values).max() <= OBSERVATION_MAX:
            checked = batch("observation", observation, (self.observation_size,))
            allowed = f"-{OBSERVATION_MAX:g} to {OBSERVATION_MAX:g}, in units of the observation"
            raise InvalidField("observation", f"{np.abs(checked).max():g}", allowed)
        seen = {"observation": values.astype(np.float32)}
        action: Array = self._session.run(["action"], seen)[0].astype(np.float64)
        usual = action.shape == (len(values), self.action_size)
        if not usual or not np.abs(action).max() <= ACTION_MAX:
            got = "NaN" if np.isnan(action).any() else f"up to {np.abs(action).max():g}"
            raise InvalidField("action", f"{got}, shape {action.shape}", "numbers from -1 to 1")
        return action

    def _try(self, path: str | Path) -> None:
        """Act on some observations; refuse a network that does not give actions there.

        Raises:
            InvalidField: A weight is not finite, or the network is damaged otherwise.
        """
        failures: tuple[type[Exception], ...] = (InvalidField, *_onnx_failures())
        drawn = np.random.default_rng(0).standard_normal((TRIED_ROWS, self.observation_size))
        try:
            self.act(np.concatenate([np.zeros_like(drawn[:1]), drawn, TRIED_SCALE * drawn]))
        except failures as error:
            got = f"{path}, which does not act: {str(error).splitlines()[0]}"
            raise InvalidField("path", got, POLICY_FILE_NAME) from error


def write_policy(
    path: str | Path, layers: Layers, activation: str, description: PolicyDescription
) -> None:
    """Write a multilayer perceptron with tanh behind its last layer, as a whole or not at all.

    Args:
        path: The ONNX file.
        layers: Weight (out, in) and bias (out,) of each layer, kept as float32.
        activation: Of the hidden layers: relu or silu.
        description: What it was trained for; kept as metadata.

    Raises:
        InvalidField: Layers that do not fit, an unknown activation, or settings without those of
            an environment.
        MissingExtra: onnx is not installed.
        CarosacError: The file cannot be written.
    """
    if activation not in ACTIVATION_NAMES:
        raise InvalidField("activation", repr(activation), f"one of {list(ACTIVATION_NAMES)}")
    model = network_model(checked_layers(layers), activation)
    if description.probe is None:
        settings = environment_settings(description.settings)
        description = replace(description, probe=make_probe(description.robot, settings))
    with replacing(Path(path)) as temporary:
        temporary.write_bytes(_with_metadata(model, description))


def checked_layers(layers: Layers) -> list[tuple[NDArray[np.float32], NDArray[np.float32]]]:
    """Return layers as float32; name the first that does not fit."""
    if not layers:
        raise InvalidField("layers", "none", "at least one layer")
    checked = []
    width: int | None = None
    for k, (weight, bias) in enumerate(layers):
        pair = (np.asarray(weight, dtype=np.float32), np.asarray(bias, dtype=np.float32))
        shape = pair[0].shape
        fits = len(shape) == 2 and pair[1].shape == shape[:1] and width in (None, shape[1])
        if not fits or 0 in shape:
            allowed = f"weight (out, {width or 'in'}) and bias (out,)"
            raise InvalidField(f"layers[{k}]", f"shapes {shape} and {pair[1].shape}", allowed)
        if not all(np.isfinite(part).all() for part in pair):
            raise InvalidField(f"layers[{k}]", "a number that is not finite", "finite numbers")
        checked.append(pair)
        width = shape[0]
    return checked


def network_model(layers: Layers, activation: str) -> ModelProto:
    """Build the graph of a perceptron: observation (batch, in) to action (batch, out)."""
    require("writing a policy", "onnx")
    from onnx import TensorProto, helper, numpy_helper

    nodes = [helper.make_node(*node) for node in network_nodes(len(layers), activation)]
    for node in nodes:
        if node.op_type == "Gemm":
            node.attribute.append(helper.make_attribute("transB", 1))
    tensors = [
        numpy_helper.from_array(part, f"{name}_{k}")
        for k, pair in enumerate(layers)
        for name, part in zip(("weight", "bias"), pair, strict=True)
    ]
    sides = [
        helper.make_tensor_value_info(name, TensorProto.FLOAT, ["batch", size])
        for name, size in (("observation", layers[0][0].shape[1]), ("action", len(layers[-1][1])))
    ]
    graph = helper.make_graph(nodes, "policy", sides[:1], sides[1:], tensors)
    opset = [helper.make_opsetid("", ONNX_OPSET)]
    return helper.make_model(
        graph, opset_imports=opset, ir_version=ONNX_IR_VERSION, producer_name="carosac-toolkit"
    )


def _with_metadata(model: ModelProto, description: PolicyDescription) -> bytes:
    """Check a model and add its description; equal policies give equal bytes."""
    record = {f.name: getattr(description, f.name) for f in fields(PolicyDescription)}
    return described_network(model, POLICY_SCHEMA, record | {"robot": record_of(description.robot)})


def record_of(robot: Robot) -> dict[str, Any]:
    """Return a robot as JSON holds it; see `robot_of`."""
    return {
        name: value.tolist() if isinstance(value, np.ndarray) else value
        for name, value in asdict(robot).items()
    }


def described_network(model: ModelProto, schema: str, record: Mapping[str, Any]) -> bytes:
    """Check a model and add metadata; equal networks give equal bytes.

    Raises:
        InvalidField: A network that could not be read again.
    """
    from onnx import checker, helper

    texts = {METADATA_PREFIX + name: json.dumps(value) for name, value in record.items()}
    helper.set_model_props(model, {METADATA_PREFIX + "schema": schema} | texts)
    checker.check_model(model, full_check=True)
    data = bytes(model.SerializeToString(deterministic=True))
    try:
        read_network(data)
    except OtherNetwork as error:
        raise InvalidField("layers", error, "a network that can be read again") from error
    return data


def _onnx_failures() -> tuple[type[Exception], ...]:
    """Return what onnxruntime raises over a network that it cannot read or run."""
    from onnxruntime.capi import onnxruntime_pybind11_state as failures

    names = ("Fail", "InvalidArgument", "InvalidGraph", "InvalidProtobuf", "NoModel",
             "NotImplemented", "RuntimeException")  # fmt: skip
    return tuple(getattr(failures, name) for name in names)


class OpenedNetwork(NamedTuple):
    """A network of a file.

    Attributes:
        session: Of onnxruntime.
        layers: Weight (out, in) and bias (out,) of each layer.
        activation: Of the hidden layers.
    """

    session: Any
    layers: Layers
    activation: str


def open_network(path: str | Path, name: str) -> OpenedNetwork:
    """Open a file in onnxruntime, on one core; it runs parts of a network as it loads it.

    Args:
        path: Of the file.
        name: What it should be, in words.

    Raises:
        MissingFile: There is no such file.
        InvalidField: It is none, or no network of `learned.policy_network`.
        MissingExtra: onnxruntime is not installed.
    """
    if not Path(path).is_file():
        raise MissingFile(path)
    require("a policy", "onnxruntime")
    import onnxruntime

    failures: tuple[type[Exception], ...] = (*_onnx_failures(), ValueError)  # a text not UTF-8
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    options.inter_op_num_threads = 1
    options.log_severity_level = 4  # what matters is raised
    with Path(path).open("rb") as file:
        data = file.read(POLICY_BYTES_MAX + 1)
    try:
        layers, activation = read_network(data)
    except OtherNetwork as error:
        allowed = f"{name}; this is no ONNX file, or of another network: {error}"
        raise InvalidField("path", path, allowed) from error
    try:
        session = onnxruntime.InferenceSession(data, options, providers=["CPUExecutionProvider"])
    except failures as error:
        raise InvalidField("path", path, f"{name}; this is no ONNX file") from error
    return OpenedNetwork(session, layers, activation)


def read_record(
    path: str | Path,
    metadata: Mapping[str, str],
    schema: str,
    names: Sequence[str],
    *,
    wanted: str,
    command: str,
) -> dict[str, Any]:
    """Read what `described_network` wrote, a robot as one.

    Args:
        path: Of the file.
        metadata: Of the network.
        schema: It must have.
        names: Of what must be there.
        wanted: What the file should be, in words.
        command: That writes such files.

    Raises:
        InvalidField: Another schema, or something is missing or damaged.
    """
    again = f" of this version: train it again with `{command}`"
    found = metadata.get(METADATA_PREFIX + "schema")
    if found != schema:
        kind, _, version = schema.rpartition("/")
        older = [f"{kind}/{number}" for number in range(int(version))]
        got = f"{path} with schema {found}" if found else f"{path} without our metadata"
        allowed = f"{wanted}, schema {schema}"
        raise InvalidField("path", got, allowed + again if found in older else allowed)
    missing = [name for name in names if METADATA_PREFIX + name not in metadata]
    if missing:
        raise InvalidField("path", f"{path} without {', '.join(missing)}", wanted + again)
    try:
        record = {name: json.loads(metadata[METADATA_PREFIX + name]) for name in names}
    except (ValueError, RecursionError) as error:
        raise InvalidField("path", f"{path} with damaged metadata", wanted) from error
    if "robot" in record:
        record["robot"] = robot_of(path, record["robot"])
    return record


def robot_of(path: str | Path, record: Any) -> Robot:
    """Read the robot of a policy; optional fields that came to `Robot` later may be missing."""
    needed = {f.name for f in fields(Robot) if f.default is f.default_factory is MISSING}
    known = {f.name for f in fields(Robot)}
    names = set(record) if isinstance(record, dict) else set()
    wrong = sorted((needed - names) | (names - known))
    if wrong:
        raise InvalidField("path", f"{path} whose robot differs in {wrong}", "the fields of Robot")
    return Robot(**record)


def _is_batch(shape: Sequence[Any]) -> bool:
    """Return whether a shape is (batch, d) with a known d."""
    return len(shape) == 2 and isinstance(shape[1], int) and 0 < shape[1] <= WIDTH_MAX


def _plain(name: str, value: Any) -> Any:
    """Return a mapping as JSON gives it back, or refuse it."""
    allowed = "a mapping of texts to what JSON can hold, all numbers finite"
    if not isinstance(value, Mapping):
        raise InvalidField(name, repr(value), allowed)
    try:
        return json.loads(json.dumps(dict(value), allow_nan=False))
    except (TypeError, ValueError) as error:
        raise InvalidField(name, f"what JSON cannot hold ({error})", allowed) from error
