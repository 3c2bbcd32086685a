import json
import subprocess
import sys
from dataclasses import asdict, fields, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from carosac_toolkit.base.errors import CarosacError, InvalidField, MissingFile
from carosac_toolkit.base.extras import MissingExtra
from carosac_toolkit.robot.bundled_names import list_robots
from carosac_toolkit.robot.differences import differing
from carosac_toolkit.robot.file import load_robot
from learned.environment import EnvironmentSettings
from learned.policy_file import Policy, PolicyDescription, write_policy
from learned.policy_probe import make_probe
from tests.robots import simple_robot

onnx = pytest.importorskip("onnx")
torch = pytest.importorskip("torch")
pytest.importorskip("onnxruntime")

ROOT = Path(__file__).resolve().parents[2]
SIZES = (10, 32, 24, 4)


def perceptron(activation="relu", sizes=SIZES, seed=0):
    """A torch network and its layers."""
    torch.manual_seed(seed)
    hidden = {"relu": torch.nn.ReLU, "silu": torch.nn.SiLU}[activation]
    linear = [torch.nn.Linear(a, b) for a, b in pairwise(sizes)]
    parts = [part for layer in linear for part in (layer, hidden())][:-1]
    network = torch.nn.Sequential(*parts, torch.nn.Tanh())
    layers = [(one.weight.detach().numpy(), one.bias.detach().numpy()) for one in linear]
    return network, layers


def described(**changes):
    description = PolicyDescription(
        preset="paper",
        robot=simple_robot(),
        observation=("lengths", "position", "target"),
        action="absolute lengths",
        period=None,
        settings={"environment": asdict(EnvironmentSettings()), "layers": (400, 300), "rate": 3e-4},
        seed=3,
        steps=1000,
        commit="0123abc",
        scores={"median_error_m": 0.0271},
    )
    return replace(description, **changes)


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "policy.onnx"
    write_policy(path, perceptron()[1], "relu", described())
    return path


def with_metadata(file, **changes):
    """Another file with other metadata; None takes an entry away."""
    model = onnx.load(file)
    texts = {one.key: one.value for one in model.metadata_props}
    texts |= {f"carosac.{name}": value for name, value in changes.items()}
    del model.metadata_props[:]
    known = {name: value for name, value in texts.items() if value is not None}
    onnx.helper.set_model_props(model, known)
    other = file.with_name("other.onnx")
    other.write_bytes(model.SerializeToString())
    return other


@pytest.mark.parametrize("activation", ["relu", "silu"])
@pytest.mark.parametrize("sizes", [SIZES, (10, 4), (13, 16, 16, 16, 8)])
def test_a_policy_acts_as_the_network_with_its_weights(tmp_path, activation, sizes):
    network, layers = perceptron(activation, sizes)
    write_policy(tmp_path / "policy.onnx", layers, activation, described())
    policy = Policy.load(tmp_path / "policy.onnx")
    observation = 3.0 * np.random.default_rng(1).standard_normal((50, sizes[0]))
    with torch.no_grad():
        expected = network(torch.tensor(observation, dtype=torch.float32)).numpy()
    action = policy.act(observation)
    assert (policy.observation_size, policy.action_size) == (sizes[0], sizes[-1])
    assert action.dtype == np.float64
    np.testing.assert_allclose(action, expected, rtol=0.0, atol=1e-6)
    for row, one in zip(action, observation, strict=True):  # a batch is its rows, to rounding
        np.testing.assert_allclose(policy.act(one[None])[0], row, rtol=0.0, atol=1e-6)


def test_actions_stay_within_one_however_large_the_observation(file):
    policy = Policy.load(file)
    directions = np.random.default_rng(2).standard_normal((200, 10))
    for size in (1.0, 1e3, 1e6, 1e12):
        action = policy.act(size * directions)
        assert np.abs(action).max() <= 1.0
    assert np.abs(action).min() > 0.99


def test_a_description_comes_back_as_it_was_written(file):
    written, found = described(), Policy.load(file).description
    for field in fields(PolicyDescription):
        if field.name not in ("robot", "probe"):
            assert getattr(found, field.name) == getattr(written, field.name), field.name
    assert found.settings["layers"] == [400, 300]  # as JSON holds it, before and after
    assert isinstance(found.observation, tuple)


