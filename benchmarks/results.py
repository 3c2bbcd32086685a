"""Write measured tables into RESULTS.md, each with its machine and date."""

from __future__ import annotations

import os
import platform
from collections.abc import Sequence
from datetime import date
from importlib.metadata import version
from pathlib import Path

RESULTS = Path(__file__).parent / "RESULTS.md"


def machine() -> str:
    """Processor, cores in use, Python and Warp, in one line."""
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
    """A Markdown table."""
    lines = ["| " + " | ".join(header) + " |", "|" + "---|" * len(header)]
    return "\n".join(lines + ["| " + " | ".join(row) + " |" for row in rows])


def write_section(key: str, title: str, command: str, body: str) -> None:
    """Replace the section between its two markers, or append it."""
    begin, end = f"<!-- {key} -->", f"<!-- end {key} -->"
    text = RESULTS.read_text() if RESULTS.is_file() else "# Results\n"
    stamp = f"`{command}`, {date.today().isoformat()}, {machine()}."
    section = f"{begin}\n## {title}\n\n{stamp}\n\n{body}\n{end}"
    if begin in text:
        head, rest = text.split(begin, 1)
        text = head + section + rest.split(end, 1)[1]
    else:
        text = text.rstrip() + "\n\n" + section + "\n"
    temporary = RESULTS.with_suffix(".tmp")
    temporary.write_text(text)
    temporary.replace(RESULTS)
