"""Read a MATLAB file in a process of its own, which a damaged file may end.

scipy reads such files in compiled code that trusts the sizes in them: a few bytes can end a process
or take all memory. The process that reads has limits of memory and time, and returns arrays alone.
"""

from __future__ import annotations

import math
import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import InvalidFile

MEMORY_MAX_BYTES = 2**30
COMPUTING_MAX_S = 5  # of the process, behind its start
DURATION_MAX_S = 60.0  # by the clock, with the start on a busy computer
MATRICES_BYTES_MAX = 2**29  # of all matrices that are wanted, as float64

_NAMES = "all names"  # no name of a variable


def read_mat(path: Path, names: str) -> tuple[Mapping[str, Array], list[str]]:
    """Return numeric matrices of a MATLAB file by name, and the names of all its variables.

    Args:
        path: The file.
        names: Pattern of the names that are wanted; others are not read.

    Raises:
        InvalidFile: It is no MATLAB file, or reading it takes too much memory or time.
    """
    command = [sys.executable, "-P", "-m", __name__, str(path.absolute()), names]
    home = Path(__file__).parents[2]  # this toolkit, wherever the caller found it
    searched = os.pathsep.join([str(home), os.environ.get("PYTHONPATH", "")]).rstrip(os.pathsep)
    environment = os.environ | {"PYTHONPATH": searched, "OPENBLAS_NUM_THREADS": "1"}
    with tempfile.TemporaryFile() as output:
        try:
            ended = subprocess.run(
                command, stdout=output, stderr=subprocess.PIPE, check=False,
                timeout=DURATION_MAX_S, env=environment,
            )  # fmt: skip
        except subprocess.TimeoutExpired as error:
            raise InvalidFile(path, [f"not read within {DURATION_MAX_S:g} s"]) from error
        if ended.returncode != 0:
            lines = ended.stderr.decode(errors="replace").strip().splitlines()
            said = ended.returncode == 1 and lines
            reason = lines[-1] if said else "it ends the process that reads, or takes it too long"
            raise InvalidFile(path, [f"this is no whole MATLAB file of version 4 to 7.2: {reason}"])
        output.seek(0)
        with np.load(output, allow_pickle=False) as arrays:
            matrices = {name: arrays[name] for name in arrays.files}
        return matrices, matrices.pop(_NAMES).tolist()


def main(path: str, names: str) -> None:
    """Write numeric matrices of a file to standard output, as `numpy.savez` does."""
    from scipy.io import loadmat, whosmat

    _limit()
    shapes = {name: shape for name, shape, _ in whosmat(path)}
    wanted = {name: shape for name, shape in shapes.items() if re.fullmatch(names, name)}
    size = sum(8 * math.prod(shape) for shape in wanted.values())
    if size > MATRICES_BYTES_MAX:
        allowed = f"up to {MATRICES_BYTES_MAX / 1e6:.0f} MB"
        raise SystemExit(f"its matrices would take {size / 1e6:.0f} MB; allowed: {allowed}")
    contents: dict[str, Any] = loadmat(path, variable_names=list(wanted))
    matrices = {
        name: np.asarray(contents.pop(name), dtype=np.float64)
        for name in wanted
        if isinstance(contents.get(name), np.ndarray)
        and contents[name].dtype.kind in "fiu"
        and contents[name].ndim == 2
    }
    np.savez(
        sys.stdout.buffer, allow_pickle=False, **matrices, **{_NAMES: np.array(sorted(shapes))}
    )


def _limit() -> None:
    """Limit what this process may take beyond what it has, where the system can; no core dump."""
    try:
        import resource
    except ImportError:  # Windows
        return
    pages = int(Path("/proc/self/statm").read_text().split()[0]) if sys.platform == "linux" else 0
    limit = pages * resource.getpagesize() + MEMORY_MAX_BYTES
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    seconds = math.ceil(time.process_time()) + COMPUTING_MAX_S
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


if __name__ == "__main__":
    main(*sys.argv[1:])
