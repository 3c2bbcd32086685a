"""Identify the dynamics of a robot from a recording with poses."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from calibration.identification.fit import CoordinateFit, Fitter, ProgressCallback
from calibration.identification.measured_poses import MeasuredPoses, poses_of
from calibration.identification.open_loop import OpenLoopStart, first_equilibrium, simulate
from calibration.identification.result import (
    FirstMotion,
    Identification,
    MeanPoseComparison,
    RestErrors,
    ScoredRange,
)
from calibration.identification.runs import FittedRun
from calibration.identification.settings import IdentificationSettings
from calibration.identification.sway import FreeSway, find_sway
from calibration.identification.unknowns import choose_coordinates
from calibration.observability import Unobservable
from calibration.robot_update import updated
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import CarosacError, InvalidField
from carosac_toolkit.loop.values import Pose
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.recordings.encoders import calibrated
from carosac_toolkit.recordings.length_path import LengthPath
from carosac_toolkit.recordings.recording import Recording
from carosac_toolkit.robot.parameters import turn_between
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.validation.first_motion import first_speed
from carosac_toolkit.validation.phases import (
    anchors_at,
    find_phases,
)
from carosac_toolkit.validation.plausibility import find_mix_ups
from carosac_toolkit.validation.scores import PoseScores, score_poses

Range = tuple[int, int]
MOTION_MIN_S = 5.0  # seconds of motion, below which no dynamics are identified
START_DISTANCE_MAX_M = 0.5  # [m]
MOTION_MIN_M = 0.01  # [m]: a platform that moves by less does not show its dynamics


def identify(
    recording: Recording,
    robot: Robot,
    settings: IdentificationSettings | None = None,
    *,
    train: Range,
    test: Range | None = None,
    report: ProgressCallback = lambda poses, position, rotation: None,
) -> Identification:
    """Fit the simulator, open loop through recorded lengths, to measured poses.

    The simulation always begins at the first sample. How far the platform is from its equilibrium
    there along its free directions (fewer than six cables), and how fast it moves, is estimated
    too. Parameters and their covariances in the robot file are what is known before; the settings
    stand for what it does not say.

    Args:
        recording: Readings of the lengths and measured poses, as recorded.
        robot: Start of the search, with as many cables.
        settings: None takes the defaults.
        train: Length samples start <= i < stop whose poses are fitted.
        test: Samples that are scored only; None: none.
        report: Called before each step with the number of poses that it looks at, from the first,
            and their RMS errors [m] and [rad].

    Raises:
        InvalidField: A range outside the recording, ranges that overlap, or too little in them.
        Unobservable: The recording does not show the dynamics.
        CarosacError: The robot cannot be simulated on these lengths.
    """
    chosen = settings or IdentificationSettings()
    poses = _check(recording, robot, train, test)
    fitted = poses.within(*train).thinned(chosen.rate)
    unknowns = choose_coordinates(robot, chosen)
    path = LengthPath(recording)
    first = first_speed(
        robot, recording.time, recording.unstrained_length, poses.time, poses.position,
        poses.rotation,
    )  # fmt: skip
    sway = find_sway(robot, first_equilibrium(robot, path), poses, moves=first.moves)
    before = _motion(robot, robot, path, poses, chosen, sway, sway.guess)
    _check_start(before)
    run = FittedRun(path=path, poses=fitted, sway=sway)
    fit = Fitter(unknowns, [run], chosen).run(report)
    estimate = unknowns.estimate(fit.coordinates, fit.covariance)
    identified = updated(robot, estimate)
    after = _motion(robot, identified, path, poses, chosen, sway, fit.starts[0])
    against_mean = _against_mean(robot, poses, after, test or train)
    scored = None if test is None else _part(poses, before, after, test)
    return Identification(
        before=robot,
        warnings=tuple(_warnings(fit, scored, against_mean)),
        estimate=estimate,
        observability=unknowns.prior.judge(fit.information),
        train=_part(poses, before, after, train),
        test=scored,
        rests=_rests(recording, robot, identified, poses),
        first_motion=FirstMotion.of(sway, fit.starts[0], first),
        against_mean=against_mean,
        measured=poses,
        position_before=before[:, :3] + poses.position,
        position_after=after[:, :3] + poses.position,
        errors=after,
        iterations=fit.iterations,
        converged=fit.converged,
        excess=fit.excess,
        fitted_samples=len(fitted.time),
    )


def _check(recording: Recording, robot: Robot, train: Range, test: Range | None) -> MeasuredPoses:
    """Refuse what nothing can be identified from; return the measured poses in W."""
    recording.require_cables(robot)
    count = len(recording.time)
    for name, span in (("train", train), ("test", test)):
        if span is not None and not 0 <= span[0] < span[1] <= count:
            allowed = f"START:STOP with 0 <= START < STOP <= {count}, the number of samples"
            raise InvalidField(name, f"{span[0]}:{span[1]}", allowed)
    if test is not None and max(train[0], test[0]) < min(train[1], test[1]):
        allowed = f"samples outside of train = {train[0]}:{train[1]}"
        raise InvalidField("test", f"{test[0]}:{test[1]}", allowed)
    material = calibrated(recording, robot)
    poses = poses_of(material)
    for name, span in (("train", train), ("test", test)):
        if span is not None and len(poses.within(*span).time) == 0:
            raise InvalidField(name, f"{span[0]}:{span[1]}", "samples with measured poses nearby")
    fitted = poses.within(*train)
    _check_order(robot, material, poses)
    duration = float(fitted.time[-1] - fitted.time[0])
    if duration < MOTION_MIN_S:
        allowed = f"at least {MOTION_MIN_S:g} s with measured poses"
        raise InvalidField("train", f"{duration:.3g} s", allowed)
    reach = float(np.ptp(fitted.position, axis=0).max())
    if reach < MOTION_MIN_M:
        raise Unobservable(
            f"identification: the platform moves by only {reach * 1e3:.2g} mm in samples "
            f"{train[0]}:{train[1]}; a platform at rest does not show its dynamics"
        )
    return poses


def _motion(
    before: Robot,
    robot: Robot,
    path: LengthPath,
    poses: MeasuredPoses,
    settings: IdentificationSettings,
    sway: FreeSway,
    coordinates: Array,
) -> Array:
    """Return the errors of a robot's simulation at all poses, in W as before, shape (K, 6)."""
    start = OpenLoopStart(sway=sway, coordinates=coordinates[None])
    motion = simulate([robot], path, poses.time, time_step=settings.time_step, start=start)
    if motion.failed.any():
        raise CarosacError(f"identification: no finite motion of robot {robot.name!r}")
    motion = motion.seen_by(before, [robot])
    return poses.errors(motion.position[:, 0], motion.rotation[:, 0])


