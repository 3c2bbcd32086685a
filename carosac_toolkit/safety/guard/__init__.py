"""The guard around a driver: lifecycle, checks, limited commands, braking and journal."""

from carosac_toolkit.safety.guard.guard import GuardedDriver
from carosac_toolkit.safety.guard.lifecycle import FaultReport, IllegalTransition, NotReady
from carosac_toolkit.safety.guard.settings import GuardSettings

__all__ = ["FaultReport", "GuardSettings", "GuardedDriver", "IllegalTransition", "NotReady"]
