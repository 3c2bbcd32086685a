"""Outputs are refused in words before any work, and are written whole or not at all."""

import json
import os
from pathlib import Path

import numpy as np
import pytest

from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.base.files import check_writable, replacing, write_json


def test_json_takes_numpy_and_has_no_nan(tmp_path):
    data = {"a": np.arange(3.0), "b": np.float64(2.5), "c": [float("nan"), np.inf], 7: Path("x"),
            "d": np.array([1.0, np.nan]), "e": np.bool_(True), "f": (1, None)}  # fmt: skip
    write_json(tmp_path / "x.json", data)
    assert json.loads((tmp_path / "x.json").read_text()) == {
        "a": [0.0, 1.0, 2.0], "b": 2.5, "c": [None, None], "7": "x", "d": [1.0, None], "e": True,
        "f": [1, None],
    }  # fmt: skip


def test_a_file_is_replaced_only_if_all_goes_well(tmp_path):
    path = tmp_path / "x.txt"
    path.write_text("old")
    with pytest.raises(RuntimeError, match="half way"), replacing(path) as temporary:
        temporary.write_text("new")
        raise RuntimeError("half way")
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]
    with replacing(path) as temporary:
        temporary.write_text("new")
    assert path.read_text() == "new"


def test_a_file_is_on_the_disk_before_it_takes_its_name(tmp_path, monkeypatch):
    path, synced = tmp_path / "x.txt", []
    monkeypatch.setattr(os, "fsync", lambda fd: synced.append((os.fstat(fd).st_ino, path.exists())))
    with replacing(path) as temporary:
        temporary.write_text("new")
    assert synced == [(path.stat().st_ino, False)]


def test_outputs_are_checked_before_any_work(tmp_path):
    check_writable("--json", None)
    check_writable("--json", tmp_path / "x.json")
    with pytest.raises(InvalidField, match="existing folder"):
        check_writable("--json", tmp_path / "no" / "x.json")
    with pytest.raises(InvalidField, match="not a folder"):
        check_writable("--json", tmp_path)
    with pytest.raises(InvalidField, match=r"ending in \.png"):
        check_writable("--picture", tmp_path / "x.jpg", (".png",))
