"""Calibrate the zeros of relative lengths at rests that nobody measured."""

from __future__ import annotations

from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from calibration.estimate import ParameterEstimate
from calibration.lengths.unknowns import LOOSE_OFFSET_SIGMA_M
from calibration.observability import Unobservable, judge
from calibration.rest_readings import rest_readings
from calibration.rests.blunders import (
    AS_GOOD_COST,
    MISFIT_USELESS,
    misfit_of,
    redundancy_of,
    sensor_blunders,
    without_blunders,
)
from calibration.rests.checks import check_observable, no_rests
from calibration.rests.fit import RestFit, first_lengths, fit
from calibration.rests.model import RestModel
from calibration.rests.result import RestCalibration
from calibration.rests.settings import RestSettings
from calibration.rests.start import RestStart, find_starts
from calibration.rests.unknowns import RestUnknowns, find_unknowns
from calibration.sensor_errors import SENSOR_UNITS, SENSOR_WORDS, SensorError
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.recordings.recording import Recording
from carosac_toolkit.robot.parameter_names import field_of
from carosac_toolkit.robot.robot import Robot

OFFSET_PLAUSIBLE_M = 0.05  # [m]: a scale for the judgement, no prior
BLUNDER_SHARE_MAX = 0.05  # of the readings of a sensor: more are hardly blunders
MISFIT_PROBABILITY = 1e-3  # of residuals as large as these
PRIOR_SIGMAS_MAX = 4.0  # a parameter that moved farther contradicts its prior
STARTS_MAX = 3  # different starts that are followed
START_COST_FACTOR_MAX = 3.0  # over that of the best one
SAME_SIGMAS = 0.5  # solutions nearer than this are one


@dataclass(frozen=True, kw_only=True, eq=False)
class _Search:
    """The best solution, and another one that fits as well, if there is one."""

    best: RestFit
    weight: NDArray[np.bool_]
    other: RestFit | None


def calibrate_rests(
    recording: Recording,
    robot: Robot,
    *,
    settings: RestSettings | None = None,
    start: int = 0,
    stop: int | None = None,
) -> RestCalibration:
    """Estimate the zeros of the lengths and the pose of every rest, with covariance.

    Args:
        recording: Lengths, relative or not, and what else the robot senses at some rests: load
            cells, AHRS or inclinometer, swivel angles. Poses are not used.
        robot: Before the calibration; covariances of its geometry are priors.
        settings: Noise and priors.
        start: First sample of length to use.
        stop: One past the last; None: to the end.

    Returns:
        The calibrated robot and what is known about it.

    Raises:
        InvalidField: Another number of cables, or a range outside the recording.
        Unobservable: The rests cannot tell where the platform was.
    """
    known = settings or RestSettings()
    recording.require_cables(robot)
    readings = rest_readings(recording.slice(start, stop))
    if not len(readings.time):
        raise Unobservable(no_rests(readings))
    relative = recording.metadata.length_kind == "relative"
    unknowns = find_unknowns(robot, readings, known, relative=relative)
    model = RestModel(unknowns, readings, known)
    began = perf_counter()
    starts = find_starts(robot, readings)
    check_observable(model, starts[0])
    search = _search(model, starts)
    return _result(model, search, recording, perf_counter() - began)


def _search(model: RestModel, starts: list[RestStart]) -> _Search:
    """Fit from the likeliest different starts, and leave blunders out."""
    first = first_lengths(model, starts[0])
    weight = np.ones(model.residual(*first).shape, dtype=np.bool_)
    best = fit(model, first, weight)
    others = []
    for start in _different(model, starts)[1:]:
        again = first_lengths(model, start)
        if again[2].converged.all():
            others.append(fit(model, again, weight))
    fits = sorted([best, *others], key=lambda one: one.cost)
    best = fits[0]
    zeros = model.unknowns.prior.rows("length_offset")
    as_good = [one for one in fits[1:] if one.cost < best.cost + AS_GOOD_COST]
    other = next((one for one in as_good if _apart(best, one, zeros)), None)
    best, weight = without_blunders(model, best, weight)
    return _Search(best=best, weight=weight, other=other)


def _different(model: RestModel, starts: list[RestStart]) -> list[RestStart]:
    """Return the first of each group of starts with the same zeros, the likeliest ones."""
    size = float(np.ptp(model.unknowns.robot.exit_points, axis=0).max())
    kept: list[RestStart] = []
    for start in starts:
        far = all(np.abs(start.offset - one.offset).max() > 0.01 * size for one in kept)
        if far and start.cost < START_COST_FACTOR_MAX * starts[0].cost:
            kept.append(start)
    return kept[:STARTS_MAX]


def _apart(one: RestFit, other: RestFit, zeros: NDArray[np.int64]) -> bool:
    """Return whether two solutions have other zeros of the lengths than their uncertainty says."""
    sigma = np.sqrt(np.diag(one.solution.covariance))[zeros]
    return bool((np.abs(one.value - other.value)[zeros] / sigma).max() > SAME_SIGMAS)


