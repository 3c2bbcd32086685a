"""Copies of robot and path files in the folder of a study, which can then be read anywhere."""

from __future__ import annotations

import json
import shutil
from collections.abc import Sequence
from pathlib import Path

from carosac_toolkit.base.errors import CarosacError
from carosac_toolkit.base.files import replacing
from carosac_toolkit.robot.file import load_robot, robot_text
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.studies.run.rows import Row
from carosac_toolkit.studies.run.run_case import robot_digest
from carosac_toolkit.trajectories.path_file import path_digest, path_file

ROBOTS_FOLDER, PATHS_FOLDER = "robots", "trajectories"  # in the folder of a study


def copy_robots(folder: Path, robots: Sequence[str]) -> list[Path]:
    """Copy robot files, bundled ones too, into the folder of a study; return the copies."""
    copies = []
    for name in robots:
        path = _copy_path(folder, name, robot_digest(name))
        if not path.is_file():
            path.parent.mkdir(parents=True, exist_ok=True)
            with replacing(path) as temporary:
                temporary.write_text(robot_text(name), encoding="utf-8", newline="")
        copies.append(path)
    return copies


def copy_paths(folder: Path, names: Sequence[str]) -> list[Path]:
    """Copy files of trajectories into the folder of a study; return the copies."""
    copies = []
    for name in names:
        source = path_file(name)
        digest = path_digest(name) or ""
        path = folder / PATHS_FOLDER / f"{source.stem}-{digest[:8]}{source.suffix}"
        if not path.is_file():
            path.parent.mkdir(parents=True, exist_ok=True)
            with replacing(path) as temporary:
                shutil.copyfile(source, temporary)
        copies.append(path)
    return copies


def copy_of(folder: Path, row: Row) -> Path | None:
    """Return the copy of the robot file that a row was run with, or None if there is none."""
    settings = row.get("settings")
    digest = json.loads(settings).get("robot_digest") if isinstance(settings, str) else None
    if not isinstance(digest, str):
        return None
    path = _copy_path(folder, str(row["robot"]), digest)
    return path if path.is_file() else None


def robot_of_row(folder: Path, row: Row) -> Robot:
    """Load the robot that a row of a study was run with.

    Raises:
        CarosacError: The folder has no copy of it, as one of an earlier version, and its file is
            no longer where it was.
    """
    path = copy_of(folder, row)
    if path is not None:
        return load_robot(path)
    try:
        return load_robot(str(row["robot"]))
    except CarosacError as error:
        raise CarosacError(
            f"{error}\n  (the study in {str(folder)!r} keeps no copy of this robot: it is of an "
            "earlier version; put the file back, or run the study again)"
        ) from error


def _copy_path(folder: Path, name: str, digest: str) -> Path:
    """Return where the copy of a robot file with this content is."""
    return folder / ROBOTS_FOLDER / f"{Path(name).stem}-{digest[:8]}.yaml"
