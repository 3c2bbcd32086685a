"""Learned controllers: environments, rewards, TD3 training and the trained policy."""

from __future__ import annotations

from typing import TYPE_CHECKING

from carosac_toolkit.base.lazy import lazy_names

if TYPE_CHECKING:
    from learned.approximate_mpc.controller import ApproximateMpc, ApproximateMpcSettings
    from learned.approximate_mpc.family_training import FamilySettings, distill_family
    from learned.approximate_mpc.training import DistillationSettings, distill
    from learned.environment import CableEnvironment, EnvironmentSettings, StepResult
    from learned.evaluation import evaluate, evaluate_inverse_kinematics
    from learned.exploration_settings import ExplorationSettings
    from learned.gym_environment import CableGymEnvironment
    from learned.learning_curve import read_curve
    from learned.moving_worlds import MovingSettings
    from learned.observation import ObservationUnits
    from learned.policy_controller import PolicyController, PolicySettings, list_policies
    from learned.policy_file import Policy, PolicyDescription
    from learned.presets import Preset, Stage, Td3Settings, find_preset
    from learned.rewards import REWARD_TERMS, RewardSettings
    from learned.scores import PolicyScores
    from learned.target_paths import PathSettings, TargetPath
    from learned.training import TrainingJob, train
    from learned.training_study import TrainingRun, TrainingStudy
    from learned.transition import Transition

__carosac__ = True  # marks this package as ours: the name is not unique

__all__ = [
    "REWARD_TERMS",
    "ApproximateMpc",
    "ApproximateMpcSettings",
    "CableEnvironment",
    "CableGymEnvironment",
    "DistillationSettings",
    "EnvironmentSettings",
    "ExplorationSettings",
    "FamilySettings",
    "MovingSettings",
    "ObservationUnits",
    "PathSettings",
    "Policy",
    "PolicyController",
    "PolicyDescription",
    "PolicyScores",
    "PolicySettings",
    "Preset",
    "RewardSettings",
    "Stage",
    "StepResult",
    "TargetPath",
    "Td3Settings",
    "TrainingJob",
    "TrainingRun",
    "TrainingStudy",
    "Transition",
    "distill",
    "distill_family",
    "evaluate",
    "evaluate_inverse_kinematics",
    "find_preset",
    "list_policies",
    "read_curve",
    "train",
]

_MODULES = {
    "ApproximateMpc": "approximate_mpc.controller",
    "ApproximateMpcSettings": "approximate_mpc.controller",
    "DistillationSettings": "approximate_mpc.training",
    "CableEnvironment": "environment",
    "CableGymEnvironment": "gym_environment",
    "EnvironmentSettings": "environment",
    "ExplorationSettings": "exploration_settings",
    "FamilySettings": "approximate_mpc.family_training",
    "MovingSettings": "moving_worlds",
    "ObservationUnits": "observation",
    "PathSettings": "target_paths",
    "Policy": "policy_file",
    "PolicyController": "policy_controller",
    "PolicyDescription": "policy_file",
    "PolicyScores": "scores",
    "PolicySettings": "policy_controller",
    "Preset": "presets",
    "REWARD_TERMS": "rewards",
    "RewardSettings": "rewards",
    "Stage": "presets",
    "StepResult": "environment",
    "TargetPath": "target_paths",
    "Td3Settings": "presets",
    "TrainingJob": "training",
    "TrainingRun": "training_study",
    "TrainingStudy": "training_study",
    "Transition": "transition",
    "distill": "approximate_mpc.training",
    "distill_family": "approximate_mpc.family_training",
    "evaluate": "evaluation",
    "evaluate_inverse_kinematics": "evaluation",
    "find_preset": "presets",
    "list_policies": "policy_controller",
    "read_curve": "learning_curve",
    "train": "training",
}
__getattr__, __dir__ = lazy_names(__name__, _MODULES)
