"""The loop between driver, estimator and controller: its values, protocols and plug-ins.

``ct.loop.run`` runs it; its names are imported when they are first used.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from carosac_toolkit.base.lazy import lazy_names

if TYPE_CHECKING:
    from carosac_toolkit.loop.loop import Log, ReferenceSource, Step, run
    from carosac_toolkit.loop.plugin_errors import BadPlugin

__all__ = ["BadPlugin", "Log", "ReferenceSource", "Step", "run"]

__getattr__, __dir__ = lazy_names(__name__, dict.fromkeys(__all__, "loop"))
