"""Compilation of all kernels at once, before several processes need them."""

from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

from carosac_toolkit.physics import warp_setup

PACKAGES = ("carosac_toolkit", "sim_warp", "learned")


def kernel_modules() -> list[str]:
    """Return the names of all modules that define kernels, not those of Warp functions alone."""
    names = []
    for package in PACKAGES:
        spec = find_spec(package)
        for folder in (spec.submodule_search_locations or []) if spec is not None else []:
            top = Path(folder).parent
            for path in sorted(Path(folder).rglob("*_kernels.py")):
                if "@wp.kernel" in path.read_text(encoding="utf-8"):
                    names.append(".".join(path.relative_to(top).with_suffix("").parts))
    return names


def compile_kernels(device: str = "cpu") -> int:
    """Compile all kernels that are not in Warp's cache yet; return how many modules there are.

    Args:
        device: Warp device name.
    """
    names = kernel_modules()
    for name in names:
        warp_setup.load(import_module(name), device)
    return len(names)
