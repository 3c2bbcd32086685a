"""A validation as a folder: pictures, and one report.html that needs nothing else."""

from __future__ import annotations

import base64
import os
import shlex
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from html import escape
from pathlib import Path

from carosac_toolkit import __version__
from carosac_toolkit.errors import InvalidField
from carosac_toolkit.recordings.metadata import RecordingMetadata
from carosac_toolkit.validation.phases import REST_DURATION, REST_SPEED
from carosac_toolkit.validation.result import ValidationResult
from carosac_toolkit.validation.tables import (
    CAUSE_HEADER,
    PART_HEADER,
    PART_UNITS,
    Rows,
    cause_rows,
    part_rows,
)

DPI = 110
CAPTIONS = {
    "paths": "Path of the platform origin: measured and modelled.",
    "error_violins": "Distribution of the absolute position error per axis and in norm.",
    "time_series": "Position and error over time; grey: the winches rest.",
    "length_errors": "Measured cable lengths less those that each model predicts at the measured "
    "pose: straight cables for a model without tensions, hanging and stretched ones otherwise.",
}
_STYLE = """
body{font:15px/1.5 system-ui,sans-serif;color:#202020;max-width:1180px;margin:2em auto;
padding:0 1em}
h1{font-size:1.5em}h2{font-size:1.15em;margin-top:2em}
.wide{overflow-x:auto}table{border-collapse:collapse;font-size:13px}
th,td{padding:3px 8px;text-align:right;border-bottom:1px solid #e2e2e2;white-space:nowrap}
th{border-bottom:2px solid #888}td:first-child,th:first-child{text-align:left}
td.t,th.t{text-align:left}tr.m td{border-top:1px solid #888}
dl{display:grid;grid-template-columns:max-content 1fr;gap:2px 16px}dt{color:#666}dd{margin:0}
figure{margin:1.5em 0}img{max-width:100%}figcaption{color:#555;font-size:14px}
pre{background:#f3f3f3;padding:10px;white-space:pre-wrap}"""


@dataclass(frozen=True, kw_only=True)
class Context:
    """Where a result comes from.

    Attributes:
        recording: Name or path of the recording, as it was given.
        metadata: What it says about itself.
        words: The command that repeats the validation.
    """

    recording: str
    metadata: RecordingMetadata
    words: list[str]


def check_folder(option: str, folder: Path) -> None:
    """Refuse an output folder that cannot be written or made, before any work is done.

    Raises:
        InvalidField: It or a folder above it is a file, or is read-only.
    """
    if folder.exists() and not folder.is_dir():
        raise InvalidField(option, f"'{folder}'", "a folder, not a file")
    existing = _existing(folder)
    if not existing.is_dir():
        raise InvalidField(option, f"'{folder}'", f"a folder below a folder; {existing} is a file")
    if not os.access(existing, os.W_OK | os.X_OK):
        allowed = f"a folder that can be written; {existing} cannot"
        raise InvalidField(option, f"'{folder}'", allowed)


def write_report(
    folder: Path, result: ValidationResult, said: list[str], context: Context
) -> list[Path]:
    """Draw the pictures and write the report; every file appears whole, or nothing does.

    Args:
        folder: Made if need be; files of an earlier report in it are replaced.
        result: What was found.
        said: Sentences on it.
        context: Where it comes from.

    Returns:
        The files, the report last.
    """
    from carosac_toolkit.pictures.validation import PICTURES

    work = Path(tempfile.mkdtemp(prefix=".carosac-", dir=_existing(folder)))
    try:
        images = {}
        for name, draw in PICTURES.items() if _any_scored(result) else ():
            picture = work / f"{name}.png"
            draw(result).savefig(picture, dpi=DPI)
            images[name] = picture.read_bytes()
        (work / "report.html").write_text(_html(result, said, context, images), encoding="utf-8")
        folder.mkdir(parents=True, exist_ok=True)
        names = [*(f"{name}.png" for name in images), "report.html"]
        for name in names:
            os.replace(work / name, folder / name)
    finally:
        shutil.rmtree(work, ignore_errors=True)
    return [folder / name for name in names]


def _existing(folder: Path) -> Path:
    """The folder itself or the nearest one above it that exists."""
    while not folder.exists() and folder != folder.parent:
        folder = folder.parent
    return folder


def _any_scored(result: ValidationResult) -> bool:
    return any(model.scores is not None for model in result.models.values())


