"""Identify the dynamics of a robot from recordings with poses."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.identification.error_noise import RUNS_APART_MIN
from calibration.identification.fit import CoordinateFit, Fitter
from calibration.identification.frequencies import ComparedFrequencies, FrequencyTable
from calibration.identification.measured_poses import MeasuredPoses, poses_of
from calibration.identification.model_error import JudgedError, Residuals, judge_model_error
from calibration.identification.open_loop import (
    OpenLoopRun,
    OpenLoopStart,
    first_equilibrium,
    simulate_runs,
)
from calibration.identification.rests import rest_doubt, rests_on
from calibration.identification.result import (
    FirstMotion,
    Identification,
    IdentifiedRun,
    MeanPoseComparison,
    RestErrors,
    Samples,
    ScoredRange,
)
from calibration.identification.runs import (
    FittedRun,
    averaged_rate,
    fastest_sway,
    is_locked,
    leading_time,
    slow_window,
    time_before,
    without_ringing,
)
from calibration.identification.search_state import ProgressCallback
from calibration.identification.settings import IdentificationSettings
from calibration.identification.sway import find_sway
from calibration.identification.unknowns import Coordinates, choose_coordinates, group_of
from calibration.identification.vibration_scan import as_vibrating
from calibration.observability import Unobservable
from calibration.robot_update import updated
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import CarosacError, InvalidField
from carosac_toolkit.base.scaled import Scaled, resolved
from carosac_toolkit.loop.values import Pose
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.recordings.columns import POSE_COLUMNS_TEXT
from carosac_toolkit.recordings.encoders import calibrated
from carosac_toolkit.recordings.length_path import LengthPath
from carosac_toolkit.recordings.recording import Recording
from carosac_toolkit.robot.parameters import turn_between
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.validation.first_motion import FirstSpeed, first_speed
from carosac_toolkit.validation.phases import anchors_at, find_phases
from carosac_toolkit.validation.plausibility import find_contradictions
from carosac_toolkit.validation.scores import PoseScores, score_poses

Range = tuple[int, int]
# Mean of the error of orientation, above which the tracked body is turned on the platform.
BODY_TURN_MIN_RAD = 0.035
BODY_TURN_SIGMAS = 1.5  # of its spread over the samples
# The same of positions, above which another point is tracked.
POINT_SHIFT_MIN = Scaled(0.02, "m", most=0.02)
POINT_SHIFT_SIGMAS = 1.5  # of its spread over the samples
APPROACH_RUNS_MAX = 12  # recordings that lead near to the robot, before all tell it
# What the phase of vibrations seems to tell: a search that follows them may end at a wrong value.
# How fast they die out does not depend on their phase, so their damping is kept.
VIBRATING = ("axial_stiffness",)
MODEL_ERROR_RUNS_MAX = 10  # recordings that tell what a model misses
NEES_MAX = 4.0  # of what was kept back, where errors are twice what is claimed; 1 / 4 is half
MOTION_MIN = Scaled(5.0, "s", most=5.0)  # of motion, below which no dynamics are identified
START_DISTANCE_MAX = Scaled(0.5, "m")
# A platform that moves by less does not show its dynamics; sensors do not shrink with it.
REACH_MIN = Scaled(0.01, "m", least=0.002)


def identify(
    recording: Recording,
    robot: Robot,
    settings: IdentificationSettings | None = None,
    *,
    train: Range,
    test: Range | None = None,
    name: str = "recording",
    frequencies: FrequencyTable | None = None,
    candidates: Sequence[str] = (),
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
        name: Of the recording, for messages.
        frequencies: Measured natural frequencies that are fitted too; None: none.
        candidates: Settings whose parameters are kept only where they predict what is held out (see
            `calibration.identification.cross_validation`), and else stay as in the robot file.
        report: Called before each step with the number of poses that it looks at, from the first,
            and their RMS errors [m] and [rad].

    Raises:
        InvalidField: A range outside the recording, ranges that overlap, too little in them, or a
            candidate that is none.
        Unobservable: The recording does not show the dynamics.
        CarosacError: The robot cannot be simulated on these lengths.
    """
    part = _Part(name=name, recording=recording, train=train, test=test)
    return _chosen([part], robot, settings, report, frequencies, candidates)


