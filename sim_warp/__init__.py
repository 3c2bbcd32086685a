"""The Warp cable simulator: many worlds, cables of particles or catenaries, winches, sensors.

Each of the names below is imported when it is first used, so that ``import sim_warp`` stays light.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from carosac_toolkit.base.lazy import lazy_names

if TYPE_CHECKING:
    from sim_warp.driver import SimDriver, SimDriverSettings, SimPlant
    from sim_warp.estimator import SimulationRecord, SimulatorEstimator, SimulatorSettings
    from sim_warp.simulator import Simulator
    from sim_warp.snapshot import Snapshot
    from sim_warp.state import SimulatorState

__carosac__ = True  # marks this package as ours: the name is not unique

_MODULES = {
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

__getattr__, __dir__ = lazy_names(__name__, _MODULES)