def test_a_policy_keeps_the_probe_of_where_it_was_written_first(file, tmp_path):
    probe = make_probe(simple_robot(), EnvironmentSettings())
    description = Policy.load(file).description
    assert described().probe is None
    assert description.probe == probe
    moved = {"observation": probe["observation"], "length": np.add(probe["length"], 0.01).tolist()}
    again = replace(description, probe=moved)  # as another version would have found it
    write_policy(tmp_path / "again.onnx", perceptron()[1], "relu", again)
    with pytest.raises(InvalidField, match=r"another version: lengths differ by up to 10 mm"):
        Policy.load(tmp_path / "again.onnx")


def test_a_policy_without_settings_of_an_environment_is_not_written(tmp_path):
    with pytest.raises(InvalidField, match=r"settings\.environment: got None"):
        write_policy(tmp_path / "p.onnx", perceptron()[1], "relu", described(settings={}))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", list_robots())
def test_a_robot_comes_back_bit_for_bit(tmp_path, name):
    robot = replace(
        load_robot(name),
        exit_covariance=np.full((load_robot(name).n, 1, 1), 1e-7) * np.eye(3) / 3.0,
        length_delay=0.1 + 0.2,
        calibrated=("mass", "drag"),
        calibration_covariance=np.diag([1.0 / 3.0, 1e-6]),
    )
    write_policy(tmp_path / "policy.onnx", perceptron()[1], "silu", described(robot=robot))
    found = Policy.load(tmp_path / "policy.onnx").description.robot
    assert differing(robot, found) == []
    for field in fields(robot):
        assert np.array_equal(getattr(found, field.name), getattr(robot, field.name)), field.name


def test_the_same_policy_gives_the_same_bytes(file, tmp_path):
    write_policy(tmp_path / "again.onnx", perceptron()[1], "relu", described())
    assert (tmp_path / "again.onnx").read_bytes() == file.read_bytes()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["again.onnx", "policy.onnx"]


