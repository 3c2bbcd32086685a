"""Optional dependencies: the extra of a distribution that brings them, and how to install it.

The metadata of the distribution, from ``pyproject.toml``, say which packages an extra brings.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import lru_cache
from importlib.metadata import Distribution, PackageNotFoundError
from importlib.util import find_spec

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from carosac_toolkit.base.errors import CarosacError

DISTRIBUTION = "carosac-toolkit"
_PACKAGES_BY_MODULE = {"pinocchio": "pin"}  # modules of our extras with another name


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
        brought = {x for extra in missing for x in _packages(extra, distribution)}
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
    """Return the packages of an extra that are not installed."""
    return [name for name in _packages(extra, distribution) if _metadata(name) is None]


def _importable(module: str) -> bool:
    """Return whether a top-level module is there, without importing it."""
    return find_spec(module) is not None


def _extras_of(module: str) -> list[str]:
    """Return our extras that bring a module, that which brings the fewest packages first."""
    package = _PACKAGES_BY_MODULE.get(module, canonicalize_name(module))
    ours = _metadata(DISTRIBUTION)  # None if imported from its sources: it has no extras then
    extras = ours.metadata.get_all("Provides-Extra") or [] if ours is not None else []
    brought = {extra: _packages(extra, DISTRIBUTION) for extra in extras}
    return sorted(
        (extra for extra, packages in brought.items() if package in packages),
        key=lambda extra: (len(brought[extra]), extra),
    )


def _packages(
    extra: str, distribution: str, seen: frozenset[tuple[str, str]] = frozenset()
) -> tuple[str, ...]:
    """Return the packages that an extra brings on this machine, also through further extras."""
    seen |= {(extra, distribution)}
    packages: set[str] = set()
    for requirement in _requirements(distribution):
        marker = requirement.marker
        if marker is None or marker.evaluate({"extra": ""}):
            continue  # belongs to no extra
        if not marker.evaluate({"extra": extra}):
            continue
        name = canonicalize_name(requirement.name)
        packages.add(name)
        for further in requirement.extras:
            if (further, name) not in seen:
                packages.update(_packages(further, name, seen))
    return tuple(sorted(packages))


@lru_cache(maxsize=8)
def _requirements(distribution: str) -> tuple[Requirement, ...]:
    """Return all requirements of a distribution, none if it is not installed."""
    found = _metadata(distribution)
    return tuple(map(Requirement, (found.requires or []) if found is not None else []))


def _metadata(name: str) -> Distribution | None:
    """Return an installed distribution, or None."""
    try:
        return Distribution.from_name(name)
    except PackageNotFoundError:
        return None
