"""Folder of a study: its cases, its rows so far, and a lock for one run at a time."""

from __future__ import annotations

import json
import shutil
import tempfile
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import count
from pathlib import Path
from typing import Any

from carosac_toolkit.base.errors import CarosacError, InvalidField, InvalidFile, MissingFile
from carosac_toolkit.base.files import refusing, replacing
from carosac_toolkit.base.version import __version__
from carosac_toolkit.studies.run.case import CASE_COLUMNS, Case, canonical
from carosac_toolkit.studies.run.row_files import (
    drop_rows,
    merge_parts,
    read_parts,
    write_part,
)
from carosac_toolkit.studies.run.rows import CASE_STATUSES, Row, in_common_columns

MANIFEST_FILE = "study.json"
STUDY_SCHEMA = "carosac-study/1"
SMALL_PARTS_MAX = 100  # small parts
NAMES_SHOWN = 3  # of those that differ in one way
VALUE_SHOWN = 40  # characters of a value in a message
_AXES = (*CASE_COLUMNS, "seed")
_AXIS_WORDS = {
    "sensors": "sensors", "trajectory": "trajectories", "perturbation": "conditions",
}  # fmt: skip
_DIGEST_WORDS = {
    "robot_digest": "file of the robot", "condition_digest": "file of the condition",
    "trajectory_digest": "file of the trajectory",
}  # fmt: skip
_ENTRY_KINDS = [str, *(str for _ in CASE_COLUMNS), int, int]  # identity, axes, seed, settings


class StudyConflict(CarosacError):
    """Error of a folder that holds another study than the requested one, or is in use."""


class StudyFolder:
    """Rows of one study on disk.

    Args:
        path: The folder.
        cases: The cases of the study, in order.
    """

    def __init__(self, path: Path, cases: Sequence[Case]) -> None:
        self.path = path
        self._identities = {case.identity for case in cases}
        self._parts = 0

    def finished(self) -> dict[str, Row]:
        """Return the rows of this study that are on disk, by case."""
        return {name: x for name, x in read_parts(self.path).items() if name in self._identities}

    def forget(self, statuses: Collection[str]) -> None:
        """Remove rows with these statuses."""
        drop_rows(self.path, self._identities, statuses)

    def forget_cases(self, identities: Collection[str]) -> None:
        """Remove the rows of some cases of this study."""
        drop_rows(self.path, self._identities & set(identities), CASE_STATUSES)

    def append(self, rows: Sequence[Row]) -> None:
        """Write rows to the disk."""
        if not rows:
            return
        write_part(self.path, rows)
        self._parts += 1
        if self._parts >= SMALL_PARTS_MAX:
            self.merge()

    def merge(self) -> None:
        """Merge the files into one."""
        merge_parts(self.path, self._identities)
        self._parts = 0


@contextmanager
def opened(path: Path, cases: Sequence[Case], function: str) -> Iterator[StudyFolder]:
    """Take a folder for a study for as long as the block lasts.

    Raises:
        StudyConflict: It holds another study, or another process runs in it.
    """
    path.mkdir(parents=True, exist_ok=True)
    with _locked(path):
        _agree(path, cases, function)
        for left_over in path.glob(".part-*"):
            left_over.unlink()
        for left_over in path.glob(".running-*"):
            shutil.rmtree(left_over, ignore_errors=True)
        yield StudyFolder(path, cases)


@contextmanager
def notes_folder(path: Path) -> Iterator[str]:
    """Give a folder for the notes of running cases, which goes with the block."""
    notes = tempfile.mkdtemp(prefix=".running-", dir=path.resolve())
    try:
        yield notes
    finally:
        shutil.rmtree(notes, ignore_errors=True)


def read_cases(folder: str | Path) -> list[Case]:
    """Return the cases that a study was asked for, in order.

    Raises:
        MissingFile: There is no study in the folder.
        InvalidFile: Its ``study.json`` is broken, or of another version of the toolkit.
    """
    manifest = _read_manifest(Path(folder))
    if manifest["toolkit"] != __version__:
        fault = f"toolkit: got {manifest['toolkit']}; allowed: {__version__}, the one installed"
        raise InvalidFile(Path(folder) / MANIFEST_FILE, [fault])
    settings = manifest["settings"]
    with _refusing(Path(folder) / MANIFEST_FILE):
        return [
            Case(**dict(zip(_AXES, values, strict=True)), settings=settings[index])
            for _, *values, index in manifest["cases"]
        ]


