"""Compilation of all kernels at once, before several processes need them."""

from __future__ import annotations

from collections.abc import Collection
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

from carosac_toolkit.physics import warp_setup

TOOLKIT = "carosac_toolkit"


def kernel_modules(packages: Collection[str] = ()) -> list[str]:
    """Return the names of all modules that define kernels, not those of Warp functions alone.

    Args:
        packages: Top-level packages to search besides the toolkit itself.
    """
    names = []
    for package in sorted({TOOLKIT, *packages}):
        spec = find_spec(package)
        for folder in (spec.submodule_search_locations or []) if spec is not None else []:
            top = Path(folder).parent
            for path in sorted(Path(folder).rglob("*_kernels.py")):
                if "@wp.kernel" in path.read_text(encoding="utf-8"):
                    names.append(".".join(path.relative_to(top).with_suffix("").parts))
    return names


def compile_kernels(packages: Collection[str] = (), device: str = "cpu") -> int:
    """Compile all kernels that are not in Warp's cache yet; return how many modules there are.

    Processes started afterwards do not tell the user that they compile.

    Args:
        packages: Top-level packages with kernels besides the toolkit itself.
        device: Warp device name.
    """
    names = kernel_modules(packages)
    for name in names:
        warp_setup.load(import_module(name), device)
    warp_setup.silence_children(device)
    return len(names)