def identify_runs(
    recordings: Sequence[Recording],
    robot: Robot,
    settings: IdentificationSettings | None = None,
    *,
    held_out: Sequence[Recording] = (),
    names: Sequence[str] | None = None,
    frequencies: FrequencyTable | None = None,
    candidates: Sequence[str] = (),
    report: ProgressCallback = lambda poses, position, rotation: None,
) -> Identification:
    """Fit one robot to the poses of several recordings; see `identify`.

    Each recording begins with a motion of its own, at its first sample or, of ten or more in which
    sway and vibrations are apart, half a sway before the first pose that is looked at. Short free
    oscillations with locked winches will do, from different places and in different directions.

    Args:
        recordings: Their poses are fitted, but for those at first that only lead the search.
        robot: Start of the search, with as many cables.
        settings: None takes the defaults.
        held_out: Scored only; nothing but their first motion is fitted to them.
        names: Of `recordings`, then of `held_out`; None numbers them.
        frequencies: Measured natural frequencies that are fitted too; None: none.
        candidates: Settings whose parameters are kept only where they predict what is held out (see
            `calibration.identification.cross_validation`), and else stay as in the robot file.
        report: Called before each step with the number of poses that it looks at, and their RMS
            errors [m] and [rad].

    Raises:
        InvalidField: No recordings, one that does not fit the robot, or a candidate that is none.
        Unobservable: The recordings do not show the dynamics.
        CarosacError: The robot cannot be simulated on these lengths.
    """
    if not recordings:
        raise InvalidField("recordings", "none", "at least one to be fitted")
    every = [*recordings, *held_out]
    if names is not None and len(names) != len(every):
        allowed = f"{len(every)} names, one for each recording and then each held out"
        raise InvalidField("names", f"{len(names)} names", allowed)
    called = names or [f"recording {k + 1}" for k in range(len(every))]
    parts = [
        _Part(
            name=name,
            recording=recording,
            train=whole if k < len(recordings) else None,
            test=None if k < len(recordings) else whole,
        )
        for k, (name, recording) in enumerate(zip(called, every, strict=True))
        for whole in [(0, len(recording.time))]
    ]
    return _chosen(parts, robot, settings, report, frequencies, candidates)


def _chosen(
    parts: Sequence[_Part],
    robot: Robot,
    settings: IdentificationSettings | None,
    report: ProgressCallback,
    frequencies: FrequencyTable | None,
    candidates: Sequence[str],
) -> Identification:
    """Identify a robot; parameters that were to be tried are held unless they predict."""
    whole = (settings or IdentificationSettings()).with_candidates(candidates)
    fit = _identify(parts, robot, whole, report, frequencies)
    found = fit.result
    if not candidates:
        return found
    group = np.full(len(found.folds.at), "", dtype=object)  # starts have none
    group[: len(found.estimate.names)] = [group_of(name) for name in found.estimate.names]
    judged = found.folds.choose({name: group == name for name in candidates})
    held = [one.name for one in judged if not one.kept]
    if not held:
        return replace(found, candidates=judged)
    without = _identify(parts, robot, whole.without(held), report, frequencies, fit).result
    judged = found.folds.verified(without.folds, judged)
    if all(one.kept for one in judged):
        return replace(found, candidates=judged)
    return replace(without, candidates=judged, warnings=(*without.warnings, *_doubts(found)))


def _doubts(judge: Identification) -> Iterator[str]:
    """Warn of a fit that candidates were judged by, and that cannot be trusted."""
    fit = "the fit with all candidates, by which they were judged,"
    if not judge.converged:
        yield f"{fit} had not settled after {judge.iterations} steps"
    if judge.unfollowed:
        yield f"{fit} had to leave out {', '.join(judge.unfollowed)}"


@dataclass(frozen=True, kw_only=True, eq=False)
class _Part:
    """A recording, with what is fitted and what is kept back of it.

    Attributes:
        name: Of the recording.
        recording: As recorded.
        train: Samples that are fitted; None: none.
        test: Samples that are scored only; None: none.
    """

    name: str
    recording: Recording
    train: Range | None
    test: Range | None


@dataclass(frozen=True, kw_only=True, eq=False)
class _Run:
    """A recording that was checked.

    Attributes:
        part: What is to be done with it.
        poses: All measured ones that lead a search or count, in W.
        left_out: Time at first whose poses do neither [s].
        first: Speed at the first samples.
        guess: How it begins, for the robot as it was known.
        fitted: What a fit sees.
    """

    part: _Part
    poses: MeasuredPoses
    left_out: float
    first: FirstSpeed
    guess: OpenLoopStart
    fitted: FittedRun


