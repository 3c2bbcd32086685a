"""The smoother: the best estimate of a whole recording, afterwards."""

from baselines.smoother.result import Smoothed
from baselines.smoother.settings import SmootherSettings
from baselines.smoother.smoother import smooth

__all__ = ["Smoothed", "SmootherSettings", "smooth"]
