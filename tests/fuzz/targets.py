"""Every reader of files and messages, with sound examples to damage."""

from __future__ import annotations

import functools
import json
import os
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from calibration.self_calibration.motor_angle_files import load_motor_angles
from calibration.tachymeter.csv_file import read_csv as read_survey_csv
from calibration.tachymeter.gsi import read_gsi
from calibration.tachymeter.synthetic import write_targets
from calibration.tachymeter.targets import read_targets
from carosac_toolkit.interchange.robots import read_robot
from carosac_toolkit.loop.values import Belief, Command, LimitHit, Measurement
from carosac_toolkit.recordings.crash_safe import CrashSafeRecorder
from carosac_toolkit.recordings.files import load_recording, save_recording
from carosac_toolkit.robot.file import load_robot
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.studies import read_cases, read_rows
from carosac_toolkit.studies.run.folder import MANIFEST_FILE, opened
from carosac_toolkit.studies.run.rows import make_row
from learned.approximate_mpc.networks import load_network
from learned.learning_curve import CURVE_COLUMNS, Episode, read_curve, read_episodes, write_curve
from learned.policy_file import Policy
from learned.rewards import RewardSettings
from learned.training_record import SETTINGS_FILE, read_record
from sim_warp.snapshot import Snapshot
from tests.calibration.tachymeter.scenes import ROBOT, drawn
from tests.calibration.tachymeter.test_files import GSI8, GSI16
from tests.fuzz.mutators import (
    MUTATORS_OF_BYTES,
    MUTATORS_OF_TEXT,
    Mutator,
    json_changed,
    json_line_changed,
    npz_changed,
)
from tests.interchange.models import (
    WIREX_CABLE,
    WIREX_PLATFORM,
    WIREX_WINCH,
    caspr_body,
    caspr_cables,
    cdpyr,
    geometry,
    straight_cables,
    wirex,
)
from tests.recordings.synthetic import full_recording
from tests.robots import simple_robot
from tests.studies.functions import some_cases

JSON = (*MUTATORS_OF_TEXT, json_changed)
PART_FILE = "part-00000000.parquet"


@dataclass(frozen=True)
class Target:
    """A reader of files.

    Attributes:
        name: What it reads.
        file: Name of the file that is damaged.
        seeds: Sound contents; called once.
        read: The reader, of the path; whatever it raises but `CarosacError` is a fault of it.
        mutators: Kinds of damage.
        beside: Sound files beside it, by name.
        weight: Share of a campaign, relative to others; less where reading is slow.
    """

    name: str
    file: str
    seeds: Callable[[], Sequence[bytes]]
    read: Callable[[Path], object]
    mutators: tuple[Mutator, ...] = MUTATORS_OF_TEXT
    beside: Callable[[], dict[str, bytes]] = dict
    weight: float = 1.0


def written(write: Callable[[Path], object], name: str) -> bytes:
    """Return what a writer writes."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / name
        write(path)
        return path.read_bytes()


def _recordings(suffix: str) -> list[bytes]:
    return [
        written(lambda path, n=n: save_recording(full_recording(n), path), f"run{suffix}")
        for n in (3, 4)
    ]


def _parquet_changed(data: bytes, rng: np.random.Generator) -> bytes:
    """Change metadata or a column of a Parquet file that stays one."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        table = pq.read_table(pa.BufferReader(data))
        names = table.column_names
    except Exception:  # damaged before, in one of many ways
        return data
    column = int(rng.integers(len(names)))
    name = names[column]
    values: list[Any] = [1, 1.5, float("nan"), None, "x", [1.0], {"a": 1}, b"x", True, 10**18]
    kind = rng.integers(3)
    if kind == 0:
        metadata = {k: json_changed(v, rng) for k, v in (table.schema.metadata or {}).items()}
        table = table.replace_schema_metadata(metadata)
    elif kind == 1:
        value = values[rng.integers(len(values))]
        table = table.set_column(column, name, pa.array([value] * table.num_rows))
    else:
        other = ["time_s", "", "x" * 1000, "unstrained_length_999_m", name + "\0"][rng.integers(5)]
        table = table.rename_columns([other if x == name else x for x in names])
    sink = pa.BufferOutputStream()
    pq.write_table(table, sink)
    return bytes(sink.getvalue())


