"""Checks that no command overwrites its input or others' files, or fails to write at the end.

Works on the fields of any ``Options``: each of type `Path` is an output, a folder where its metavar
is DIR; each text that is the path of something there is an input.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator, Sequence
from dataclasses import Field, fields
from pathlib import Path
from typing import Any, NamedTuple, get_args, get_type_hints

from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.base.files import check_writable, try_folder

MARKER_FILE = ".carosac-results"  # in folders of results: the commands that wrote them, a line each
DEFAULT_FOLDER = "carosac-results"  # whatever is below it is ours
# What a command writes before its results, so that an interrupted run can be continued: pattern,
# text in it, command.
EARLY_FILES = (
    ("study.json", '"carosac-study/', "compare"),
    ("*/study.json", '"carosac-study/', "compare"),
    ("reference.json", '"carosac-reference/', "compare"),
    ("settings.json", "td3", "train"),
    ("*/settings.json", "td3", "train"),
    ("*/*/settings.json", "td3", "train"),
    ("settings.json", '"demonstrations"', "distill"),
)
MAY_JOIN = {"figures": "compare"}  # commands whose files lie beside those of another
NAMES_SHOWN = 3


class _Named(NamedTuple):
    """Path and the option or argument that named it."""

    option: str
    path: Path
    folder: bool = False


def check_outputs(options: Any, command: str = "") -> None:
    """Check every output of a command before it does anything.

    Args:
        options: Instance of the command's ``Options``.
        command: Its name, whose earlier results may be continued or replaced.

    Raises:
        InvalidField: An output is an input, is given twice, or cannot be written.
    """
    hints = get_type_hints(type(options), include_extras=True)
    outputs = _all_outputs(options, hints)
    inputs = [named for f in fields(options) for named in _inputs(f, hints[f.name], options)]
    for k, output in enumerate(outputs):
        _check_clash(output, inputs, outputs[:k])
        if output.folder:
            _check_folder(output, command)
        else:
            check_writable(output.option, output.path)


def mark_outputs(options: Any, command: str) -> None:
    """Leave a note in the output folders of a command that ran, by which it knows them again."""
    hints = get_type_hints(type(options), include_extras=True)
    for output in _all_outputs(options, hints):
        if output.folder and output.path.is_dir():
            names = sorted({*_marked(output.path), command})
            with contextlib.suppress(OSError):  # the results are there; only the note is missing
                (output.path / MARKER_FILE).write_text("\n".join(names) + "\n", encoding="utf-8")


def _check_clash(output: _Named, inputs: Sequence[_Named], earlier: Sequence[_Named]) -> None:
    """Refuse an output that is read as well, or written twice."""
    uses = [(other, "read from") for other in inputs] + [(other, "written to") for other in earlier]
    for other, use in uses:
        if same_file(output.path, other.path):
            allowed = f"another path; {other.option} is {use} this one"
            raise InvalidField(output.option, f"'{output.path}'", allowed)


def _check_folder(output: _Named, command: str) -> None:
    """Refuse an output folder that cannot be made or written."""
    existing = output.path
    while not os.path.lexists(existing) and existing != existing.parent:
        existing = existing.parent
    if not os.path.isdir(existing):
        allowed = f"a folder; {existing} is a file" if os.path.exists(existing) else "a folder"
        raise InvalidField(output.option, f"'{output.path}'", allowed)
    try_folder(output.option, output.path, existing)
    _check_own(output, command)


def _check_own(output: _Named, command: str) -> None:
    """Refuse a folder with files of somebody else, or with results of another command only."""
    try:
        held = sorted(x.name for x in os.scandir(output.path) if not x.name.startswith("."))
    except OSError:  # not there yet
        return
    commands = _commands_of(output.path)
    if not held or command in commands or MAY_JOIN.get(command) in commands:
        return
    if DEFAULT_FOLDER in output.path.resolve().parts[:-1]:
        return
    more = f" and {len(held) - NAMES_SHOWN} more" if len(held) > NAMES_SHOWN else ""
    holds = f"{', '.join(held[:NAMES_SHOWN])}{more}"
    if commands:
        holds = f"results of carosac {' and '.join(sorted(commands))}"
    own = f"carosac {command}" if command else "this command"
    allowed = f"a new or empty folder, or one with results of {own}; this one holds {holds}"
    raise InvalidField(output.option, f"'{output.path}'", allowed)


def _commands_of(folder: Path) -> set[str]:
    """Return the commands that have written results into a folder."""
    found = _marked(folder)
    for pattern, text, command in EARLY_FILES:
        for path in folder.glob(pattern):
            with contextlib.suppress(OSError):
                if text in path.read_text(encoding="utf-8", errors="replace"):
                    found.add(command)
    return found


def _marked(folder: Path) -> set[str]:
    """Return the commands in the note of a folder."""
    try:
        return set((folder / MARKER_FILE).read_text(encoding="utf-8").split("\n")) - {""}
    except (OSError, UnicodeDecodeError):
        return set()


def same_file(one: Path, other: Path) -> bool:
    """Return whether two paths lead to one place, through links, existing or not."""
    try:
        return os.path.samefile(one, other)
    except OSError:
        return os.path.realpath(one) == os.path.realpath(other)


def _all_outputs(options: Any, hints: dict[str, Any]) -> list[_Named]:
    """Return the outputs that all fields hold."""
    return [named for f in fields(options) for named in _outputs(f, hints[f.name], options)]


def _outputs(field: Field[Any], hint: Any, options: Any) -> Iterator[_Named]:
    """Yield the output that a field holds."""
    value = getattr(options, field.name)
    if isinstance(value, Path):
        folder = any(getattr(part, "metavar", None) == "DIR" for part in get_args(hint))
        yield _Named(_spelling(field, hint), value, folder)


def _inputs(field: Field[Any], hint: Any, options: Any) -> Iterator[_Named]:
    """Yield the existing inputs that a field holds; bundled names are skipped."""
    value = getattr(options, field.name)
    for text in value if isinstance(value, list | tuple) else [value]:
        if isinstance(text, str) and os.path.exists(text):
            yield _Named(_spelling(field, hint), Path(text))


def _spelling(field: Field[Any], hint: Any) -> str:
    """Return the option as users write it; a positional argument by its metavar."""
    from tyro.conf import Positional

    marker = get_args(Positional[int])[1]
    if marker in get_args(hint):
        metavars = [getattr(part, "metavar", None) for part in get_args(hint)]
        return next((name for name in metavars if name), field.name.upper())
    return "--" + field.name.replace("_", "-")
