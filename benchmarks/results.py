"""Write measured tables into RESULTS.md, each with its machine and date, and figures beside it."""

from __future__ import annotations

import os
import platform
from collections.abc import Sequence
from datetime import date
from importlib.metadata import version
from pathlib import Path

from benchmarks import figures
from benchmarks.figures import RESULTS


def machine() -> str:
    """Return processor, cores in use, Python and Warp, in one line."""
    model = platform.processor() or platform.machine()
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.is_file():
        names = [x for x in cpuinfo.read_text().splitlines() if x.startswith("model name")]
        model = names[0].split(":", 1)[1].strip() if names else model
    return (
        f"{model}, {os.cpu_count()} cores, Python {platform.python_version()}, "
        f"Warp {version('warp-lang')}, numpy {version('numpy')}"
    )


def table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a Markdown table."""
    lines = ["| " + " | ".join(header) + " |", "|" + "---|" * len(header)]
    return "\n".join(lines + ["| " + " | ".join(row) + " |" for row in rows])


def write_section(key: str, title: str, command: str, body: str) -> None:
    """Write a section of RESULTS.md, in place of an older one, and its figures to results.json.

    Figures of the catalogue that the section lacks, as after a run of one robot only, are printed.
    """
    begin, end = f"<!-- {key} -->", f"<!-- end {key} -->"
    text = RESULTS.read_text(encoding="utf-8") if RESULTS.is_file() else "# Results\n"
    stamp = f"`{command}`, {date.today().isoformat()}, {machine()}."
    section = f"{begin}\n## {title}\n\n{stamp}\n\n{body}\n{end}"
    if begin in text:
        head, rest = text.split(begin, 1)
        text = head + section + rest.split(end, 1)[1]
    else:
        text = text.rstrip() + "\n\n" + section + "\n"
    temporary = RESULTS.with_suffix(".tmp")
    temporary.write_text(text, encoding="utf-8")
    temporary.replace(RESULTS)
    for line in figures.refresh_values():
        print(line)
