"""The survey as a gtsam factor graph: one stacked factor for each set-up, one for each known point.

Rows of the adjustment are in a fixed order: Hz, V and distance of shot 0, of shot 1, ...; then x, y
and z of each known reference. They can be weighted one by one, so that a wrong distance does not
take a good direction with it. Priors (compensator, swivels, frame tilt, exit points) stand last and
are never weighted.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calibration.tachymeter.model import STATION_SIZE, difference, predict
from calibration.tachymeter.observations import ReferencePoint, Shot, Survey
from calibration.tachymeter.sightings import SightedPoint, SightedPulley, sighted_point
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.rotations import cross_matrix

Blocks = dict[int, Array]  # Jacobian blocks by key
_UNKNOWN_SIZES = {
    "s": STATION_SIZE,
    "p": 3,
    "w": 1,
    "t": 2,
}  # of the unknowns, by the letter of their keys


@dataclass(frozen=True, kw_only=True, eq=False)
class Network:
    """Unknowns and measurements of an adjustment.

    Attributes:
        survey: All that was measured.
        pulleys: Pulleys of which a point off the datum was sighted, by cable.
        sides: On which side of its wheel each shot was taken, 1 or -1, one for each shot.
        exit_prior: Position [m], (3,), and covariance [m^2], (3, 3), known before, by cable.
        frame_tilt: Standard deviation of the tilt of the references' frame against W, about x and
            about y [rad]; 0: their frame is W.
    """

    survey: Survey
    sides: tuple[float, ...]
    pulleys: Mapping[str, SightedPulley] = field(default_factory=dict)
    exit_prior: Mapping[str, tuple[Array, Array]] = field(default_factory=dict)
    frame_tilt: float = 0.0

    @cached_property
    def reading(self) -> Array:
        """Hz, V, distance of every shot, shape (shots, 3)."""
        return self.survey.reading

    @cached_property
    def sigma(self) -> Array:
        """Standard deviation of every weighted row, shape (m,)."""
        shots = self.survey.instrument.sigma(self.reading).ravel()
        known = [ref.sigma for ref in self.survey.known if ref.sigma is not None]
        return np.concatenate([shots, *known])

    @cached_property
    def keys(self) -> dict[str, int]:
        """Keys of all unknowns by name: set-ups, points, swivels, tilt."""
        keys = {f"setup {name}": _key("s", i) for i, name in enumerate(self.survey.setups)}
        keys |= {f"point {name}": _key("p", i) for i, name in enumerate(self.survey.targets)}
        keys |= {f"swivel {name}": _key("w", i) for i, name in enumerate(self.pulleys)}
        return keys | ({"tilt": _key("t", 0)} if self.frame_tilt > 0.0 else {})

    @cached_property
    def columns(self) -> dict[str, slice]:
        """Columns of each unknown in the dense Jacobian, in the order of `keys`."""
        columns, start = {}, 0
        for name, key in self.keys.items():
            columns[name] = slice(start, start + _size(key))
            start += _size(key)
        return columns

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return int(list(self.columns.values())[-1].stop)

    @property
    def prior_rows(self) -> int:
        """Rows of the priors, which are never weighted."""
        tilts = 2 * len(self.survey.setups) + (2 if self.frame_tilt > 0.0 else 0)
        return tilts + len(self.pulleys) + 3 * len(self.exit_prior)

    def graph(self, weight: Array) -> Any:
        """Build the factor graph.

        Args:
            weight: Of every weighted row, 0 to 1, shape (m,).

        Returns:
            A ``gtsam.NonlinearFactorGraph``.
        """
        import gtsam

        graph = gtsam.NonlinearFactorGraph()
        scale = np.sqrt(weight) / self.sigma
        for name in self.survey.setups:
            graph.add(self._setup_factor(name, scale))
        first = 3 * len(self.survey.shots)
        for k, reference in enumerate(self.survey.known):
            graph.add(self._reference_factor(reference, scale[first + 3 * k : first + 3 * k + 3]))
        compensator = self.survey.instrument.compensator
        for name in self.survey.setups:
            graph.add(_level_factor(self.keys[f"setup {name}"], compensator))
        for name in self.pulleys:
            noise = gtsam.noiseModel.Isotropic.Sigma(1, self.survey.swivel_sigma)
            key = self.keys[f"swivel {name}"]
            graph.add(gtsam.PriorFactorVector(key, np.zeros(1), noise))
        if self.frame_tilt > 0.0:
            noise = gtsam.noiseModel.Isotropic.Sigma(2, self.frame_tilt)
            graph.add(gtsam.PriorFactorVector(self.keys["tilt"], np.zeros(2), noise))
        for name, (position, covariance) in self.exit_prior.items():
            key = self.keys[f"point {name}"]
            full = gtsam.noiseModel.Gaussian.Covariance(covariance)
            graph.add(gtsam.PriorFactorVector(key, position, full))
        return graph

    def dense(self, values: Any) -> tuple[Array, Array]:
        """Return whitened, unweighted Jacobian and residual (model minus measured) at an estimate.

        Args:
            values: ``gtsam.Values``.

        Returns:
            Jacobian, shape (m + priors, size), and residual, shape (m + priors,), in the fixed
            order of rows.
        """
        import gtsam

        ordering = gtsam.Ordering()
        for key in self.keys.values():
            ordering.push_back(key)
        jacobian, right = self.graph(np.ones(len(self.sigma))).linearize(values).jacobian(ordering)
        shots = self.survey.shots
        stacked = [i for name in self.survey.setups for i in _of(shots, name)]
        rows = np.arange(len(right))
        place = (3 * np.array(stacked)[:, None] + np.arange(3)).ravel()
        order = rows.copy()
        order[place] = rows[: len(place)]
        return np.asarray(jacobian)[order], -np.asarray(right)[order]

    def sighted(self, i: int, point: Array, swivel: float) -> SightedPoint:
        """Return the sighted point of shot i, from the point of its target, both in W [m], (3,)."""
        shot = self.survey.shots[i]
        if not shot.sighting.on_pulley:
            return SightedPoint(point=point, by_exit=np.eye(3), by_swivel=np.zeros(3))
        return sighted_point(point, shot.sighting, self.pulleys[shot.target], swivel, self.sides[i])

    def _setup_factor(self, name: str, scale: Array) -> Any:
        """Return the factor of all shots of one set-up."""
        rows = _of(self.survey.shots, name)
        shots = [self.survey.shots[i] for i in rows]
        measured = self.reading[rows]
        factor_scale = scale[(3 * rows[:, None] + np.arange(3)).ravel()].reshape(-1, 3)
        targets = list(dict.fromkeys(shot.target for shot in shots))
        swivels = [
            target for target in targets
            if any(shot.target == target and shot.sighting.on_pulley for shot in shots)
        ]  # fmt: skip
        keys = [
            self.keys[f"setup {name}"],
            *(self.keys[f"point {target}"] for target in targets),
            *(self.keys[f"swivel {target}"] for target in swivels),
        ]

        def error(_: Any, values: Any, jacobians: list[Array] | None) -> Array:
            station = values.atVector(keys[0])
            sights = [
                self.sighted(
                    int(i),
                    values.atVector(self.keys[f"point {shot.target}"]),
                    self._swivel(values, shot),
                )
                for i, shot in zip(rows, shots, strict=True)
            ]
            prediction = predict(station, np.array([sight.point for sight in sights]))
            residual = -difference(measured.copy(), prediction.reading) * factor_scale
            if jacobians is not None:
                blocks = {key: np.zeros((3 * len(shots), _size(key))) for key in keys}
                blocks[keys[0]][:] = prediction.by_station.reshape(-1, STATION_SIZE)
                for i, (shot, sight) in enumerate(zip(shots, sights, strict=True)):
                    self._add_shot(blocks, i, shot, sight, prediction.by_point[i])
                for i, key in enumerate(keys):
                    whitened = blocks[key] * factor_scale.ravel()[:, None]
                    jacobians[i] = np.asfortranarray(whitened)
            return np.asarray(residual.ravel())

        return _custom(keys, 3 * len(shots), error)

    def _add_shot(
        self, blocks: Blocks, i: int, shot: Shot, sight: SightedPoint, by_point: Array
    ) -> None:
        """Add derivatives of shot i of a factor with respect to its target and swivel."""
        rows = slice(3 * i, 3 * i + 3)
        blocks[self.keys[f"point {shot.target}"]][rows] = by_point @ sight.by_exit
        if shot.sighting.on_pulley:
            blocks[self.keys[f"swivel {shot.target}"]][rows, 0] = by_point @ sight.by_swivel

    def _swivel(self, values: Any, shot: Shot) -> float:
        """Return the swivel angle of the pulley that a shot sights [rad]."""
        if not shot.sighting.on_pulley:
            return 0.0
        return float(values.atVector(self.keys[f"swivel {shot.target}"])[0])

    def _reference_factor(self, reference: ReferencePoint, scale: Array) -> Any:
        """Return the factor of a known point's coordinates, in a frame that may be tilted."""
        known = np.asarray(reference.position)
        keys = [self.keys[f"point {reference.name}"]]
        keys += [self.keys["tilt"]] if self.frame_tilt > 0.0 else []

        def error(_: Any, values: Any, jacobians: list[Array] | None) -> Array:
            turned, slope = known, np.zeros((3, 2))
            if len(keys) > 1:
                turned, slope = tilted(known, values.atVector(keys[1]))
            if jacobians is not None:
                jacobians[0] = np.asfortranarray(np.diag(scale))
                if len(keys) > 1:
                    jacobians[1] = np.asfortranarray(-scale[:, None] * slope)
            return np.asarray((values.atVector(keys[0]) - turned) * scale)

        return _custom(keys, 3, error)


