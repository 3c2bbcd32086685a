r"""Errors of an estimator as a linear model that is learned from drives with it.

An estimator takes milliseconds a step and a world, and training takes many steps of many worlds.
What a policy feels of an estimator is how its belief errs: it lags, overestimates a swing, and is
off by what the plant hides. All of that is, to first order, linear in what the platform does:

.. math:: e_k = A\,e_{k-1} + B\,u_k + m + w_k

with the error :math:`e` of pose and twist, the platform's twist of now and of the two steps before
(thus its acceleration), and what cables reach beyond their lengths, in :math:`u`, an offset
:math:`m` of the episode, and noise :math:`w`.

References:
    Lütkepohl, *New Introduction to Multiple Time Series Analysis*, Springer 2005, chapter 10
    (autoregression with further variables).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import CarosacError
from carosac_toolkit.loop.values import Belief
from carosac_toolkit.physics.cable import straight_line
from carosac_toolkit.robot.robot import Robot
from learned.worlds import WorldStates

ERROR_SIZE = 12  # of position, rotation vector and twist
TWISTS = 3  # of now, and before
RIDGE_STEPS = (1e-6, 1e-4, 1e-3, 1e-2, 1e-1)  # of a sum of squares, until errors fade
FADING_MAX = 0.999  # a step: of an error that is left alone, at most
EPISODES_MIN = 8  # beyond one for each number that offsets depend on


@dataclass(frozen=True, kw_only=True, eq=False)
class Episode:
    """What was believed in one drive of K + 1 looks; the first is where it began.

    Attributes:
        error: As `errors_of` gives it, shape (K + 1, 12).
        twist: Of the platform, shape (K + 1, 6).
        reach: As `reach_of` gives it [m], shape (K + 1, n).
    """

    error: Array
    twist: Array
    reach: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class BeliefErrorModel:
    """Model of how a belief errs; errors as `errors_of` gives them.

    Attributes:
        fading: A, shape (12, 12).
        motion: B, of twists from now on back and of the change of `reach` since the start, shape
            (12, 18 + n).
        offset: Of an episode, by 1 and by the reach at its start, shape (12, 1 + n).
        offset_spread: Root of the covariance of what is left of offsets, shape (12, 12).
        start: Error at the start, by 1, reach and twist there, shape (12, 1 + n + 6).
        start_spread: Root of the covariance of what is left of it, shape (12, 12).
        noise: Root of the covariance of the noise, shape (12, 12).
    """

    fading: Array
    motion: Array
    offset: Array
    offset_spread: Array
    start: Array
    start_spread: Array
    noise: Array


class BeliefErrors:
    """Errors of the beliefs in some worlds, step by step."""

    def __init__(self, model: BeliefErrorModel, count: int, n: int, seed: int) -> None:
        """Begin nowhere: `begin` says in which worlds.

        Args:
            model: How beliefs err.
            count: Of worlds.
            n: Number of cables.
            seed: Of offsets and noise.
        """
        self.model = model
        self.error: Array = np.zeros((count, ERROR_SIZE))
        self._offset: Array = np.zeros((count, ERROR_SIZE))
        self._twists: Array = np.zeros((TWISTS, count, 6))
        self._first_reach: Array = np.zeros((count, n))
        self._rng = np.random.default_rng([seed, 12])

    def begin(self, rows: NDArray[Any], twist: Array, reach: Array) -> None:
        """Draw the errors of some worlds anew, which begin with twists (B, 6), reaches (B, n)."""
        model, one = self.model, np.ones((len(rows), 1))
        known = np.hstack([one, reach[rows]])
        self._offset[rows] = known @ model.offset.T + self._draw(len(rows), model.offset_spread)
        self.error[rows] = np.hstack([known, twist[rows]]) @ model.start.T
        self.error[rows] += self._draw(len(rows), model.start_spread)
        self._twists[:, rows] = twist[rows]
        self._first_reach[rows] = reach[rows]

    def advance(self, twist: Array, reach: Array) -> None:
        """Take a step, after which the platforms have twists (B, 6) and reaches (B, n)."""
        model = self.model
        self._twists = np.concatenate([twist[None], self._twists[:-1]])
        moved = np.hstack([*self._twists, reach - self._first_reach])
        self.error = self.error @ model.fading.T + moved @ model.motion.T + self._offset
        self.error += self._draw(len(twist), model.noise)

    def state(self) -> dict[str, Any]:
        """Return everything that changes, and the model."""
        return {
            "model": self.model, "error": self.error.copy(), "offset": self._offset.copy(),
            "twists": self._twists.copy(), "first_reach": self._first_reach.copy(),
            "rng": self._rng.bit_generator.state,
        }  # fmt: skip

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from there."""
        self.model = state["model"]
        self.error, self._offset = state["error"].copy(), state["offset"].copy()
        self._twists, self._first_reach = state["twists"].copy(), state["first_reach"].copy()
        self._rng.bit_generator.state = state["rng"]

    def _draw(self, count: int, root: Array) -> Array:
        return np.asarray(self._rng.standard_normal((count, ERROR_SIZE)) @ root.T)


