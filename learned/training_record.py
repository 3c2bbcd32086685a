"""Record of a training: its settings, the code that ran it, and what it started from."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from carosac_toolkit.base.errors import InvalidField, MissingFile
from carosac_toolkit.base.files import refusing, replacing

SETTINGS_FILE = "settings.json"
UNKNOWN_COMMIT = "unknown"  # commit of code that is not under git
HISTORY_FIELDS = (
    "commit",
    "commits",
    "started_from",
)  # beside the settings; the first in older files
# Fields that came later, with what trainings did before.
LATER_FIELDS: tuple[tuple[tuple[str, ...], dict[str, Any]], ...] = (
    ((), {"changes": "", "device": "cpu"}),
    (
        ("environment",),
        {"memory": 1.0, "correction": 0.0, "correction_memory": 4.0, "truth": False},
    ),
    (("environment", "reward"), {"tracking_scale": 0.1, "slack": 0.0, "reserve": 0.0, "jerk": 3.0}),
    (("environment", "units"), {"acceleration": 1.0}),
    (
        ("environment", "moving"),
        {"estimator": None, "estimated": 1.0, "suite": "lengths+imu", "modelled": False},
    ),
    (("td3",), {"target_rate": 0.005}),
)
DIFFERENCES_SHOWN = 3  # of the settings that differ, in an error
SHARED_FIELDS = (  # with the stage that a later one starts from
    ("preset",), ("robot_digest",), ("seed",),
    ("environment", "observation"), ("environment", "preview"), ("environment", "units"),
    ("environment", "action"), ("environment", "memory"), ("environment", "correction"),
    ("environment", "correction_memory"), ("environment", "truth"),
    ("td3", "hidden"), ("td3", "activation"), ("td3", "critic"), ("td3", "critics"),
)  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class TrainingRecord:
    """Content of ``settings.json``.

    Attributes:
        settings: What was asked for, as JSON gives it back.
        commits: Of the code that trained, in their order; another each time that a training went
            on with other code.
        started_from: Checkpoint of the earlier stage whose networks were taken over, its steps and
            how many it was asked for, its commits, the digests of its robot and of the networks;
            None: it began with nothing.
    """

    settings: dict[str, Any]
    commits: tuple[str, ...]
    started_from: dict[str, Any] | None = None

    @property
    def commit(self) -> str:
        """Text of all commits."""
        return ", ".join(self.commits)

    def resumed(self, commit: str) -> TrainingRecord:
        """Return the record of a training that continues with the code of a commit."""
        if commit == self.commits[-1]:
            return self
        return replace(self, commits=(*self.commits, commit))

    def data(self) -> dict[str, Any]:
        """Return all of it, as JSON holds it."""
        return self.settings | {"commits": list(self.commits), "started_from": self.started_from}

    def as_start(self, checkpoint: str, steps: int, networks: Iterable[Any]) -> dict[str, Any]:
        """Return what a later stage keeps of this one when it starts from its networks.

        Args:
            checkpoint: Folder and name.
            steps: That the networks were trained for.
            networks: Names and values.
        """
        return {
            "checkpoint": checkpoint, "steps": steps, "of_steps": self.settings["td3"]["steps"],
            "commits": list(self.commits), "robot_digest": self.settings["robot_digest"],
            "networks_digest": digest(networks),
        }  # fmt: skip

    def write(self, folder: Path) -> None:
        """Write it to a folder, as a whole or not at all."""
        with replacing(folder / SETTINGS_FILE) as temporary:
            temporary.write_text(json.dumps(self.data(), indent=1) + "\n", encoding="utf-8")


def read_record(folder: Path) -> TrainingRecord | None:
    """Read the record of a training; return None where there is none.

    Settings that came later than the training change nothing in it, and are there by default.

    Raises:
        InvalidFile: It is damaged.
    """
    path = folder / SETTINGS_FILE
    if not path.is_file():
        return None
    with refusing(path, "the settings of a training"):
        settings = dict(json.loads(path.read_text(encoding="utf-8")))
        history = {name: settings.pop(name, None) for name in HISTORY_FIELDS}
        return TrainingRecord(
            settings=with_later_fields(settings),
            commits=tuple(history["commits"] or [history["commit"] or UNKNOWN_COMMIT]),
            started_from=history["started_from"],
        )


def check_settings(settings: dict[str, Any], folder: Path) -> TrainingRecord | None:
    """Make sure that a folder holds a training of the same settings, or none.

    Returns:
        Its record, if it holds one.

    Raises:
        InvalidField: They differ.
    """
    known = read_record(folder)
    if known is None:
        return None
    if known.settings != settings:
        differences = _differences(known.settings, settings)
        more = (
            f", and {len(differences) - DIFFERENCES_SHOWN} more differ"
            if len(differences) > DIFFERENCES_SHOWN
            else ""
        )
        allowed = (
            "a folder of the same settings; there "
            f"{', '.join(differences[:DIFFERENCES_SHOWN])}{more}"
        )
        raise InvalidField("output", f"'{folder}'", allowed)
    return known


def check_start(
    settings: dict[str, Any], checkpoint: Path, changes: str | None = None
) -> TrainingRecord:
    """Make sure that a stage may start from the networks of an earlier one.

    Args:
        settings: Of the later stage.
        checkpoint: Of the earlier one, in its folder.
        changes: What is to be changed in the preset of the earlier one, in short; None: anything.

    Returns:
        The record of the earlier one.

    Raises:
        MissingFile: There is no checkpoint, or no settings beside it.
        InvalidField: It was trained for another robot, with another preset or seed, or its networks
            see, mean or are something else.
    """
    if not checkpoint.is_file():
        raise MissingFile(checkpoint, "train the earlier stage first")
    earlier = read_record(checkpoint.parent)
    if earlier is None:
        reason = "the settings of the earlier stage must be beside its checkpoint"
        raise MissingFile(checkpoint.parent / SETTINGS_FILE, reason)
    names = [
        keys[-1] for keys in SHARED_FIELDS if _at(settings, keys) != _at(earlier.settings, keys)
    ]
    if names:
        allowed = f"a checkpoint of the same robot, preset, seed and networks; {', '.join(names)} "
        raise InvalidField("start", f"'{checkpoint}'", allowed + "differ")
    known = earlier.settings["changes"]
    if changes is not None and known != changes:
        got = f"'{checkpoint}', trained with {known or 'no changes'}"
        raise InvalidField("start", got, f"one trained with {changes or 'no changes'}")
    return earlier


def with_later_fields(settings: dict[str, Any]) -> dict[str, Any]:
    """Fill in the fields that the settings of an older training lack."""
    filled: dict[str, Any] = json.loads(json.dumps(settings))
    for keys, fields in LATER_FIELDS:
        part = _at(filled, keys)
        if isinstance(part, dict):
            part |= fields | part
    return filled


def digest(values: Iterable[Any]) -> str:
    """Return a digest of numbers and texts."""
    parts = [x.tobytes() if isinstance(x, np.ndarray) else repr(x).encode() for x in values]
    return hashlib.sha256(b"|".join(parts)).hexdigest()[:16]


def _differences(known: Any, asked: Any, path: str = "") -> list[str]:
    """Describe the differences of nested settings: ``td3.steps is 400000, not 20000``."""
    if isinstance(known, dict) or isinstance(asked, dict):
        one, other = (x if isinstance(x, dict) else {} for x in (known, asked))
        both = ((name, f"{path}.{name}" if path else name) for name in one | other)
        parts = [_differences(one.get(name), other.get(name), where) for name, where in both]
        return [difference for part in parts for difference in part]
    return [] if known == asked else [f"{path} is {known!r}, not {asked!r}"]


def _at(settings: dict[str, Any], keys: Iterable[str]) -> Any:
    """Return a nested setting; None where there is none."""
    value: Any = settings
    for key in keys:
        value = value.get(key) if isinstance(value, dict) else None
    return value
