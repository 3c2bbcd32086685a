"""Calibrate a robot from readings of its cable lengths at measured poses."""

from __future__ import annotations

from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from calibration.estimate import ParameterEstimate
from calibration.lengths.checks import check_observable, check_order, radial_sentences
from calibration.lengths.fit import ROUNDS_MAX, LengthProblem, LinearReadings, Reweighting, fit
from calibration.lengths.result import Gravity, LengthCalibration
from calibration.lengths.samples import PosePath
from calibration.lengths.settings import TYPICAL_LENGTH_NOISE_M, TYPICAL_SWAY_RAD, LengthSettings
from calibration.lengths.unknowns import LOOSE_OFFSET_SIGMA_M, LengthUnknowns, find_unknowns
from calibration.observability import Unobservable, judge
from calibration.robot_update import updated
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.loop.values import Pose
from carosac_toolkit.recordings.recording import Recording
from carosac_toolkit.robot.parameters import field_of
from carosac_toolkit.robot.robot import Robot

SAMPLES_MAX = 2000  # used, evenly spread: more of the same run tell hardly more
TILT_MENTIONED_RAD = 3e-3  # [rad]: a frame that is more level than that needs no mention
PRIOR_SIGMAS_MAX = (
    4.0  # prior standard deviations: a parameter that moved farther contradicts its prior
)


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
    known = settings or LengthSettings()
    recording.require_cables(robot)
    end = len(recording.time) if stop is None else stop
    if not 0 <= start < end <= len(recording.time):
        allowed = f"0 <= start < stop <= {len(recording.time)}"
        raise InvalidField("samples", f"{start}:{stop}", allowed)
    relative = recording.metadata.length_kind == "relative"
    unknowns = find_unknowns(robot, known, relative=relative)
    if not unknowns.names:
        raise InvalidField("settings", "priors of 0 for everything", "something to calibrate")
    chosen = start + _spread(end - start)
    problem = LengthProblem(
        unknowns, known, PosePath(recording), recording.time[chosen],
        recording.unstrained_length[chosen],
    )  # fmt: skip
    problem.freeze(unknowns.start)
    _check_samples(problem, robot)
    placed = problem.placed(unknowns.start)
    pose = Pose(position=placed.position, rotation=placed.rotation)
    check_order(robot, problem.reading[problem.usable], pose, relative=relative)
    check_observable(unknowns, _typical(problem), placed.position)
    began = perf_counter()
    state, covariance, linear = fit(problem, unknowns.start)
    seconds = perf_counter() - began
    _check_left(state, robot)
    return _result(problem, state, covariance, linear, chosen, seconds, relative)


def _spread(count: int) -> NDArray[np.int64]:
    """Numbers of the samples that are used."""
    kept = min(count, SAMPLES_MAX)
    return np.linspace(0, count - 1, kept).round().astype(np.int64)


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
    """Information of the readings alone, with typical noise, shape (k, k)."""
    linear = problem.linear(problem.unknowns.start)
    noise = problem.settings.length_noise or TYPICAL_LENGTH_NOISE_M
    state = Reweighting(
        value=problem.unknowns.start,
        weight=np.ones(linear.residual.shape),
        length_noise=noise,
        plumb_noise=TYPICAL_SWAY_RAD,
    )
    return information(problem, state, linear)


def information(problem: LengthProblem, state: Reweighting, linear: LinearReadings) -> Array:
    """Fisher information of the weighted samples, without priors, shape (k, k)."""
    white = problem.whitening(linear.by_pose, state) @ linear.jacobian
    flat = white.reshape(-1, white.shape[2])
    return np.asarray(flat.T @ flat)