def _run(path: Path) -> None:
    """Write a crash-safe log with every kind of row."""
    recorder = CrashSafeRecorder(path)
    for k in range(5):
        time, lengths = np.array([0.01 * k]), np.full((1, 4), 5.0 + 0.1 * k)
        recorder.measured(Measurement(time=time, unstrained_length=lengths))
        hit = LimitHit(limit="speed", cable=1, asked=2.0, sent=1.0)
        sent = Command(time=time, unstrained_length=lengths, limited=(hit,))
        recorder.sent(sent, sent, really=k % 2 == 0)
        recorder.believed(Belief(time=time, position=np.ones((1, 3)), rotation=np.eye(3)[None]))
        recorder.event(0.01 * k, "enabled", "")
    recorder.close()


@functools.cache
def _study(name: str) -> bytes:
    """Return a file of a small study, with a column of each kind."""
    cases = some_cases(3, duration=0.5, weights={"sway": [1]})
    values = {"real": 0.5, "whole": 3, "text": "x", "flag": True, "big": 2**70, "none": None}
    rows = [make_row(case, "ok", wall_time=0.0, values=values) for case in cases]
    rows[1] |= {"status": "failed", "reason": "ValueError", "whole": "three"}

    def write(path: Path) -> None:
        with opened(path.parent, cases, "a:b") as store:
            store.append(rows)

    return written(write, name)


def _read_study(path: Path) -> None:
    """Read a study, and open it to go on with the cases that it had."""
    read_cases(path.parent)
    read_rows(path.parent)
    with opened(path.parent, some_cases(3, duration=0.5, weights={"sway": [1]}), "a:b") as store:
        store.merge()
        store.forget(["failed"])


def _mats() -> list[bytes]:
    from scipy.io import savemat

    n = 5
    variables = {
        "time_stamps": np.arange(float(n))[:, None], "measured_cable_lengths": np.ones((n, 2)),
        "ef_poses": np.tile([0.0, 0, 0, 1, 0, 0, 0], (n, 1)),
    }  # fmt: skip
    return [
        written(lambda path, k=k: savemat(path, variables, **k), "run.mat")
        for k in ({}, {"do_compression": True}, {"format": "4"})
    ]


def _policies() -> list[bytes]:
    folder = Path(str(files("learned") / "policies"))
    return [path.read_bytes() for path in sorted(folder.glob("*settle.onnx"))]


def _plans() -> list[bytes]:
    folder = Path(str(files("learned") / "plans"))
    return [path.read_bytes() for path in sorted(folder.glob("*.onnx"))]


def _policy_changed(data: bytes, rng: np.random.Generator) -> bytes:
    """Change metadata, a weight or a node of a network that stays one."""
    import onnx

    try:
        model = onnx.load_model_from_string(data)
    except Exception:  # damaged before
        return data
    kind = rng.integers(3)
    if kind == 0 and model.metadata_props:
        entry = model.metadata_props[rng.integers(len(model.metadata_props))]
        entry.value = json_changed(entry.value.encode(), rng).decode(errors="replace")
    elif kind == 1 and model.graph.initializer:
        tensor = model.graph.initializer[rng.integers(len(model.graph.initializer))]
        tensor.raw_data = MUTATORS_OF_BYTES[0](tensor.raw_data or b"\0", rng)
    elif model.graph.node:
        node = model.graph.node[rng.integers(len(model.graph.node))]
        node.op_type = ["Relu", "Tanh", "Exp", "Log", "Gemm", "Identity", "Reciprocal"][
            rng.integers(7)
        ]
    return bytes(model.SerializeToString())


