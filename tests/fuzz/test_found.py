"""What damaged inputs have broken before, each as a case of its own."""

import io
import json
import zipfile

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from carosac_toolkit.base.errors import CarosacError
from tests.fuzz.targets import checkpoint_with, place, targets

for package in ("onnx", "onnxruntime", "safetensors", "torch", "rosbags"):
    pytest.importorskip(package)


def replaced(old, new):
    """Exchange a text that must be there."""

    def change(data):
        assert old in data
        return data.replace(old, new, 1)

    return change


def with_member(name, content):
    """Exchange one member of an npz file."""

    def change(data):
        with zipfile.ZipFile(io.BytesIO(data)) as source:
            parts = {x: source.read(x) for x in source.namelist()}
        assert name in parts
        stream = io.BytesIO()
        with zipfile.ZipFile(stream, "w") as target:
            for other, known in parts.items():
                target.writestr(other, content(known) if other == name else known)
        return stream.getvalue()

    return change


def as_npy(value):
    """Bytes of an array."""
    stream = io.BytesIO()
    np.save(stream, np.array(value))
    return stream.getvalue()


def with_cases(cases):
    """Exchange the cases of a study."""
    return lambda data: json.dumps(json.loads(data) | {"cases": cases}).encode()


def with_column(name, *values, as_json=False):
    """Exchange or add a column of the rows of a study."""

    def change(data):
        table = pq.read_table(pa.BufferReader(data))
        array = pa.array([*values] * table.num_rows)
        field = pa.field(name, array.type, metadata={"carosac": "json"} if as_json else None)
        if name in table.column_names:
            table = table.drop_columns(name)
        sink = pa.BufferOutputStream()
        pq.write_table(table.append_column(field, array), sink)
        return bytes(sink.getvalue())

    return change


def wide_parquet(_):
    """More columns than any robot has."""
    sink = pa.BufferOutputStream()
    pq.write_table(pa.table({f"a{i}": [1.0] for i in range(3000)}), sink)
    return sink.getvalue().to_pybytes()


def large_matrices(_):
    """Names that nobody asked for, and one that takes 800 MB as float64."""
    from scipy.io import savemat

    stream = io.BytesIO()
    ones = np.ones((100_000, 1000), np.uint8)
    savemat(stream, {"other": ones[:9], "ef_poses": ones}, do_compression=True)
    return stream.getvalue()


AXES = ["carosac", "c", "e", "s", "t", "p"]
FOUND = [
    ("robot YAML", lambda data: b"a: " + b"[" * 50_000),
    ("Parquet", lambda data: data.replace(b"time_s", b"time_\xff")),
    ("CSV", replaced(b'"rows": ', b'"rows": ' + b"1" * 5000)),
    ("log (jsonl)", replaced(b'"time":0.01', b'"time":1' + b"0" * 399)),
    ("log (jsonl)", replaced(b'"metadata":{', b'"metadata":[],"x":{')),
    ("policy", lambda data: b"linear_\xff".join(data.rsplit(b"linear_0", 1))),
    ("checkpoint", lambda data: checkpoint_with('{"parameters": {}}', data)),
    ("GSI", replaced(b"21.322", b"21X322")),
    ("GSI", replaced(b"21.322", b"3a.322")),
    ("cdpyr", replaced(b"25.0", b"1" * 5000)),
    ("cdpyr", replaced(b"25.0", b"1" * 400)),
    ("learning curve", lambda data: data.splitlines()[0] + b"\n1,2\n"),
    ("learning curve", lambda data: data + b"\xff"),
    ("episodes", replaced(b"4,-1.5", b"x,-1.5")),
    ("training settings", lambda data: data[:-5]),
    ("training settings", replaced(b'["abc"]', b"1.5")),
    ("snapshot npz", with_member("__header__.npy", lambda _: as_npy('{"cables": "straight"}'))),
    ("snapshot npz", with_member("position.npy", lambda x: x.replace(b"(2, 3), }", b"(2, 3,   "))),
    ("robot npz", with_member("__fields__.npy", lambda _: as_npy("[1]"))),
    ("robot npz", with_member("__fields__.npy", lambda _: as_npy('{"hardware": [1]}'))),
    ("study", lambda data: b"[" * 100_000),
    ("study", lambda data: b'{"schema": ' + b"[" * 900 + b"]" * 900 + b"}"),
    *(("study", with_cases([entry])) for entry in (1, "x", [], ["a"], {}, [[1]] * 9)),
    ("study", with_cases([["id", *AXES, 0, 9]])),
    ("study", with_cases([["id", *AXES, -1, 0]])),
    ("study", with_cases([["id", "", *AXES[1:], 0, 0]])),
    ("study", replaced(b'"duration": 0.5', b'"duration": NaN')),
    ("study", replaced(b"a:b", b"a:\xff")),
    ("rows of a study", lambda data: data.replace(b"text", b"te\xfft")),
    ("rows of a study", with_column("case", ["x"])),
    ("rows of a study", with_column("status", {"a": 1})),
    ("rows of a study", with_column("more", [1.0])),
    ("rows of a study", with_column("more", "{", as_json=True)),
    ("rows of a study", with_column("more", "[1]", as_json=True)),
    ("rows of a study", with_column("more", "[" * 100_000, as_json=True)),
    ("rows of a study", with_column("more", "1" * 400, as_json=True)),
    ("CSV", lambda data: b"time_s," + b",".join(b"a%d" % i for i in range(20_000)) + b"\n1\n"),
    ("CSV", lambda data: b"#" + b"1" * 300_000),
    ("survey CSV", lambda data: b"setup,target,x_m" + b"1" * 200_000 + b"\n" + data),
    ("survey CSV", lambda data: data + b"1" * 200_000 + b"\n"),
    ("survey CSV", lambda data: b",".join(b"a%d" % i for i in range(60_000)) + b"\n1\n"),
    ("motor angles", lambda data: data + b"1" * 200_000 + b"\n"),
    ("motor angles", lambda data: b",".join(b"a%d" % i for i in range(60_000)) + b"\n1\n"),
    ("Parquet", wide_parquet),
    ("MATLAB", large_matrices),
    ("robot YAML", lambda data: b"".join(b"k%d: 1\n" % i for i in range(17_000))),
    ("CASPR bodies", lambda data: b"<r>" + b"<a/>" * 600_000 + b"</r>"),
    ("bag MCAP", lambda data: data[:9] + b"\xff" * 7 + data[16:]),
]


@pytest.mark.parametrize("number", range(len(FOUND)))
def test_what_broke_a_reader_is_refused(tmp_path, number):
    name, change = FOUND[number]
    (target,) = (one for one in targets() if one.name == name)
    with pytest.raises(CarosacError):
        target.read(place(target, tmp_path, change(target.seeds()[0])))
