"""What an identified model misses: sizes of its errors under which its residuals are likely.

The dynamic estimator claims a covariance. On lengths alone it is a sum over sources of error, each
with a size; with the noise of the measured poses it is the covariance of what an open-loop
simulation is off. Sizes are those of largest likelihood (variance components; Harville, *Journal of
the American Statistical Association* 72, 1977), with a wide prior about the usual ones where the
residuals cannot tell sources apart.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from baselines.dynamic_estimator.error_growth import SOURCES, ErrorGrowth, error_growth
from calibration.identification.error_noise import repeats_of
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.loop.consistency import normalised_square
from carosac_toolkit.recordings.encoders import calibrated
from carosac_toolkit.recordings.length_path import LengthPath
from carosac_toolkit.recordings.recording import Recording
from carosac_toolkit.robot.model_error import MODEL_ERROR_UNITS, ModelError
from carosac_toolkit.robot.robot import Robot

# Prior standard deviations of the logarithms: of what moves the platform, and of the poses' noise.
SOURCE_SPREAD, SENSOR_SPREAD = 2.0, 1.0
LOG_RATIO_MAX = 9.0  # of a size to the usual one: smaller or larger is none, or nonsense
FIELDS = tuple(MODEL_ERROR_UNITS)


@dataclass(frozen=True, kw_only=True, eq=False)
class Residuals:
    """Errors of a model at measured poses of a run.

    Attributes:
        growth: Of the covariance at these times.
        errors: Model minus measured position [m]; rotation vector of R_measured^T R_model in the
            axes of the platform [rad]; shape (K, 6).
        rotation: Measured, from P to W, shape (K, 3, 3).
    """

    growth: ErrorGrowth
    errors: Array
    rotation: Array

    @classmethod
    def of(
        cls, robot: Robot, recording: Recording, time: Array, errors: Array, rotation: Array
    ) -> Residuals:
        """Follow the covariance of a robot along a recording; see `Residuals`.

        Args:
            robot: As identified.
            recording: As it was recorded.
            time: Of the poses, increasing [s], shape (K,).
            errors: shape (K, 6).
            rotation: Measured, shape (K, 3, 3).

        Raises:
            CarosacError: The robot cannot hang on the lengths, or has no finite motion.
        """
        path, delay = LengthPath(calibrated(recording, robot)), robot.length_delay or 0.0
        growth = error_growth(robot, lambda when: path.at(np.asarray(when - delay)), time)
        return cls(growth=growth, errors=errors, rotation=rotation)

    @property
    def in_world(self) -> Array:
        """The errors with rotation vectors in W, shape (K, 6)."""
        turned = np.einsum("kij,kj->ki", self.rotation, self.errors[:, 3:])
        return np.hstack([self.errors[:, :3], turned])

    def rows(self, which: NDArray[np.int64]) -> Residuals:
        """Return the residuals at some of the times."""
        growth = ErrorGrowth(
            usual=self.growth.usual, always=self.growth.always[which],
            by_source=self.growth.by_source[:, which],
        )  # fmt: skip
        return Residuals(growth=growth, errors=self.errors[which], rotation=self.rotation[which])

    def parts(self) -> Array:
        """Return covariances by `FIELDS`, each of the usual size, shape (6, K, 6, 6)."""
        usual, count = self.growth.usual, len(self.errors)
        position, rotation = np.zeros((2, 6))
        position[:3], rotation[3:] = usual.position**2, usual.rotation**2
        poses = [np.tile(np.diag(part), (count, 1, 1)) for part in (position, rotation)]
        return np.concatenate([self.growth.by_source, np.stack(poses)])

    def nees(self, error: ModelError) -> float:
        """Return the normalised square of the errors per degree of freedom; 1 is honest."""
        ratio = np.array([getattr(error, f) / getattr(self.growth.usual, f) for f in FIELDS])
        claimed = self.growth.always + np.einsum("j,jkab->kab", ratio**2, self.parts())
        return float(normalised_square(self.in_world, claimed).mean())


def find_model_error(runs: Sequence[Residuals]) -> ModelError:
    """Return the sizes of errors under which residuals of runs of one robot are most likely."""
    from scipy.optimize import minimize

    errors = np.concatenate([run.in_world for run in runs])
    always = np.concatenate([run.growth.always for run in runs])
    parts = np.concatenate([run.parts() for run in runs], axis=1)
    repeats = float(repeats_of([run.errors for run in runs]).mean())
    spread = np.array([SOURCE_SPREAD if name in SOURCES else SENSOR_SPREAD for name in FIELDS])

    def cost(log: Array) -> tuple[float, Array]:
        ratio = np.exp(2.0 * log)
        claimed = always + np.einsum("j,jkab->kab", ratio, parts)
        inverse = np.linalg.inv(claimed)
        white = np.einsum("kab,kb->ka", inverse, errors)
        value = 0.5 * (np.linalg.slogdet(claimed)[1].sum() + (white * errors).sum())
        excess = np.einsum("kab,jkba->j", inverse, parts)
        excess -= np.einsum("ka,jkab,kb->j", white, parts, white)
        prior = log / spread
        return (
            float(value / repeats + 0.5 * prior @ prior),
            excess * ratio / repeats + prior / spread,
        )

    bounds = [(-LOG_RATIO_MAX, LOG_RATIO_MAX)] * len(FIELDS)
    starts = (np.zeros(len(FIELDS)), np.full(len(FIELDS), -2.0))
    found = [minimize(cost, at, jac=True, method="L-BFGS-B", bounds=bounds) for at in starts]
    best = min(found, key=lambda result: float(result.fun))
    usual = runs[0].growth.usual
    return ModelError(**{
        name: getattr(usual, name) * float(np.exp(log))
        for name, log in zip(FIELDS, best.x, strict=True)
    })  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class JudgedError:
    """What a model misses, and how honest that is.

    Attributes:
        error: The sizes.
        nees: Mean normalised square per degree of freedom; 1 is honest.
        trained_nees: The same of the residuals on which the sizes were found: below 1 where these
            are smaller than what estimators claim at the least.
    """

    error: ModelError
    nees: float
    trained_nees: float


def judge_model_error(trained: Sequence[Residuals], kept: Sequence[Residuals]) -> JudgedError:
    """Find the sizes on some residuals, and judge them on others, or on these if there are none."""
    error = find_model_error(trained)
    own = _mean_nees(trained, error)
    return JudgedError(error=error, nees=_mean_nees(kept, error) if kept else own, trained_nees=own)


def _mean_nees(runs: Sequence[Residuals], error: ModelError) -> float:
    """Return the mean normalised square of all errors of some runs."""
    counts = [len(run.errors) for run in runs]
    return float(np.average([run.nees(error) for run in runs], weights=counts))
