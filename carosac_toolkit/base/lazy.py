"""Public names of a package that are imported when they are first used (PEP 562)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib import import_module
from types import MappingProxyType
from typing import Any

from carosac_toolkit.base.extras import naming_extras

NO_NAMES: Mapping[str, str] = MappingProxyType({})


def lazy_names(
    package: str, modules: Mapping[str, str], namespaces: Mapping[str, str] = NO_NAMES
) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """Return the functions ``__getattr__`` and ``__dir__`` of a package.

    Type checkers do not call them: the package imports the same names under `TYPE_CHECKING`.

    Args:
        package: ``__name__`` of the package.
        modules: Module of the package that defines each public name.
        namespaces: Modules of the package that are public names themselves.
    """

    def import_name(name: str) -> Any:
        if name in namespaces:
            return import_module(f"{package}.{namespaces[name]}")
        if name not in modules:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        module = f"{package}.{modules[name]}"
        try:
            with naming_extras(f"{package}.{name}"):
                return getattr(import_module(module), name)
        except AttributeError as error:  # would read as if the package had no such name
            raise ImportError(f"{module}: {error}") from error

    return import_name, lambda: sorted({*modules, *namespaces})