@dataclass(frozen=True, kw_only=True, eq=False)
class _Averaged:
    """How the errors of recordings are averaged.

    Attributes:
        robot: Nearly the one that moved. A robot file may have cables three times too stiff: by its
            vibrations windows would be too short, and let those of the robot through.
        windows: Over which errors of each recording are averaged [s].
        mixed: Names of fitted ones in which sway and vibrations are not told apart; if there are
            any, nothing is averaged.
    """

    robot: Robot
    windows: list[float]
    mixed: tuple[str, ...]

    @classmethod
    def of(
        cls,
        parts: Sequence[_Part],
        robot: Robot,
        times: Sequence[Array],
        paths: Sequence[LengthPath],
        rate: float,
    ) -> _Averaged:
        """Find windows.

        Args:
            parts: Recordings.
            robot: Nearly the one that moved.
            times: Of the poses of each [s], shape (K,).
            paths: Readings of each.
            rate: Of poses that are fitted, at most [Hz].
        """
        windows = [
            slow_window(robot, first_equilibrium(robot, path), time, rate)
            for path, time in zip(paths, times, strict=True)
        ]
        mixed = tuple(
            part.name
            for part, window in zip(parts, windows, strict=True)
            if part.train is not None and not window
        )
        return cls(robot=robot, windows=windows, mixed=mixed)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Leader:
    """A search that leads near to a robot, by a dozen of many recordings.

    Attributes:
        parts: Recordings.
        unknowns: Coordinates of the robot.
        settings: Of the computation.
        frequencies: Measured beside the recordings; None: none.
        times: Of the poses of each [s], shape (K,).
        paths: Readings of each.
        report: As of `identify`.
    """

    parts: Sequence[_Part]
    unknowns: Coordinates
    settings: IdentificationSettings
    frequencies: FrequencyTable | None
    times: Sequence[Array]
    paths: Sequence[LengthPath]
    report: ProgressCallback

    def lead(
        self, runs: Sequence[_Run], prepare: Callable[[Robot, Sequence[float]], list[_Run]]
    ) -> tuple[Array, _Averaged]:
        """Return coordinates (k,) near to the robot, and how errors are to be averaged.

        A first search follows vibrations, and finds the sway. What vibrations tell of the cables is
        found from their frequencies and decay, and if they are not seen, from averages.

        Args:
            runs: Prepared without averages.
            prepare: What prepares them with averages, for a robot and by windows.
        """
        nearly = self._search(runs)
        averaged = self._averaged(nearly)
        if averaged.mixed:
            return nearly, averaged
        nearly = self.unknowns.as_before(nearly, VIBRATING)
        fitted = [run.fitted for run in runs if run.part.train is not None]
        cables = as_vibrating(self.unknowns, fitted, nearly, self.unknowns.prior.sigma)
        if cables is None:
            cables = self._search(prepare(averaged.robot, averaged.windows), nearly)
        return cables, self._averaged(cables)

    def _search(self, runs: Sequence[_Run], begin: Array | None = None) -> Array:
        fitted = [run.fitted for run in runs if run.part.train is not None]
        some = _spread(fitted, APPROACH_RUNS_MAX)
        fitter = Fitter(self.unknowns, some, self.settings, frequencies=self.frequencies)
        return fitter.approach(self.report, begin)

    def _averaged(self, nearly: Array) -> _Averaged:
        robot = self.unknowns.robot_at(nearly)
        return _Averaged.of(self.parts, robot, self.times, self.paths, self.settings.rate)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Fit:
    """An identification.

    Attributes:
        result: What it found.
        poses: Of each part, checked.
        averaged: How errors were averaged; None: recordings are few, or cables six or more.
    """

    result: Identification
    poses: list[MeasuredPoses]
    averaged: _Averaged | None