def has_cases_left(folder: str | Path, cases: Sequence[Case], retry: Collection[str] = ()) -> bool:
    """Return whether a run into a folder would run any case.

    Args:
        folder: Folder of the rows; it need not exist.
        cases: The cases.
        retry: Statuses of finished cases to run again.
    """
    rows = read_parts(Path(folder))
    finished = {name for name, row in rows.items() if row["status"] not in retry}
    return any(case.identity not in finished for case in cases)


def read_rows(folder: str | Path) -> list[Row]:
    """Return the rows of a study, one per finished case, in the order of the cases.

    All rows have the same columns; None stands where a case has no value. Rows in the folder that
    belong to no case of the study are left out. This works while the study runs, too.

    Raises:
        MissingFile: There is no study in the folder.
        InvalidFile: A file in it is broken; the message names it.
    """
    order = [entry[0] for entry in _read_manifest(Path(folder))["cases"]]
    by_case = read_parts(Path(folder))
    return in_common_columns(by_case[name] for name in order if name in by_case)


def free_folder(base: Path, cases: Sequence[Case]) -> Path:
    """Choose a folder that holds none but some of these cases: `base`, `base`-2, `base`-3, ..."""
    asked = {case.identity for case in cases}
    for number in count(1):
        folder = base if number == 1 else base.with_name(f"{base.name}-{number}")
        if not (folder / MANIFEST_FILE).exists():
            return folder
        try:
            if {case.identity for case in read_cases(folder)} <= asked:
                return folder
        except CarosacError:  # broken, or of another version: not ours to touch
            continue
    raise AssertionError("count() ends nowhere")


def check_statuses(retry: Collection[str]) -> None:
    """Refuse anything but the statuses of unfinished cases."""
    allowed = [status for status in CASE_STATUSES if status != "ok"]
    for status in retry:
        if status not in allowed:
            raise InvalidField("retry", repr(status), f"some of {allowed}")


@contextmanager
def _locked(path: Path) -> Iterator[None]:
    """Hold the folder's lock, which the system takes back from a process that dies."""
    try:
        import fcntl
    except ImportError:  # a system without such locks
        yield
        return
    with (path / ".lock").open("w") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise StudyConflict(f"{path}: another process runs a study in this folder") from error
        yield


def _agree(path: Path, cases: Sequence[Case], function: str) -> None:
    """Compare the request with the manifest; write it if there is none or cases are added."""
    asked = _manifest(cases, function)
    file = path / MANIFEST_FILE
    if file.is_file():
        held = _read_manifest(path)
        for key in ("toolkit", "function"):
            if held[key] != asked[key]:
                raise _conflict(path, _compared(key, held[key], asked[key]))
        missing = [x for x in held["cases"] if x[0] not in {y[0] for y in asked["cases"]}]
        if missing:
            with _refusing(file):
                differing = _differing(held, missing, asked)
            raise _conflict(path, differing)
        if held["cases"] == asked["cases"]:
            return
    with replacing(file) as temporary:
        temporary.write_text(json.dumps(asked), encoding="utf-8")


def _manifest(cases: Sequence[Case], function: str) -> dict[str, Any]:
    """Return the request as JSON."""
    texts = [canonical(dict(case.settings)) for case in cases]
    index = {text: i for i, text in enumerate(dict.fromkeys(texts))}
    return {
        "schema": STUDY_SCHEMA,
        "toolkit": __version__,
        "function": function,
        "fields": ["case", *_AXES, "settings"],
        "settings": [json.loads(text) for text in index],
        "cases": [
            [case.identity, *(getattr(case, name) for name in CASE_COLUMNS), case.seed, index[text]]
            for case, text in zip(cases, texts, strict=True)
        ],
    }


def _read_manifest(path: Path) -> dict[str, Any]:
    """Read the cases that a study was asked for."""
    file = path / MANIFEST_FILE
    kinds = {"toolkit": str, "function": str, "settings": list, "cases": list}
    try:
        manifest = json_record(file, STUDY_SCHEMA, kinds)
    except FileNotFoundError as error:
        raise MissingFile(file, "this is no folder of a study") from error
    with _refusing(file):
        for entry in manifest["cases"]:
            if [type(value) for value in entry] != _ENTRY_KINDS:
                raise ValueError("a case is no list of texts, seed and number of its settings")
            if type(manifest["settings"][entry[-1]]) is not dict:
                raise ValueError("the settings of a case are no object")
    return manifest


