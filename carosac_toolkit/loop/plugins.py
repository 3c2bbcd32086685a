"""Plug-ins by name: controllers, estimators, drivers, links, commands and figures.

Each is an entry point of an installed distribution, in the group ``carosac.<kind>``, or is named
directly as ``module:Class``. Looking up reads metadata only; `load` imports the one asked for.
Extras in brackets after an entry point are those of its distribution that the plug-in needs.
"""

from __future__ import annotations

import os
import sys
from functools import lru_cache
from importlib import import_module
from importlib.metadata import EntryPoint, EntryPoints, entry_points
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Literal, get_args

from carosac_toolkit.base.errors import CarosacError, InvalidField, did_you_mean
from carosac_toolkit.base.extras import (
    MissingExtra,
    missing_extras,
    naming_extras,
    require_extras,
    with_extras,
)

Kind = Literal["controllers", "estimators", "drivers", "links", "commands", "figures"]

OUR_PACKAGES = ("baselines", "learned", "sim_warp", "calibration")
_PACKAGE_MARKER = "__carosac__"


def names(kind: Kind) -> list[str]:
    """Return the names of installed plug-ins of a kind, sorted, without importing them."""
    return sorted(_installed(kind))


def load(kind: Kind, name: str, *, complete: bool = True) -> Any:
    """Import one plug-in.

    Args:
        kind: ``"controllers"``, ``"estimators"``, ``"drivers"``, ``"links"``, ``"commands"`` or
            ``"figures"``.
        name: A name from `names`, or ``module:Class`` for what is not installed but importable;
            modules are looked for in the working folder as well, after all other places.
        complete: True refuses a plug-in that needs an extra which is not installed; False imports
            it to be described.

    Returns:
        The object of that name: a class, or a module for most commands and figures.

    Raises:
        InvalidField: There is no such plug-in; the message lists those there are.
        MissingExtra: It needs packages that are not installed.
        CarosacError: It is there but cannot be used: two distributions claim the name, another
            package hides one of ours, or its import fails.
    """
    if ":" in name:
        _look_in_working_folder()
        return _resolve(kind, name, EntryPoint(name, name, _group(kind)))
    installed = _installed(kind)
    if name not in installed:
        raise InvalidField(kind[:-1], repr(name), _allowed(kind, name))
    entries = installed[name]
    if len(entries) > 1:
        claims = ", ".join(sorted(f"{_owner(point)} ({point.value})" for point in entries))
        raise CarosacError(
            f"{kind[:-1]} '{name}' is claimed by several installed distributions: {claims}; "
            "uninstall one, or name yours as 'module:Class'"
        )
    if complete:
        extras, distribution = entries[0].extras, _owner(entries[0])
        require_extras(_spoken(kind, name), extras, distribution)
    return _resolve(kind, name, entries[0])


def lacking(point: EntryPoint) -> str:
    """Return what has to be installed for a plug-in, such as ``name[extra]``; empty for nothing."""
    missing = missing_extras(point.extras, _owner(point))
    return with_extras(missing, _owner(point)) if missing else ""


def name_of(plugin: str | type[Any]) -> str:
    """Return the name by which any process can `load` a plug-in: ``module:Class`` for a class.

    Args:
        plugin: A name, which is returned as it is, or a class at the top of a module; one of the
            script that runs is named after its file.

    Raises:
        InvalidField: No other process could import the class: it stands inside a function, or was
            typed into an interpreter.
    """
    if isinstance(plugin, str):
        return plugin
    if not isinstance(plugin, type):
        raise InvalidField("plug-in", repr(plugin), "a name, 'module:Class', or a class")
    qualname, module = plugin.__qualname__, plugin.__module__
    if module == "__main__":
        main = sys.modules["__main__"]
        spec, file = getattr(main, "__spec__", None), getattr(main, "__file__", None)
        module = spec.name if spec is not None else Path(file).stem if file else ""
    importable = all(part.isidentifier() for part in module.split("."))  # not so "<stdin>"
    if "<locals>" in qualname or not importable:
        allowed = "a class at the top of a module, in a file: workers import it by name"
        raise InvalidField("plug-in", qualname, allowed)
    return f"{module}:{qualname}"


