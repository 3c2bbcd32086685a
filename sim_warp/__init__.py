"""The Warp cable simulator: many worlds, cables of particles or catenaries, winches, sensors."""

from sim_warp.simulator import Simulator
from sim_warp.snapshot import Snapshot
from sim_warp.state import SimulatorState

__all__ = ["Simulator", "SimulatorState", "Snapshot"]
__carosac__ = True  # marks this package as ours: the name is not unique