def errors_of(truth: WorldStates, belief: Belief) -> Array:
    """Return how beliefs err: position [m], rotation vector in W [rad], twist, shape (B, 12)."""
    assert belief.twist is not None
    turn = belief.rotation @ truth.rotation.transpose(0, 2, 1)
    turned = Rotation.from_matrix(turn).as_rotvec()
    return np.hstack([belief.position - truth.position, turned, belief.twist - truth.twist])


def erring(time: Array, position: Array, rotation: Array, twist: Array, error: Array) -> Belief:
    """Return what is believed of platforms with errors (B, 12): the inverse of `errors_of`."""
    turn = Rotation.from_rotvec(error[:, 3:6]).as_matrix()
    return Belief(
        time=time, position=position + error[:, :3], rotation=turn @ rotation,
        twist=twist + error[:, 6:],
    )  # fmt: skip


def reach_of(robot: Robot, position: Array, rotation: Array, length: Array) -> Array:
    """Return what straight cables need beyond the lengths that encoders say [m], shape (B, n).

    An estimator that knows the lengths alone takes for motion what is stretch, and the other way
    round.
    """
    return np.asarray(straight_line.inverse_kinematics(robot, position, rotation) - length)


def fit_belief_errors(episodes: list[Episode]) -> BeliefErrorModel:
    """Fit a model to drives.

    Where an error would grow by itself, the sum of squares is told to keep coefficients small, by
    as little as lets it fade.

    Args:
        episodes: Of drives in which the belief was not lost, of any lengths.

    Raises:
        CarosacError: There are too few drives, or errors that do not fade.
    """
    long_enough = [one for one in episodes if len(one.error) > TWISTS]
    numbers = 1 + long_enough[0].reach.shape[1] + 6 if long_enough else 0
    if len(long_enough) < numbers + EPISODES_MIN:
        got = f"{len(long_enough)} of {len(episodes)} drives"
        raise CarosacError(f"errors of the estimator: only {got} ended with the platform found")
    inputs = [_inputs(one) for one in long_enough]
    wanted = [one.error[1:] for one in long_enough]
    middle = [(x.mean(axis=0), y.mean(axis=0)) for x, y in zip(inputs, wanted, strict=True)]
    x = np.concatenate([each - mean for each, (mean, _) in zip(inputs, middle, strict=True)])
    y = np.concatenate([each - mean for each, (_, mean) in zip(wanted, middle, strict=True)])
    found = _fading_fit(x, y)
    offset = np.stack([b - a @ found for a, b in middle])
    known = np.stack([np.concatenate([[1.0], one.reach[0]]) for one in long_enough])
    twist = np.stack([one.twist[0] for one in long_enough])
    by_reach, offset_spread = _regression(known, offset)
    start, start_spread = _regression(
        np.hstack([known, twist]), np.stack([one.error[0] for one in long_enough])
    )
    return BeliefErrorModel(
        fading=found[:ERROR_SIZE].T, motion=found[ERROR_SIZE:].T, offset=by_reach,
        offset_spread=offset_spread, start=start, start_spread=start_spread,
        noise=_root(y - x @ found, len(y) - len(long_enough)),
    )  # fmt: skip


def _inputs(one: Episode) -> Array:
    """Return what each error but the first follows from, shape (K, 12 + 18 + n)."""
    twist = np.concatenate([np.repeat(one.twist[:1], TWISTS - 1, axis=0), one.twist])
    back = [twist[TWISTS - k : len(twist) - k] for k in range(TWISTS)]
    return np.hstack([one.error[:-1], *back, one.reach[1:] - one.reach[0]])


def _fading_fit(x: Array, y: Array) -> Array:
    """Return coefficients (inputs, 12) of least squares by which errors fade."""
    scale = np.sqrt((x**2).mean(axis=0)) + np.finfo(float).tiny
    unit = x / scale
    normal, right = unit.T @ unit, unit.T @ y
    for ridge in RIDGE_STEPS:
        found = np.linalg.solve(normal + ridge * len(x) * np.eye(len(normal)), right)
        found = found / scale[:, None]
        if np.abs(np.linalg.eigvals(found[:ERROR_SIZE].T)).max() < FADING_MAX:
            return np.asarray(found)
    raise CarosacError("errors of the estimator: they grow by themselves; it cannot be modelled")


def _regression(known: Array, wanted: Array) -> tuple[Array, Array]:
    """Return coefficients (12, numbers) and the root (12, 12) of what is left."""
    found, *_ = np.linalg.lstsq(known, wanted)
    return np.asarray(found.T), _root(wanted - known @ found, len(known) - known.shape[1])


def _root(left: Array, freedom: int) -> Array:
    """Return a root (12, 12) of the covariance of what is left, (K, 12)."""
    value, vector = np.linalg.eigh(left.T @ left / freedom)
    return np.asarray(vector * np.sqrt(np.maximum(value, 0.0)))
