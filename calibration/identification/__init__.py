"""Identification of the dynamics: the simulator, open loop, fitted to measured poses."""

from calibration.identification.procedure import identify
from calibration.identification.result import Identification
from calibration.identification.settings import IdentificationSettings

__all__ = ["Identification", "IdentificationSettings", "identify"]
