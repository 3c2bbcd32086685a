"""Validation of models on a recording: run open loop on its lengths, scored on its poses."""

from carosac_toolkit.validation.procedure import DEFAULT_MODELS, validate
from carosac_toolkit.validation.result import ModelResult, ValidationResult

__all__ = ["DEFAULT_MODELS", "ModelResult", "ValidationResult", "validate"]
