"""Compile every Warp kernel once, so that tests that run at the same time all find them cached.

Run it as ``python -m tests.warm_kernels``.
"""

from __future__ import annotations

import time
from importlib import import_module
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("carosac_toolkit", "learned", "sim_warp")


def kernel_modules() -> list[str]:
    """Names of the modules that define kernels; those with Warp functions alone are left out."""
    files = sorted(path for package in PACKAGES for path in (ROOT / package).rglob("*_kernels.py"))
    return [
        ".".join(path.relative_to(ROOT).with_suffix("").parts)
        for path in files
        if "@wp.kernel" in path.read_text(encoding="utf-8")
    ]


def main() -> None:
    """Load them all for the CPU and say how long it took."""
    from carosac_toolkit.physics import warp_setup

    start = time.perf_counter()
    names = kernel_modules()
    for name in names:
        warp_setup.load(import_module(name))
    print(f"{len(names)} kernel modules ready after {time.perf_counter() - start:.1f} s")


if __name__ == "__main__":
    main()
