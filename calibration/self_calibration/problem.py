r"""Motor angles as a function of what is unknown.

The drum of cable i pays out, since the reference at which its motor angle is 0, by drum angle
:math:`\varphi` and with radius :math:`r_i` at the reference, build-up :math:`b_i` and advantage
:math:`\alpha_i`,

.. math:: L_i(\varphi) = L_{0,i} + (r_i \varphi - b_i \varphi^2 / 4) / \alpha_i,

and a straight cable to the platform at p has the length :math:`\ell_i(p)` (with the wrapped arc
where there is a pulley). Where the tension f is measured, line and run length R stretch by it,

.. math:: L^s_i = L_i + (L_i + R_i) f_i / EA_i;

otherwise cables are stiff. The residual is :math:`L^s_i(\varphi) - \ell_i(p)`.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calibration.linear_samples import LinearSamples
from calibration.observability import Unobservable
from calibration.self_calibration.motor_angles import MotorAngles
from calibration.self_calibration.reference import TIE_SIGMA_SHARE, tied_to_home
from calibration.self_calibration.settings import HOME, SelfCalibrationSettings
from calibration.self_calibration.shared_unknowns import shared_unknowns
from carosac_toolkit.base.arrays import Array, frozen_array
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.base.rotations import from_rotation_vector, left_jacobian
from carosac_toolkit.physics.cable.drum import drums_of
from carosac_toolkit.physics.cable.straight_line import straight_length
from carosac_toolkit.robot.robot import Robot

POINT_LIKE_SHARE = 0.02  # of the longest cable: cables that end that close end at one point
POSITION_PRIOR_FACTOR = (
    20.0  # times the longest cable: one standard deviation of a position before any data
)
DISTANCE_SLACK_SHARE = 0.2  # of the longest cable: distances so far from possible are mistakes
TURN_PRIOR_RAD = 1.0  # one standard deviation of a rotation vector before any data
FORGOTTEN_SIGMAS = 5.0  # factor of the sigmas of a prior that is left out: far, but no collapse
Rows = slice | NDArray[np.intp]


@dataclass(frozen=True, kw_only=True, eq=False)
class Before:
    """What priors and measured distances say of the shared unknowns, at some values of them.

    Attributes:
        information: Shape (m, m).
        gradient: Half the derivative of the cost, shape (m,).
        cost: Sum of squares in standard deviations.
    """

    information: Array
    gradient: Array
    cost: float


class MotorAngleProblem:
    """All samples; unknown are the positions and m numbers that they share.

    A platform whose cables end apart turns as it moves. Where lengths are to spare for it, its
    rotation is unknown as well: the position of each sample is followed by a rotation vector, from
    home's rotation [rad].

    The shared unknowns are the exit points (3 n), one error of the drum radius and one build-up
    for each group of alike drums, the lengths at the reference (n), and, where tensions are
    measured, the error of the compliance 1 / EA of each group of alike cables, as a share of it.

    Attributes:
        prior: Of the shared unknowns, m of them.
        file_prior: The same as the robot file has it.
        exits: Places of the exit points among them, shape (n, 3).
        radii: Place of each cable's radius error, shape (n,).
        buildups: Place of its build-up, shape (n,).
        zeros: Place of its length at the reference, shape (n,).
        compliances: Place of the error of its compliance, shape (n,); empty without tensions.
        advantage: Line paid out per length of cable, shape (n,).
        radius: Of the drums at the reference, as known before [m], shape (n,).
        own: Unknowns of each sample: 3, or 6 with its rotation.
        keeps_rotation: True if the platform has the rotation that it has at home.
        reach: One standard deviation of a sample's own unknowns before any data, shape (own,).
        home: Own unknowns at home, shape (own,).
        known_axes: True for each own unknown that is known, shape (N, own). Where no sample has
            some coordinate known, that of the reference is taken to be home's: see `reference`.
        known_position: Known ones, shape (N, own).
        known_sigma: One standard deviation of these, shape (N, own).
        is_known: Samples with a known coordinate, shape (N,).
        reference: Sample that is taken to be at home, and in which coordinates, or None.
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
            InvalidField: The robot file does not say how motor angle and length belong together,
                or a distance is between points that the robot lacks, or impossible.
            Unobservable: The origin cannot be put to home, as no sample was taken near there.
        """
        drums = drums_of(robot)
        self.robot, self.angles, self.settings = robot, angles, settings
        self.advantage = drums.advantage
        home = straight_length(robot, robot.home_position[None]).length[0]
        zero = home if settings.length_at_zero is None else settings.length_at_zero
        length = self._at_rest(frozen_array("length_at_zero", zero, (robot.n,)))
        turned = drums.motor_angle(length) / drums.gear
        self.radius = drums.radius - 0.5 * drums.buildup * turned
        self._drums = drums
        self._drum_angle = angles.motor_angle / drums.gear
        places = shared_unknowns(
            robot, drums, self.radius, length, settings, soft=angles.tension is not None
        )
        self.exits, self.radii, self.buildups = places.exits, places.radii, places.buildups
        self.zeros, self.compliances, self.prior = places.zeros, places.compliances, places.prior
        self.file_prior = self.prior
        spread = angles.known_sigma
        self._set_own()
        self.known_sigma = np.tile(settings.known_sigma, (len(angles.samples), 1))
        if spread is not None:
            known = angles.coordinates_known
            self.known_sigma[known] = spread[known]
        if settings.x_through is not None and settings.x_through not in robot.cable_names:
            allowed = f"one of {list(robot.cable_names)}"
            raise InvalidField("x_through", repr(settings.x_through), allowed)
        self._ends = [
            tuple(_end(robot, name) for name in (d.first, d.second)) for d in settings.distances
        ]
        self._check_distances()
        wound = self._unstrained(self.prior.mean, slice(None))
        self._friction_noise = (
            settings.friction_share / np.sqrt(3.0) * self.advantage
            * self._strain(self.prior.mean, slice(None)) * (wound + robot.run_length)
        )  # fmt: skip
        turned = wound - length
        self.reference = tied_to_home(angles, robot, self.prior, turned)
        turns = np.zeros((len(angles.samples), self.own - 3))
        self.known_axes = np.hstack([angles.coordinates_known, turns.astype(np.bool_)])
        self.known_position = np.hstack([angles.known_position, turns])
        self.known_sigma = np.hstack([self.known_sigma, turns + TIE_SIGMA_SHARE])
        if self.reference is not None:
            row, axes, sigma = self.reference.row, self.reference.axes, self.reference.sigma
            self.known_axes[row, :3] |= axes
            self.known_position[row, :3][axes] = robot.home_position[axes]
            self.known_sigma[row, :3][axes] = sigma
            # What of the rotation at home is a convention as well; known heights tell the rest.
            self.known_axes[row, 3:] = [axes.all(), axes.all(), axes[:2].all()][: self.own - 3]
        self.is_known: NDArray[np.bool_] = np.asarray(self.known_axes.any(axis=1))

    @property
    def size(self) -> int:
        """Number of shared unknowns m."""
        return len(self.prior.names)

    @property
    def longest(self) -> float:
        """Longest cable at the reference, as known before [m]."""
        return float(self.prior.mean[self.zeros].max())

    def turned(self, rotation: Array) -> MotorAngleProblem:
        """Return the same with the exit points known before turned about home.

        Args:
            rotation: That leaves all known coordinates where they are, shape (3, 3).
        """
        turn = np.eye(self.size)
        block = self.exits.ravel()
        turn[np.ix_(block, block)] = np.kron(np.eye(self.robot.n), rotation)
        mean = self.turned_values(rotation, self.prior.mean)
        other = copy(self)
        other.prior = replace(
            self.prior, mean=mean, covariance=turn @ self.prior.covariance @ turn.T
        )
        return other

    def turned_values(self, rotation: Array, shared: Array) -> Array:
        """Return shared unknowns (m,) with the exit points turned about home."""
        center = self.robot.home_position + self._not_turning
        new = shared.copy()
        new[self.exits] = (shared[self.exits] - center) @ rotation.T + center
        return new

    def without(
        self,
        *,
        places: NDArray[np.intp] | None = None,
        distance: int | None = None,
        cable: int | None = None,
    ) -> MotorAngleProblem:
        """Return the same as if some of what was known or measured were not.

        Args:
            places: Of shared unknowns whose prior is left out, but for `FORGOTTEN_SIGMAS`.
            distance: Number of the measured distance that is left out.
            cable: Number of the cable whose motor angles are left out: their noise is as large as
                the longest cable.
        """
        other = copy(self)
        if places is not None:
            scale = np.ones(self.size)
            scale[places] = FORGOTTEN_SIGMAS
            covariance = self.prior.covariance * np.outer(scale, scale)
            other.prior = replace(self.prior, covariance=covariance)
        if distance is not None:
            kept = [k for k in range(len(self._ends)) if k != distance]
            distances = tuple(self.settings.distances[k] for k in kept)
            other.settings = replace(self.settings, distances=distances)
            other._ends = [self._ends[k] for k in kept]
        if cable is not None:
            noise = np.broadcast_to(self._friction_noise, self.angles.motor_angle.shape).copy()
            noise[:, cable] = self.longest
            other._friction_noise = noise
        return other

    def line_noise(self, line_sigma: float) -> Array:
        """Return one standard deviation of the line by noise and friction [m], shape (N, n)."""
        return np.asarray(np.hypot(line_sigma, self._friction_noise))

    def before(self, shared: Array) -> Before:
        """Return what priors and measured distances say of the shared unknowns."""
        moved = shared - self.prior.mean
        pull = self.prior.information @ moved
        miss, slope = self.distances(shared)
        sigma = np.array([distance.sigma for distance in self.settings.distances])
        white, tilt = miss / sigma, slope / sigma[:, None]
        return Before(
            information=self.prior.information + tilt.T @ tilt,
            gradient=pull + tilt.T @ white,
            cost=float(moved @ pull + white @ white),
        )

    def distances(self, shared: Array) -> tuple[Array, Array]:
        """Return modelled less measured distances [m], (D,), and their derivative, (D, m)."""
        miss = np.zeros(len(self._ends))
        slope = np.zeros((len(self._ends), self.size))
        for k, (first, second) in enumerate(self._ends):
            ray = self._place(first, shared) - self._place(second, shared)
            length = float(np.linalg.norm(ray))
            miss[k] = length - self.settings.distances[k].length
            for end, sign in ((first, 1.0), (second, -1.0)):
                if end is not None:
                    slope[k, self.exits[end]] = sign * ray / max(length, 1e-12)
        return miss, slope

    def points(self, shared: Array) -> Array:
        """Return points in W [m], shape (n, 3): turning them and the positions changes no length.

        They are the exit points, less the anchor points at home's rotation where that is kept.
        """
        return np.asarray(shared[self.exits] - self._not_turning)

    @property
    def offsets(self) -> Array:
        """Anchor points at home's rotation, from the platform's origin [m], shape (n, 3)."""
        return np.asarray(self.robot.anchor_points @ self.robot.home_rotation.T)

    @property
    def _not_turning(self) -> Array:
        """Part of the exit points that stays as everything turns [m], shape (n, 3)."""
        return self.offsets if self.own == 3 else np.zeros_like(self.offsets)

    @property
    def spread(self) -> float:
        """Largest distance between the ends of two cables on the platform [m]."""
        return float(np.linalg.norm(self.offsets[:, None] - self.offsets, axis=2).max())

    def _place(self, end: int | None, shared: Array) -> Array:
        """Return an end of a distance [m], shape (3,): an exit point, or home."""
        return self.robot.home_position if end is None else shared[self.exits[end]]

    def linearize(self, shared: Array, position: Array, rows: Rows = slice(None)) -> LinearSamples:
        """Return residuals and their derivatives.

        Args:
            shared: Shape (m,).
            position: Own unknowns of the chosen samples, shape (N, own).
            rows: Chosen samples.
        """
        straight, direction = self.straight(shared, position)
        by_own = -direction
        if self.own == 6:
            moment = np.cross(self._arms(position), direction)
            by_own = np.concatenate([by_own, -moment @ left_jacobian(position[:, 3:])], axis=2)
        by_shared = self.wound_slope(shared, rows)
        for i in range(self.robot.n):
            by_shared[:, i, self.exits[i]] = direction[:, i]
        return LinearSamples(
            residual=self.wound(shared, rows) - straight,
            by_shared=by_shared,
            by_own=by_own,
        )

    def drum_radius(self, shared: Array) -> tuple[Array, Array]:
        """Return the radii at unstrained length 0 [m], (n,), and their derivative, (n, m).

        Raises:
            Unobservable: There is no such radius.
        """
        radius = self.radius + shared[self.radii]
        buildup, length = shared[self.buildups], shared[self.zeros]
        square = radius**2 + self.advantage * buildup * length
        if not (square > 0.0).all():
            i = int(np.argmin(square))
            raise Unobservable(
                f"the drum of {self.robot.cable_names[i]} comes out impossible: with a radius of "
                f"{radius[i]:g} m where {length[i]:g} m are out and a build-up of {buildup[i]:g} m "
                "it has no radius with all line wound in. Allowed: motors whose order, sign and "
                "gear are those of the robot file, more samples, or drums that are known better"
            )
        empty_radius = np.sqrt(square)
        slope = np.zeros((len(empty_radius), self.size))
        rows = np.arange(len(empty_radius))
        slope[rows, self.radii] = radius / empty_radius
        slope[rows, self.buildups] = 0.5 * self.advantage * length / empty_radius
        slope[rows, self.zeros] = 0.5 * self.advantage * buildup / empty_radius
        return empty_radius, slope

    def wound(self, shared: Array, rows: Rows = slice(None)) -> Array:
        """Return the lengths of the cables by their drums, stretched [m], shape (N, n)."""
        length, strain = self._unstrained(shared, rows), self._strain(shared, rows)
        return length + (length + self.robot.run_length) * strain

    def _unstrained(self, shared: Array, rows: Rows) -> Array:
        """Return the unstrained lengths of the cables by their drums [m], shape (N, n)."""
        drums = replace(
            self._drums,
            radius=self.radius + shared[self.radii],
            buildup=shared[self.buildups],
            gear=np.ones(self.robot.n),
        )
        return np.asarray(shared[self.zeros] + drums.length(self._drum_angle[rows]))

    def _strain(self, shared: Array, rows: Rows) -> Array:
        """Return the strains of the cables, shape (N, n); 0 where tensions are unknown."""
        if self.angles.tension is None:
            return np.zeros_like(self._drum_angle[rows])
        tension = self.angles.tension[rows]
        return np.asarray(tension * (1.0 + shared[self.compliances]) / self.robot.axial_stiffness)

    def wound_slope(self, shared: Array, rows: Rows = slice(None)) -> Array:
        """Return the derivative of `wound`, shape (N, n, m); without tensions it is linear."""
        angle = self._drum_angle[rows]
        count, n = angle.shape
        slope = np.zeros((count, n, self.size))
        for i in range(n):
            slope[:, i, self.radii[i]] = angle[:, i] / self.advantage[i]
            slope[:, i, self.buildups[i]] = -0.25 * angle[:, i] ** 2 / self.advantage[i]
            slope[:, i, self.zeros[i]] = 1.0
        if self.angles.tension is not None:
            slope *= (1.0 + self._strain(shared, rows))[:, :, None]
            soft = self.angles.tension[rows] / self.robot.axial_stiffness
            soft = soft * (self._unstrained(shared, rows) + self.robot.run_length)
            for i in range(n):
                slope[:, i, self.compliances[i]] = soft[:, i]
        return slope

    def straight(self, shared: Array, position: Array) -> tuple[Array, Array]:
        """Return the straight lengths (N, n) [m] and directions (N, n, 3), as `straight_length`.

        Only the vector from exit to anchor point matters: the platform moves instead of the exit
        points, so that one robot's buffers serve all calls.
        """
        exits, count = shared[self.exits], len(position)
        n = len(exits)
        moved = (position[:, :3] - (exits - self.robot.exit_points)[:, None, :]).reshape(-1, 3)
        rotation = np.tile(self.rotations(position), (n, 1, 1)) if self.own == 6 else None
        cables = straight_length(self.robot, moved, rotation)
        each = np.arange(n)
        length = cables.length.reshape(n, count, n)[each, :, each].T
        return length, cables.direction.reshape(n, count, n, 3)[each, :, each].swapaxes(0, 1)

    def rotations(self, position: Array) -> Array:
        """Return the rotations from P to W of own unknowns (N, own), shape (N, 3, 3)."""
        home = self.robot.home_rotation
        if self.own == 3:
            return np.tile(home, (len(position), 1, 1))
        return np.asarray(from_rotation_vector(position[:, 3:]) @ home)

    def _arms(self, position: Array) -> Array:
        """Return the anchor points from the platform's origin, in W [m], shape (N, n, 3)."""
        turn = from_rotation_vector(position[:, 3:])
        return np.asarray(self.offsets @ turn.swapaxes(1, 2))

    def _set_own(self) -> None:
        """Decide whether the rotation of each sample is unknown."""
        self.keeps_rotation = (
            self.settings.keeps_rotation or self.spread < POINT_LIKE_SHARE * self.longest
        )
        self.own = 3 if self.keeps_rotation or self.robot.n <= 6 else 6
        far = POSITION_PRIOR_FACTOR * self.longest
        self.reach = np.array([far] * 3 + [TURN_PRIOR_RAD] * 3)[: self.own]
        self.home = np.concatenate([self.robot.home_position, np.zeros(3)])[: self.own]

    def _check_distances(self) -> None:
        """Refuse distances that the lengths at home rule out, such as millimetres for metres."""
        prior, names = self.prior, self.robot.cable_names
        slack = DISTANCE_SLACK_SHARE * self.longest + self.spread
        for distance, ends in zip(self.settings.distances, self._ends, strict=True):
            cables = [end for end in ends if end is not None]
            home, sigma = prior.mean[self.zeros[cables]], prior.sigma[self.zeros[cables]]
            most = float(home.sum())
            least = most if len(cables) == 1 else float(abs(home[0] - home[1]))
            wide = slack + 4.0 * float(np.linalg.norm(sigma))
            if not least - wide <= distance.length <= most + wide:
                lengths = [f"{names[i]} {prior.mean[self.zeros[i]]:.3g} m" for i in cables]
                raise InvalidField(
                    f"distance {distance}",
                    f"{distance.length:g} m",
                    f"{max(least - wide, 0.0):.3g} to {most + wide:.3g} m by the lengths at home "
                    f"({', '.join(lengths)})",
                )

    def _at_rest(self, length: Array) -> Array:
        """Return the unstrained lengths at the reference of cables of these lengths [m], (n,)."""
        if self.angles.tension is None:
            return length
        row = int(np.argmin(np.abs(self.angles.motor_angle).max(axis=1)))
        strain = self.angles.tension[row] / self.robot.axial_stiffness
        return np.asarray((length - self.robot.run_length * strain) / (1.0 + strain))


def _end(robot: Robot, name: str) -> int | None:
    """Return the place of a cable by its name; None for home."""
    if name in robot.cable_names:
        return robot.cable_names.index(name)
    if name != HOME:
        allowed = f"one of {list(robot.cable_names)}, for its exit point, or {HOME!r}"
        raise InvalidField("end of a distance", repr(name), allowed)
    return None


def check_drums(robot: Robot) -> None:
    """Refuse a robot whose drums are unknown, before any work is done."""
    try:
        drums_of(robot)
    except InvalidField as error:
        allowed = f"{error.allowed} of {robot.name!r}, as in the bundled robot 'hangprinter'"
        raise InvalidField(error.field, error.value, allowed) from error
