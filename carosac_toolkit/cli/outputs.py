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

OWN_FILES = {  # in folders of results, with a text in each that others hardly have
    "study.json": '"carosac-study/',
    "*/study.json": '"carosac-study/',
    "reference.json": '"carosac-reference/',
    "report.html": "carosac",
    "report_settings.json": "carosac",
    "scores.npz": "position",
    "estimate.parquet": "carosac",
    "smoothed.parquet": "carosac",
    "settings.json": "td3",
    "*/settings.json": "td3",
    "positions*.csv": "margin",
    "positions*.parquet": "margin",
    "[01][0-9]_*.*": "",  # figures
}
OWN_BYTES_MAX = 2**23  # [bytes] of a file that are searched
NAMES_SHOWN = 3


class _Named(NamedTuple):
    """Path and the option or argument that named it."""

    option: str
    path: Path
    folder: bool = False


def check_outputs(options: Any) -> None:
    """Check every output of a command before it does anything.

    Args:
        options: Instance of the command's ``Options``.

    Raises:
        InvalidField: An output is an input, is given twice, or cannot be written.
    """
    hints = get_type_hints(type(options), include_extras=True)
    outputs = [named for f in fields(options) for named in _outputs(f, hints[f.name], options)]
    inputs = [named for f in fields(options) for named in _inputs(f, hints[f.name], options)]
    for k, output in enumerate(outputs):
        _check_clash(output, inputs, outputs[:k])
        if output.folder:
            _check_folder(output)
        else:
            check_writable(output.option, output.path)


def _check_clash(output: _Named, inputs: Sequence[_Named], earlier: Sequence[_Named]) -> None:
    """Refuse an output that is read as well, or written twice."""
    uses = [(other, "read from") for other in inputs] + [(other, "written to") for other in earlier]
    for other, use in uses:
        if same_file(output.path, other.path):
            allowed = f"another path; {other.option} is {use} this one"
            raise InvalidField(output.option, f"'{output.path}'", allowed)


def _check_folder(output: _Named) -> None:
    """Refuse an output folder that cannot be made or written."""
    existing = output.path
    while not os.path.lexists(existing) and existing != existing.parent:
        existing = existing.parent
    if not os.path.isdir(existing):
        allowed = f"a folder; {existing} is a file" if os.path.exists(existing) else "a folder"
        raise InvalidField(output.option, f"'{output.path}'", allowed)
    try_folder(output.option, output.path, existing)
    _check_own(output)


def _check_own(output: _Named) -> None:
    """Refuse a folder with files of somebody else and no results of ours."""
    try:
        held = sorted(x.name for x in os.scandir(output.path) if not x.name.startswith("."))
    except OSError:  # not there yet
        return
    if held and not _is_ours(output.path):
        more = f" and {len(held) - NAMES_SHOWN} more" if len(held) > NAMES_SHOWN else ""
        allowed = (
            "a new or empty folder, or one with results of carosac; this one holds "
            f"{', '.join(held[:NAMES_SHOWN])}{more}"
        )
        raise InvalidField(output.option, f"'{output.path}'", allowed)


def _is_ours(folder: Path) -> bool:
    """Return whether a folder holds a file that only a command of the toolkit writes."""
    for pattern, text in OWN_FILES.items():
        for path in folder.glob(pattern):
            with contextlib.suppress(OSError), path.open("rb") as file:
                if text.encode() in file.read(OWN_BYTES_MAX):
                    return True
    return False


def same_file(one: Path, other: Path) -> bool:
    """Return whether two paths lead to one place, through links, existing or not."""
    try:
        return os.path.samefile(one, other)
    except OSError:
        return os.path.realpath(one) == os.path.realpath(other)


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
