"""Smooth a recording: forward passes, each with the errors of the one before put right."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from baselines.dynamic_estimator.filter_state import DynamicFilterState
from baselines.dynamic_estimator.measurement_models import LinearisedMeasurement
from baselines.dynamic_estimator.model import DynamicModel
from baselines.dynamic_estimator.reading_models import prepared
from baselines.dynamic_estimator.rest_start import RestStart
from baselines.smoother.arranged_recording import ArrangedRecording, arrange
from baselines.smoother.error_graph import ErrorGraph, GraphSolution
from baselines.smoother.forward_pass import ForwardModel, ForwardPass, scales, shifted
from baselines.smoother.result import Smoothed
from baselines.smoother.scores import score
from baselines.smoother.settings import SmootherSettings
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import CarosacError, InvalidField
from carosac_toolkit.base.extras import require
from carosac_toolkit.base.scaled import Scaled
from carosac_toolkit.loop.values import Pose
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.recordings.recording import Recording
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.validation.first_motion import first_motion
from carosac_toolkit.validation.phases import find_phases
from carosac_toolkit.validation.plausibility import find_misfits

REWEIGHTINGS_MAX = 6  # of poses and angles, in one pass
WEIGHT_TOLERANCE = 0.05
CONSTANT_CHANGE_DEVIATIONS = 0.3
STEP_RATIO_MIN = 0.125  # of the correction of a pass that goes into the next one
# From which on a pose or an angle pulls no more: beyond lie gross errors, not noise.
HUBER_DEVIATIONS = 4.0
# With an IMU, at least: the phase of cable vibrations is unknown.
IMU_STRETCH_DAMPING = Scaled(0.04, "s")
TURNED_LEVER = Scaled(1.0, "m")  # at which a rotation counts as a move

PassReport = Callable[[int, float], None]


def smooth(
    recording: Recording,
    robot: Robot,
    settings: SmootherSettings | None = None,
    *,
    start: int = 0,
    stop: int | None = None,
    report: PassReport | None = None,
) -> Smoothed:
    """Find the best estimate of a whole recording.

    The platform hangs at rest on the first lengths, or moves as the first poses do, if poses are
    used; its dynamics go through a smooth path of the
    recorded lengths. The errors of this motion are told, with gtsam, by what else was measured,
    and put right; then all is done again until nothing changes.

    Args:
        recording: As it was recorded.
        robot: As calibrated.
        settings: What is used, and how uncertain everything is.
        start: First length sample to score.
        stop: One past the last; None: to the end.
        report: Called after each pass with its number and the largest change of a position [m].

    Raises:
        InvalidField: The recording has not what is needed.
        CarosacError: The robot cannot hang on the first lengths, or has no finite motion.
    """
    require("the smoother", "gtsam", "pinocchio")
    chosen = settings or SmootherSettings()
    end = len(recording.time) if stop is None else stop
    if not 0 <= start < end <= len(recording.time):
        allowed = f"0 <= start < stop <= {len(recording.time)}, the number of samples"
        raise InvalidField("start, stop", f"{start}, {end}", allowed)
    measured = arrange(recording, robot, chosen)
    chosen = measured.settings
    angles = sorted({name for each in measured.readings.values() for name in each})
    misfits = find_misfits(measured.recording, robot, angles=angles)
    misfits = (*misfits, *_unseen_motion(measured, robot))
    try:
        last = _settled(measured, robot, chosen, report)
    except CarosacError as error:
        raise CarosacError("\n  ".join([str(error), *misfits])) from error
    return _result(last, measured, misfits, measured.withheld(start, end))


def _unseen_motion(measured: ArrangedRecording, robot: Robot) -> tuple[str, ...]:
    """Warn of a motion at the first sample that only poses show, which are withheld."""
    run = measured.recording
    rests = find_phases(run.time, run.unstrained_length).rests
    resting = bool(rests) and rests[0][0] == 0  # else the winches may have begun to move it
    if measured.poses or not resting or first_motion(run, robot) is None:
        return ()
    return (
        "The platform moves at the first sample, as the measured poses show, but the estimate "
        "begins at rest: until that motion has died away it is wrong by as much. Use poses.",
    )


def _settled(
    measured: ArrangedRecording, robot: Robot, chosen: SmootherSettings, report: PassReport | None
) -> _LastPass:
    """Go through the recording until nothing changes; see `smooth`."""
    ratios = Scales(robot).ratios
    damping = chosen.dynamics.stretch_damping
    if measured.felt:
        damping = max(damping, IMU_STRETCH_DAMPING.of(ratios))
    model = DynamicModel(robot, replace(chosen.dynamics, stretch_damping=damping), soft=False)
    rest = _rest(measured, model, chosen)
    forward = ForwardModel(model, measured, chosen)
    start_covariance = np.pad(rest.covariance, (0, 1))
    start_covariance[-1, -1] = measured.delay_sigma**2
    graph = ErrorGraph(model.errors, scales(model, chosen), start_covariance)
    wanted: list[DynamicFilterState] | None = None
    delay, step, before = measured.delay, 1.0, np.inf
    for passes in range(1, chosen.iterations + 1):
        passed = forward.run(rest, wanted, delay)
        solution, weight = _solved(graph, passed, measured, chosen)
        change, turned = _change(passed, solution)
        if report is not None:
            report(passes, change)
        largest = max(change, TURNED_LEVER.of(ratios) * turned)
        settled = largest <= chosen.tolerance and _still(solution, graph)
        if settled or passes == chosen.iterations:
            break
        step = min(1.0, 2.0 * step) if largest < before else max(0.5 * step, STEP_RATIO_MIN)
        before = largest
        wanted, delay = _wanted(passed, solution, graph, step)
    return _LastPass(robot, graph, passed, solution, weight, passes, change, settled)


@dataclass(frozen=True)
class _LastPass:
    """The last pass."""

    robot: Robot
    graph: ErrorGraph
    passed: ForwardPass
    solution: GraphSolution
    weight: dict[tuple[int, str], float]
    passes: int
    change: float
    settled: bool


def _rest(
    measured: ArrangedRecording, model: DynamicModel, settings: SmootherSettings
) -> DynamicFilterState:
    """Return the state at which the recording begins: in motion where poses are used and say so."""
    robot, when = model.robot, float(measured.time[0])
    reading = measured.reading(when, measured.delay)
    start = RestStart(robot, settings.dynamics, model.errors)
    rest = start.state(when, reading, settings.dynamics.start_speed)
    if rest is None:
        lengths = ", ".join(f"{value:.3f}" for value in reading)
        raise CarosacError(
            f"the robot {robot.name!r} cannot hang at rest on the first recorded lengths "
            f"({lengths} m)"
        )
    first = first_motion(measured.seen, robot) if measured.poses else None
    if first is not None and first.twist is not None:
        rest = start.moving(rest, reading, first.position[0], first.rotation[0], first.twist[0])
    for key in sorted(measured.readings):
        for channel, value in measured.readings[key].items():
            rest = prepared(robot, rest, channel, value)  # as if there had been no motion yet
    return replace(rest, swivel_offset=np.nan_to_num(rest.swivel_offset))  # 0 where none tells it


def _solved(
    graph: ErrorGraph, passed: ForwardPass, measured: ArrangedRecording, settings: SmootherSettings
) -> tuple[GraphSolution, dict[tuple[int, str], float]]:
    """Solve for the errors, with poses and angles that are far off weighing less."""
    import gtsam

    huber = gtsam.noiseModel.mEstimator.Huber.Create(HUBER_DEVIATIONS)
    said = {
        (k, channel): each
        for k, channels in passed.said.items()
        for channel, each in channels.items()
    }
    weight = dict.fromkeys(said, 1.0)
    for _ in range(REWEIGHTINGS_MAX):
        solution = graph.solve(passed, measured.time, weight, settings.lag)
        before, weight = weight, {
            key: float(huber.weight(_distance(measurement, solution.error[key[0]])))
            for key, measurement in said.items()
        }  # fmt: skip
        if all(abs(weight[k] - before[k]) <= WEIGHT_TOLERANCE for k in weight):
            break
    return solution, weight


def _distance(measurement: LinearisedMeasurement, error: Array) -> float:
    """Return the residual after an error is put right, in standard deviations."""
    left = measurement.residual - measurement.by @ error
    return float(np.sqrt(left @ np.linalg.solve(measurement.noise, left)))


def _change(passed: ForwardPass, solution: GraphSolution) -> tuple[float, float]:
    """Return the largest change of a position [m] and of an orientation [rad]."""
    moved = np.array([
        state.pose_by() @ error[:-1] - error[-1] * state.twist
        for state, error in zip(passed.states, solution.error, strict=True)
    ])  # fmt: skip
    size = np.linalg.norm(moved.reshape(-1, 2, 3), axis=2).max(axis=0)
    return float(size[0]), float(size[1])


def _still(solution: GraphSolution, graph: ErrorGraph) -> bool:
    """Return whether the constants change by less than a share of their deviations."""
    moved = np.abs(solution.error[-1, graph.constant])
    return bool((moved <= CONSTANT_CHANGE_DEVIATIONS * np.sqrt(np.diag(solution.constant))).all())


def _wanted(
    passed: ForwardPass, solution: GraphSolution, graph: ErrorGraph, step: float
) -> tuple[list[DynamicFilterState], float]:
    """Return the states that the next pass is to reach, and its delay [s].

    A `step` below 1 goes only that share of the way.
    """
    error = step * solution.error
    error[:, graph.constant] = error[-1, graph.constant]
    wanted = [
        _put_right(state, one, state.covariance)
        for state, one in zip(passed.states, error, strict=True)
    ]
    return wanted, passed.delay + float(error[-1, -1])


def _put_right(state: DynamicFilterState, error: Array, covariance: Array) -> DynamicFilterState:
    """Return a state with an estimated error removed, that of the delay included."""
    return shifted(state.corrected(error[:-1], covariance), float(error[-1]))


def _result(
    last_pass: _LastPass,
    measured: ArrangedRecording,
    misfits: tuple[str, ...],
    withheld: tuple[NDArray[np.int64], Pose] | None,
) -> Smoothed:
    """Return the estimate at the length samples."""
    settings, robot, graph = measured.settings, last_pass.robot, last_pass.graph
    states, covariance = _states(last_pass, measured.samples)
    last = states[-1]
    sigma = np.zeros(last.errors.size + 1)
    sigma[graph.constant] = np.sqrt(np.diag(last_pass.solution.constant))
    noise = settings.dynamics.stretch_deviation, settings.dynamics.rate_noise, float(sigma[-1])
    estimate, platform = _poses(states, measured.recording.time, noise)
    wanted = compared = scores = None
    if withheld is not None:
        keys, wanted = withheld
        compared, doubt = _poses(_states(last_pass, keys)[0], wanted.time, noise)
        scores = score(measured.recording, wanted, compared, doubt, settings.dynamics)
    where = last.errors
    doubted = Counter(name for (_, name), value in last_pass.weight.items() if value < 0.5)
    variance = np.diagonal(covariance, axis1=1, axis2=2)
    mass = robot.mass * float(np.exp(last.log_mass))
    return Smoothed(
        recording=measured.recording,
        robot=robot,
        settings=settings,
        time=measured.recording.time,
        position=estimate.position,
        rotation=estimate.rotation,
        twist=np.stack([state.twist for state in states]),
        covariance=platform,
        tension=np.stack([state.tension for state in states]),
        wind=np.stack([state.wind for state in states]),
        length_bias=np.stack([state.length_bias for state in states]),
        length_bias_sigma=np.sqrt(variance[:, where.bias]),
        wind_sigma=np.sqrt(variance[:, where.wind].mean(axis=0)),
        mass=mass,
        mass_sigma=mass * float(sigma[where.mass][0]),
        center_of_mass=last.center,
        center_sigma=sigma[where.center],
        imu_bias=last.imu_bias,
        swivel_offset=last.swivel_offset,
        swivel_offset_sigma=sigma[where.swivels],
        mounting=last.mounting,
        mounting_sigma=sigma[where.mounting],
        delay=last_pass.passed.delay + float(last_pass.solution.error[-1, -1]),
        delay_sigma=float(sigma[-1]) if measured.delay_sigma else 0.0,
        passes=last_pass.passes,
        change=last_pass.change,
        converged=last_pass.settled,
        inertial=len(measured.felt),
        poses=len(measured.poses),
        readings=Counter(name for each in measured.readings.values() for name in each),
        doubted=doubted.pop("pose", 0),
        doubted_readings=doubted,
        outliers=measured.outliers,
        misfits=misfits,
        measured=wanted,
        compared=compared,
        scores=scores,
    )


def _poses(
    states: list[DynamicFilterState], time: Array | None, noise: tuple[float, float, float]
) -> tuple[Pose, Array]:
    """Return poses, and the covariances of pose and twist, shape (S, 12, 12).

    What is left open of the delay counts as if it were independent of all else: it is where
    nothing tells it, and next to nothing where something does.
    """
    poses = Pose(
        position=np.stack([state.position for state in states]),
        rotation=np.stack([state.rotation for state in states]),
        time=time,
    )
    covariance = np.stack([state.platform_covariance(*noise[:2]) for state in states])
    twist = np.stack([state.twist for state in states])
    covariance[:, :6, :6] += noise[2] ** 2 * twist[:, :, None] * twist[:, None, :]
    return poses, covariance


def _states(
    last_pass: _LastPass, keys: NDArray[np.int64]
) -> tuple[list[DynamicFilterState], Array]:
    """Return states at S key frames, and their covariances, shape (S, size, size)."""
    solution, graph, states = last_pass.solution, last_pass.graph, []
    size = len(graph.changing) + len(graph.constant) - 1  # without the delay
    covariance = np.zeros((len(keys), size, size))
    for row, k in enumerate(keys):
        covariance[row][np.ix_(graph.changing, graph.changing)] = solution.covariance[k]
        states.append(_put_right(last_pass.passed.states[k], solution.error[k], covariance[row]))
    return states, covariance