def _result(
    model: RestModel, search: _Search, recording: Recording, seconds: float
) -> RestCalibration:
    """Put the result together."""
    best, unknowns = search.best, model.unknowns
    redundancy, misfit = redundancy_of(best, search.weight), misfit_of(best, search.weight)
    improbable = bool(best.cost > chi2.isf(MISFIT_PROBABILITY, max(redundancy, 1)))
    inflation = misfit**2 if improbable else 1.0
    covariance = inflation * best.solution.covariance
    pose = inflation * best.solution.joint_covariance(
        *model.pose_derivatives(best.value, best.length, best.rest)
    )
    estimate = _estimate(unknowns, best.value, covariance)
    data = np.linalg.inv(best.solution.covariance) - unknowns.prior.information
    scale = np.minimum(
        unknowns.prior.sigma,
        [OFFSET_PLAUSIBLE_M if field_of(n) == "length_offset" else np.inf
         for n in unknowns.prior.names],
    )  # fmt: skip
    blunders = sensor_blunders(model, best, search.weight)
    result = RestCalibration(
        before=unknowns.robot,
        estimate=estimate,
        observability=judge(unknowns.prior.names, data, scale),
        time=model.readings.time,
        position=best.rest.position,
        rotation=best.rest.rotation,
        pose_covariance=pose,
        tension=best.rest.tension,
        residual={
            name: np.where(search.weight, best.linear.residual, np.nan)[:, columns]
            for name, columns in model.columns.items()
        },
        noise=model.noise,
        sensors=_sensors(unknowns, best.value, covariance),
        blunders=blunders,
        misfit=misfit,
        redundancy=redundancy,
        relative=recording.metadata.length_kind == "relative",
        single=model.readings.single,
        skipped=model.readings.skipped,
        unused=_unused(model, recording),
        converged=best.converged,
        useless=not best.converged or misfit > MISFIT_USELESS or search.other is not None,
        seconds=seconds,
    )
    return replace(result, warnings=tuple(_warnings(result, search, improbable)))


def _estimate(unknowns: RestUnknowns, value: Array, covariance: Array) -> ParameterEstimate:
    """Return the parameters that go into the robot."""
    count = len(unknowns.robot_names)
    prior = unknowns.prior.sigma[:count]
    return ParameterEstimate(
        names=unknowns.robot_names,
        value=value[:count],
        covariance=covariance[:count, :count],
        start=unknowns.prior.mean[:count],
        prior_sigma=np.where(prior >= LOOSE_OFFSET_SIGMA_M, np.inf, prior),
    )


def _sensors(unknowns: RestUnknowns, value: Array, covariance: Array) -> tuple[SensorError, ...]:
    """Return the errors of the other sensors."""
    sigma = np.sqrt(np.diag(covariance))
    return tuple(
        SensorError(
            name=name,
            unit=SENSOR_UNITS[field_of(name)],
            value=float(value[k]),
            sigma=float(sigma[k]),
            prior_sigma=float(unknowns.prior.sigma[k]),
        )
        for k, name in enumerate(unknowns.prior.names)
        if k >= len(unknowns.robot_names)
    )


def _unused(model: RestModel, recording: Recording) -> tuple[str, ...]:
    """Say which measurements are not used, and why."""
    lines = []
    if recording.poses is not None:
        lines.append("measured poses are not used")
    if model.readings.inclination is not None and model.readings.attitude is not None:
        lines.append("the inclinometer is not used, as there is an AHRS")
    if recording.swivel_angle is not None and not len(model.pulleys):
        lines.append("swivel angles are not used, as the robot has no pulleys")
    return tuple(lines)


def _what(result: RestCalibration) -> str:
    """Say what large residuals may mean."""
    if result.misfit > MISFIT_USELESS:
        return "are the units, the order of the cables and the signs of the angles right?"
    size = {name: float(np.sqrt(np.nanmean(x**2))) for name, x in result.residual.items()}
    worst = max(size, key=lambda name: size[name])
    return (
        f"the noise is larger, that of {SENSOR_WORDS[worst][0]} above all, or the model lacks an "
        "effect."
    )


def _warnings(result: RestCalibration, search: _Search, improbable: bool) -> list[str]:
    """Return what must not be overlooked."""
    lines = []
    if not result.converged:
        lines.append(
            "The fit did not settle: often what was known before, such as exit points, contradicts "
            "the readings."
        )
    if search.other is not None:
        away = float(np.linalg.norm(search.other.rest.position[0] - result.position[0]))
        lines.append(
            f"Another solution, {1e3 * away:.0f} mm away at the first rest, fits as well: record "
            "more rests or sensors."
        )
    if improbable:
        lines.append(
            f"Residuals are {result.misfit:.1f} times as large as the noise of the sensors says: "
            f"{_what(result)} All sigmas are that much wider."
        )
    moved = np.concatenate(
        [np.abs(result.estimate.moved), [abs(s.value) / s.prior_sigma for s in result.sensors]]
    )
    names = [*result.estimate.names, *(sensor.name for sensor in result.sensors)]
    far = np.flatnonzero(moved > PRIOR_SIGMAS_MAX)
    if len(far):
        worst = ", ".join(f"{names[k]} ({moved[k]:.0f})" for k in far[np.argsort(-moved[far])][:4])
        lines.append(
            f"{len(far)} parameters moved by more than {PRIOR_SIGMAS_MAX:g} of their prior "
            f"standard deviations, such as {worst}: their priors are too tight, or the model lacks "
            "an effect."
        )
    for name, residual in result.residual.items():
        share = float(np.isnan(residual).mean())
        if share > BLUNDER_SHARE_MAX:
            lines.append(
                f"{share:.0%} of the readings of {SENSOR_WORDS[name][0]} were left out as blunders."
            )
    return lines
