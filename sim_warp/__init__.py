"""The Warp cable simulator: many worlds, cables of particles or catenaries, winches, sensors.

Each of the names below is imported when it is first used, so that ``import sim_warp`` stays light.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sim_warp.driver import SimDriver, SimDriverSettings, SimPlant
    from sim_warp.estimator import SimulationRecord, SimulatorEstimator, SimulatorSettings
    from sim_warp.simulator import Simulator
    from sim_warp.snapshot import Snapshot
    from sim_warp.state import SimulatorState

__carosac__ = True  # marks this package as ours: the name is not unique

_MODULE_OF = {
    "SimDriver": "driver",
    "SimDriverSettings": "driver",
    "SimPlant": "driver",
    "SimulationRecord": "estimator",
    "Simulator": "simulator",
    "SimulatorEstimator": "estimator",
    "SimulatorSettings": "estimator",
    "SimulatorState": "state",
    "Snapshot": "snapshot",
}

__all__ = [
    "SimDriver",
    "SimDriverSettings",
    "SimPlant",
    "SimulationRecord",
    "Simulator",
    "SimulatorEstimator",
    "SimulatorSettings",
    "SimulatorState",
    "Snapshot",
]

if not TYPE_CHECKING:  # a type checker shall know the names above and no others

    def __getattr__(name: str) -> Any:
        """Import a public class at its first use."""
        if name in _MODULE_OF:
            return getattr(import_module(f"{__name__}.{_MODULE_OF[name]}"), name)
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
