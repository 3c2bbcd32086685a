"""Functions of CasADi as machine code, kept in a cache folder from one run to the next."""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import tempfile
from importlib.metadata import version
from pathlib import Path
from typing import Any

from baselines.mpc.settings import Compiled
from carosac_toolkit.base.errors import CarosacError

COMPILER_FLAGS = ("-O1", "-fPIC", "-shared")
COMPILER_NAMES = ("cc", "gcc", "clang")
COMPILE_TIMEOUT_S = 300.0


class CompileError(CarosacError):
    """A function had to be compiled and could not."""


def cache_folder() -> Path:
    """Return where compiled code is kept: ``CAROSAC_CACHE``, else the user's cache folder."""
    own = os.environ.get("CAROSAC_CACHE")
    if own:
        return Path(own)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "carosac"


def with_machine_code(function: Any, compiled: Compiled) -> tuple[Any, str]:
    """Return a function as machine code, or as it is with the reason why it is not compiled.

    Raises:
        CompileError: It must be compiled and cannot be.
    """
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

    generator = ca.CodeGenerator("function.c")
    generator.add(function)
    generator.generate(f"{folder}{os.sep}")
    return folder / "function.c"


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
