"""Open-loop run of a model over a recording."""

from __future__ import annotations

from dataclasses import dataclass
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.loop.loop import checked_belief
from carosac_toolkit.loop.protocols import Estimator, SupportsMovingStart
from carosac_toolkit.loop.values import Belief, Command, Measurement
from carosac_toolkit.recordings.recording import Recording


@dataclass(frozen=True, kw_only=True, eq=False)
class ModelRun:
    """Beliefs of a model after each of K samples.

    Attributes:
        position: Platform origin in W [m], shape (K, 3).
        rotation: Rotation from P to W, shape (K, 3, 3).
        tension: At the platform [N], shape (K, n), NaN where it had none; None: it has no forces.
        covariance: Of the pose, as beliefs have it, shape (K, 6, 6), NaN where it had none; None:
            it claims none.
        converged: True where the model itself found a pose, shape (K,).
        moves: True if it estimated a twist.
        seconds: Wall time of each update [s], shape (K,); the first is the reset.
    """

    position: Array
    rotation: Array
    tension: Array | None
    covariance: Array | None
    converged: NDArray[np.bool_]
    moves: bool
    seconds: Array


def load_model(name: str) -> Any:
    """Import an estimator by its entry-point name or as ``module:Class``.

    Raises:
        InvalidField: There is none of this name, or it has no ``build``.
    """
    from carosac_toolkit.loop.plugins import load

    target = load("estimators", name)
    if not callable(getattr(target, "build", None)):
        allowed = "something with build(robot, settings, *, seed)"
        raise InvalidField("estimator", repr(name), allowed)
    return target


def run_open_loop(
    model: Estimator, recording: Recording, stop: int, first: Belief | None = None
) -> ModelRun:
    """Feed a model the samples 0 <= i < stop in order, measured poses withheld.

    The command given with sample i is the newest recorded one that is not later than the sample;
    where the recording has none, it is the measured lengths of the sample before.

    Args:
        model: The estimator.
        recording: N length samples.
        stop: One past the last sample, <= N.
        first: Pose and twist at the first sample, from which a model that can starts; None: at
            rest.
    """
    beliefs: list[Belief] = []
    seconds = np.empty(stop)
    previous = None
    for index in range(stop):
        measurement = recording.measurement(index)
        command = _command(recording, measurement, previous)
        start = perf_counter()
        if beliefs:
            belief = model.update(beliefs[-1], command, measurement)
        elif first is not None and isinstance(model, SupportsMovingStart):
            belief = model.reset_moving(measurement, first)
        else:
            belief = model.reset(measurement)
        seconds[index] = perf_counter() - start
        beliefs.append(checked_belief(belief, measurement))
        previous = measurement
    tension = [_tension(belief, recording.n) for belief in beliefs]
    return ModelRun(
        position=np.concatenate([belief.position for belief in beliefs]),
        rotation=np.concatenate([belief.rotation for belief in beliefs]),
        tension=None if np.isnan(tension).all() else np.array(tension),
        covariance=_covariances(beliefs),
        converged=np.array([_converged(belief) for belief in beliefs]),
        moves=any(belief.twist is not None for belief in beliefs),
        seconds=seconds,
    )


def _command(
    recording: Recording, measurement: Measurement, previous: Measurement | None
) -> Command:
    """Return the command applied when a measurement was taken."""
    now = measurement.time
    channel = recording.command
    if channel is not None:
        index = int(np.searchsorted(channel.time, now[0], side="right")) - 1
        if index >= 0:
            return Command(time=now, unstrained_length=channel.value[index : index + 1])
    return Command(time=now, unstrained_length=(previous or measurement).unstrained_length)


def _tension(belief: Belief, n: int) -> Array:
    """Return the tensions of a belief, shape (n,); NaN if there are none."""
    if belief.tension is None:
        return np.full(n, np.nan)
    tension: Array = np.asarray(belief.tension, dtype=np.float64)[0]
    return tension


def _covariances(beliefs: list[Belief]) -> Array | None:
    """Return the covariances of the poses, shape (K, 6, 6), NaN where there is none."""
    claimed = [belief.covariance for belief in beliefs]
    if all(each is None for each in claimed):
        return None
    none = np.full((6, 6), np.nan)
    return np.array([none if each is None else np.asarray(each)[0, :6, :6] for each in claimed])


def _converged(belief: Belief) -> bool:
    """Return whether a model found this pose, by its own account; True if it gives none."""
    converged = belief.converged
    return True if converged is None else bool(np.all(converged))
