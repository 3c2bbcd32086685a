"""Predicted readings at equilibria on true lengths, with derivatives.

The true unstrained lengths of each rest are unknowns of their own; pose, tensions and swivel angles
are those of the statics on them. Derivatives are central differences of batches of equilibria.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
from scipy.spatial.transform import Rotation

from calibration.linear_samples import LinearSamples
from calibration.rest_readings import RestReadings
from calibration.rests.settings import RestSettings
from calibration.rests.unknowns import RestUnknowns
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.rotations import roll_and_pitch, wrapped_angle
from carosac_toolkit.loop.values import Pose
from carosac_toolkit.physics.cable.swivel import swivel_angle
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.recordings.encoders import readings as length_readings
from carosac_toolkit.robot.robot import Robot

LENGTH_STEP_SHARE = 1e-6  # of a cable's length, in differences
PARAMETER_STEP_SIGMAS = 1e-2  # prior sigmas, in differences
PARAMETER_STEP_MAX = 1e-4  # [m], [rad], ...: loose priors take no longer steps
KEPT_LENGTH_SHARE = 1e-4  # derivatives by geometry hardly change while lengths change by less
TENSION_FLOOR_SHARE = 0.1  # of the weight per cable: smaller tensions have its noise


class RestModel:
    """Readings of K rests as functions of k shared parameters and of the true lengths (K, n)."""

    def __init__(
        self, unknowns: RestUnknowns, readings: RestReadings, settings: RestSettings
    ) -> None:
        """Set up.

        Args:
            unknowns: The shared parameters.
            readings: Of K rests.
            settings: Noise.
        """
        self.unknowns, self.readings, self._settings = unknowns, readings, settings
        robot = unknowns.robot
        self.pulleys = np.flatnonzero(robot.pulley_radius > 0.0)
        self._kept: tuple[Array, Array] | None = None
        self._rotates = readings.attitude is not None or readings.inclination is not None

    @property
    def columns(self) -> dict[str, Array]:
        """Numbers of the residuals of a rest by sensor, in the order of the cables."""
        read, n = self.readings, self.unknowns.robot.n
        sizes = {
            "length": n,
            "tension": n * (read.tension is not None),
            "attitude": 3 * (read.attitude is not None),
            "inclination": 2 * (read.inclination is not None and read.attitude is None),
            "swivel_angle": len(self.pulleys) * (read.swivel_angle is not None),
        }
        ends = np.cumsum(list(sizes.values()))
        return {
            name: np.arange(end - size, end)
            for (name, size), end in zip(sizes.items(), ends, strict=True)
            if size
        }

    @property
    def noise(self) -> dict[str, Array | float]:
        """Standard deviation of the readings by sensor [m, N, rad]."""
        s = self._settings
        noise: dict[str, Array | float] = {
            "length": s.length_noise, "attitude": s.attitude_noise,
            "inclination": s.attitude_noise, "swivel_angle": s.swivel_noise,
        }  # fmt: skip
        return noise | ({} if self.readings.tension is None else {"tension": self._tension_noise})

    def equilibria(
        self, value: Array, length: Array, guess: statics.Equilibrium | Pose
    ) -> statics.Equilibrium:
        """Return the rests on true lengths [m], (K, n), with these parameters."""
        return statics.forward_kinematics(self.unknowns.robot_at(value), length, guess=guess)

    def residual(self, value: Array, length: Array, rest: statics.Equilibrium) -> Array:
        """Return measured minus predicted readings in standard deviations, shape (K, m)."""
        return self._residual(self.unknowns.robot_at(value), value, length, rest)

    def linear(
        self, value: Array, length: Array, rest: statics.Equilibrium, *, fresh: bool = False
    ) -> LinearSamples:
        """Return residuals and their derivatives; a sample's own unknowns are its true lengths.

        Args:
            value: Of the shared parameters, shape (k,).
            length: True lengths [m], shape (K, n).
            rest: Equilibria there.
            fresh: True to take derivatives by geometry anew, even if those of lengths nearby are
                known.
        """
        if fresh:
            self._kept = None
        return LinearSamples(
            residual=self.residual(value, length, rest),
            by_shared=self._by_shared(value, length, rest),
            by_own=self._by_length(value, length, rest),
        )

    def pose_derivatives(
        self, value: Array, length: Array, rest: statics.Equilibrium
    ) -> tuple[Array, Array]:
        """Return the poses by their lengths, (K, 6, n), and by the parameters, (K, 6, k).

        Translation [m], then rotation vector in W [rad].
        """
        step = self._length_step(length)
        by_length = np.stack(
            [
                _moves(low, high) / (2.0 * step[:, i : i + 1])
                for i, (low, high) in enumerate(self._length_pairs(value, length, rest))
            ],
            axis=2,
        )
        by_shared = np.zeros((len(length), 6, len(value)))
        for k in self.unknowns.moving:
            (_, _, low), (_, _, high) = self._sides(k, value, length, rest)
            by_shared[:, :, k] = _moves(low, high) / (2.0 * self._parameter_step(k))
        return by_length, by_shared

    def _residual(
        self, robot: Robot, value: Array, length: Array, rest: statics.Equilibrium
    ) -> Array:
        errors, read = self.unknowns.sensors_at(value), self.readings
        parts = [(read.length - length_readings(robot, length)) / self._settings.length_noise]
        if read.tension is not None:
            predicted = (1.0 + errors.tension_scale) * rest.tension + errors.tension_offset
            parts.append((read.tension - predicted) / self._tension_noise)
        if self._rotates:
            parts.append(self._rotation_residual(rest.rotation, errors.heading, errors.mounting))
        if read.swivel_angle is not None:
            predicted = swivel_angle(robot, -rest.exit_tension) + errors.swivel_offset
            off = wrapped_angle(read.swivel_angle - predicted)[:, self.pulleys]
            parts.append(off / self._settings.swivel_noise)
        return np.concatenate(parts, axis=1)

    @cached_property
    def _tension_noise(self) -> Array:
        """Return the noise of the load cells [N], shape (K, n)."""
        tension = np.asarray(self.readings.tension)
        return tension_noise(self.unknowns.robot, tension, self._settings)

    def _rotation_residual(self, rotation: Array, heading: Array, mounting: Array) -> Array:
        """Return the residuals of AHRS, (K, 3), or inclinometer, (K, 2)."""
        predicted = heading @ rotation @ mounting
        if self.readings.attitude is not None:
            turn = predicted.swapaxes(1, 2) @ self.readings.attitude
            off = Rotation.from_matrix(turn).as_rotvec()
        else:
            off = wrapped_angle(np.asarray(self.readings.inclination) - roll_and_pitch(predicted))
        return np.asarray(off / self._settings.attitude_noise)

    def _length_step(self, length: Array) -> Array:
        return np.asarray(LENGTH_STEP_SHARE * length)

    def _length_pairs(
        self, value: Array, length: Array, rest: statics.Equilibrium
    ) -> list[tuple[statics.Equilibrium, statics.Equilibrium]]:
        """Return equilibria with the length of each cable a step shorter and longer."""
        count, n = length.shape
        step = self._length_step(length)
        changes = np.einsum("ki,ij->jki", step, np.eye(n))  # (n, K, n)
        moved = np.concatenate([length - changes, length + changes]).reshape(-1, n)
        found = self.equilibria(value, moved, rest.rows(np.tile(np.arange(count), 2 * n)))
        rows = np.arange(2 * n * count).reshape(2, n, count)
        return [(found.rows(rows[0, i]), found.rows(rows[1, i])) for i in range(n)]

    def _by_length(self, value: Array, length: Array, rest: statics.Equilibrium) -> Array:
        """Return the derivative of the residuals by the true lengths, shape (K, m, n)."""
        step, columns = self._length_step(length), []
        for i, (low, high) in enumerate(self._length_pairs(value, length, rest)):
            change = np.zeros_like(length)
            change[:, i] = step[:, i]
            after = self.residual(value, length + change, high)
            before = self.residual(value, length - change, low)
            columns.append((after - before) / (2.0 * step[:, i : i + 1]))
        return np.stack(columns, axis=2)

    def _parameter_step(self, place: int) -> float:
        sigma = float(self.unknowns.prior.sigma[place])
        return min(PARAMETER_STEP_SIGMAS * sigma, PARAMETER_STEP_MAX)

    def _sides(
        self, place: int, value: Array, length: Array, rest: statics.Equilibrium
    ) -> list[tuple[Robot, Array, statics.Equilibrium]]:
        """Return robot, parameters and equilibria with one parameter a step lower and higher."""
        sides = []
        for sign in (-1.0, 1.0):
            moved = value.copy()
            moved[place] += sign * self._parameter_step(place)
            found = rest
            robot = self.unknowns.robot_at(moved)
            if place in self.unknowns.moving:
                found = statics.forward_kinematics(robot, length, guess=rest)
            sides.append((robot, moved, found))
        return sides

    def _by_shared(self, value: Array, length: Array, rest: statics.Equilibrium) -> Array:
        """Return the derivative of the residuals by the shared parameters, shape (K, m, k)."""
        places, geometry = list(self.unknowns.moving), self._by_geometry(value, length, rest)
        columns = np.zeros((len(length), geometry.shape[1], len(value)))
        columns[:, :, places] = geometry
        for k in set(range(len(value))) - set(places):
            columns[:, :, k] = self._slope(k, value, length, rest)
        return columns

    def _by_geometry(self, value: Array, length: Array, rest: statics.Equilibrium) -> Array:
        """Return the columns on which the equilibria depend; those of lengths nearby are kept."""
        if self._kept is not None:
            before, columns = self._kept
            if (np.abs(length - before) < KEPT_LENGTH_SHARE * length).all():
                return columns
        columns = np.zeros((len(length), sum(map(len, self.columns.values())), 0))
        if self.unknowns.moving:
            each = [self._slope(k, value, length, rest) for k in self.unknowns.moving]
            columns = np.stack(each, axis=2)
        self._kept = length, columns
        return columns

    def _slope(self, place: int, value: Array, length: Array, rest: statics.Equilibrium) -> Array:
        """Return the derivative of the residuals by one parameter, shape (K, m)."""
        before, after = (
            self._residual(robot, moved, length, found)
            for robot, moved, found in self._sides(place, value, length, rest)
        )
        return np.asarray((after - before) / (2.0 * self._parameter_step(place)))


def tension_noise(robot: Robot, reading: Array, settings: RestSettings) -> Array:
    """Return the noise of readings of load cells [N], shape (K, n)."""
    floor = TENSION_FLOOR_SHARE * robot.weight / robot.n
    return np.asarray(settings.tension_noise * np.maximum(np.abs(reading), floor))


def _moves(low: statics.Equilibrium, high: statics.Equilibrium) -> Array:
    """Return translations and rotation vectors in W from some poses to others, shape (K, 6)."""
    turn = Rotation.from_matrix(high.rotation @ low.rotation.swapaxes(1, 2)).as_rotvec()
    return np.concatenate([high.position - low.position, turn], axis=1)
