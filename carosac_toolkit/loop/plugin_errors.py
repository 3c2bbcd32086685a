"""Errors of plug-ins that the loop names: unusable results, and attempts to end the program."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from carosac_toolkit.base.errors import CarosacError


class BadPlugin(CarosacError):
    """A controller or estimator that returned something the loop cannot use, or called an exit."""


@contextmanager
def exit_refused(part: str, plugin: object) -> Iterator[None]:
    """Turn `sys.exit()` in a plug-in into an error, as its status 0 would pass for success.

    Args:
        part: Kind of plug-in, such as ``controller``.
        plugin: The plug-in or its class, named in the message.

    Raises:
        BadPlugin: The plug-in called it.
    """
    try:
        yield
    except SystemExit as error:
        name = (plugin if isinstance(plugin, type) else type(plugin)).__name__
        text = (
            f"{part} {name}: called sys.exit({error.code!r}); allowed: to return or raise an error"
        )
        raise BadPlugin(text) from error
