"""The forward pass: the dynamics through a recording, and how errors go along with it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from baselines.dynamic_estimator.evidence import Evidence, Felt, Sensors
from baselines.dynamic_estimator.model import Model
from baselines.dynamic_estimator.state import Errors, FilterState
from baselines.smoother.measured import Measured
from baselines.smoother.settings import SmootherSettings
from carosac_toolkit.arrays import Array

FLOOR = 1e-4  # of the scale of an error, per root of a second: noise of what is constant


@dataclass(frozen=True, kw_only=True, eq=False)
class Link:
    """From one key frame to the next, to first order.

    Attributes:
        carry: Errors at the end per error at the start, shape (size, size).
        noise: Covariance of what is added, shape (size, size).
        felt: What the IMU said at its end of the errors at its start, or None.
    """

    carry: Array
    noise: Array
    felt: Evidence | None


@dataclass(frozen=True, kw_only=True, eq=False)
class Correction:
    """What was added to a state of the forward pass where it arrived.

    Attributes:
        error: In the order of `Errors`, shape (size,).
        ways: To sway, in which it is given, shape (6, m).
    """

    error: Array
    ways: Array

    def seen_from(self, state: FilterState) -> Array:
        """The same in the ways to sway of another state nearby, shape (size,)."""
        where = state.errors
        turn = state.sway.momentum @ self.ways
        found = self.error.copy()
        found[where.sway] = turn @ self.error[where.sway]
        found[where.speed] = turn @ self.error[where.speed]
        return found


@dataclass(frozen=True, kw_only=True, eq=False)
class Passed:
    """A forward pass through K key frames.

    Attributes:
        states: At each key frame, corrections included; their covariance means nothing.
        corrections: What was added to each, shape (K, size): to the first, against rest.
        links: K - 1 of them.
        poses: What measured poses say, by key frame.
    """

    states: list[FilterState]
    corrections: Array
    links: list[Link]
    poses: dict[int, Evidence]


class Forward:
    """Forward passes through one recording."""

    def __init__(self, model: Model, measured: Measured, settings: SmootherSettings) -> None:
        """Take the dynamics and the recording."""
        self._model = model
        self._measured = measured
        self._settings = settings
        self._sensors = Sensors(model, settings.dynamics)
        self._floor = (FLOOR * scales(model, settings)) ** 2

    def run(self, rest: FilterState, corrections: list[Correction] | None) -> Passed:
        """Go through the recording.

        Args:
            rest: Where it begins without a correction.
            corrections: To be added at each key frame, or None.

        Raises:
            NoMotion: The dynamics have no finite motion.
        """
        time = self._measured.time
        size = self._model.errors.size
        states, links = [], []
        added = np.zeros((len(time), size))
        state = rest
        for k in range(len(time)):
            if k:
                state, link = self._to(state, float(time[k]), self._measured.felt.get(k))
                links.append(link)
            if corrections is not None:
                added[k] = corrections[k].seen_from(state)
                state = state.corrected(added[k], state.covariance)
            states.append(state)
        poses = {
            k: self._sensors.pose(states[k], *pose)
            for k, pose in sorted(self._measured.poses.items())
        }
        return Passed(states=states, corrections=added, links=links, poses=poses)

    def _to(self, state: FilterState, end: float, felt: Felt | None) -> tuple[FilterState, Link]:
        """Move a state to the next key frame."""
        size = self._model.errors.size
        carry, noise, said = np.eye(size), np.zeros((size, size)), None
        count = max(1, int(np.ceil((end - state.time) / self._settings.grid - 1e-6)))
        stops = np.linspace(state.time, end, count + 1)
        for start, stop in pairwise(stops.tolist()):
            reading = self._measured.reading(start), self._measured.reading(stop)
            move = self._model.step(state, *reading, stop - start)
            step, keep = self._sensors.carried(move, stop - start)
            added = self._noise(stop - start, keep)
            if felt is not None and stop == stops[-1]:
                now = self._sensors.felt(move, felt)
                said = Evidence(now.residual, now.by @ carry, now.noise + now.by @ noise @ now.by.T)
            carry, noise = step @ carry, step @ noise @ step.T + added
            state = replace(move.state, time=stop, wind=keep * state.wind)
        return replace(state, time=end), Link(carry=carry, noise=noise, felt=said)

    def _noise(self, duration: float, keep: float) -> Array:
        """What a step adds to the covariance of the errors; `keep` of the wind is left [-]."""
        where, s = self._model.errors, self._settings.dynamics
        spread = self._floor * duration
        spread[where.wind] += s.wind_force**2 * (1.0 - keep**2)
        spread[where.bias] += s.length_bias_walk**2 * duration
        spread[where.mass.start : where.center.stop] = 0.0
        spread[where.imu] = 0.0
        noise = np.diag(spread)
        density = s.acceleration_noise**2 * self._model.robot.mass
        one = np.eye(where.m)
        noise[where.speed, where.speed] += density * duration * one
        noise[where.sway, where.sway] += density * duration**3 / 3.0 * one
        noise[where.sway, where.speed] += density * duration**2 / 2.0 * one
        noise[where.speed, where.sway] += density * duration**2 / 2.0 * one
        return noise


def scales(model: Model, settings: SmootherSettings) -> Array:
    """What errors are measured in, so that all are of order one, shape (size,)."""
    where: Errors = model.errors
    s = settings.dynamics
    found = np.full(where.size, 0.01 * np.sqrt(model.robot.mass))
    found[where.speed] *= 3.0
    found[where.wind] = s.wind_force or 1.0
    found[where.mass] = s.mass or 0.03
    found[where.center] = s.center_of_mass or 0.01
    found[where.bias] = s.length_bias or 7e-3
    found[where.imu] = np.repeat([s.angular_rate_bias or 5e-3, s.specific_force_bias or 0.05], 3)
    return found