def _identify(
    parts: Sequence[_Part],
    robot: Robot,
    settings: IdentificationSettings | None,
    report: ProgressCallback,
    frequencies: FrequencyTable | None,
    other: _Fit | None = None,
) -> _Fit:
    """Identify a robot from parts of recordings, first those that are fitted.

    What is held out counts as in the `other` fit of the same parts, by which it is to be judged.
    """
    if frequencies is not None:
        frequencies = frequencies.matched(robot)
    chosen = resolved(settings or IdentificationSettings(), Scales(robot).ratios)
    unknowns = choose_coordinates(robot, chosen)
    if other is None:
        poses = [_check(part, robot, unknowns) for part in parts]
        _check_motion(robot, parts, poses)
    else:
        poses = other.poses  # what was told of the robot before must not refuse them now
    paths = [LengthPath(part.recording) for part in parts]
    times = [each.within(*_fitted_span(part)).time for part, each in zip(parts, poses, strict=True)]

    prepare = partial(_prepare, parts, robot, poses, chosen, paths)
    runs = prepare(robot, [0.0] * len(parts))
    before = _motions(robot, robot, runs, chosen, [run.guess for run in runs])
    for run, errors in zip(runs, before, strict=True):
        _check_start(run.part.name, robot, errors)
    trained = [run.fitted for run in runs if run.part.train is not None]
    nearly = averaged = None
    if len(trained) >= RUNS_APART_MIN and robot.n < 6:
        leader = _Leader(
            parts=parts, unknowns=unknowns, settings=chosen, frequencies=frequencies, times=times,
            paths=paths, report=report,
        )  # fmt: skip
        nearly, averaged = leader.lead(runs, prepare)
        averaged = averaged if other is None else other.averaged
    if averaged is not None and not averaged.mixed:
        runs = prepare(averaged.robot, averaged.windows)
        before = _motions(robot, robot, runs, chosen, [run.guess for run in runs])
        trained = [run.fitted for run in runs if run.part.train is not None]
    judge = None if other is None else other.result.folds.judge
    fitter = Fitter(unknowns, trained, chosen, frequencies=frequencies, judge=judge)
    fit = fitter.run(report, nearly)
    kept = [run.fitted for run in runs if run.part.train is None]
    starts = [*fit.starts, *_starts(unknowns, kept, chosen, fit.coordinates)]
    estimate = unknowns.estimate(fit.coordinates, fit.spread)
    identified = updated(robot, estimate)
    found = [
        OpenLoopStart(sway=run.fitted.sway, coordinates=start[None])
        for run, start in zip(runs, starts, strict=True)
    ]
    after = _motions(robot, identified, runs, chosen, found)
    told = [k for k in range(len(runs)) if k not in fit.left_out]  # the fitted ones are the first
    told_runs = [runs[k] for k in told]
    told_before, told_after = ([each[k] for k in told] for each in (before, after))
    judged = _model_error(identified, told_runs, told_after)
    compared = (
        None if frequencies is None else ComparedFrequencies.of(frequencies, robot, identified)
    )
    against_mean = _against_mean(robot, told_runs, told_after)
    scored = _scored(told_runs, told_before, told_after, "test")
    unfollowed = tuple(runs[k].part.name for k in fit.left_out)
    trained_scores = _scored(told_runs, told_before, told_after, "train")
    assert trained_scores is not None, "something was fitted"
    result = Identification(
        before=robot,
        warnings=(
            *_warnings(fit, scored, against_mean),
            *_left_out(unfollowed),
            *_dishonest(judged, scored),
            *_turned_body(told_runs, told_after),
            *_moved_point(robot, told_runs, told_after),
            *(() if compared is None else compared.warnings()),
        ),
        estimate=estimate,
        observability=unknowns.prior.judge(fit.information),
        train=trained_scores,
        test=scored,
        runs=tuple(
            IdentifiedRun(
                name=run.part.name,
                train=_scored([run], [old], [new], "train"),
                test=_scored([run], [old], [new], "test"),
                rests=_rests(run, robot, identified, chosen.rate),
                first_motion=FirstMotion.of(run.fitted.sway, start, run.first, run.fitted.begin),
                left_out=run.left_out,
                measured=run.poses,
                position_before=old[:, :3] + run.poses.position,
                position_after=new[:, :3] + run.poses.position,
                errors=new,
            )
            for run, start, old, new in zip(runs, starts, before, after, strict=True)
        ),
        against_mean=against_mean,
        iterations=fit.iterations,
        converged=fit.converged,
        excess=fit.excess,
        model_error=None if judged is None else judged.error,
        nees=None if judged is None else judged.nees,
        frequencies=compared,
        folds=fit.folds,
        unfollowed=unfollowed,
        mixed=() if averaged is None else averaged.mixed,
        fitted_samples=sum(
            len(run.first(1.0).poses.time) for k, run in enumerate(trained) if k not in fit.left_out
        ),
    )
    return _Fit(result=result, poses=poses, averaged=averaged)


