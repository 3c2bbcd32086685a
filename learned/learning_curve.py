"""Tables that a training leaves behind: its learning curve, and each episode that ended."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

from carosac_toolkit.base.files import refusing, replacing

CURVE_FILE, EPISODES_FILE = "curve.csv", "episodes.csv"
CURVE_COLUMNS = (
    "steps", "updates", "cpu_seconds", "reward", "median_error_m", "median_of_means_m",
    "p95_error_m", "rmse_m", "inconsistency_m", "failed_paths",
)  # fmt: skip
COUNT_COLUMNS = ("steps", "updates", "failed_paths")  # of the columns, those that are whole numbers
LATER_COLUMNS = ("failed_paths",)  # older curves lack it


class Episode(NamedTuple):
    """An episode of training that ended.

    Attributes:
        steps: Environment steps of the whole training at its end.
        reward: Sum over its steps, with the noise of exploration in the actions [-].
        length: Its own steps; fewer than others have if it was cut short.
    """

    steps: int
    reward: float
    length: int


def measured(scores: Mapping[str, Any]) -> dict[str, float]:
    """Return the columns that come from `PolicyScores.data` of the test paths."""
    return {
        "median_error_m": scores["median_error_m"]["norm"],
        "median_of_means_m": scores["median_of_trajectory_means_m"],
        "p95_error_m": scores["p95_error_m"],
        "rmse_m": scores["rmse_m"],
        "inconsistency_m": scores["inconsistency_m"],
        "failed_paths": float(scores["failures"]),
    }


def write_curve(path: Path, rows: Sequence[dict[str, float]]) -> None:
    """Write the learning curve as CSV, as a whole or not at all.

    Args:
        path: The file.
        rows: A number for each of `CURVE_COLUMNS`: environment steps and updates so far, CPU time
            of the stage [s], mean reward of the episodes that ended since the row before [-]; then,
            of the policy without noise on the test paths, errors and inconsistency [m] up to where
            a path fails, and how many paths fail.
    """
    _write(
        path, CURVE_COLUMNS, ([_text(name, row[name]) for name in CURVE_COLUMNS] for row in rows)
    )


def read_curve(path: Path) -> list[dict[str, float]]:
    """Read what `write_curve` wrote; a column that an older curve lacks is NaN.

    Raises:
        InvalidFile: It is damaged.
    """
    rows = []
    with _reading(path) as table:
        for read in table:
            texts = dict.fromkeys(LATER_COLUMNS, "nan") | read
            rows.append({name: float(texts[name]) for name in CURVE_COLUMNS})
    return rows


def write_episodes(path: Path, episodes: Sequence[Episode]) -> None:
    """Write all episodes that ended as CSV, as a whole or not at all."""
    lines = ([str(one.steps), f"{one.reward:.6g}", str(one.length)] for one in episodes)
    _write(path, Episode._fields, lines)


def read_episodes(path: Path) -> list[Episode]:
    """Read what `write_episodes` wrote.

    Raises:
        InvalidFile: It is damaged.
    """
    with _reading(path) as table:
        return [
            Episode(int(row["steps"]), float(row["reward"]), int(row["length"])) for row in table
        ]


@contextmanager
def _reading(path: Path) -> Iterator[Iterable[dict[str, str]]]:
    """Give the rows of a table by column; refuse a damaged one."""
    with refusing(path, "a table of a training"):
        with path.open(newline="", encoding="utf-8") as stream:
            yield csv.DictReader(stream)


def _write(path: Path, header: Sequence[str], lines: Iterable[Sequence[str]]) -> None:
    """Write a table."""
    with replacing(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as stream:
        writer: Any = csv.writer(stream)
        writer.writerow(header)
        writer.writerows(lines)


def _text(name: str, value: float) -> str:
    """Format a number of the curve; six digits are too few for some numbers of steps."""
    return f"{value:.0f}" if name in COUNT_COLUMNS else f"{value:.6g}"