def _html(
    result: ValidationResult, said: list[str], context: Context, images: dict[str, bytes]
) -> str:
    """The whole document."""
    title = f"Validation of {', '.join(result.models)} on {Path(context.recording).name}"
    parts = [
        '<!DOCTYPE html><html lang="en"><head><meta charset="utf-8">',
        f"<title>{escape(title)}</title><style>{_STYLE}</style></head><body>",
        f"<h1>{escape(title)}</h1>",
        "<ul>" + "".join(f"<li>{escape(line)}</li>" for line in said) + "</ul>",
        f"<h2>Errors</h2><p>{PART_UNITS}. Error is model minus measured, in world frame W. At rest "
        f"means that no cable length changes faster than {REST_SPEED * 1e3:g} mm/s for at least "
        f"{REST_DURATION:g} s; the platform may still sway.</p>",
        _table(PART_HEADER, part_rows(result), left=2),
        "<h2>What may explain them</h2><p>Delay: least squares of the error in motion on the "
        "measured velocity; positive means that poses are late against the lengths. Sway: the "
        "frequency that fits the error at rest best, on the axis that swings most.</p>",
        _table(CAUSE_HEADER, cause_rows(result), left=1),
        *(_picture(name, image) for name, image in images.items()),
        "<h2>Provenance</h2>",
        _definitions(result, context),
        f"<h2>How to repeat</h2><pre>{escape(shlex.join(context.words))}</pre></body></html>",
    ]
    return "\n".join(parts)


def _table(header: tuple[str, ...], rows: Rows, *, left: int) -> str:
    """An HTML table; the first columns hold text."""

    def line(cells: tuple[str, ...], tag: str) -> str:
        kinds = [' class="t"' if i < left else "" for i in range(len(cells))]
        texts = [f"<{tag}{k}>{escape(c)}</{tag}>" for k, c in zip(kinds, cells, strict=True)]
        first = ' class="m"' if tag == "td" and cells[0] else ""
        return f"<tr{first}>{''.join(texts)}</tr>"

    body = "".join(line(row, "td") for row in rows)
    return f'<div class="wide"><table>{line(header, "th")}{body}</table></div>'


def _picture(name: str, image: bytes) -> str:
    """One embedded picture."""
    text, caption = base64.b64encode(image).decode(), escape(CAPTIONS[name])
    source = f"data:image/png;base64,{text}"
    return (
        f'<figure><img src="{source}" alt="{caption}"><figcaption>{caption}</figcaption></figure>'
    )


def _definitions(result: ValidationResult, context: Context) -> str:
    """Settings and origins as a list of terms."""
    pairs = "".join(f"<dt>{k}</dt><dd>{escape(v)}</dd>" for k, v in _provenance(result, context))
    return f"<dl>{pairs}</dl>"


def _provenance(result: ValidationResult, context: Context) -> Iterator[tuple[str, str]]:
    """What went in; terms without a value are left out."""
    metadata, robot = context.metadata, result.robot
    terms = {
        "recording": context.recording,
        "description": metadata.description,
        "source": metadata.source,
        "licence": metadata.licence,
        "cite": metadata.citation,
        "written by": metadata.created_by,
        "samples scored": f"{result.samples} of {result.start}:{result.stop}, "
        f"{len(result.rests)} rests",
        "robot": f"{robot.name}: {robot.description}",
        "robot licence": robot.licence,
        "seed": str(result.seed),
        "models": ", ".join(result.models) + "; each with its default settings",
        "toolkit": f"carosac-toolkit {__version__}",
        "git commit": _commit() or "",
        "made": datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
    }
    return ((term, text) for term, text in terms.items() if text)


def _commit() -> str | None:
    """Git commit of the toolkit's own sources, or None where they are not under git."""
    here = Path(__file__)

    def git(*words: str) -> str | None:
        try:
            done = subprocess.run(
                ["git", "-C", str(here.parent), *words],
                capture_output=True, text=True, timeout=10, check=False,
            )  # fmt: skip
        except (OSError, subprocess.TimeoutExpired):
            return None
        return done.stdout.strip() if done.returncode == 0 else None

    if git("ls-files", "--error-unmatch", "result.py") is None:
        return None
    changed = git("status", "--porcelain", "--untracked-files=no")
    return (git("rev-parse", "--short", "HEAD") or "") + (" with changes" if changed else "")