def _starts(
    unknowns: Coordinates, runs: Sequence[FittedRun], settings: IdentificationSettings, at: Array
) -> list[Array]:
    """Return the starts of recordings held out; those without a window are searched apart."""
    found: dict[int, Array] = {}
    for averaged in (True, False):
        rows = [r for r, run in enumerate(runs) if bool(run.window) == averaged]
        if rows:
            fitter = Fitter(unknowns, [runs[r] for r in rows], settings, robot_at=at)
            found |= dict(zip(rows, fitter.starts(), strict=True))
    return [found[r] for r in range(len(runs))]


def _model_error(
    identified: Robot, runs: Sequence[_Run], errors: Sequence[Array]
) -> JudgedError | None:
    """Return what the identified robot misses; None where no estimator can follow the runs.

    Of many recordings some tell it as well as all.
    """
    residuals: dict[int, Residuals] = {}
    chosen = {which: _some(runs, which) for which in ("train", "test")}
    try:
        for r in sorted({*chosen["train"], *chosen["test"]}):
            run = runs[r]
            residuals[r] = Residuals.of(
                identified, run.part.recording, run.poses.time, errors[r], run.poses.rotation
            )
    except CarosacError:
        return None
    trained, kept = (
        [residuals[r].rows(_rows_of(runs[r], which)) for r in rows]
        for which, rows in chosen.items()
    )
    return judge_model_error(trained, kept)


def _some(runs: Sequence[_Run], which: str) -> list[int]:
    """Return places of recordings with samples to be fitted or scored only, some of many."""
    rows = [r for r, run in enumerate(runs) if _span(run, which) is not None]
    return _spread(rows, MODEL_ERROR_RUNS_MAX)


def _spread(each: Sequence[Any], most: int) -> list[Any]:
    """Return at most so many of some things, evenly spread."""
    picked = np.linspace(0, len(each) - 1, min(len(each), most))
    return [each[int(k)] for k in np.unique(picked.round())]


def _fitted_span(part: _Part) -> Range:
    """Return the samples that are fitted, or scored if none are."""
    span = part.train or part.test
    assert span is not None, "a recording is fitted or scored"
    return span


def _prepare(
    parts: Sequence[_Part],
    robot: Robot,
    poses: Sequence[MeasuredPoses],
    settings: IdentificationSettings,
    paths: Sequence[LengthPath],
    nearly: Robot,
    windows: Sequence[float],
) -> list[_Run]:
    """Find how recordings begin, and what of them a fit sees, averaged over windows [s].

    Poses are in W of a `robot`; `nearly` is the one that moved, as far as it is known.
    """
    rests = [first_equilibrium(nearly, path) for path in paths]
    averaged = [
        (time_before(nearly, rest), window)
        for part, rest, window in zip(parts, rests, windows, strict=True)
        if window and part.train is not None
    ]
    # the same for all: recordings that are sampled alike are simulated together
    early = max((before for before, _ in averaged), default=0.0)
    rate = averaged_rate([window for _, window in averaged]) if averaged else np.inf
    turn = turn_between(robot, nearly)
    runs = []
    for part, each, path, rest, window in zip(parts, poses, paths, rests, windows, strict=True):
        seen, before = each, 0.0
        if window:
            calm = without_ringing(each, window, fastest_sway(nearly, rest))
            if is_locked(path, max(calm.time[0], path.first + early)):
                seen, before = calm, early
        first = _first_speed(nearly, part.recording, seen)
        moves = first.moves or before > 0.0  # of what seems to rest, averages show a slow sway
        sway = partial(find_sway, moves=moves, before=before)
        fitted = FittedRun(
            path=path, poses=seen.within(*_fitted_span(part)), rate=settings.rate,
            sway=sway(nearly, rest, seen.turned(turn)), window=window,
            leading=leading_time(before, seen) if before else 0.0, averaged_rate=rate,
        )  # fmt: skip
        known = fitted.sway
        if nearly is not robot:
            known = sway(robot, first_equilibrium(robot, path), seen)
        runs.append(
            _Run(
                part=part, poses=seen, left_out=float(seen.time[0] - each.time[0]), first=first,
                guess=OpenLoopStart(sway=known, coordinates=known.guess[None]), fitted=fitted,
            )
        )  # fmt: skip
    return runs


