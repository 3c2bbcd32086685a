"""Virtual environments with the packages of some extras alone, borrowed from this environment.

Nothing is downloaded: what a package index would install is linked. With
``python -m tests.lean_environment FOLDER`` `.ci/run` links the dependencies of the base.
"""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Iterable
from importlib.metadata import Distribution, distribution
from pathlib import Path

from packaging.requirements import Requirement

ROOT = Path(__file__).resolve().parents[1]
TOOLKIT = "carosac-toolkit"


def needed(name: str, extras: Iterable[str]) -> dict[str, Distribution]:
    """Return distributions by name: the named one with some extras, and all that it needs."""
    done: dict[tuple[str, str], Distribution] = {}
    todo = [(_plain(name), extra) for extra in ("", *extras)]
    while todo:
        key = todo.pop()
        if key in done:
            continue
        done[key] = distribution(key[0])
        for line in done[key].requires or []:
            requirement = Requirement(line)
            if requirement.marker is None or requirement.marker.evaluate({"extra": key[1]}):
                todo += [(_plain(requirement.name), x) for x in ("", *requirement.extras)]
    return {name: found for (name, _), found in done.items()}


def link_packages(folder: Path, extras: Iterable[str] = (), *, toolkit: bool = False) -> None:
    """Link the packages that the toolkit needs with some extras into a folder.

    Args:
        folder: New folder, for the path of imports.
        extras: Extras of the toolkit.
        toolkit: Link the metadata of the toolkit as well, which name its plug-ins.
    """
    folder.mkdir(parents=True)
    for name, found in needed(TOOLKIT, extras).items():
        parts = {file.parts[0] for file in found.files or []} - {"..", "__pycache__"}
        if name == TOOLKIT:
            parts = {part for part in parts if toolkit and part.endswith(".dist-info")}
        for part in parts:
            link = folder / part
            if not link.exists():
                link.symlink_to(Path(str(found.locate_file(part))).resolve())


def make_environment(folder: Path, extras: Iterable[str] = ()) -> Path:
    """Make an environment with this checkout and what it needs with some extras.

    Returns:
        Its interpreter.
    """
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", folder], check=True)
    packages = folder / "packages"
    link_packages(packages, extras, toolkit=True)
    (site,) = folder.glob("lib/python*/site-packages")
    with_theirs = f"import site; site.addsitedir({str(packages)!r})"  # .pth files of packages too
    (site / "lean.pth").write_text(f"{ROOT}\n{with_theirs}\n")
    return folder / "bin" / "python"


def _plain(name: str) -> str:
    """Return a distribution's name as indexes compare it."""
    return re.sub(r"[-_.]+", "-", name).lower()


if __name__ == "__main__":
    link_packages(Path(sys.argv[1]))