def _check_order(robot: Robot, material: Recording, poses: MeasuredPoses) -> None:
    """Refuse cables in another order, and other units."""
    pose = Pose(position=poses.position, rotation=poses.rotation)
    mix_ups = find_mix_ups(robot, material.unstrained_length[poses.index], pose, zeros_known=False)
    if mix_ups:
        allowed = "lengths and poses of this robot; see 'carosac calibrate lengths'"
        raise InvalidField("recording", " ".join(mix_ups), allowed)


def _check_start(errors: Array) -> None:
    """Refuse a robot that hangs somewhere else than where it was measured."""
    away = float(np.linalg.norm(errors[0, :3]))
    if away > START_DISTANCE_MAX_M:
        got = f"lengths that hang the robot {away:.2f} m from the first measured pose"
        allowed = (
            "lengths and poses of this robot, whose first pose is that of its first lengths within "
            f"{START_DISTANCE_MAX_M:g} m; 'carosac calibrate lengths' finds offsets, swapped "
            "cables and wrong units"
        )
        raise InvalidField("recording", got, allowed)


def _against_mean(
    robot: Robot, poses: MeasuredPoses, errors: Array, span: Range
) -> MeanPoseComparison:
    """Compare the errors of a simulation (K, 6) in some samples with those of the mean pose."""
    from scipy.spatial.transform import Rotation

    rows = _rows(poses, *span)
    measured = anchors_at(robot, poses.position[rows], poses.rotation[rows])
    turned = poses.rotation[rows] @ Rotation.from_rotvec(errors[rows, 3:]).as_matrix()
    simulated = anchors_at(robot, poses.position[rows] + errors[rows, :3], turned)
    distances = (simulated - measured, measured - measured.mean(axis=0))
    missed, spread = (float(np.sqrt((each**2).sum(axis=2).mean())) for each in distances)
    return MeanPoseComparison(start=span[0], stop=span[1], missed=missed, spread=spread)


def _part(poses: MeasuredPoses, before: Array, after: Array, span: Range) -> ScoredRange:
    """Score a range of samples."""
    rows = (poses.index >= span[0]) & (poses.index < span[1])
    return ScoredRange(
        start=span[0], stop=span[1], before=_scores(before[rows]), after=_scores(after[rows])
    )


def _scores(errors: Array) -> PoseScores:
    return score_poses(errors[:, :3], np.linalg.norm(errors[:, 3:], axis=1))


def _warnings(
    fit: CoordinateFit, test: ScoredRange | None, against_mean: MeanPoseComparison
) -> list[str]:
    """Return what must not be overlooked."""
    lines = []
    if not fit.converged:
        lines.append(f"the search had not settled after {fit.iterations} steps")
    if against_mean.useless:
        lines.append(
            f"the identified robot is of no use: in samples {against_mean.start}:"
            f"{against_mean.stop} its anchor points miss the measured ones by "
            f"{against_mean.missed * 1e3:.1f} mm RMS, where their own mean positions miss them by "
            f"{against_mean.spread * 1e3:.1f} mm"
        )
    if test is not None and test.after.rmse[3] > test.before.rmse[3]:
        lines.append("the identified robot is worse than before on the samples kept back")
    return lines


def _rests(
    recording: Recording, robot: Robot, identified: Robot, poses: MeasuredPoses
) -> RestErrors:
    """Compare the mean pose of each rest with the mean equilibrium of its lengths."""
    rests = find_phases(recording.time, recording.unstrained_length).rests
    spans = [rows for a, b in rests if len(rows := _rows(poses, a, b))]
    first = [int(poses.index[rows[0]]) for rows in spans]
    distances = []
    for each in (robot, identified):
        lengths = calibrated(recording, each).unstrained_length
        back = turn_between(each, robot)
        hung = [back @ _mean_position(each, lengths[poses.index[rows]]) for rows in spans]
        where = [poses.position[rows].mean(axis=0) for rows in spans]
        distances.append(np.linalg.norm(np.array(hung) - np.array(where), axis=1) if spans else [])
    return RestErrors(
        before=np.array(distances[0]), after=np.array(distances[1]), starts=np.array(first)
    )


def _rows(poses: MeasuredPoses, start: int, stop: int) -> NDArray[np.int64]:
    """Return the rows of the poses of some length samples."""
    return np.flatnonzero((poses.index >= start) & (poses.index < stop))


def _mean_position(robot: Robot, lengths: Array) -> Array:
    """Return the mean equilibrium on some lengths (K, n), shape (3,); NaN where there is none."""
    if (lengths <= 0.0).any():
        return np.full(3, np.nan)
    rest = statics.forward_kinematics(robot, lengths)
    if not rest.converged.all():
        return np.full(3, np.nan)
    return np.asarray(rest.position.mean(axis=0))
