"""Recorded runs for the viewer: from a recording, or from the folder of a study."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import CarosacError, InvalidField, InvalidFile
from carosac_toolkit.base.rotations import to_matrix
from carosac_toolkit.loop.values import Pose, Stamped
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.recordings.encoders import calibrated
from carosac_toolkit.recordings.files import load_recording
from carosac_toolkit.recordings.poses import PoseSamples
from carosac_toolkit.recordings.recording import Recording
from carosac_toolkit.recordings.robot import find_robot
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.studies.run.rows import Row
from carosac_toolkit.viewer.picture import Picture, take_picture

RUN_SAMPLES_MAX = 6_000  # samples of a run; longer ones are thinned out
POSE_GAP_MAX_S = 0.5  # [s] without a pose that is bridged


@dataclass(frozen=True, kw_only=True, eq=False)
class RecordedRun:
    """Run of T samples of a robot with n cables.

    Attributes:
        name: For people.
        robot: Robot of the run.
        time: From its start [s], shape (T,).
        position: Platform origin in W [m], shape (T, 3).
        rotation: From P to W, shape (T, 3, 3).
        tension: At the platform [N], shape (T, n); NaN where unknown.
        target: Reference positions in W [m], shape (T, 3), or None.
        believed: Estimated positions in W [m], shape (T, 3), or None.
        source: Sources of poses, tensions and target, in words.
    """

    name: str
    robot: Robot
    time: Array
    position: Array
    rotation: Array
    tension: Array
    target: Array | None
    believed: Array | None
    source: str

    @property
    def duration(self) -> float:
        """[s]."""
        return float(self.time[-1])

    @property
    def error(self) -> Array:
        """Distance from the target [m], shape (T,); NaN without one."""
        if self.target is None:
            return np.full(len(self.time), np.nan)
        return np.asarray(np.linalg.norm(self.position - self.target, axis=1))

    def index(self, time: float) -> int:
        """Return the latest sample at a time [s]."""
        return int(np.clip(np.searchsorted(self.time, time, side="right") - 1, 0, None))

    def picture(self, k: int) -> Picture:
        """Return the picture of sample `k`."""
        return take_picture(
            self.robot, self.position[k], self.rotation[k], time=float(self.time[k]),
            tension=self.tension[k],
            status=f"replay, {self.time[k]:.2f} s of {self.duration:.1f} s",
            target=None if self.target is None else self.target[k],
            believed=None if self.believed is None else self.believed[k],
        )  # fmt: skip


def load_runs(where: str, robot: str | None = None) -> list[RecordedRun]:
    """Load the runs to play.

    Args:
        where: A recording (file, or name of a bundled one), or the folder of a study, of which
            those cases are taken that were kept whole; ``FOLDER:NUMBER`` takes one of them.
        robot: Bundled robot or YAML file of a recording that names none.

    Raises:
        CarosacError: There is nothing that can be played.
    """
    folder, number = _numbered(where)
    return _study_runs(folder, number) if folder.is_dir() else [_recorded_run(where, robot)]


def _numbered(where: str) -> tuple[Path, int | None]:
    """Return a folder, and which of its runs."""
    folder, colon, number = where.rpartition(":")
    if colon and number.isdigit() and Path(folder).is_dir():
        return Path(folder), int(number)
    return Path(where), None


def _study_runs(folder: Path, number: int | None) -> list[RecordedRun]:
    """Return the cases of a study whose time series was kept."""
    from carosac_toolkit.studies.run.folder import read_rows

    kept = [row for row in read_rows(folder) if row.get("series") is not None]
    runs = [run for row in kept if (run := _case_run(folder, row)) is not None]
    if not runs:
        why = (
            "none of its cases kept its time series" if not kept else
            "its cases were kept without rotations and tensions, by an earlier version; run "
            "the study again"
        )  # fmt: skip
        raise InvalidFile(folder, [f"this study holds no run to replay: {why}"])
    if number is None:
        return runs
    if number >= len(runs):
        raise InvalidField("RUN", f"'{folder}:{number}'", f"0 to {len(runs) - 1}")
    return [runs[number]]


def _case_run(folder: Path, row: Row) -> RecordedRun | None:
    """Return a case of a study, or None if too little of it was kept."""
    series: dict[str, Any] = json.loads(str(row["series"]))
    if series["position_m"] is None or series.get("quaternion") is None:
        return None
    from carosac_toolkit.studies.run.robot_copies import robot_of_row

    robot = robot_of_row(folder, row)
    time = np.array(series["time_s"])
    quaternion = np.array(series["quaternion"])
    tension = series.get("tension_N")
    names = [str(row[key]) for key in ("controller", "estimator", "trajectory", "perturbation")]
    return RecordedRun(
        name=f"{names[0]} with {names[1]}: {names[2]}, {names[3]}, seed {row['seed']}",
        robot=robot, time=time - time[0], position=np.array(series["position_m"]),
        rotation=to_matrix(quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True)),
        tension=np.full((len(time), robot.n), np.nan) if tension is None else np.array(tension),
        target=np.array(series["reference_m"]), believed=np.array(series["belief_m"]),
        source="poses and tensions of the simulated plant, drawn on the nominal robot; target: "
               "the reference",
    )  # fmt: skip


def _recorded_run(where: str, asked: str | None) -> RecordedRun:
    """Return the run of a recording."""
    from carosac_toolkit.recordings.bundled import find_recording

    path = find_recording(where)
    recording, believed = _load(path)
    robot_choice = find_robot(recording, path, asked)
    recording.require_cables(robot_choice.robot)
    recording = calibrated(recording, robot_choice.robot)
    thinned = _thinned(recording)
    run = _run_of(Path(where).name, robot_choice.robot, thinned, believed)
    if len(thinned.time) == len(recording.time):
        return run
    return replace(
        run, source=f"{run.source}; {len(thinned.time)} of {len(recording.time)} samples"
    )


def _load(path: Path) -> tuple[Recording, PoseSamples | None]:
    """Load a recording, with the estimates if it is the file of a run."""
    recording = load_recording(path)
    if path.suffix.lower() != ".jsonl":
        return recording, None
    from carosac_toolkit.recordings.crash_safe import read_run

    return recording, read_run(path).believed_poses


def _thinned(recording: Recording) -> Recording:
    """Return at most `RUN_SAMPLES_MAX` samples of the lengths."""
    step = -(-len(recording.time) // RUN_SAMPLES_MAX)
    return replace(
        recording, time=recording.time[::step],
        unstrained_length=recording.unstrained_length[::step],
    )  # fmt: skip


def _run_of(
    name: str, robot: Robot, recording: Recording, believed: PoseSamples | None
) -> RecordedRun:
    """Return poses as measured, else as estimated, else at rest on the recorded lengths."""
    poses, source = recording.poses, "measured"
    if poses is None:
        poses, source = believed, "as estimated"
        believed = None
    absolute = recording.metadata.length_kind == "unstrained"
    keep = np.ones(len(recording.time), dtype=bool)
    guess = None
    if poses is not None:
        matched = poses.at(recording.time, gap_max=POSE_GAP_MAX_S)
        keep = matched.valid
        if not keep.any():
            raise CarosacError(f"{name}: no pose near the time of any length; nothing to show")
        guess = Pose(position=matched.pose.position[keep], rotation=matched.pose.rotation[keep])
    length, time = recording.unstrained_length[keep], recording.time[keep]
    rest = statics.forward_kinematics(robot, length, guess=guess) if absolute else None
    if guess is None:
        if rest is None:
            raise CarosacError(f"{name}: neither poses nor absolute lengths; nothing to show")
        keep = rest.converged
        if not keep.any():
            raise CarosacError(f"{name}: {robot.name} rests at none of the recorded lengths")
        guess, source = (
            Pose(position=rest.position, rotation=rest.rotation),
            "at rest on the lengths",
        )
    else:
        keep = np.ones(len(time), dtype=bool)
    tension, words = _tensions(recording.tension, rest, time, robot.n)
    target = _targets(robot, recording.command, time, guess) if absolute else None
    return RecordedRun(
        name=name, robot=robot, time=time[keep] - time[keep][0], position=guess.position[keep],
        rotation=guess.rotation[keep], tension=tension[keep],
        target=None if target is None else target[keep],
        believed=None if believed is None else
        believed.at(time[keep], gap_max=POSE_GAP_MAX_S).pose.position,
        source=f"poses {source}; tensions {words}{_of_target(recording.command, target)}",
    )  # fmt: skip


def _of_target(command: Stamped | None, target: Array | None) -> str:
    """Return the source of the target, or why there is none."""
    if target is not None:
        return "; target: where the commanded lengths would rest"
    return "" if command is None else "; no target: some commanded lengths have no equilibrium"


def _tensions(recorded: Stamped | None, rest: Any, time: Array, n: int) -> tuple[Array, str]:
    """Return tensions at times [N], shape (T, n), and their source."""
    if recorded is not None:
        columns = [
            np.interp(time, recorded.time, recorded.value[:, i], left=np.nan, right=np.nan)
            for i in range(n)
        ]
        return np.stack(columns, axis=1), "measured"
    if rest is None:
        return np.full((len(time), n), np.nan), "unknown"
    known = rest.converged[:, None] & (rest.tension > 0.0)
    return np.where(known, rest.tension, np.nan), "of rest on the recorded lengths"


def _targets(robot: Robot, command: Stamped | None, time: Array, guess: Pose) -> Array | None:
    """Return the equilibria of the commanded lengths in W [m], shape (T, 3); None if unknown."""
    if command is None:
        return None
    latest = np.searchsorted(command.time, time, side="right") - 1
    length = command.value[np.clip(latest, 0, None)]
    rest = statics.forward_kinematics(robot, length, guess=guess)
    return rest.position if (rest.converged & (latest >= 0)).all() else None


def same_robot(runs: Sequence[RecordedRun]) -> list[RecordedRun]:
    """Return the runs of the same robot as the first."""
    return [run for run in runs if run.robot.name == runs[0].robot.name]