def tilted(point: Array, tilt: Array) -> tuple[Array, Array]:
    """Turn a point by a rotation vector in the x-y plane.

    Args:
        point: [m], shape (3,).
        tilt: About x and about y [rad], shape (2,).

    Returns:
        The turned point, shape (3,), and its derivative by the tilt, shape (3, 2).
    """
    vector = np.array([tilt[0], tilt[1], 0.0])
    angle = float(np.linalg.norm(vector))
    cross = cross_matrix(vector)
    first, second = 0.5, 1.0 / 6.0
    if angle > 1e-4:
        first, second = (1.0 - np.cos(angle)) / angle**2, (angle - np.sin(angle)) / angle**3
    left = np.eye(3) + first * cross + second * cross @ cross
    turned: Array = Rotation.from_rotvec(vector).as_matrix() @ point
    return turned, (-cross_matrix(turned) @ left)[:, :2]


def _custom(keys: list[int], rows: int, error: Callable[..., Array]) -> Any:
    """Return a factor whose error is whitened already."""
    import gtsam

    return gtsam.CustomFactor(gtsam.noiseModel.Unit.Create(rows), keys, error)


def _level_factor(key: int, sigma: float) -> Any:
    """Return the prior of the tilt that a compensator leaves."""

    def error(_: Any, values: Any, jacobians: list[Array] | None) -> Array:
        if jacobians is not None:
            selected = np.zeros((2, STATION_SIZE))
            selected[[0, 1], [4, 5]] = 1.0 / sigma
            jacobians[0] = np.asfortranarray(selected)
        return np.asarray(values.atVector(key)[4:] / sigma)

    return _custom([key], 2, error)


def _key(letter: str, index: int) -> int:
    import gtsam

    return int(gtsam.symbol(letter, index))


def _size(key: int) -> int:
    """Return the dimension of an unknown."""
    import gtsam

    return _UNKNOWN_SIZES[chr(gtsam.symbolChr(key))]


def _of(shots: tuple[Shot, ...], setup: str) -> NDArray[np.intp]:
    """Return the indices of the shots of a set-up."""
    return np.flatnonzero([shot.setup == setup for shot in shots])
