"""Importer of the ``.mat`` layout in which the SCAMPI run is published.

Reference: Allak et al., "Kinematics-Inertial Fusion for Localization of a 4-Cable Underactuated
Suspended Robot Considering Cable Sag", IROS 2022.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import InvalidFile, did_you_mean
from carosac_toolkit.recordings.columns import (
    FIXED_COLUMNS,
    TIME_COLUMN,
    channel_columns,
    exit_point_columns,
)
from carosac_toolkit.recordings.conversion import RECORDING_SCHEMA, from_table
from carosac_toolkit.recordings.mat_process import read_mat
from carosac_toolkit.recordings.metadata import RecordingMetadata
from carosac_toolkit.recordings.recording import Recording
from carosac_toolkit.recordings.table import Column, Table

Part = tuple[Array, tuple[str, ...], str]  # values (N, columns), columns, variable
REQUIRED_VARIABLES = ("time_stamps", "measured_cable_lengths", "ef_poses")
_VARIABLES = "|".join(REQUIRED_VARIABLES) + r"|pulley\d+_poses"
_PULLEY_VARIABLE = re.compile(r"pulley(\d+)_poses")


def read_scampi_mat(path: Path) -> Recording:
    """Read ``time_stamps``, ``measured_cable_lengths``, ``ef_poses`` and ``pulleyK_poses``.

    ``ef_poses`` are x y z [m] and a quaternion in order w x y z; of the square matrix
    ``time_stamps`` only the first column is filled.

    Raises:
        InvalidFile: With all faults that were found.
    """
    variables, names = read_mat(path, _VARIABLES)
    faults = []
    for name in (name for name in REQUIRED_VARIABLES if name not in variables):
        hint = did_you_mean(name, names) or f"; there are {names}"
        faults.append(f"variable {name!r} is missing{hint}")
    if faults:
        raise InvalidFile(path, faults)
    parts = _parts(variables, path)
    rows = len(parts[0][0])
    faults = [
        f"variable {name!r}: got shape {value.shape}; allowed: {(rows, len(columns))}"
        for value, columns, name in parts
        if value.shape != (rows, len(columns))
    ]
    if faults:
        raise InvalidFile(path, faults)
    columns = {name: (value, j) for value, names, _ in parts for j, name in enumerate(names)}

    def take(name: str) -> Column:
        value, j = columns[name]
        return value[:, j].copy(), np.ones(rows, dtype=np.bool_)

    table = Table(names=list(columns), rows=rows, take=take)
    metadata = RecordingMetadata(source=path.name, description="imported from the SCAMPI layout")
    return from_table(table, {"schema": RECORDING_SCHEMA, "metadata": metadata.to_dict()}, path)


def _parts(variables: Mapping[str, Array], path: Path) -> list[Part]:
    """Pair each variable with the columns that it fills."""
    lengths = variables["measured_cable_lengths"]
    n = lengths.shape[1]
    parts: list[Part] = [
        (_time(variables["time_stamps"])[:, None], (TIME_COLUMN,), "time_stamps"),
        (lengths, channel_columns("unstrained_length", n), "measured_cable_lengths"),
        (variables["ef_poses"], FIXED_COLUMNS["poses"], "ef_poses"),
    ]
    pulleys = sorted(
        (int(m.group(1)), k) for k in variables if (m := _PULLEY_VARIABLE.fullmatch(k))
    )
    if pulleys and [number for number, _ in pulleys] != list(range(1, n + 1)):
        raise InvalidFile(path, [f"pulleys {[k for _, k in pulleys]}; allowed: 1 to {n}"])
    points = exit_point_columns(n)
    return parts + [(variables[k], points[3 * i - 3 : 3 * i], k) for i, k in pulleys]


def _time(stamps: Array) -> Array:
    """Return the time stamps of a row, a column or a matrix with one filled column, (N,)."""
    return stamps[0] if stamps.shape[0] == 1 else stamps[:, 0]