def _result(
    problem: LengthProblem, state: Reweighting, covariance: Array, linear: LinearReadings,
    chosen: NDArray[np.int64], seconds: float, relative: bool,
) -> LengthCalibration:  # fmt: skip
    """Put together what was found."""
    unknowns, n = problem.unknowns, problem.unknowns.robot.n
    placed = problem.placed(state.value)
    estimate = _estimate(unknowns, state.value, covariance)
    kept = problem.usable
    observability = judge(unknowns.names, information(problem, state, linear), _plausible(unknowns))
    cables = problem.direction(state.value).mean(axis=0)
    deviation = linear.residual / np.sqrt(
        np.einsum("sii->si", problem.covariance(linear.by_pose, state))
    )
    said = radial_sentences(unknowns, covariance, cables)
    gravity = _gravity(unknowns, state.value, covariance)
    outlier = state.weight[:, :n] == 0.0
    return LengthCalibration(
        robot=updated(unknowns.robot, estimate),
        start=unknowns.robot,
        unknowns=unknowns,
        estimate=estimate,
        gravity=gravity,
        anchored=unknowns.anchored,
        sample=chosen[kept],
        time=problem.time[kept],
        position=placed.position,
        residual=linear.residual[:, :n],
        residual_before=_before(problem, n, relative),
        outlier=outlier,
        deviation=deviation[:, :n],
        plumb_outlier=(state.weight[:, n:] == 0.0).any(axis=1),
        length_noise=state.length_noise,
        plumb_noise=state.plumb_noise if problem.plumb else None,
        inflation=state.inflation,
        observability=observability,
        sentences=(*said, *_tilted(unknowns, gravity)),
        warnings=tuple(_warnings(unknowns, estimate, state, outlier)),
        skipped={
            "no measured pose": int(problem.without_pose.sum()),
            "no tensions that hold the pose": int((~kept & ~problem.without_pose).sum()),
        },
        rounds=state.rounds,
        converged=state.rounds < ROUNDS_MAX,
        covariance=covariance,
        seconds=seconds,
    )


def _plausible(unknowns: LengthUnknowns) -> Array:
    """By how much each parameter may plausibly be off, shape (k,)."""
    prior = np.sqrt(np.diag(unknowns.covariance))
    most = {"length_offset": 0.05, "length_delay": 0.02}
    limits = [most.get(field_of(name), np.inf) for name in unknowns.names]
    return np.asarray(np.minimum(prior, limits))


def _estimate(unknowns: LengthUnknowns, value: Array, covariance: Array) -> ParameterEstimate:
    """The parameters that go into the robot: a tilt of gravity alone does not."""
    into = [
        k
        for k, name in enumerate(unknowns.names)
        if unknowns.anchored or not name.startswith("pose_tilt")
    ]
    prior = np.sqrt(np.diag(unknowns.covariance))
    return ParameterEstimate(
        names=tuple(unknowns.names[k] for k in into),
        value=value[into],
        covariance=covariance[np.ix_(into, into)],
        start=unknowns.start[into],
        prior_sigma=np.where(prior >= LOOSE_OFFSET_SIGMA_M, np.inf, prior)[into],
    )


def _gravity(unknowns: LengthUnknowns, value: Array, covariance: Array) -> Gravity | None:
    """Direction of gravity in the frame of the poses."""
    rows = unknowns.index("pose_tilt")
    if len(rows) != 2:
        return None
    return Gravity(
        tilt=value[rows], sigma=np.sqrt(np.diag(covariance))[rows], before=unknowns.start[rows]
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
    """Residuals of the robot as it was, at the same samples and the delay found, (S, n)."""
    start = problem.unknowns.start.copy()
    delay = problem.unknowns.index("length_delay")
    start[delay] = problem.delay
    found = problem.linear(start).residual[:, :n]
    return np.asarray(found - np.median(found, axis=0) if relative else found)


def _warnings(
    unknowns: LengthUnknowns, estimate: ParameterEstimate, state: Reweighting,
    outlier: NDArray[np.bool_],
) -> list[str]:  # fmt: skip
    """What must not be overlooked."""
    said = []
    if state.rounds >= ROUNDS_MAX:
        said.append(
            f"The fit did not settle within {ROUNDS_MAX} rounds of reweighting: often what was "
            "known before, such as surveyed exit points, contradicts these lengths and poses."
        )
    moved = estimate.moved
    far = np.flatnonzero(moved > PRIOR_SIGMAS_MAX)
    if len(far):
        worst = far[np.argsort(-moved[far])][:4]
        names = ", ".join(f"{estimate.names[k]} ({moved[k]:.0f})" for k in worst)
        said.append(
            f"{len(far)} parameters moved by more than {PRIOR_SIGMAS_MAX:g} of their prior "
            f"standard deviations, such as {names}: their priors are too tight, or the model lacks "
            "an effect."
        )
    share = outlier.mean(axis=0)
    for name, part in zip(unknowns.robot.cable_names, share, strict=True):
        if part > 0.2:
            said.append(f"{part:.0%} of the readings of cable '{name}' were left out as blunders.")
    return said