def entry_points_of(group: str) -> EntryPoints:
    """Return the entry points of a group, read again only after an installation."""
    return _read(group, tuple((folder, _changed(folder)) for folder in sys.path))


def check_package(package: str) -> None:
    """Import one of our top-level packages and make sure that it is ours.

    Package indexes hold unrelated distributions that install a ``baselines`` or a ``learned``.

    Raises:
        CarosacError: Python finds another package under this name.
    """
    spec = find_spec(package)
    if spec is None:
        raise CarosacError(
            f"package '{package}' is missing: carosac-toolkit is not fully installed"
        )
    cause: ImportError | None = None
    try:
        if getattr(import_module(package), _PACKAGE_MARKER, False) is True:
            return
    except ImportError as error:  # ours imports `carosac_toolkit.base` alone
        cause = error
    where = spec.origin or ", ".join(spec.submodule_search_locations or [])
    raise CarosacError(
        f"package '{package}' at {where} does not belong to carosac-toolkit: another "
        "distribution, or a folder on the Python path, uses the same name; remove it, or "
        "install carosac-toolkit in an environment of its own"
    ) from cause


def _group(kind: Kind) -> str:
    """Return the entry-point group of a kind."""
    if kind not in get_args(Kind):
        raise InvalidField("kind", repr(kind), f"one of {list(get_args(Kind))}")
    return f"carosac.{kind}"


def _installed(kind: Kind) -> dict[str, list[EntryPoint]]:
    """Return entry points of a kind by name; more than one where distributions clash."""
    entries: dict[str, list[EntryPoint]] = {}
    for point in entry_points_of(_group(kind)):
        claims = entries.setdefault(point.name, [])
        if all(point.value != other.value for other in claims):
            claims.append(point)
    return entries


def _changed(folder: str) -> int:
    """Return when entries of a folder of the Python path last changed [ns]; 0: absent."""
    try:
        return os.stat(folder or ".").st_mtime_ns
    except OSError:
        return 0


@lru_cache(maxsize=16)
def _read(group: str, state: tuple[tuple[str, int], ...]) -> EntryPoints:
    """Read the entry points of a group, for a state of the Python path."""
    return entry_points(group=group)


def _look_in_working_folder() -> None:
    """Add the folder to the import path, as ``python -m`` does; also for workers started later."""
    here = os.getcwd()
    if here not in sys.path and "" not in sys.path:
        sys.path.append(here)


def _owner(point: EntryPoint) -> str:
    """Return the distribution of an entry point."""
    return point.dist.name if point.dist is not None else "unknown distribution"


def _spoken(kind: Kind, name: str) -> str:
    """Name a plug-in in a message; commands as the user writes them."""
    return f"{kind[:-1]} '{name.replace('.', ' ') if kind == 'commands' else name}'"


def _allowed(kind: Kind, name: str) -> str:
    """Describe the allowed names, and what those need that cannot be used."""
    installed = _installed(kind)
    ready: list[str] = []
    others: dict[str, list[str]] = {}
    for known, points in sorted(installed.items()):
        needed = lacking(points[0])
        (others.setdefault(needed, []) if needed else ready).append(known)
    more = "".join(f", with {needed} also {names}" for needed, names in others.items())
    return f"one of {ready}{more}, or 'module:Class'" + did_you_mean(name, sorted(installed))


def _resolve(kind: Kind, name: str, point: EntryPoint) -> Any:
    """Import the target of an entry point or ``module:Class``."""
    if point.pattern.match(point.value) is None:
        raise InvalidField(kind[:-1], repr(name), "a name, or 'module:Class'")
    package = point.module.partition(".")[0]
    try:
        if package in OUR_PACKAGES:
            check_package(package)
        with naming_extras(_spoken(kind, name)):
            target: Any = import_module(point.module)
        for attribute in filter(None, (point.attr or "").split(".")):
            if not hasattr(target, attribute):  # imports what a package hands on lazily
                allowed = f"a name that {point.module} defines when imported, in no 'if __name__'"
                hint = did_you_mean(attribute, dir(target))
                raise InvalidField(kind[:-1], repr(name), allowed + hint)
            target = getattr(target, attribute)
    except MissingExtra:
        raise
    except ImportError as error:
        raise CarosacError(
            f"{kind[:-1]} '{name}': cannot import {point.module}: {error}"
        ) from error
    return target
