"""Names in tables, sentences and pictures: short ones, and the own names of robots."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from carosac_toolkit.base.errors import CarosacError
from carosac_toolkit.recordings.files import READERS_BY_SUFFIX
from carosac_toolkit.studies.compare.results import StudyResults
from carosac_toolkit.studies.run.robot_copies import robot_of_row
from carosac_toolkit.studies.run.rows import Row


def short_name(text: str) -> str:
    """Return the stem of a file, the class of ``module:Class``, or the name itself."""
    path = Path(text)
    if path.suffix.lower() in (".yaml", ".yml", *READERS_BY_SUFFIX) or "/" in text:
        return path.stem
    return text.rpartition(":")[2] or text


def robot_names(results: StudyResults) -> dict[str, str]:
    """Return the name of each robot of a study by its name or path in the rows.

    Robots of one name are told apart by their files.
    """
    named = {str(row["robot"]): row for row in reversed(results.rows)}
    return told_apart(
        {text: _robot_name(results.folder, row) for text, row in reversed(named.items())}
    )


def told_apart(names: Mapping[str, str]) -> dict[str, str]:
    """Return the names of robots by name or path; those of one name with their files.

    Files of the same name are told apart by their paths.
    """
    known = list(names.values())
    told = {
        text: name if known.count(name) == 1 else f"{name} ({short_name(text)})"
        for text, name in names.items()
    }
    shown = list(told.values())
    return {
        text: name if shown.count(name) == 1 else f"{names[text]} ({text})"
        for text, name in told.items()
    }


def named_labels(results: StudyResults, *, short: bool = False) -> list[str]:
    """Return the labels of the groups, with the names of robots in place of their files.

    Args:
        results: Results of a study.
        short: Whether all other names are shortened by `short_name`.
    """
    own = robot_names(results)
    shown = short_name if short else str
    return [
        " / ".join(own.get(part, shown(part)) for part in label.split(" / "))
        for label in results.labels
    ]


def _robot_name(folder: Path, row: Row) -> str:
    """Return the name in the file of a robot; that of the file where it can no longer be read."""
    try:
        return robot_of_row(folder, row).name
    except CarosacError:
        return short_name(str(row["robot"]))