def _checkpoint(path: Path) -> None:
    import torch

    from learned.checkpoint import write_checkpoint

    records = np.zeros(2, dtype=[("a", "f8"), ("b", "i4", (2,))])
    ended = [Episode(4, -1.5, 3), (1, records, np.float32(0.5)), RewardSettings()]
    parameters = {"policy": np.ones((3, 2)), 0: torch.ones(2)}
    write_checkpoint(path, {"parameters": parameters, "steps": 4, "ended": ended})


def _read_checkpoint(path: Path) -> object:
    from learned.checkpoint import read_checkpoint

    return read_checkpoint(path, ("parameters", "steps", "ended"), {"learned"})


def checkpoint_with(tree: str, data: bytes) -> bytes:
    """Exchange how the arrays of a checkpoint nest; the checksum fits again."""
    from safetensors.numpy import load, save

    from learned.checkpoint import FORMAT, _checksum

    arrays = load(data)
    checksum = str(_checksum(tree, arrays))
    return save(arrays, metadata={"format": FORMAT, "state": tree, "crc32": checksum})


def _checkpoint_changed(data: bytes, rng: np.random.Generator) -> bytes:
    """Change the nesting of a checkpoint that stays one."""
    size = int.from_bytes(data[:8], "little")
    try:
        tree = json.loads(data[8 : 8 + size])["__metadata__"]["state"]
        return checkpoint_with(json_changed(tree.encode(), rng).decode(errors="replace"), data)
    except Exception:  # damaged before
        return data


def _snapshot() -> Snapshot:
    return Snapshot(cables="catenary", segments=4, arrays={"position": np.zeros((2, 3))})


def _settings() -> list[bytes]:
    record = {"preset": "tiny", "changes": "", "environment": {"reward": {}}, "td3": {"steps": 4},
              "commits": ["abc"], "started_from": None}  # fmt: skip
    return [json.dumps(record).encode()]


def _curve(path: Path) -> None:
    write_curve(path, [{name: float(k) for name in CURVE_COLUMNS} for k in range(3)])


def _bags(kind: str) -> list[bytes]:
    from tests.interchange.bags import Bags
    from tests.interchange.test_bags import run_messages

    bags = Bags(kind)
    with tempfile.TemporaryDirectory() as folder:
        path = bags.write(Path(folder), run_messages(bags))
        found = [path] if path.is_file() else sorted(path.glob("*.mcap"))
        return [found[0].read_bytes()]


def _read_bag(path: Path) -> object:
    from carosac_toolkit.interchange.bag import open_bag
    from carosac_toolkit.interchange.bag_recording import Topics, read_bag

    with open_bag([path]) as bag:
        return read_bag(bag, Topics(lengths=("/array",), pose="/mocap", imu="/imu"))


ANGLES_CSV = (
    b"sample,motor_a_deg,motor_b_deg,known_x_mm,known_y_mm,known_z_mm\n"
    b"1,0,0,0,0,0\n2,10.5,-3.25,,,\n3,20,4,100,0,50\n"
)
SURVEY_CSV = b"setup,target,hz_gon,v_gon,slope_m\nA,front_left,12.5,98.7,3.25\nA,b,20,99,4\n"


