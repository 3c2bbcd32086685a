r"""Reward terms: those of the CaRoSaC paper, and those of the presets that go beyond it.

Each term is a function of quantities that are computed from a `Transition` in one place; a reward
is the sum of named terms. The paper's terms are

.. math::

    r_{step} &= 0.01, \quad r_{goal} = [d < 0.05\,m], \quad
    r_{dist} = -\tanh(2 (d_{norm} - 0.06)) + 0.002, \\
    r_{csag} &= -0.7 \tanh(c_{diff}^2 + 0.09) - 0.035, \quad
    r_{cact} = -\tanh(c_{ratio})^{15} / 10, \quad r_{cdev} = -\tanh(a_{diff})^4 / 5 .

The paper's printed sum of the sag stage leaves out :math:`r_{goal}`, its text has it; it is in.

References:
    Dhakate et al., *CaRoSaC*, IEEE Robotics and Automation Letters, 2025.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.base.numbers import check_fields
from learned.transition import Transition

DISTANCE_FLOOR_M = 0.01  # [m] below which the distance in `action_ratio` is not counted smaller
PAPER_NO_SAG = ("step", "distance", "goal")
PAPER_SAG = (*PAPER_NO_SAG, "sag", "action_ratio", "deviation")


@dataclass(frozen=True, kw_only=True)
class RewardSettings:
    """Which terms are summed, and their numbers.

    Attributes:
        terms: Names of `REWARD_TERMS`.
        goal_radius: Within which the goal counts as reached [m].
        fit_scale: Misfit at which the reward `fit` turns from linear to logarithmic [m].
        tracking_scale: Misfit at which `tracking` turns from quadratic to logarithmic [m].
        consistency: What a metre of inconsistency costs in `fit`, in metres of distance.
        slack: What a cable costs in `fit` whose tension is below its lower limit by its share of
            the platform's weight, weight / n [m].
        reserve: How far above the limit a tension must be to cost nothing, over the same share [-].
        velocity: Time that turns a velocity error into a misfit of `tracking` [s].
        effort: Weight of the squared effort.
        jerk: Weight of the squared jerk.
    """

    terms: tuple[str, ...] = PAPER_NO_SAG
    goal_radius: float = 0.05
    fit_scale: float = 0.04
    tracking_scale: float = 0.1
    consistency: float = 1.0
    slack: float = 0.0
    reserve: float = 0.0
    velocity: float = 0.1
    effort: float = 0.02
    jerk: float = 3.0

    def __post_init__(self) -> None:
        """Refuse unknown terms and numbers that make no sense."""
        for k, name in enumerate(self.terms):
            if name not in REWARD_TERMS:
                raise InvalidField(f"terms[{k}]", repr(name), f"one of {sorted(REWARD_TERMS)}")
        check_fields(
            self,
            positive=("goal_radius", "fit_scale", "tracking_scale"),
            not_negative=("consistency", "slack", "reserve", "velocity", "effort", "jerk"),
        )
        if self.reserve > 0.0 and self.slack == 0.0:
            raise InvalidField("reserve", self.reserve, "0 where `slack` is 0 and costs nothing")


def step_reward(distance: Array) -> Array:
    """Return the paper's reward for being there at all, 0.01 a step, shape (B,)."""
    return np.full_like(distance, 0.01)


def goal_reward(distance: Array, radius: float = 0.05) -> Array:
    """Return the paper's 1 within a radius [m] of the goal; `distance` [m], shape (B,)."""
    return (distance < radius).astype(np.float64)


def distance_reward(normalised: Array) -> Array:
    """Return the paper's reward of the distance over the largest in the workspace, (B,)."""
    return -np.tanh(2.0 * (normalised - 0.06)) + 0.002


def sag_reward(difference: Array) -> Array:
    """Return the paper's reward of length less straight distance [m], a mean, shape (B,)."""
    return -0.7 * np.tanh(difference**2 + 0.09) - 0.035


def action_ratio_reward(ratio: Array) -> Array:
    """Return the paper's reward of the change of length over the distance, shape (B,)."""
    return -(np.tanh(ratio) ** 15) / 10.0


def deviation_reward(difference: Array) -> Array:
    """Return the paper's reward of the action less straight lengths of the goal [m], (B,)."""
    return -(np.tanh(difference) ** 4) / 5.0


