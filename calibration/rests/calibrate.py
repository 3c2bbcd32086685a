"""Calibrate the zeros of relative lengths at rests that nobody measured."""

from __future__ import annotations

from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from calibration.estimate import ParameterEstimate
from calibration.lengths.unknowns import LOOSE_OFFSET_SIGMA_M
from calibration.normal_equations import solve
from calibration.observability import Unobservable, judge
from calibration.rests.fit import RestFit, first_lengths, fit
from calibration.rests.model import RestModel
from calibration.rests.readings import RestReadings, rest_readings
from calibration.rests.result import (
    SENSOR_WORDS,
    RestCalibration,
    SensorBlunder,
    SensorError,
)
from calibration.rests.settings import RestSettings
from calibration.rests.start import RestStart, find_starts
from calibration.rests.unknowns import SENSOR_UNITS, RestUnknowns, find_unknowns
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.recordings.recording import Recording
from carosac_toolkit.robot.parameter_names import field_of
from carosac_toolkit.robot.robot import Robot

POSE_SIGMA_SHARE_MAX = 0.02  # of the size of the frame: a first rest known worse is not known
OFFSET_PLAUSIBLE_M = 0.05  # [m]: a scale for the judgement, no prior
BLUNDER_SIGMAS = 4.5  # farther residuals are blunders
BLUNDER_OF_WORST = 0.5  # of the largest one: smaller ones may be its work, and wait
BLUNDER_ROUNDS_MAX = 8
BLUNDER_ROUNDS_MIN = 2  # after which the rest of the readings should fit
BLUNDER_SHARE_MAX = 0.05  # of the readings of a sensor: more are hardly blunders
REDUNDANCY_MIN = 1e-4  # residuals with less show no blunder beside rounding
MISFIT_PROBABILITY = 1e-3  # of residuals as large as these
MISFIT_USELESS = 3.0  # times as large as their noise: the result is of no use
PRIOR_SIGMAS_MAX = 4.0  # a parameter that moved farther contradicts its prior
STARTS_MAX = 3  # different starts that are followed
START_COST_FACTOR_MAX = 3.0  # over that of the best one
AS_GOOD_COST = 9.0  # a solution whose squares sum up to so much more fits as well
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
        raise Unobservable(_no_rests(readings))
    relative = recording.metadata.length_kind == "relative"
    unknowns = find_unknowns(robot, readings, known, relative=relative)
    model = RestModel(unknowns, readings, known)
    began = perf_counter()
    starts = find_starts(robot, readings)
    _check_observable(model, starts[0])
    search = _search(model, starts)
    return _result(model, search, recording, perf_counter() - began)


def _no_rests(readings: RestReadings) -> str:
    """Say why there is no rest to use."""
    if readings.skipped:
        names = " and ".join(readings.skipped)
        return f"no rest has samples of all sensors: {names} lack some"
    return "the winches never rest: record poses of rest, each at least half a second long"


def _check_observable(model: RestModel, start: RestStart) -> None:
    """Refuse rests that leave the pose of the first one unknown."""
    value, length, rest = first_lengths(model, start)
    robot, count = model.unknowns.robot, len(length)
    if not rest.converged.all():
        bad = int((~rest.converged).sum())
        raise Unobservable(
            f"robot {robot.name} cannot rest at {bad} of the {count} rests with the lengths that "
            "fit best: are robot, units, order of the cables and signs of the angles right?"
        )
    prior = model.unknowns.prior
    linear = model.linear(value, length, rest)
    solution = solve(linear, prior.information, np.zeros(len(value)))
    covariance = solution.joint_covariance(*model.pose_derivatives(value, length, rest))[0]
    values, vectors = np.linalg.eigh(covariance[:3, :3])
    limit = POSE_SIGMA_SHARE_MAX * float(np.ptp(robot.exit_points, axis=0).max())
    sigma = float(np.sqrt(values[-1]))
    if sigma <= limit:
        return
    sensors = ", ".join(name.replace("_", " ") + "s" for name in model.columns)
    missing = [
        words
        for name, words in (
            ("tension", "load cells"), ("attitude", "an AHRS"), ("swivel_angle", "swivel angles"),
        )
        if name not in model.columns
    ]  # fmt: skip
    unknown = (
        "by more than the frame is wide"
        if sigma > limit / POSE_SIGMA_SHARE_MAX
        else (
            f"by {1e3 * sigma:.0f} mm along {np.array2string(np.abs(vectors[:, -1]), precision=2)}"
        )
    )
    advice = "record more rests, spread over the whole workspace" + (
        f", or {' or '.join(missing)}" if missing else ""
    )
    raise Unobservable(
        f"{count} rests with {sensors} leave the first pose unknown {unknown}, and nothing else "
        f"measures it:\n  {advice}, or measure poses"
    )


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
    other = next(
        (one for one in fits[1:] if one.cost < best.cost + AS_GOOD_COST and _apart(best, one)), None
    )
    best, weight = _without_blunders(model, best, weight)
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