@functools.cache
def targets() -> tuple[Target, ...]:
    """Return all readers of files."""
    points = geometry("cogiro")
    bodies, cables = (
        caspr_body().encode(),
        caspr_cables({"original": straight_cables(*points)}).encode(),
    )
    wirex_text = wirex(*points, platform=WIREX_PLATFORM, cable=WIREX_CABLE, winch=WIREX_WINCH)
    bundled = sorted(Path(str(files("carosac_toolkit.robot") / "bundled")).glob("*.yaml"))
    gsi = ["\r\n".join([line] * 3).encode() for line in (GSI8, GSI16)]
    return (
        Target("robot YAML", "robot.yaml", lambda: [x.read_bytes() for x in bundled], load_robot),
        Target("CSV", "run.csv", lambda: _recordings(".csv"), load_recording),
        Target("Parquet", "run.parquet", lambda: _recordings(".parquet"), load_recording,
               (*MUTATORS_OF_BYTES, _parquet_changed)),
        Target("log (jsonl)", "run.jsonl", lambda: [written(_run, "run.jsonl")], load_recording,
               (*MUTATORS_OF_TEXT, json_line_changed)),
        Target("study", MANIFEST_FILE, lambda: [_study(MANIFEST_FILE)], _read_study, JSON,
               beside=lambda: {PART_FILE: _study(PART_FILE)}),
        Target("rows of a study", PART_FILE, lambda: [_study(PART_FILE)], _read_study,
               (*MUTATORS_OF_BYTES, _parquet_changed),
               beside=lambda: {MANIFEST_FILE: _study(MANIFEST_FILE)}),
        Target("MATLAB", "run.mat", _mats, load_recording, MUTATORS_OF_BYTES, weight=0.02),
        Target("robot npz", "robot.npz",
               lambda: [written(simple_robot().to_npz, "robot.npz")], Robot.from_npz,
               (*MUTATORS_OF_BYTES, npz_changed)),
        Target("snapshot npz", "state.npz", lambda: [written(_snapshot().to_npz, "state.npz")],
               Snapshot.from_npz, (*MUTATORS_OF_BYTES, npz_changed)),
        Target("GSI", "job.gsi", lambda: gsi, lambda path: read_gsi(str(path))),
        Target("survey CSV", "job.csv", lambda: [SURVEY_CSV], lambda x: read_survey_csv(str(x))),
        Target("survey targets", "targets.yaml",
               lambda: [written(lambda x: write_targets(x, drawn().survey), "targets.yaml")],
               lambda path: read_targets(str(path), ROBOT)),
        Target("motor angles", "angles.csv", lambda: [ANGLES_CSV], load_motor_angles),
        Target("policy", "policy.onnx", _policies, Policy.load,
               (*MUTATORS_OF_BYTES, _policy_changed), weight=0.3),
        Target("plan network", "network.onnx", _plans, lambda path: load_network(str(path)),
               (*MUTATORS_OF_BYTES, _policy_changed), weight=0.3),
        Target("checkpoint", "checkpoint.safetensors",
               lambda: [written(_checkpoint, "checkpoint.safetensors")], _read_checkpoint,
               (*MUTATORS_OF_BYTES, _checkpoint_changed, _checkpoint_changed)),
        Target("training settings", SETTINGS_FILE, _settings,
               lambda path: read_record(path.parent), JSON),
        Target("learning curve", "curve.csv", lambda: [written(_curve, "curve.csv")], read_curve),
        Target("episodes", "episodes.csv", lambda: [b"steps,reward,length\n4,-1.5,3\n8,2,4\n"],
               read_episodes),
        Target("CASPR bodies", "a_bodies.xml", lambda: [bodies], lambda x: read_robot([x]),
               beside=lambda: {"a_cables.xml": cables}),
        Target("CASPR cables", "a_cables.xml", lambda: [cables], lambda x: read_robot([x]),
               beside=lambda: {"a_bodies.xml": bodies}),
        Target("WireX", "robot.wcrfx", lambda: [wirex_text.encode()], lambda x: read_robot([x])),
        Target("cdpyr", "robot.json", lambda: [json.dumps(cdpyr(*points)).encode()],
               lambda path: read_robot([path]), JSON),
        Target("bag ROS 1", "run.bag", lambda: _bags("ros1"), _read_bag, MUTATORS_OF_BYTES,
               weight=0.3),
        Target("bag MCAP", "run.mcap", lambda: _bags("mcap"), _read_bag, MUTATORS_OF_BYTES,
               weight=0.3),
    )  # fmt: skip


def place(target: Target, folder: Path, content: bytes) -> Path:
    """Write a content where a target reads it."""
    os.makedirs(folder, exist_ok=True)
    for name, sound in target.beside().items():
        (folder / name).write_bytes(sound)
    path = folder / target.file
    path.write_bytes(content)
    return path