def _first_speed(robot: Robot, recording: Recording, poses: MeasuredPoses) -> FirstSpeed:
    """Judge whether a platform moves at the first of some poses."""
    return first_speed(
        robot, recording.time, recording.unstrained_length, poses.time, poses.position,
        poses.rotation,
    )  # fmt: skip


def _check(part: _Part, robot: Robot, unknowns: Coordinates) -> MeasuredPoses:
    """Refuse what nothing can be identified from; return the measured poses in W."""
    recording, train, test = part.recording, part.train, part.test
    recording.require_cables(robot)
    count = len(recording.time)
    for name, span in (("train", train), ("test", test)):
        if span is not None and not 0 <= span[0] < span[1] <= count:
            allowed = f"START:STOP with 0 <= START < STOP <= {count}, the number of samples"
            raise InvalidField(name, f"{span[0]}:{span[1]}", allowed)
    if train is not None and test is not None and max(train[0], test[0]) < min(train[1], test[1]):
        allowed = f"samples outside of train = {train[0]}:{train[1]}"
        raise InvalidField("test", f"{test[0]}:{test[1]}", allowed)
    if recording.poses is None:
        raise InvalidField(part.name, "no poses", POSE_COLUMNS_TEXT)
    material = calibrated(recording, robot)
    poses = poses_of(material)
    for name, span in (("train", train), ("test", test)):
        if span is not None and len(poses.within(*span).time) == 0:
            raise InvalidField(name, f"{span[0]}:{span[1]}", "samples with measured poses nearby")
    _check_order(part, robot, material, poses, unknowns)
    return poses


def _check_motion(robot: Robot, parts: Sequence[_Part], poses: Sequence[MeasuredPoses]) -> None:
    """Refuse too little motion in all that is fitted."""
    ratios = Scales(robot).ratios
    duration, reach = 0.0, 0.0
    for part, each in zip(parts, poses, strict=True):
        if part.train is None:
            continue
        fitted = each.within(*part.train)
        duration += float(fitted.time[-1] - fitted.time[0])
        anchors = anchors_at(robot, fitted.position, fitted.rotation)
        reach = max(reach, float(np.ptp(anchors, axis=0).max()))
    shortest = MOTION_MIN.of(ratios)
    if duration < shortest:
        allowed = f"at least {shortest:.3g} s with measured poses"
        raise InvalidField("train", f"{duration:.3g} s", allowed)
    if reach < REACH_MIN.of(ratios):
        raise Unobservable(
            f"identification: the platform moves by only {reach * 1e3:.2g} mm in what is to be "
            "fitted; a platform at rest does not show its dynamics"
        )


def _motions(
    before: Robot,
    robot: Robot,
    runs: Sequence[_Run],
    settings: IdentificationSettings,
    starts: Sequence[OpenLoopStart],
) -> list[Array]:
    """Return the errors of a robot's simulation at all poses, in W as before, (K, 6) a run."""
    jobs = [
        OpenLoopRun(robots=[robot], path=run.fitted.path, time=run.poses.time, start=start)
        for run, start in zip(runs, starts, strict=True)
    ]
    errors = []
    motions = simulate_runs(jobs, time_step=settings.time_step)
    for run, motion in zip(runs, motions, strict=True):
        if motion.failed.any():
            raise CarosacError(f"identification: no finite motion of robot {robot.name!r}")
        seen = motion.seen_by(before, [robot])
        errors.append(run.poses.errors(seen.position[:, 0], seen.rotation[:, 0]))
    return errors


def _check_order(
    part: _Part, robot: Robot, material: Recording, poses: MeasuredPoses, unknowns: Coordinates
) -> None:
    """Refuse clocks that are apart, cables in another order, other units and other frames."""
    pose = Pose(position=poses.position, rotation=poses.rotation)
    mix_ups = find_contradictions(
        material, robot, material.unstrained_length[poses.index], pose,
        zeros_known=False, channels=("poses",),
        doubt=lambda rows: rest_doubt(part.recording, unknowns, poses.index[rows]),
    )  # fmt: skip
    if mix_ups:
        raise CarosacError(f"{part.name}: {' '.join(mix_ups)}")


