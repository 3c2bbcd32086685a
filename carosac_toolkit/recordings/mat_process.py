"""Read a MATLAB file in a process of its own, which a damaged file may end.

scipy reads such files in compiled code that trusts the sizes in them: a few bytes can end a process
or take all memory. The process that reads has limits of memory and time, and returns arrays alone.
"""

from __future__ import annotations

import io
import os
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carosac_toolkit.base.errors import InvalidFile

MEMORY_MAX_BYTES = 2**30
DURATION_MAX_S = 60.0


def read_mat(path: Path) -> Mapping[str, NDArray[Any]]:
    """Return the numeric matrices of a MATLAB file by name.

    Raises:
        InvalidFile: It is no MATLAB file, or reading it takes too much memory or time.
    """
    command = [sys.executable, "-P", "-m", __name__, str(path.absolute())]
    home = Path(__file__).parents[2]  # this toolkit, wherever the caller found it
    searched = os.pathsep.join([str(home), os.environ.get("PYTHONPATH", "")]).rstrip(os.pathsep)
    environment = os.environ | {"PYTHONPATH": searched, "OPENBLAS_NUM_THREADS": "1"}
    try:
        ended = subprocess.run(
            command, capture_output=True, check=False, timeout=DURATION_MAX_S, env=environment
        )
    except subprocess.TimeoutExpired as error:
        raise InvalidFile(path, [f"not read within {DURATION_MAX_S:g} s"]) from error
    if ended.returncode != 0:
        lines = ended.stderr.decode(errors="replace").strip().splitlines()
        reason = lines[-1] if ended.returncode == 1 and lines else "it ends the process that reads"
        raise InvalidFile(path, [f"this is no whole MATLAB file of version 4 to 7.2: {reason}"])
    with np.load(io.BytesIO(ended.stdout), allow_pickle=False) as arrays:
        return {name: arrays[name] for name in arrays.files}


def main(path: str) -> None:
    """Write the numeric matrices of a file to standard output, as `numpy.savez` does."""
    from scipy.io import loadmat

    _limit_memory()
    contents: dict[str, Any] = loadmat(path)
    matrices = {
        name: value
        for name, value in contents.items()
        if isinstance(value, np.ndarray) and value.dtype.kind in "fiu" and value.ndim == 2
    }
    stream = io.BytesIO()
    np.savez(stream, allow_pickle=False, **matrices)
    sys.stdout.buffer.write(stream.getvalue())


def _limit_memory() -> None:
    """Limit what this process may take beyond what it has, where the system can; no core dump."""
    try:
        import resource
    except ImportError:  # Windows
        return
    pages = int(Path("/proc/self/statm").read_text().split()[0]) if sys.platform == "linux" else 0
    limit = pages * resource.getpagesize() + MEMORY_MAX_BYTES
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


if __name__ == "__main__":
    main(sys.argv[1])
