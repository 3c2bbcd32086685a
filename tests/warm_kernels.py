"""Compile every Warp kernel once, so that tests that run at the same time all find them cached.

Run it as ``python -m tests.warm_kernels``.
"""

from __future__ import annotations

import time


def main() -> None:
    """Compile them all for the CPU and say how long it took."""
    from carosac_toolkit.physics.kernel_modules import compile_kernels

    start = time.perf_counter()
    count = compile_kernels(("learned", "sim_warp"))
    print(f"{count} kernel modules ready after {time.perf_counter() - start:.1f} s")


if __name__ == "__main__":
    main()
