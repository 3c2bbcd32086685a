from dataclasses import dataclass

import numpy as np
import pytest

pytest.importorskip("torch")
pytest.importorskip("safetensors")

import torch

from carosac_toolkit.base.errors import InvalidField, InvalidFile
from carosac_toolkit.loop.values import Pose
from learned.checkpoint import packages_of, read_checkpoint, write_checkpoint
from learned.learning_curve import Episode


@dataclass(frozen=True)
class Nested:
    value: object
    other: object = None

    def __post_init__(self):
        raise AssertionError("reading a file runs no code of its classes")


def nested(value):
    made = object.__new__(Nested)
    object.__setattr__(made, "value", value)
    return made


def test_every_kind_of_value_comes_back_as_it_was(tmp_path):
    state = {
        "arrays": [np.arange(6).reshape(2, 3).T.astype(kind) for kind in ("f8", "f4", "u4", "?")],
        "records": np.array([(1.5, [1, 2])] * 3, dtype=[("a", "f8"), ("b", "i4", (2,))]),
        "empty": np.zeros((0, 4)),
        "tensor": torch.tensor(3.0, dtype=torch.float64),
        "numbers": (np.float32(0.1), np.int64(7), -0.0, float("inf"), 2**127 + 1, None, True),
        "keys": {0: {"exp_avg": torch.ones(2)}, "betas": (0.9, 0.999)},
        "named": Episode(40, -1.5, 30),
        "pose": Pose(position=np.ones((1, 3)), rotation=np.eye(3)[None], time=None),
    }
    write_checkpoint(tmp_path / "file", state)
    found = read_checkpoint(tmp_path / "file", list(state), packages_of(state))
    for one, other in zip(found["arrays"], state["arrays"], strict=True):
        np.testing.assert_array_equal(one, other)
        assert one.dtype == other.dtype
    np.testing.assert_array_equal(found["records"], state["records"])
    assert found["records"].dtype == state["records"].dtype
    assert found["empty"].shape == (0, 4)
    assert found["tensor"].shape == () and found["tensor"].dtype == torch.float64
    assert found["numbers"] == state["numbers"]
    assert list(map(type, found["numbers"])) == list(map(type, state["numbers"]))
    assert np.copysign(1.0, found["numbers"][2]) == -1.0
    assert found["keys"][0]["exp_avg"].tolist() == [1.0, 1.0]
    assert found["keys"]["betas"] == (0.9, 0.999)
    assert found["named"] == state["named"] and isinstance(found["named"], Episode)
    assert isinstance(found["pose"], Pose) and found["pose"].time is None
    np.testing.assert_array_equal(found["pose"].rotation, np.eye(3)[None])


def test_a_dataclass_is_read_without_its_code_and_of_known_packages_alone(tmp_path):
    state = {"one": nested([nested(1.5)])}
    object.__setattr__(state["one"].value[0], "other", None)
    write_checkpoint(tmp_path / "file", state)
    assert packages_of(state) == {"tests"}
    assert read_checkpoint(tmp_path / "file", ["one"], {"tests"})["one"].value[0].value == 1.5
    with pytest.raises(InvalidFile, match="unknown class 'tests"):
        read_checkpoint(tmp_path / "file", ["one"], {"learned"})


def test_a_value_that_no_file_can_hold_is_refused_by_its_place(tmp_path):
    with pytest.raises(InvalidField, match=r"beliefs\[1\]\.memory: got Generator"):
        write_checkpoint(
            tmp_path / "file", {"beliefs": [None, {"memory": np.random.default_rng(0)}]}
        )
    assert not (tmp_path / "file").exists()