def test_a_policy_loads_and_acts_without_what_trained_it(file):
    program = (
        "import json, sys\n"
        "from learned.policy_file import Policy\n"
        f"Policy.load({str(file)!r}).act([[0.0] * 10])\n"
        "print(json.dumps([name.partition('.')[0] for name in sys.modules]))"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    loaded = set(json.loads(done.stdout.splitlines()[-1]))
    assert "onnxruntime" in loaded
    assert loaded & {"torch", "stable_baselines3", "onnx", "gymnasium", "matplotlib"} == set()


@pytest.mark.parametrize(("name", "extra"), [("onnx", "learn"), ("onnxruntime", "control")])
def test_a_missing_package_says_how_to_install_it(file, monkeypatch, name, extra):
    monkeypatch.setitem(sys.modules, name, None)
    message = rf"not installed: {name}\): pip install 'carosac-toolkit\[{extra}\]'"
    with pytest.raises(MissingExtra, match=message):
        if name == "onnx":
            write_policy(file, perceptron()[1], "relu", described())
        else:
            Policy.load(file)


def test_files_that_are_no_policies_are_refused(tmp_path):
    with pytest.raises(MissingFile, match=r"none\.onnx: no such file"):
        Policy.load(tmp_path / "none.onnx")
    for content in (b"", b"mass: 3\n", bytes(range(256)) * 8):
        path = tmp_path / "wrong.onnx"
        path.write_bytes(content)
        with pytest.raises(InvalidField, match="an ONNX file that `carosac train` wrote"):
            Policy.load(path)
    with pytest.raises(InvalidField, match=r"the folder .*: policy\.onnx in the folder of a stage"):
        Policy.load(tmp_path)


def test_a_cut_file_is_refused(file):
    file.write_bytes(file.read_bytes()[:-500])
    with pytest.raises(InvalidField, match=r"no ONNX file|metadata"):
        Policy.load(file)


@pytest.mark.parametrize(
    "changes, message",
    [
        ({"schema": None}, "without our metadata"),
        ({"schema": "carosac-policy/0"}, "policy/0; .*policy/1 of this version: train it again"),
        ({"schema": "carosac-policy/2"}, "schema carosac-policy/2; .*schema carosac-policy/1$"),
        ({"schema": "carosac-plan/0"}, "schema carosac-plan/0; .*schema carosac-policy/1$"),
        ({"robot": None, "seed": None}, "without robot, seed"),
        ({"probe": None}, "without probe; .*train it again with `carosac train`"),
        ({"probe": "null"}, r"policy\.probe: got None"),
        ({"probe": "[]"}, "probe: got .*a mapping"),
        ({"settings": "{"}, "damaged metadata"),
        ({"robot": '{"name": "carosac"}'}, r"robot differs in \['acceleration_max'"),
        ({"robot": "[1]"}, "robot differs in"),
        ({"period": "-0.1"}, "period > 0"),
        ({"observation": "4"}, "names of the parts"),
        ({"period": "[1]"}, r"period: got \[1\]"),
        ({"steps": "[1]"}, r"steps: got \[1\]; allowed: a whole number"),
        ({"seed": "[1]"}, r"seed: got \[1\]; allowed: a whole number"),
        ({"commit": "[1]"}, r"commit: got \[1\]; allowed: text"),
        ({"settings": '{"environment": {"path": [1]}}'}, "damaged metadata"),
        ({"settings": '{"environment": {"path": {"speed": "x"}}}'}, "damaged metadata"),
        ({"scores": "[" * 5000}, "damaged metadata"),
    ],
)
def test_wrong_metadata_is_refused(file, changes, message):
    with pytest.raises(InvalidField, match=message):
        Policy.load(with_metadata(file, **changes))


@pytest.mark.parametrize("value", [np.nan, np.inf])
@pytest.mark.parametrize("layer", [0, 2])
def test_a_network_that_does_not_act_is_refused(file, value, layer):
    model = onnx.load(file)
    (tensor,) = (x for x in model.graph.initializer if x.name == f"weight_{layer}")
    weights = np.array(onnx.numpy_helper.to_array(tensor))
    weights[0] = value * np.sign(weights[0])
    tensor.CopyFrom(onnx.numpy_helper.from_array(weights, tensor.name))
    file.write_bytes(model.SerializeToString())
    with pytest.raises(InvalidField, match="which does not act: action: got NaN"):
        Policy.load(file)


def with_loop(graph):
    """A loop of so many turns that it does not end."""
    helper, tensor = onnx.helper, onnx.TensorProto
    turn = [helper.make_node("Identity", ["go"], ["on"]), helper.make_node("Tanh", ["x"], ["y"])]
    value = helper.make_tensor_value_info
    body = helper.make_graph(
        turn, "body", [value("i", tensor.INT64, []), value("go", tensor.BOOL, []),
                       value("x", tensor.FLOAT, None)],
        [value("on", tensor.BOOL, []), value("y", tensor.FLOAT, None)],
    )  # fmt: skip
    turns = helper.make_tensor("turns", tensor.INT64, [], [10**9])
    graph.initializer.append(turns)
    graph.node[-1].output[0] = "once"
    graph.node.append(helper.make_node("Loop", ["turns", "", "once"], ["action"], body=body))


def with_constant(graph):
    """A constant of gigabytes, which is made as the file is loaded."""
    size = onnx.numpy_helper.from_array(np.array([700_000_000]), "size")
    graph.initializer.append(size)
    graph.node.insert(0, onnx.helper.make_node("ConstantOfShape", ["size"], ["large"]))


def with_product(graph):
    """A product of two small constants that takes gigabytes."""
    for name, shape in (("row", (1, 30_000)), ("column", (30_000, 1))):
        graph.initializer.append(onnx.numpy_helper.from_array(np.ones(shape, np.float32), name))
    graph.node.insert(0, onnx.helper.make_node("Mul", ["row", "column"], ["large"]))


def with_data_outside(graph):
    """A weight that lies in any file of the machine."""
    tensor = graph.initializer[0]
    tensor.ClearField("raw_data")
    tensor.data_location = onnx.TensorProto.EXTERNAL
    tensor.external_data.add(key="location", value="policy.data")


def with_many_zeros(graph):
    """A weight that says it is larger than its numbers."""
    graph.initializer[0].dims[0] = 2**31


def with_other_attribute(graph):
    graph.node[0].attribute.append(onnx.helper.make_attribute("transA", 1))


def with_other_domain(graph):
    graph.node[0].domain = "com.microsoft"


def with_other_width(graph):
    weight = onnx.numpy_helper.from_array(np.ones((24, 1), np.float32), "weight_1")
    graph.initializer[2].CopyFrom(weight)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (with_loop, "operator 'Loop'"),
        (with_constant, "operator 'ConstantOfShape'"),
        (with_product, "nodes in another order"),
        (with_data_outside, "a field 1[34],"),
        (with_many_zeros, "not as large as its numbers"),
        (with_other_attribute, "attributes of a node Gemm"),
        (with_other_domain, "a field 7"),
        (with_other_width, "layer 1 does not fit"),
    ],
)
def test_any_other_network_is_refused_before_it_is_loaded(file, change, message, monkeypatch):
    import onnxruntime

    model = onnx.load(file)
    change(model.graph)
    file.write_bytes(model.SerializeToString())
    monkeypatch.setattr(onnxruntime, "InferenceSession", None)
    with pytest.raises(InvalidField, match=f"no ONNX file, or of another network: .*{message}"):
        Policy.load(file)


