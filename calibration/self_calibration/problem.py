r"""Motor angles as a function of what is unknown.

The drum of cable i pays out, since the reference at which its motor angle is 0, by drum angle
:math:`\varphi` and with radius :math:`r_i` at the reference, build-up :math:`b_i` and advantage
:math:`\alpha_i`,

.. math:: L_i(\varphi) = L_{0,i} + (r_i \varphi - b_i \varphi^2 / 4) / \alpha_i,

and a straight stiff cable to the platform at p has the length :math:`\ell_i(p)` (with the wrapped
arc where there is a pulley). The residual is :math:`L_i(\varphi) - \ell_i(p)`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from calibration.linear_samples import LinearSamples
from calibration.prior import Prior
from calibration.robot_update import prior_covariance
from calibration.self_calibration.motor_angles import MotorAngles
from calibration.self_calibration.settings import SelfCalibrationSettings
from carosac_toolkit.base.arrays import Array, frozen_array
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.physics.cable.drum import drums_of
from carosac_toolkit.physics.cable.straight_line import straight_length
from carosac_toolkit.robot.parameter_names import point_names
from carosac_toolkit.robot.robot import Robot

LENGTH_AT_ZERO_SIGMA_M = 0.02  # as measured by hand
DRUM_RADIUS_SIGMA_M = 2e-3  # alike drums are wrong by the same
DRUM_BUILDUP_SIGMA_SHARE = 0.15  # of the build-up
ALIKE_RADIUS_M = 2e-5  # [m] between the radii of drums that are of one make
Rows = slice | NDArray[np.intp]


class MotorAngleProblem:
    """All samples; unknown are the positions and m numbers that they share.

    The shared unknowns are the exit points (3 n), one error of the drum radius and one build-up
    for each group of alike drums, and the lengths at the reference (n).

    Attributes:
        prior: Of the shared unknowns, m of them.
        exits: Places of the exit points among them, shape (n, 3).
        radii: Place of each cable's radius error, shape (n,).
        buildups: Place of its build-up, shape (n,).
        zeros: Place of its length at the reference, shape (n,).
        advantage: Line paid out per length of cable, shape (n,).
        radius: Of the drums at the reference, as known before [m], shape (n,).
        known_sigma: Of known positions [m], shape (N, 3).
    """

    def __init__(
        self, robot: Robot, angles: MotorAngles, settings: SelfCalibrationSettings
    ) -> None:
        """Set up.

        Args:
            robot: As known before.
            angles: N samples, the motors in the order of the robot's cables.
            settings: Priors.

        Raises:
            InvalidField: The robot file does not say how motor angle and length belong together.
        """
        drums = drums_of(robot)
        self.robot, self.angles = robot, angles
        self.advantage = drums.advantage
        home = straight_length(robot, robot.home_position[None]).length[0]
        zero = home if settings.length_at_zero is None else settings.length_at_zero
        length = frozen_array("length_at_zero", zero, (robot.n,))
        turned = drums.motor_angle(length) / drums.gear
        self.radius = drums.radius - 0.5 * drums.buildup * turned
        self._drums = drums
        self._drum_angle = angles.motor_angle / drums.gear
        self._set_places(_alike(drums.radius, self.radius, self._makes()))
        mean = [robot.exit_points.ravel(), np.zeros(self._groups), np.array(self._buildups), length]
        self.prior = self._prior(np.concatenate(mean), settings)
        spread = angles.known_sigma
        self.known_sigma = np.tile(settings.known_sigma, (len(angles.samples), 1))
        if spread is not None:
            self.known_sigma[angles.is_known] = spread[angles.is_known]

    @property
    def size(self) -> int:
        """Number of shared unknowns m."""
        return len(self.prior.names)

    @property
    def longest(self) -> float:
        """Longest cable at the reference, as known before [m]."""
        return float(self.prior.mean[self.zeros].max())

    def linearize(self, shared: Array, position: Array, rows: Rows = slice(None)) -> LinearSamples:
        """Return residuals and their derivatives.

        Args:
            shared: Shape (m,).
            position: Of the chosen samples [m], shape (N, 3).
            rows: Chosen samples.
        """
        angle = self._drum_angle[rows]
        count, n = angle.shape
        straight, direction = self.straight(shared, position)
        by_shared = np.zeros((count, n, self.size))
        for i in range(n):
            by_shared[:, i, self.exits[i]] = direction[:, i]
            by_shared[:, i, self.radii[i]] = angle[:, i] / self.advantage[i]
            by_shared[:, i, self.buildups[i]] = -0.25 * angle[:, i] ** 2 / self.advantage[i]
            by_shared[:, i, self.zeros[i]] = 1.0
        return LinearSamples(
            residual=self.wound(shared, rows) - straight,
            by_shared=by_shared,
            by_own=-direction,
        )

    def drum_radius(self, shared: Array) -> tuple[Array, Array]:
        """Return the radii at unstrained length 0 [m], (n,), and their derivative, (n, m)."""
        radius = self.radius + shared[self.radii]
        buildup, length = shared[self.buildups], shared[self.zeros]
        empty_radius = np.sqrt(radius**2 + self.advantage * buildup * length)
        slope = np.zeros((len(empty_radius), self.size))
        rows = np.arange(len(empty_radius))
        slope[rows, self.radii] = radius / empty_radius
        slope[rows, self.buildups] = 0.5 * self.advantage * length / empty_radius
        slope[rows, self.zeros] = 0.5 * self.advantage * buildup / empty_radius
        return empty_radius, slope

    def wound(self, shared: Array, rows: Rows = slice(None)) -> Array:
        """Return the lengths of the cables by their drums [m], shape (N, n)."""
        drums = replace(
            self._drums,
            radius=self.radius + shared[self.radii],
            buildup=shared[self.buildups],
            gear=np.ones(self.robot.n),
        )
        return np.asarray(shared[self.zeros] + drums.length(self._drum_angle[rows]))

    def straight(self, shared: Array, position: Array) -> tuple[Array, Array]:
        """Return the straight lengths (N, n) [m] and directions (N, n, 3), as `straight_length`.

        Only the vector from exit to anchor point matters: the platform moves instead of the exit
        points, so that one robot's buffers serve all calls.
        """
        exits, count = shared[self.exits], len(position)
        n = len(exits)
        moved = (position - (exits - self.robot.exit_points)[:, None, :]).reshape(-1, 3)
        cables = straight_length(self.robot, moved)
        each = np.arange(n)
        length = cables.length.reshape(n, count, n)[each, :, each].T
        return length, cables.direction.reshape(n, count, n, 3)[each, :, each].swapaxes(0, 1)

    def _makes(self) -> list[tuple[float, ...]]:
        """Return what drums of one make have in common."""
        drums = self._drums
        return list(zip(drums.gear, drums.advantage, drums.buildup, strict=True))

    def _set_places(self, group: Sequence[int]) -> None:
        """Give each unknown its place and its name."""
        n = self.robot.n
        cables = self.robot.cable_names
        self._groups = max(group) + 1
        self._buildups = sorted(set(self._drums.buildup.tolist()))
        of_buildup = [self._buildups.index(b) for b in self._drums.buildup.tolist()]
        self.exits = np.arange(3 * n).reshape(n, 3)
        self.radii = 3 * n + np.array(group)
        self.buildups = 3 * n + self._groups + np.array(of_buildup)
        self.zeros = 3 * n + self._groups + len(self._buildups) + np.arange(n)
        self._names = (
            *point_names("exit_points", cables),
            *(f"drum_radius[{_joined(cables, group, g)}]" for g in range(self._groups)),
            *(f"drum_buildup[{_joined(cables, of_buildup, g)}]"
              for g in range(len(self._buildups))),
            *(f"length_at_zero[{cable}]" for cable in cables),
        )  # fmt: skip

    def _prior(self, mean: Array, settings: SelfCalibrationSettings) -> Prior:
        """Return what the robot file and the settings say of the shared unknowns."""
        exits = self._names[: self.exits.size]
        sigma = np.full(len(mean), LENGTH_AT_ZERO_SIGMA_M)
        sigma[: len(exits)] = settings.exit_sigma
        sigma[self.radii] = DRUM_RADIUS_SIGMA_M
        sigma[self.buildups] = DRUM_BUILDUP_SIGMA_SHARE * np.maximum(mean[self.buildups], 1e-9)
        covariance = np.diag(sigma**2)
        block = slice(0, len(exits))
        covariance[block, block] = prior_covariance(self.robot, exits, sigma[block])
        return Prior(names=self._names, mean=mean, covariance=covariance)


def _alike(empty: Array, reference: Array, makes: Sequence[tuple[float, ...]]) -> list[int]:
    """Group drums of one make: the same radius with all line wound in, or at the reference."""
    group: list[int] = []
    for i in range(len(makes)):
        for j in range(i):
            same = min(abs(empty[i] - empty[j]), abs(reference[i] - reference[j])) < ALIKE_RADIUS_M
            if makes[i] == makes[j] and same:
                group.append(group[j])
                break
        else:
            group.append(max(group, default=-1) + 1)
    return group


def _joined(cables: Sequence[str], group: Sequence[int], g: int) -> str:
    """Return the cables of one group."""
    return ", ".join(name for name, mine in zip(cables, group, strict=True) if mine == g)


def check_drums(robot: Robot) -> None:
    """Refuse a robot whose drums are unknown, before any work is done."""
    try:
        drums_of(robot)
    except InvalidField as error:
        allowed = f"{error.allowed} of {robot.name!r}, as in the bundled robot 'hangprinter'"
        raise InvalidField(error.field, error.value, allowed) from error