@contextmanager
def _refusing(file: Path) -> Iterator[None]:
    """Name a manifest in whatever is wrong with its cases."""
    try:
        with refusing(file, "the cases of a study"):
            yield
    except InvalidField as error:
        raise InvalidFile(file, [str(error)]) from error


def _utf8(file: Path) -> str:
    return file.read_text(encoding="utf-8")


def json_record(
    file: Path, schema: str, kinds: Mapping[str, type], *, read: Callable[[Path], str] = _utf8
) -> dict[str, Any]:
    """Read a JSON object of a schema.

    Args:
        file: The file.
        schema: Value that its field ``schema`` must have.
        kinds: Fields that it must have, texts or lists.
        read: Reads its text.

    Raises:
        InvalidFile: It is no JSON, of another schema, or lacks a field.
    """
    try:
        record = json.loads(read(file))
    except (ValueError, RecursionError) as error:
        raise InvalidFile(file, [f"this is no JSON: {error}"]) from error
    held = record.get("schema") if isinstance(record, dict) else None
    if held != schema:
        raise InvalidFile(file, [f"schema: got {_shown(held)}; allowed: {schema!r}"])
    faults = [
        f"{name}: got {_shown(record.get(name))}; allowed: a {'text' if kind is str else 'list'}"
        for name, kind in kinds.items()
        if not isinstance(record.get(name), kind)
    ]
    if faults:
        raise InvalidFile(file, faults)
    return dict(record)


def _shown(value: Any) -> str:
    """Return a value of JSON for a message."""
    return type(value).__name__ if isinstance(value, list | dict) else repr(value)[:80]


def _conflict(path: Path, differing: str) -> StudyConflict:
    """Return the error of a folder that holds something else."""
    return StudyConflict(
        f"{path} holds another study: {differing}. Use another folder, or remove this one"
    )


def _compared(name: str, held: str, asked: str) -> str:
    """Tell two values apart; long ones are cut."""
    there, here = (
        f"{value[:VALUE_SHOWN]}..." if len(value) > VALUE_SHOWN else value
        for value in (held, asked)
    )
    return f"{name}: {there} there, {here} here"


def _settings(manifest: dict[str, Any], entries: list[list[Any]]) -> set[tuple[str, str]]:
    """Return the settings of some cases: name, dotted where it is nested, and value."""

    def leaves(settings: Mapping[str, Any], above: str = "") -> Iterator[tuple[str, str]]:
        for name, value in settings.items():
            if isinstance(value, dict):
                yield from leaves(value, f"{above}{name}.")
            else:
                yield f"{above}{name}", json.dumps(value)

    used = {entry[-1] for entry in entries}
    return {leaf for index in used for leaf in leaves(manifest["settings"][index])}


def _differing(held: dict[str, Any], missing: list[list[Any]], asked: dict[str, Any]) -> str:
    """Name what cases of the held study have and the request has not: names and settings.

    Where they have nothing of their own, settings that only the request has are named.
    """
    texts = []
    for i, axis in enumerate(_AXES, start=1):
        here = {entry[i] for entry in asked["cases"]}
        gone = [str(x) for x in dict.fromkeys(entry[i] for entry in missing) if x not in here]
        more = f" and {len(gone) - NAMES_SHOWN} more" if len(gone) > NAMES_SHOWN else ""
        verb = "is" if len(gone) == 1 else "are"
        if gone:
            names = f"{', '.join(gone[:NAMES_SHOWN])}{more}"
            texts.append(f"{_AXIS_WORDS.get(axis, f'{axis}s')}: {names} {verb} missing here")
    there, here = _settings(held, missing), _settings(asked, asked["cases"])
    differing = there - here
    if not texts and not differing:
        differing = here - there
    for name in sorted({name for name, _ in differing}):
        values = [
            " or ".join(sorted(value for other, value in side if other == name)) or "none"
            for side in (there, here)
        ]
        if name in _DIGEST_WORDS:
            texts.append(f"the {_DIGEST_WORDS[name]} has changed")
        else:
            texts.append(_compared(name, *values))
    verb = "is" if len(missing) == 1 else "are"
    return "; ".join(texts) or f"{len(missing)} of its cases {verb} missing here"