def _check_start(name: str, robot: Robot, errors: Array) -> None:
    """Refuse a robot that hangs somewhere else than where it was measured."""
    away = float(np.linalg.norm(errors[0, :3]))
    farthest = START_DISTANCE_MAX.of(Scales(robot).ratios)
    if away > farthest:
        got = f"lengths that hang the robot {away:.2f} m from the first measured pose"
        allowed = (
            "lengths and poses of this robot, whose first pose is that of its first lengths within "
            f"{farthest:.2g} m; 'carosac calibrate lengths' finds offsets, swapped cables and "
            "wrong units"
        )
        raise InvalidField(name, got, allowed)


def _against_mean(
    robot: Robot, runs: Sequence[_Run], errors: Sequence[Array]
) -> MeanPoseComparison:
    """Compare the errors of simulations, (K, 6) a run, with those of the mean poses."""
    from scipy.spatial.transform import Rotation

    which = "train" if all(run.part.test is None for run in runs) else "test"
    samples = _samples(runs, which)
    assert samples is not None, "something was fitted"
    missed, spread = [], []
    for run, error in zip(runs, errors, strict=True):
        rows = _rows_of(run, which)
        poses = run.poses.rows(rows)
        measured = anchors_at(robot, poses.position, poses.rotation)
        turned = poses.rotation @ Rotation.from_rotvec(error[rows, 3:]).as_matrix()
        simulated = anchors_at(robot, poses.position + error[rows, :3], turned)
        missed.append(simulated - measured)
        if len(rows):
            spread.append(measured - measured.mean(axis=0))
    distances = [
        float(np.sqrt((np.concatenate(each) ** 2).sum(axis=2).mean())) for each in (missed, spread)
    ]
    return MeanPoseComparison(**vars(samples), missed=distances[0], spread=distances[1])


def _span(run: _Run, which: str) -> Range | None:
    """Return the samples that are fitted (`train`) or scored only (`test`)."""
    return run.part.train if which == "train" else run.part.test


def _samples(runs: Sequence[_Run], which: str) -> Samples | None:
    """Return what is fitted or scored only, of all runs together; None: there is none."""
    spans = [span for run in runs if (span := _span(run, which)) is not None]
    if not spans:
        return None
    first = spans[0][0] if len(spans) == 1 else 0
    stop = first + sum(stop - start for start, stop in spans)
    names = [run.part.name for run in runs if _span(run, which) is not None]
    name = names[0] if len(spans) == 1 < len(runs) else None
    return Samples(start=first, stop=stop, runs=len(spans), name=name)


def _rows_of(run: _Run, which: str) -> NDArray[np.int64]:
    """Return the rows of the poses that are fitted or scored only."""
    span = _span(run, which) or (0, 0)
    return _rows(run.poses, *span)


def _scored(
    runs: Sequence[_Run], before: Sequence[Array], after: Sequence[Array], which: str
) -> ScoredRange | None:
    """Score what was fitted or what was not, of all runs together; None: there is none."""
    samples = _samples(runs, which)
    if samples is None:
        return None
    rows = [_rows_of(run, which) for run in runs]
    old, new = (
        np.concatenate([each[own] for each, own in zip(errors, rows, strict=True)])
        for errors in (before, after)
    )
    return ScoredRange(**vars(samples), before=_scores(old), after=_scores(new))


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
            f"the identified robot is of no use: in {against_mean.words} its anchor points miss "
            f"the measured ones by {against_mean.missed * 1e3:.1f} mm RMS, where their own mean "
            f"positions miss them by {against_mean.spread * 1e3:.1f} mm"
        )
    if test is not None and test.after.rmse[3] > test.before.rmse[3]:
        lines.append("the identified robot is worse than before on what was kept back")
    return lines


def _left_out(names: Sequence[str]) -> Iterator[str]:
    """Warn of recordings that tell nothing of the robot."""
    if names:
        yield (
            f"{', '.join(names)}: left out of the fit, as what the motion seems to tell of the "
            "robot is chance, mostly where cables vibrate strongly; kick the platform more gently, "
            "or add damping to the robot file if it has too little"
        )