def misfit_reward(misfit: Array, scale: float, span: float) -> Array:
    r"""Return a reward that asks for the last millimetre as well as for the first metre.

    .. math:: r = -\ln(1 + \min(m, D) / s) / \ln(1 + D / s)

    It is never below -1, which is what a step without a solution is worth. Its slope over relative
    changes of the misfit is the same at all distances above `scale`, where tanh is flat far away
    and a square is flat close by.

    Args:
        misfit: [m], shape (B,).
        scale: s [m].
        span: D, the largest distance in the workspace [m], from which on the reward is -1.
    """
    return np.asarray(-np.log1p(np.minimum(misfit, span) / scale) / np.log1p(span / scale))


def tracking_reward(misfit: Array, scale: float, span: float) -> Array:
    r"""Return a reward for feedback: quadratic close by, so small errors get small actions.

    .. math:: r = -\ln(1 + (m / s)^2) / \ln(1 + (D / s)^2)

    A reward with a slope at zero, as `misfit_reward`, makes a policy bang-bang.

    Args:
        misfit: [m], shape (B,).
        scale: s, where it turns from quadratic to logarithmic [m].
        span: D, the largest distance in the workspace [m], where the reward is -1.
    """
    return np.asarray(-np.log1p((misfit / scale) ** 2) / np.log1p((span / scale) ** 2))


def lengths_misfit(transition: Transition, settings: RewardSettings) -> Array:
    r"""Return the misfit of lengths wherever the target is, as a distance [m], shape (B,).

    .. math:: m_L^2 = (c |\Delta L|)^2 + \sum_i (k o_i)^2, \qquad
              o_i = \max(0, t_{min,i} + \rho w - t_i) / w, \qquad w = m g / n

    with inconsistency :math:`\Delta L`, tensions t, and the settings c: `consistency`, k: `slack`
    and :math:`\rho`: `reserve`. Without forces the sum is left out.
    """
    square: Array = settings.consistency**2 * (transition.inconsistency**2).sum(axis=1)
    if settings.slack > 0.0 and transition.tension is not None:
        robot = transition.robot
        share = robot.weight / robot.n
        taut = robot.tension_min + settings.reserve * share
        lack = np.maximum(0.0, taut - transition.tension) / share
        square = square + settings.slack**2 * (lack**2).sum(axis=1)
    return np.asarray(np.sqrt(square))


class Reward:
    """The sum of the terms of some settings, for one workspace."""

    def __init__(self, settings: RewardSettings, span: float) -> None:
        """Keep the settings.

        Args:
            settings: Terms and numbers.
            span: Largest distance in the workspace, the diagonal of its box [m].
        """
        self.settings = settings
        self.span = span

    def __call__(self, transition: Transition) -> Array:
        """Return the reward of each environment, shape (B,)."""
        return np.asarray(np.sum(list(self.terms(transition).values()), axis=0))

    def terms(self, transition: Transition) -> dict[str, Array]:
        """Return each term by name, shape (B,)."""
        return {name: REWARD_TERMS[name](transition, self) for name in self.settings.terms}


def _distance(transition: Transition, reward: Reward) -> Array:
    return distance_reward(transition.distance / reward.span)


def _sag(transition: Transition, reward: Reward) -> Array:
    return sag_reward(np.abs(transition.length - transition.straight_position).mean(axis=1))


def _action_ratio(transition: Transition, reward: Reward) -> Array:
    change = np.linalg.norm(transition.asked - transition.length_before, axis=1)
    away = np.linalg.norm(transition.position_before - transition.target, axis=1)
    return action_ratio_reward(change / np.maximum(away, DISTANCE_FLOOR_M))


def _deviation(transition: Transition, reward: Reward) -> Array:
    return deviation_reward(np.abs(transition.straight_target - transition.asked).mean(axis=1))


def _fit(transition: Transition, reward: Reward) -> Array:
    misfit = np.hypot(transition.distance, lengths_misfit(transition, reward.settings))
    return misfit_reward(misfit, reward.settings.fit_scale, reward.span)


def _tracking(transition: Transition, reward: Reward) -> Array:
    speed = np.linalg.norm(transition.velocity, axis=1)
    misfit = np.hypot(transition.distance, reward.settings.velocity * speed)
    return tracking_reward(misfit, reward.settings.tracking_scale, reward.span)


REWARD_TERMS: dict[str, Callable[[Transition, Reward], Array]] = {
    "step": lambda transition, reward: step_reward(transition.distance),
    "goal": lambda transition, reward: goal_reward(
        transition.distance, reward.settings.goal_radius
    ),
    "distance": _distance,
    "sag": _sag,
    "action_ratio": _action_ratio,
    "deviation": _deviation,
    "fit": _fit,
    "tracking": _tracking,
    "effort": lambda transition, reward: -reward.settings.effort * transition.effort**2,
    "jerk": lambda transition, reward: -reward.settings.jerk * transition.jerk**2,
}
