"""Optional dependencies: the extra of a distribution that brings them, and how to install it.

The metadata of the distribution, from ``pyproject.toml``, say which packages an extra brings.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import lru_cache
from importlib.metadata import PackageNotFoundError, requires
from importlib.util import find_spec

from carosac_toolkit.base.errors import CarosacError

DISTRIBUTION = "carosac-toolkit"
_IMPORT_NAMES = {"pin": "pinocchio"}  # of packages imported under another name than their own
_NAME = re.compile(r"\s*([A-Za-z0-9._-]+)")
_EXTRA = re.compile(r"\bextra\s*==\s*['\"]([^'\"]+)['\"]")


class MissingExtra(CarosacError, ImportError):
    """Something that needs packages which are not installed; the message says how to install them.

    Attributes:
        extras: Extras that bring the missing packages, sorted.
    """

    def __init__(
        self, user: str, modules: Sequence[str], extras: Sequence[str], distribution: str
    ) -> None:
        names = f"the extra{'s' if len(extras) > 1 else ''} {' and '.join(extras)}"
        names = names if extras else "more packages"  # run from sources, without metadata
        lacking = f" (not installed: {', '.join(modules)})" if modules else ""
        command = install_command(extras, distribution)
        super().__init__(f"{user} needs {names}{lacking}: {command}")
        self.extras = tuple(extras)


def with_extras(extras: Sequence[str], distribution: str = DISTRIBUTION) -> str:
    """Return a distribution with some extras as installers write it: ``name[one,two]``."""
    return f"{distribution}[{','.join(extras)}]" if extras else distribution


def install_command(extras: Sequence[str], distribution: str = DISTRIBUTION) -> str:
    """Return the command that installs a distribution with some extras."""
    return f"pip install '{with_extras(extras, distribution)}'"


def require(user: str, *modules: str) -> None:
    """Refuse to go on if modules of our extras cannot be imported; nothing is imported.

    Args:
        user: What needs them, for the message.
        modules: Top-level modules.

    Raises:
        MissingExtra: Some are not installed.
    """
    missing = [name for name in modules if not _importable(name)]
    if missing:
        raise _missing(user, missing)


def require_extras(user: str, extras: Sequence[str], distribution: str = DISTRIBUTION) -> None:
    """Refuse to go on unless all packages of some extras are installed.

    Args:
        user: What needs them, for the message.
        extras: Names of the extras.
        distribution: Distribution that offers them.

    Raises:
        MissingExtra: Some are not installed.
    """
    missing = missing_extras(extras, distribution)
    if missing:
        brought = {x for extra in missing for x in _modules_by_extra(distribution)[extra]}
        lacking = {x for extra in missing for x in _lacking(extra, distribution)}
        told = [] if lacking == brought else sorted(lacking)  # of an extra that is there in part
        raise MissingExtra(user, told, missing, distribution)


def missing_extras(extras: Sequence[str], distribution: str = DISTRIBUTION) -> tuple[str, ...]:
    """Return those of some extras of which a package is not installed, sorted."""
    return tuple(sorted(extra for extra in extras if _lacking(extra, distribution)))


@contextmanager
def naming_extras(user: str) -> Iterator[None]:
    """Turn a failed import of a package of our extras into `MissingExtra`.

    Args:
        user: What the block does, for the message.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        module = (error.name or "").partition(".")[0]
        if not _extras_of(module):
            raise
        raise _missing(user, [module]) from error


def _missing(user: str, modules: Sequence[str]) -> MissingExtra:
    """Return the error for missing modules of our extras."""
    extras = sorted({extra for name in modules for extra in _extras_of(name)[:1]})
    return MissingExtra(user, modules, extras, DISTRIBUTION)


def _lacking(extra: str, distribution: str) -> list[str]:
    """Return the modules of an extra that cannot be imported."""
    modules = _modules_by_extra(distribution).get(extra, ())
    return [name for name in modules if not _importable(name)]


def _importable(module: str) -> bool:
    """Return whether a top-level module is there, without importing it."""
    return find_spec(module) is not None


def _extras_of(module: str) -> list[str]:
    """Return our extras that bring a module, that which brings the fewest modules first."""
    brought = _modules_by_extra(DISTRIBUTION)
    return sorted(
        (extra for extra, modules in brought.items() if module in modules),
        key=lambda extra: (len(brought[extra]), extra),
    )


@lru_cache(maxsize=8)
def _modules_by_extra(distribution: str) -> dict[str, tuple[str, ...]]:
    """Return the top-level modules that each extra of a distribution brings, from its metadata."""
    try:
        requirements = requires(distribution) or []
    except PackageNotFoundError:  # imported from its sources: it has no extras then
        requirements = []
    modules: dict[str, set[str]] = {}
    for line in requirements:
        wanted, _, marker = line.partition(";")
        name, extra = _NAME.match(wanted), _EXTRA.search(marker)
        if name is not None and extra is not None:
            package = re.sub(r"[-_.]+", "-", name[1]).lower()
            module = _IMPORT_NAMES.get(package, package.replace("-", "_"))
            modules.setdefault(extra[1], set()).add(module)
    return {extra: tuple(sorted(names)) for extra, names in modules.items()}