def _apart(one: RestFit, other: RestFit) -> bool:
    """Return whether two solutions differ by more than their uncertainty."""
    sigma = np.sqrt(np.diag(one.solution.covariance))
    return bool((np.abs(one.value - other.value) / sigma).max() > SAME_SIGMAS)


def _without_blunders(
    model: RestModel, best: RestFit, weight: NDArray[np.bool_]
) -> tuple[RestFit, NDArray[np.bool_]]:
    """Leave blunders out, the worst ones of all rests, and fit again (data snooping).

    Of a rest, readings of which one as well as the other may be the blunder are all left out.
    """
    turning = model.columns.get("attitude", model.columns.get("inclination", np.zeros(0, int)))
    for round_ in range(BLUNDER_ROUNDS_MAX):
        if round_ >= BLUNDER_ROUNDS_MIN and _misfit(best, weight) > MISFIT_USELESS:
            break  # these are no blunders
        deviation = np.where(weight, _deviation(best), 0.0)
        size = deviation.max(axis=1, keepdims=True)
        out = size > max(BLUNDER_SIGMAS, BLUNDER_OF_WORST * float(size.max()))
        out = out & (deviation**2 > size**2 - AS_GOOD_COST) & (deviation > BLUNDER_SIGMAS)
        if not out.any():
            break
        out[:, turning] = out[:, turning].any(axis=1, keepdims=True)
        weight = weight & ~out
        best = fit(model, (best.value, best.length, best.rest), weight)
    return best, weight


def _misfit(best: RestFit, weight: NDArray[np.bool_]) -> float:
    """Return the size of the residuals over that which their noise lets expect."""
    return float(np.sqrt(best.cost / max(_redundancy(best, weight), 1)))


def _redundancy(best: RestFit, weight: NDArray[np.bool_]) -> int:
    """Return the number of readings beyond those that the unknowns take."""
    return int(weight.sum()) - best.length.size


def _deviation(best: RestFit) -> Array:
    """Return sizes of residuals in their own standard deviations, shape (K, m).

    They are nearer to the solution than their noise is large; 0 where they cannot tell.
    """
    rows = best.linear
    known = np.einsum("kmm->km", best.solution.joint_covariance(rows.by_own, rows.by_shared))
    tells = known < 1.0 - REDUNDANCY_MIN
    return np.where(tells, np.abs(rows.residual) / np.sqrt(np.where(tells, 1.0 - known, 1.0)), 0.0)


def _result(
    model: RestModel, search: _Search, recording: Recording, seconds: float
) -> RestCalibration:
    """Put the result together."""
    best, unknowns = search.best, model.unknowns
    redundancy, misfit = _redundancy(best, search.weight), _misfit(best, search.weight)
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
    blunders = _blunders(model, search)
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


def _blunders(model: RestModel, search: _Search) -> tuple[SensorBlunder, ...]:
    """Return the readings that were left out, with their distance from the solution."""
    best, robot = search.best, model.unknowns.robot
    residual = model.residual(best.value, best.length, best.rest)
    found = []
    for name, columns in model.columns.items():
        cables = model.pulleys if name == "swivel_angle" else np.arange(robot.n)
        per_cable = name in ("length", "tension", "swivel_angle")
        for j, column in enumerate(columns):
            if not per_cable and j:
                continue  # an orientation is left out as a whole
            for rest in np.flatnonzero(~search.weight[:, column]):
                whole = residual[rest, [column] if per_cable else columns]
                found.append(
                    SensorBlunder(
                        rest=int(rest),
                        sensor=name,
                        cable=robot.cable_names[cables[j]] if per_cable else None,
                        sigmas=float(np.linalg.norm(whole)),
                    )
                )
    return tuple(found)


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
        [result.estimate.moved, [abs(s.value) / s.prior_sigma for s in result.sensors]]
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
