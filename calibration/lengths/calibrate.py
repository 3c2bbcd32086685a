"""Calibrate a robot from readings of its cable lengths at measured poses."""

from __future__ import annotations

from dataclasses import replace
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from calibration.estimate import ParameterEstimate
from calibration.lengths.checks import (
    check_clock_and_frames,
    check_observable,
    check_order,
    radial_sentences,
)
from calibration.lengths.fit import ROUNDS_MAX, LengthProblem, Reweighting, fit
from calibration.lengths.pose_path import PosePath
from calibration.lengths.result import Gravity, LengthCalibration
from calibration.lengths.settings import TYPICAL_LENGTH_NOISE_M, TYPICAL_SWAY_RAD, LengthSettings
from calibration.lengths.unknowns import LOOSE_OFFSET_SIGMA_M, LengthUnknowns, find_unknowns
from calibration.observability import Unobservable, judge
from calibration.prior import Prior
from calibration.rest_readings import rests_alone
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.base.extras import require
from carosac_toolkit.loop.values import Pose
from carosac_toolkit.recordings.recording import Recording
from carosac_toolkit.robot.parameter_names import field_of
from carosac_toolkit.robot.robot import Robot

SAMPLES_MAX = 2000  # used, evenly spread: more of the same run tell hardly more
TILT_MENTIONED_RAD = 3e-3  # [rad]: a frame that is more level than that needs no mention
PLAUSIBLE_MAX = {"length_offset": 0.05, "length_delay": 0.02}  # [m], [s]: scales, no priors
OUTLIER_SHARE_MAX = 0.2  # of the readings of a cable: more are hardly blunders
PRIOR_SIGMAS_MAX = 4.0  # a parameter that moved farther contradicts its prior


def calibrate_lengths(
    recording: Recording,
    robot: Robot,
    *,
    settings: LengthSettings | None = None,
    start: int = 0,
    stop: int | None = None,
) -> LengthCalibration:
    """Estimate exit and anchor points, offsets, scales, delay and gravity, with covariance.

    Args:
        recording: Readings of n cables with measured poses.
        robot: Before the calibration; its covariances are priors.
        settings: Noise and priors.
        start: First sample to use.
        stop: One past the last; None: to the end.

    Returns:
        The calibrated robot and what is known about it.

    Raises:
        InvalidField: No poses, another number of cables, or a range outside the recording.
        MixUp: Readings and poses do not belong together as they are.
        Unobservable: The recording cannot tell the exit points.
    """
    require("the calibration from lengths", "gtsam")
    known = settings or LengthSettings()
    recording.require_cables(robot)
    end = len(recording.time) if stop is None else stop
    if not 0 <= start < end <= len(recording.time):
        allowed = f"0 <= start < stop <= {len(recording.time)}"
        raise InvalidField("samples", f"{start}:{stop}", allowed)
    relative = recording.metadata.length_kind == "relative"
    unknowns = find_unknowns(robot, known, relative=relative)
    if not unknowns.prior.names:
        raise InvalidField("settings", "priors of 0 for everything", "something to calibrate")
    rests = rests_alone(recording.slice(start, end))
    if rests is None:
        sample, measured = start + _spread(end - start), recording
        time, reading = recording.time[sample], recording.unstrained_length[sample]
    else:
        measured, middle = rests
        sample, time, reading = start + middle, measured.time, measured.unstrained_length
    problem = LengthProblem(unknowns, known, PosePath(measured), time, reading)
    check_clock_and_frames(recording, robot)
    problem.freeze(unknowns.prior.mean)
    _check_samples(problem, robot)
    placed = problem.placed(unknowns.robot_at(unknowns.prior.mean))
    pose = Pose(position=placed.position, rotation=placed.rotation)
    check_order(robot, problem.reading[problem.usable], pose, relative=relative)
    check_observable(unknowns, _typical(problem), placed.position)
    began = perf_counter()
    state = fit(problem)
    seconds = perf_counter() - began
    _check_left(state, robot)
    result = _result(problem, state, sample, seconds, relative)
    if rests is None:
        return result
    note = "nothing moves between the rests of the recording: each of them counts as one sample"
    return replace(result, notes=(note, *result.notes))


def _spread(count: int) -> NDArray[np.int64]:
    """Return the numbers of the samples that are used."""
    return np.linspace(0, count - 1, min(count, SAMPLES_MAX)).round().astype(np.int64)


def _check_samples(problem: LengthProblem, robot: Robot) -> None:
    """Refuse a recording of which nothing can be used."""
    if problem.usable.any():
        return
    if problem.without_pose.all():
        raise Unobservable("no reading has a measured pose at its time")
    raise Unobservable(
        f"robot {robot.name} cannot rest at any of the measured poses: are frame, robot and "
        "orientation right?"
    )


def _check_left(state: Reweighting, robot: Robot) -> None:
    """Refuse a cable of which nothing is left."""
    gone = (state.weight[:, : robot.n] == 0.0).all(axis=0)
    if gone.any():
        name = robot.cable_names[int(np.argmax(gone))]
        raise Unobservable(
            f"no reading of cable '{name}' fits the poses, whatever its offset: is it in another "
            "unit than the others, or of another cable?"
        )


def _typical(problem: LengthProblem) -> Array:
    """Return the information of the readings alone, with typical noise, shape (k, k)."""
    prior = problem.unknowns.prior
    linear = problem.linear(prior.mean)
    state = Reweighting(
        value=prior.mean,
        covariance=prior.covariance,
        linear=linear,
        weight=np.ones(linear.residual.shape),
        length_noise=problem.settings.length_noise or TYPICAL_LENGTH_NOISE_M,
        balance_noise=TYPICAL_SWAY_RAD,
    )
    return problem.information(state)


