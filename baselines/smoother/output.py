"""A smoothed recording as files."""

from __future__ import annotations

import io
from dataclasses import replace
from pathlib import Path

import numpy as np

from baselines.smoother.pictures import draw_estimate, draw_unknowns
from baselines.smoother.result import Smoothed
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.version import __version__
from carosac_toolkit.pictures.saving import PICTURE_FORMATS, picture_files
from carosac_toolkit.recordings.poses import PoseSamples
from carosac_toolkit.recordings.recording import Recording
from carosac_toolkit.reports.page import write_files
from carosac_toolkit.robot.robot import Robot

TABLE_FILE = "estimate.parquet"
PICTURES = {"estimate": draw_estimate, "unknowns": draw_unknowns}
REPORT_FILES = (TABLE_FILE, *(f"{name}.{end}" for name in PICTURES for end in PICTURE_FORMATS))


def recording_of(
    result: Smoothed, recording: Recording, robot: Robot, source: str, named: str | None
) -> Recording:
    """Return a recording with smoothed poses in place of measured ones.

    All else is left as it was recorded, and poses are given in the frame of measured ones: the same
    robot may be used with it again.

    Args:
        result: What was found.
        recording: As it was recorded.
        robot: That it was smoothed with.
        source: What made it, for the metadata.
        named: Name or path by which the robot is found from it; None: as it was.
    """
    metadata = replace(
        recording.metadata,
        robot=recording.metadata.robot if named is None else named,
        description=f"Smoothed: {recording.metadata.description}".strip(),
        source="; ".join(part for part in (source, recording.metadata.source) if part),
        created_by=f"carosac-toolkit {__version__}",
    )
    frame = np.eye(3) if robot.pose_rotation is None else robot.pose_rotation
    poses = PoseSamples.from_rotation(
        result.time, result.position @ frame, frame.T @ result.rotation
    )
    return replace(recording, poses=poses, metadata=metadata)


def table_of(result: Smoothed) -> dict[str, Array]:
    """Return all estimates at each sample, by columns with units."""
    sigma = result.sigma
    columns = {
        "time_s": result.time,
        **_columns("position_{}_m", result.position),
        **dict(zip(_QUATERNION_COLUMNS, _quaternion(result).T, strict=True)),
        **_columns("velocity_{}_m_per_s", result.twist[:, :3]),
        **_columns("angular_velocity_{}_rad_per_s", result.twist[:, 3:]),
        **_columns("position_sigma_{}_m", sigma[:, :3]),
        **_columns("rotation_sigma_{}_rad", sigma[:, 3:6]),
        **_columns("velocity_sigma_{}_m_per_s", sigma[:, 6:9]),
        **_columns("angular_velocity_sigma_{}_rad_per_s", sigma[:, 9:]),
    }
    for i in range(12):
        for j in range(i, 12):
            columns[f"covariance_{i + 1:02d}_{j + 1:02d}"] = result.covariance[:, i, j]
    columns |= _columns("wind_{}_N", result.wind)
    for i in range(result.length_bias.shape[1]):
        columns |= {
            f"length_bias_{i + 1:02d}_m": result.length_bias[:, i],
            f"length_bias_sigma_{i + 1:02d}_m": result.length_bias_sigma[:, i],
            f"tension_{i + 1:02d}_N": result.tension[:, i],
        }
    return columns


_QUATERNION_COLUMNS = tuple(f"quaternion_{axis}" for axis in "wxyz")


def _columns(name: str, values: Array) -> dict[str, Array]:
    return dict(zip([name.format(axis) for axis in "xyz"], values.T, strict=False))


def _quaternion(result: Smoothed) -> Array:
    """Return the rotations as quaternions w x y z, shape (N, 4)."""
    return PoseSamples.from_rotation(result.time, result.position, result.rotation).quaternion


def write(folder: Path, result: Smoothed) -> list[Path]:
    """Write table and pictures; every file appears whole, or nothing does.

    Args:
        folder: Made if need be; files of the same names are replaced.
        result: What was found.
    """
    pictures = picture_files({name: draw(result) for name, draw in PICTURES.items()})
    return write_files(folder, {TABLE_FILE: _parquet(table_of(result)), **pictures})


def _parquet(columns: dict[str, Array]) -> bytes:
    """Return a table as the content of a Parquet file."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    buffer = io.BytesIO()
    pq.write_table(pa.table({name: np.array(value) for name, value in columns.items()}), buffer)
    return buffer.getvalue()