def test_a_file_that_is_too_large_is_refused(file):
    with file.open("ab") as out:
        out.truncate(2**34)  # takes no room on the disk
    with pytest.raises(InvalidField, match="more than 17 MB"):
        Policy.load(file)


def test_a_second_graph_which_readers_would_merge_is_refused(file):
    data = file.read_bytes()
    graph = onnx.load(file).graph
    graph.node[0].op_type = "Loop"
    file.write_bytes(data + onnx.ModelProto(graph=graph).SerializeToString())
    with pytest.raises(InvalidField, match="of another network"):
        Policy.load(file)


def test_layers_that_could_not_be_read_again_are_not_written(tmp_path):
    layers = [(np.ones((1, 1)), np.ones(1))] * 101
    with pytest.raises(InvalidField, match=r"layers: got 202 weights and biases; .*read again"):
        write_policy(tmp_path / "policy.onnx", layers, "relu", described())
    assert list(tmp_path.iterdir()) == []


def test_an_action_that_is_none_at_run_time_is_named(file):
    policy = Policy.load(file)
    session = policy._session
    for value in (np.nan, np.inf, 1.1):

        class Broken:
            def run(self, names, seen, value=value):
                return [np.full_like(session.run(names, seen)[0], value)]

        policy._session = Broken()
        with pytest.raises(InvalidField, match=r"action: got .*; allowed: numbers from -1 to 1"):
            policy.act(np.zeros((1, 10)))


def test_a_file_with_another_input_is_refused(file):
    model = onnx.load(file)
    model.graph.input[0].type.tensor_type.shape.dim[1].dim_param = "d"
    file.write_bytes(model.SerializeToString())
    with pytest.raises(InvalidField, match=r"'d'.*observation \(batch, d\)"):
        Policy.load(file)


def test_observations_of_another_size_or_not_finite_are_refused(file):
    policy = Policy.load(file)
    with pytest.raises(InvalidField, match=r"observation: got shape \(2, 9\); .*\(B, 10\)"):
        policy.act(np.zeros((2, 9)))
    with pytest.raises(InvalidField, match=r"shape \(10,\)"):
        policy.act(np.zeros(10))
    with pytest.raises(InvalidField, match=r"shape \(0, 10\)"):
        policy.act(np.zeros((0, 10)))
    with pytest.raises(InvalidField, match="a finite number"):
        policy.act(np.full((1, 10), np.nan))
    with pytest.raises(InvalidField, match=r"got 1e.300; allowed: -1e.15 to 1e.15"):
        policy.act(np.full((1, 10), 1e300) * np.sign(np.arange(10) - 4.5))


def cut(layers, k, part, index):
    """Layers, one of which lost entries."""
    changed = [list(pair) for pair in layers]
    changed[k][part] = changed[k][part][index]
    return changed


def test_layers_that_do_not_fit_are_refused(tmp_path):
    path, layers = tmp_path / "policy.onnx", perceptron()[1]
    cases = [
        ([], "relu", "at least one layer"),
        (layers, "elu", r"activation: got 'elu'; allowed: one of \['relu', 'silu'\]"),
        (cut(layers, 1, 0, np.s_[:, :-1]), "relu", r"layers\[1\].*weight \(out, 32\)"),
        (cut(layers, 2, 1, np.s_[:-1]), "relu", r"layers\[2\]"),
        (cut(layers, 0, 0, np.s_[0]), "relu", r"layers\[0\]"),
        ([(np.full((4, 10), np.inf), np.zeros(4))], "relu", "finite numbers"),
    ]
    for wrong, activation, message in cases:
        with pytest.raises(InvalidField, match=message):
            write_policy(path, wrong, activation, described())
    with pytest.raises(CarosacError, match="cannot be written"):
        write_policy(tmp_path / "none" / "policy.onnx", layers, "relu", described())
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "changes, message",
    [
        ({"observation": "lengths"}, "observation: .*names of the parts"),
        ({"period": 0.0}, "period > 0"),
        ({"period": float("nan")}, "period > 0"),
        ({"steps": -1}, "steps: got -1; allowed: a whole number from 0"),
        ({"settings": {"robot": simple_robot()}}, "settings: .*JSON cannot hold"),
        ({"settings": [1]}, "settings: .*a mapping"),
        ({"scores": {"median_error_m": float("nan")}}, "scores: .*all numbers finite"),
    ],
)
def test_descriptions_that_a_file_cannot_hold_are_refused(changes, message):
    with pytest.raises(InvalidField, match=message):
        described(**changes)