def _result(
    problem: LengthProblem, state: Reweighting, chosen: NDArray[np.int64], seconds: float,
    relative: bool,
) -> LengthCalibration:  # fmt: skip
    """Put the result together."""
    unknowns, n, residual = problem.unknowns, problem.unknowns.robot.n, state.linear.residual
    robot = unknowns.robot_at(state.value)
    estimate = _estimate(unknowns, state.value, state.covariance)
    cables = problem.direction(state.value).mean(axis=0)
    gravity = _gravity(unknowns, state.value, state.covariance)
    outlier = state.weight[:, :n] == 0.0
    return LengthCalibration(
        before=unknowns.robot,
        unknowns=unknowns,
        estimate=estimate,
        gravity=gravity,
        anchored=unknowns.anchored,
        sample=chosen[problem.usable],
        time=problem.time[problem.usable],
        position=problem.placed(robot).position,
        residual=residual[:, :n],
        residual_before=_before(problem, n, relative),
        outlier=outlier,
        deviation=problem.deviation(state)[:, :n],
        balance_outlier=(state.weight[:, n:] == 0.0).any(axis=1),
        length_noise=state.length_noise,
        balance_noise=state.balance_noise if problem.with_balance else None,
        inflation=state.inflation,
        observability=judge(
            unknowns.prior.names, problem.information(state), _plausible(unknowns.prior)
        ),
        notes=(
            *radial_sentences(unknowns, state.covariance, cables), *_tilted(unknowns, gravity)
        ),
        warnings=tuple(_warnings(estimate, state, outlier, unknowns.robot.cable_names)),
        skipped={
            "no measured pose": int(problem.without_pose.sum()),
            "no tensions that hold the pose": int((~problem.usable & ~problem.without_pose).sum()),
        },
        rounds=state.rounds,
        converged=state.rounds < ROUNDS_MAX,
        covariance=state.covariance,
        seconds=seconds,
    )  # fmt: skip


def _plausible(prior: Prior) -> Array:
    """Return by how much each parameter may plausibly be off, shape (k,)."""
    limits = [PLAUSIBLE_MAX.get(field_of(name), np.inf) for name in prior.names]
    return np.asarray(np.minimum(prior.sigma, limits))


def _estimate(unknowns: LengthUnknowns, value: Array, covariance: Array) -> ParameterEstimate:
    """Return the parameters that go into the robot: a tilt of gravity alone does not."""
    into = [
        k
        for k, name in enumerate(unknowns.prior.names)
        if unknowns.anchored or not name.startswith("pose_tilt")
    ]
    prior = unknowns.prior.sigma
    return ParameterEstimate(
        names=tuple(unknowns.prior.names[k] for k in into),
        value=value[into],
        covariance=covariance[np.ix_(into, into)],
        start=unknowns.prior.mean[into],
        prior_sigma=np.where(prior >= LOOSE_OFFSET_SIGMA_M, np.inf, prior)[into],
    )


def _gravity(unknowns: LengthUnknowns, value: Array, covariance: Array) -> Gravity | None:
    """Return the direction of gravity in the frame of the poses."""
    rows = unknowns.prior.rows("pose_tilt")
    if len(rows) != 2:
        return None
    return Gravity(
        tilt=value[rows], sigma=np.sqrt(np.diag(covariance))[rows], before=unknowns.prior.mean[rows]
    )


def _tilted(unknowns: LengthUnknowns, gravity: Gravity | None) -> list[str]:
    """Say of a robot that its z is not up."""
    if unknowns.anchored or gravity is None:
        return []
    tilt, sigma = float(np.hypot(*gravity.tilt)), float(gravity.sigma.max())
    if tilt < max(TILT_MENTIONED_RAD, 3.0 * sigma):
        return []
    return [
        f"The frame of the poses, in which the exit points now are, is tilted by {tilt * 1e3:.1f} "
        "mrad against gravity, but statics takes z for up: level the frame of the motion capture, "
        "or survey the exit points with a tachymeter first."
    ]


def _before(problem: LengthProblem, n: int, relative: bool) -> Array:
    """Return the residuals of the robot before, at the same samples and delay, shape (S, n)."""
    start = problem.unknowns.prior.mean.copy()
    start[problem.unknowns.prior.rows("length_delay")] = problem.delay
    residual = problem.linear(start).residual[:, :n]
    return np.asarray(residual - np.median(residual, axis=0) if relative else residual)


def _warnings(
    estimate: ParameterEstimate, state: Reweighting, outlier: NDArray[np.bool_],
    cable_names: tuple[str, ...],
) -> list[str]:  # fmt: skip
    """Return what must not be overlooked."""
    lines = []
    if state.rounds >= ROUNDS_MAX:
        lines.append(
            f"The fit did not settle within {ROUNDS_MAX} rounds of reweighting: often what was "
            "known before, such as surveyed exit points, contradicts these lengths and poses."
        )
    moved = np.abs(estimate.moved)
    far = np.flatnonzero(moved > PRIOR_SIGMAS_MAX)
    if len(far):
        worst = far[np.argsort(-moved[far])][:4]
        names = ", ".join(f"{estimate.names[k]} ({moved[k]:.0f})" for k in worst)
        lines.append(
            f"{len(far)} parameters moved by more than {PRIOR_SIGMAS_MAX:g} of their prior "
            f"standard deviations, such as {names}: their priors are too tight, or the model lacks "
            "an effect."
        )
    for name, part in zip(cable_names, outlier.mean(axis=0), strict=True):
        if part > OUTLIER_SHARE_MAX:
            lines.append(f"{part:.0%} of the readings of cable '{name}' were left out as blunders.")
    return lines
