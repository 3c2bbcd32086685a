"""The dynamic estimator: platform dynamics driven by the lengths, corrected by what is measured."""

from baselines.dynamic_estimator.estimator import DynamicEstimator
from baselines.dynamic_estimator.settings import DynamicEstimatorSettings

__all__ = ["DynamicEstimator", "DynamicEstimatorSettings"]