def _dishonest(judged: JudgedError | None, test: ScoredRange | None) -> Iterator[str]:
    """Warn of a robot file whose claims do not hold on what was kept back."""
    if judged is None or test is None:
        return
    if judged.nees > NEES_MAX:
        yield (
            "estimators would claim too much by the identified robot: what was kept back is missed "
            f"by {np.sqrt(judged.nees):.1f} times what the fitted samples say. It shows an effect "
            "that they do not, or that no fitted parameter has; see --candidates and --free"
        )
    elif judged.nees < judged.trained_nees / NEES_MAX:
        yield (
            "estimators would claim too little by the identified robot: what was kept back is "
            f"missed by {np.sqrt(judged.nees / judged.trained_nees):.2f} times what the fitted "
            "samples say. Some of these may be wrong, as where a tracker errs or a cable slips: "
            "look at the errors over time in the report, and leave them out"
        )


def _fitted(runs: Sequence[_Run], errors: Sequence[Array]) -> Array:
    """Return the errors of all poses that were fitted, (K, 6)."""
    return np.concatenate([
        each[_rows(run.poses, *run.part.train)]
        for run, each in zip(runs, errors, strict=True) if run.part.train is not None
    ])  # fmt: skip


def _moved_point(robot: Robot, runs: Sequence[_Run], errors: Sequence[Array]) -> Iterator[str]:
    """Warn of poses of another point than the platform's: a constant error of position."""
    fitted = _fitted(runs, errors)[:, :3]
    shift = -fitted.mean(axis=0)
    spread = float(np.sqrt(fitted.var(axis=0).sum()))
    least = POINT_SHIFT_MIN.of(Scales(robot).ratios)
    if np.linalg.norm(shift) > max(least, POINT_SHIFT_SIGMAS * spread):
        x, y, z = 1e3 * shift
        yield (
            f"the measured positions are ({x:.0f}, {y:.0f}, {z:.0f}) mm in W from the identified "
            "platform all the time: is the tracked point the origin of the platform frame, and is "
            "the frame of the poses W? Its parameters cannot be trusted until they are"
        )


def _turned_body(runs: Sequence[_Run], errors: Sequence[Array]) -> Iterator[str]:
    """Warn of poses whose body is turned against the platform: a constant error of orientation."""
    fitted = _fitted(runs, errors)
    turn = -fitted[:, 3:].mean(axis=0)  # of the tracked body, in the axes of the platform
    spread = float(np.sqrt(fitted[:, 3:].var(axis=0).sum()))
    angle = float(np.linalg.norm(turn))
    if angle <= max(BODY_TURN_MIN_RAD, BODY_TURN_SIGMAS * spread):
        return
    x, y, z = np.degrees(turn)
    yield (
        f"the measured poses are turned against the identified platform by {np.degrees(angle):.1f} "
        f"degrees all the time (rotation vector {x:.1f}, {y:.1f}, {z:.1f} degrees in its axes): is "
        "the tracked body turned on the platform? Its parameters cannot be trusted until the poses "
        "are those of the platform"
    )


def _rests(run: _Run, robot: Robot, identified: Robot, rate: float) -> RestErrors:
    """Compare the mean pose of each rest with the mean equilibrium of its lengths.

    While a platform swings on locked winches, its mean pose is not that.
    """
    recording, poses = run.part.recording, run.poses.thinned(rate)
    swings = run.fitted.sway.begin is not None
    rests = () if swings else find_phases(recording.time, recording.unstrained_length).rests
    spans = [rows for a, b in rests if len(rows := _rows(poses, a, b))]
    first = [int(poses.index[rows[0]]) for rows in spans]
    distances = []
    for each in (robot, identified):
        lengths = calibrated(recording, each).unstrained_length
        back = turn_between(each, robot)
        hung = [back @ rests_on(each, lengths[poses.index[rows]])[0].mean(axis=0) for rows in spans]
        where = [poses.position[rows].mean(axis=0) for rows in spans]
        distances.append(np.linalg.norm(np.array(hung) - np.array(where), axis=1) if spans else [])
    return RestErrors(
        before=np.array(distances[0]), after=np.array(distances[1]), starts=np.array(first)
    )


def _rows(poses: MeasuredPoses, start: int, stop: int) -> NDArray[np.int64]:
    """Return the rows of the poses of some length samples."""
    return np.flatnonzero((poses.index >= start) & (poses.index < stop))
