"""The stage function on buffers: compiled to machine code where possible, else interpreted."""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import tempfile
from functools import lru_cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from baselines.mpc import model
from baselines.mpc.settings import Compiled
from carosac_toolkit.base.errors import CarosacError

COMPILER_FLAGS = ("-O1", "-fPIC", "-shared")
COMPILER_NAMES = ("cc", "gcc", "clang")
COMPILE_TIMEOUT_S = 300.0


class CompileError(CarosacError):
    """The stage function had to be compiled and could not."""


class StageFunction:
    """`model.stage` of K stages at once, on arrays that are there already.

    Fill `state`, `tension`, `parameters`, `duration` and call it.

    Attributes:
        compiled: Whether machine code runs.
        reason: Why not, else empty.
        state: (K, 12).
        tension: [N], shape (K, n).
        parameters: (K, number of parameters).
        duration: [s], shape (K,).
        after: State at the end of the stage, shape (K, 12).
        by_state: d after / d state, shape (K, 12, 12).
        by_tension: d after / d tension, shape (K, 12, n).
        path: [length; rate; acceleration] at its start, shape (K, 3 n).
        path_by_state: (K, 3 n, 12).
        path_by_tension: (K, 3 n, n).
    """

    def __init__(self, n: int, stages: int, compiled: Compiled = "auto") -> None:
        """Make one.

        Args:
            n: Cables.
            stages: K.
            compiled: As in `MpcSettings`.

        Raises:
            CompileError: It must be compiled and cannot be.
        """
        function, self.reason = _function(n, stages, compiled)
        self.compiled = not self.reason
        size, rows = model.STATE_SIZE, model.PATH_QUANTITIES * n
        count = sum(model.parameter_names(n).values())
        self.state, self.tension = np.zeros((stages, size)), np.zeros((stages, n))
        self.parameters, self.duration = np.zeros((stages, count)), np.zeros(stages)
        shapes = [(size,), (size, size), (n, size), (rows,), (size, rows), (n, rows)]
        results = [np.zeros((stages, *shape)) for shape in shapes]
        buffer, self._evaluate = function.buffer()
        for i, array in enumerate((self.state, self.tension, self.parameters, self.duration)):
            buffer.set_arg(i, array.data)
        for i, array in enumerate(results):
            buffer.set_res(i, array.data)
        self._keep = (function, buffer)
        self.after, self.path = results[0], results[3]
        turned = (results[i].swapaxes(1, 2) for i in (1, 2, 4, 5))  # CasADi stores columns
        self.by_state, self.by_tension, self.path_by_state, self.path_by_tension = turned

    def __call__(self) -> None:
        """Evaluate all stages."""
        self._evaluate()


def cache_folder() -> Path:
    """Return where compiled code is kept: ``CAROSAC_CACHE``, else the user's cache folder."""
    own = os.environ.get("CAROSAC_CACHE")
    if own:
        return Path(own)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "carosac"


@lru_cache(maxsize=16)
def _function(n: int, stages: int, compiled: Compiled) -> tuple[Any, str]:
    """Return the function, and why it is not compiled."""
    function = model.interpreted(n, stages)
    if compiled == "never":
        return function, "setting"
    try:
        return _compiled(function), ""
    except (CompileError, OSError) as error:
        if compiled == "always":
            raise CompileError(str(error)) from error
        return function, str(error)


def _compiled(function: Any) -> Any:
    """Load the function's machine code; make it first, unless it is in the cache."""
    import casadi as ca

    compiler = next((c for c in map(shutil.which, COMPILER_NAMES) if c), None)
    if compiler is None:
        raise CompileError(f"no C compiler: none of {', '.join(COMPILER_NAMES)} is on the path")
    folder = cache_folder()
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=folder, prefix=".build-") as scratch:
        source = _source(function, Path(scratch))
        key = hashlib.sha256(source.read_bytes())
        key.update(repr((compiler, COMPILER_FLAGS, os.uname().machine, version("casadi"))).encode())
        library = folder / f"{function.name()}-{key.hexdigest()[:24]}.so"
        if not library.is_file():
            built = Path(scratch) / library.name
            _compile(compiler, source, built)
            built.replace(library)  # at once: other processes see all of it or nothing
        try:
            return ca.external(function.name(), str(library))
        except RuntimeError as error:
            library.unlink(missing_ok=True)
            raise CompileError(f"cannot load {library}: {error}") from error


def _source(function: Any, folder: Path) -> Path:
    """Write the function as C."""
    import casadi as ca

    generator = ca.CodeGenerator("stage.c")
    generator.add(function)
    generator.generate(f"{folder}{os.sep}")
    return folder / "stage.c"


def _compile(compiler: str, source: Path, library: Path) -> None:
    """Run the compiler."""
    command = [compiler, *COMPILER_FLAGS, str(source), "-o", str(library), "-lm"]
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=COMPILE_TIMEOUT_S, check=False
        )
    except subprocess.TimeoutExpired as error:
        raise CompileError(f"{compiler} took more than {COMPILE_TIMEOUT_S:.0f} s") from error
    if done.returncode:
        raise CompileError(f"{compiler} failed: {done.stderr.strip()[:500]}")
