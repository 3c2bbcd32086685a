"""The loop between driver, estimator and controller: its values, protocols and plug-ins.

``ct.loop.run`` runs it; its names are imported when they are first used.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from carosac_toolkit.loop.loop import BadPlugin, Log, ReferenceSource, Step, run

__all__ = ["BadPlugin", "Log", "ReferenceSource", "Step", "run"]


def __getattr__(name: str) -> Any:
    """Import a public name at its first use."""
    if name in __all__:
        return getattr(import_module("carosac_toolkit.loop.loop"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
