"""Inertial fusion with the kinematic solver: an error-state Kalman filter over IMU and lengths."""

from baselines.ks_ekf.estimator import KsEkf
from baselines.ks_ekf.settings import KsEkfSettings

__all__ = ["KsEkf", "KsEkfSettings"]
