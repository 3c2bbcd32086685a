"""Table of the judged poses, for other programs."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carosac_toolkit.workspace.limits import CABLE_LIMITS, LIMIT_LABELS, Limit
from carosac_toolkit.workspace.maps import Maps
from carosac_toolkit.workspace.region import Region


def columns(region: Region, found: Maps | None = None) -> dict[str, NDArray[Any]]:
    """Return columns by name; numbers are NaN where there is no rest.

    Args:
        region: Verdicts on a grid.
        found: Their maps, if there are any.
    """
    out, rest = region.verdicts, region.verdicts.rest
    names = np.array([*region.robot.cable_names, ""])
    words = np.array([LIMIT_LABELS[limit] for limit in Limit])
    of_cable = np.isin(out.limit, CABLE_LIMITS)
    near_cable = np.isin(out.nearest, CABLE_LIMITS)
    table: dict[str, NDArray[Any]] = {
        **{f"{axis}_m": rest.position[:, k] for k, axis in enumerate("xyz")},
        "inside": out.inside,
        "margin_N": out.margin,
        "limit": words[out.limit],
        "cable": names[np.where(of_cable, out.cable, -1)],
        "nearest_tension_limit": words[out.nearest],
        "nearest_cable": names[np.where(near_cable, out.nearest_cable, -1)],
        "tilt_rad": out.tilt,
        "stable": rest.stable,
        "cable_distance_m": out.distance,
    }
    held = rest.converged[:, None]
    for k in range(region.robot.n):
        table[f"tension_{k + 1:02d}_N"] = np.where(held, rest.tension, np.nan)[:, k]
        length = np.where(held, rest.unstrained_length, np.nan)
        table[f"unstrained_length_{k + 1:02d}_m"] = length[:, k]
    if found is not None:
        table |= {
            "stiffness_N_per_m": found.stiffness,
            **{f"softest_{axis}": found.softest[:, k] for k, axis in enumerate("xyz")},
            "turning_stiffness_Nm_per_rad": found.turning_stiffness,
            "frequency_Hz": found.frequency,
            "sag_m": found.sag,
        }
    return table


def write_table(path: Path, table: dict[str, NDArray[Any]]) -> None:
    """Write columns as CSV or Parquet, by the suffix of the path."""
    if path.suffix == ".parquet":
        import pyarrow as pa
        import pyarrow.parquet as pq

        pq.write_table(pa.table({name: pa.array(value) for name, value in table.items()}), path)
        return
    cells = [[_cell(x) for x in value.tolist()] for value in table.values()]
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(table)
        writer.writerows(zip(*cells, strict=True))


def _cell(value: Any) -> str:
    """Return one cell of a CSV file; empty for NaN."""
    if isinstance(value, bool):
        return str(int(value))
    if isinstance(value, float):
        return "" if np.isnan(value) else f"{value:.9g}"
    return str(value)
