"""Model predictive control: see `docs/mpc.md`."""

from baselines.mpc.controller import Mpc
from baselines.mpc.geometry import NoStart
from baselines.mpc.machine_code import CompileError
from baselines.mpc.record import MpcRecord
from baselines.mpc.settings import MpcSettings

__all__ = ["CompileError", "Mpc", "MpcRecord", "MpcSettings", "NoStart"]
