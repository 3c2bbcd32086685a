"""The paper's figure of its reward, redrawn from the functions that train."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from learned.pictures.training import reward_terms
from learned.rewards import (
    action_ratio_reward,
    deviation_reward,
    distance_reward,
    goal_reward,
    sag_reward,
    step_reward,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

CURVE_SAMPLES = 401
DRAWN_TERMS = {
    "step": (step_reward, "distance to the target [m]", 0.2),
    "goal": (goal_reward, "distance to the target [m]", 0.2),
    "distance": (distance_reward, "distance over the largest [-]", 1.0),
    "sag": (sag_reward, "mean |length - straight| [m]", 2.0),
    "action_ratio": (action_ratio_reward, "length change over distance [-]", 5.0),
    "deviation": (deviation_reward, "mean |action - straight| [m]", 3.0),
}


def paper_reward_terms(path: str | Path) -> Figure:
    """Draw the six terms of the paper against their variables.

    Args:
        path: Picture file.
    """
    terms = {}
    for name, (function, label, largest) in DRAWN_TERMS.items():
        variable = np.linspace(0.0, largest, CURVE_SAMPLES)
        terms[name] = (label, variable, function(variable))
    return reward_terms(terms, path)
