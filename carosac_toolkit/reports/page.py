"""Reports: one self-contained HTML page and its pictures, in a folder, written atomically."""

from __future__ import annotations

import base64
import os
import platform
import shlex
import shutil
import subprocess
import tempfile
from collections.abc import Collection, Iterable, Mapping, Sequence
from datetime import UTC, datetime
from html import escape
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.base.tables import Rows
from carosac_toolkit.base.version import __version__

REPORTED_LIBRARIES = ("numpy", "warp-lang", "scipy", "casadi", "osqp")
_PAGE_STYLE = """
body{font:15px/1.5 system-ui,sans-serif;color:#202020;max-width:1180px;margin:2em auto;
padding:0 1em}
h1{font-size:1.5em}h2{font-size:1.15em;margin-top:2em}
.wide{overflow-x:auto}table{border-collapse:collapse;font-size:13px}
th,td{padding:3px 8px;text-align:right;border-bottom:1px solid #e2e2e2;white-space:nowrap}
th{border-bottom:2px solid #888}td:first-child,th:first-child{text-align:left}
td.t,th.t{text-align:left}tr.m td{border-top:1px solid #888}
dl{display:grid;grid-template-columns:max-content 1fr;gap:2px 16px}dt{color:#666}dd{margin:0}
figure{margin:1.5em 0}img{max-width:100%}figcaption{color:#555;font-size:14px}
.warning{border-left:4px solid #c0392b;background:#fbeceb;padding:6px 12px;font-weight:600}
pre{background:#f3f3f3;padding:10px;white-space:pre-wrap}"""


def check_folder(option: str, folder: Path) -> None:
    """Refuse an output folder that cannot be written or made, before any work is done.

    Raises:
        InvalidField: It or a folder above it is a file, or is read-only.
    """
    if folder.exists() and not folder.is_dir():
        raise InvalidField(option, f"'{folder}'", "a folder, not a file")
    above = existing(folder)
    if not above.is_dir():
        raise InvalidField(option, f"'{folder}'", f"a folder below a folder; {above} is a file")
    if not os.access(above, os.W_OK | os.X_OK):
        raise InvalidField(option, f"'{folder}'", f"a writable folder; {above} is not")


def existing(folder: Path) -> Path:
    """Return the folder itself or its nearest parent that exists."""
    while not folder.exists() and folder != folder.parent:
        folder = folder.parent
    return folder


def write_files(folder: Path, files: Mapping[str, bytes]) -> list[Path]:
    """Write files into a folder; every file appears whole, or nothing does.

    Args:
        folder: Made if need be; files of the same names are replaced.
        files: Contents by name.

    Returns:
        Their paths, in order.

    Raises:
        InvalidField: A folder is in the way of a file.
    """
    for name in files:
        if (folder / name).is_dir():
            raise InvalidField("output", f"'{folder / name}'", f"no folder named {name} in it")
    work = Path(tempfile.mkdtemp(prefix=".carosac-", dir=existing(folder)))
    try:
        for name, content in files.items():
            (work / name).write_bytes(content)
        folder.mkdir(parents=True, exist_ok=True)
        for name in files:
            os.replace(work / name, folder / name)
    finally:
        shutil.rmtree(work, ignore_errors=True)
    return [folder / name for name in files]


def page(title: str, parts: Sequence[str]) -> str:
    """Return the whole document."""
    head = [
        '<!DOCTYPE html><html lang="en"><head><meta charset="utf-8">',
        f"<title>{escape(title)}</title><style>{_PAGE_STYLE}</style></head><body>",
        f"<h1>{escape(title)}</h1>",
    ]
    return "\n".join([*head, *parts]) + "</body></html>"


def warnings(lines: Iterable[str]) -> list[str]:
    """Format lines that must not be overlooked."""
    return [f'<p class="warning">{escape(line)}</p>' for line in lines]


def bullets(lines: Iterable[str]) -> str:
    """Format a list of sentences."""
    return "<ul>" + "".join(f"<li>{escape(line)}</li>" for line in lines) + "</ul>"


def table(
    header: tuple[str, ...], rows: Rows, *, left: int, bold: Collection[tuple[int, int]] = ()
) -> str:
    """Format an HTML table; the first columns hold text, some cells by row and column stand out."""

    def line(cells: tuple[str, ...], tag: str, row: int = -1) -> str:
        kinds = [' class="t"' if i < left else "" for i in range(len(cells))]
        shown = [f"<b>{escape(c)}</b>" if (row, i) in bold else escape(c)
                 for i, c in enumerate(cells)]  # fmt: skip
        texts = [f"<{tag}{k}>{c}</{tag}>" for k, c in zip(kinds, shown, strict=True)]
        first = ' class="m"' if tag == "td" and cells[0] else ""
        return f"<tr{first}>{''.join(texts)}</tr>"

    body = "".join(line(row, "td", k) for k, row in enumerate(rows))
    return f'<div class="wide"><table>{line(header, "th")}{body}</table></div>'


def pictures(files: Mapping[str, bytes], captions: Mapping[str, str]) -> list[str]:
    """Embed pictures, with links to their vector versions beside the page.

    Args:
        files: Contents by file name; every PNG and WebP among them is embedded.
        captions: Caption of each by the stem of its name.
    """
    names = [Path(name) for name in files]
    return [
        picture(
            files[name.name],
            captions[name.stem],
            [one.name for one in names if one.stem == name.stem and one != name],
        )
        for name in names
        if name.suffix in (".png", ".webp")
    ]


def picture(image: bytes, caption: str, others: Sequence[str] = ()) -> str:
    """Embed one picture, PNG or WebP, with links to its files in other formats beside the page."""
    text, caption = base64.b64encode(image).decode(), escape(caption)
    kind = "webp" if image[8:12] == b"WEBP" else "png"
    source = f"data:image/{kind};base64,{text}"
    links = [
        f'<a href="{escape(name)}">{escape(Path(name).suffix[1:].upper())}</a>' for name in others
    ]
    more = f" ({', '.join(links)})" if links else ""
    return (
        f'<figure><img src="{source}" alt="{caption}">'
        f"<figcaption>{caption}{more}</figcaption></figure>"
    )


def definitions(terms: Mapping[str, str]) -> str:
    """Format settings and origins as a list of terms; leave out those without a value."""
    pairs = [f"<dt>{k}</dt><dd>{escape(v)}</dd>" for k, v in terms.items() if v]
    return f"<dl>{''.join(pairs)}</dl>"


def repeat(words: Sequence[str]) -> str:
    """Format the command that reproduces this report."""
    return f"<h2>How to repeat</h2><pre>{escape(shlex.join(words))}</pre>"


def made_with() -> dict[str, str]:
    """Return version, commit and date, as terms of `definitions`."""
    return {
        "toolkit": f"carosac-toolkit {__version__}",
        "git commit": commit_of_code() or "",
        "versions": ", ".join(_versions()),
        "made": datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
    }


def _versions() -> list[str]:
    """Return the versions of Python and of the libraries that the numbers depend on."""
    versions = [f"Python {platform.python_version()}"]
    for name in REPORTED_LIBRARIES:
        try:
            versions.append(f"{name} {version(name)}")
        except PackageNotFoundError:
            continue
    return [*versions, f"{platform.system()} {platform.machine()}"]


def commit_of_code() -> str | None:
    """Return the git commit of the toolkit's own sources; None if they are not under git."""
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

    if git("ls-files", "--error-unmatch", here.name) is None:
        return None
    changed = git("status", "--porcelain", "--untracked-files=no")
    return (git("rev-parse", "--short", "HEAD") or "") + (" with changes" if changed else "")
