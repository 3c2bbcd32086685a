"""Run of models over a recording, and their scores."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import CarosacError, InvalidField
from carosac_toolkit.loop.plugin_builder import build_plugin, uses_of
from carosac_toolkit.loop.values import Belief, Pose
from carosac_toolkit.physics.cable.lengths import length_at_tension
from carosac_toolkit.recordings.encoders import calibrated
from carosac_toolkit.recordings.recording import Recording
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.validation.another_robot import another_robot, cable_count_hint
from carosac_toolkit.validation.clocks import ANGLE_CHANNELS
from carosac_toolkit.validation.diagnostics import find_delay, find_sway, rest_frequencies
from carosac_toolkit.validation.first_motion import first_motion
from carosac_toolkit.validation.phases import anchor_speed, find_phases, slope
from carosac_toolkit.validation.plausibility import exit_point_distance, find_contradictions
from carosac_toolkit.validation.pose_noise import measured_pose_noise
from carosac_toolkit.validation.residual_effects import (
    ResidualEffects,
    SimulatedRun,
    residual_effects,
)
from carosac_toolkit.validation.result import ModelResult, ValidationResult
from carosac_toolkit.validation.run import ModelRun, load_model, run_open_loop
from carosac_toolkit.validation.scores import (
    normalised_pose_squares,
    rotation_angle,
    score_lengths,
    score_poses,
)

DEFAULT_MODELS = ("straight_line", "kinematic_solver", "simulator")


def validate(
    recording: Recording,
    robot: Robot,
    models: Sequence[str] = DEFAULT_MODELS,
    *,
    start: int = 0,
    stop: int | None = None,
    seed: int = 0,
    effects: bool = False,
) -> ValidationResult:
    """Score models on a recording: open loop on its lengths, against its measured poses.

    Each model gets the measurements in order from sample 0, poses withheld; `start` and `stop`
    limit what is scored. Samples without a measured pose nearby are left out and counted. A model
    that raises costs its own scores only. Where the platform moves at sample 0, models that can
    (`SupportsMovingStart`) start from its measured pose and speed there.

    Args:
        recording: With measured poses and lengths, as it was recorded: what the robot says of its
            sensors (`carosac_toolkit.recordings.encoders`) is applied here.
        robot: Robot of the models, with as many cables as the recording.
        models: Names of estimators, or ``module:Class``; each once.
        start: First sample to score.
        stop: One past the last; None: to the end.
        seed: Given to every model.
        effects: True to tell which effects the error of the best model that moves looks like
            (`carosac_toolkit.validation.residual_effects`), for a plausible recording.

    Returns:
        Scores and diagnostics per model.

    Raises:
        InvalidField: An unknown model, a range outside the recording, another number of cables, a
            recording without poses in the range or with relative lengths.
    """
    if recording.n != robot.n:
        raise InvalidField(
            "robot", f"{robot.name!r} with {robot.n} cables",
            f"one with {recording.n}: {cable_count_hint(recording, robot)}",
        )  # fmt: skip
    other = another_robot(recording, robot)
    recording = calibrated(recording, robot)
    targets = _check_inputs(recording, models, start=start, stop=stop)
    end = len(recording.time) if stop is None else stop
    poses = recording.pose_at(recording.time[start:end])
    index = start + np.flatnonzero(poses.valid)
    measured = Pose(
        position=poses.pose.position[poses.valid],
        rotation=poses.pose.rotation[poses.valid],
        time=recording.time[index],
    )
    phases = find_phases(recording.time, recording.unstrained_length)
    rests = _kept(phases.rests, index)
    lengths = recording.unstrained_length[index]
    resting = phases.resting[index]
    speed = anchor_speed(robot, recording.time[index], measured.position, measured.rotation)
    first = first_motion(recording, robot)
    scoring = _Scoring(recording, robot, index, measured, resting, rests, first)
    scored = {name: scoring.result(name, target, end, seed) for name, target in targets.items()}
    found_wrong = find_contradictions(recording, robot, lengths, measured, angles=ANGLE_CHANNELS)
    warnings = (*other, *found_wrong)
    moving = _best_moving(scored) if effects and not warnings else None
    if moving is not None:
        found = _effects(recording, robot, measured, moving)
    elif not effects:
        found = "not asked for"
    else:
        found = "warnings" if warnings else "no model that moves solved every sample"
    return ValidationResult(
        robot=robot,
        start=start,
        stop=end,
        seed=seed,
        index=index,
        time=recording.time[index],
        measured=measured,
        resting=resting,
        rests=rests,
        models=scored,
        starts_moving=first is not None,
        rest_speed=float(np.sqrt((speed[resting] ** 2).mean())) if resting.any() else None,
        natural_frequency=rest_frequencies(robot, lengths, rests),
        exit_point_distance=exit_point_distance(recording, robot),
        effects=found if isinstance(found, ResidualEffects) else None,
        effects_model="" if moving is None else moving.name,
        effects_reason="" if isinstance(found, ResidualEffects) else found,
        warnings=warnings,
    )


def _check_inputs(
    recording: Recording, models: Sequence[str], *, start: int = 0, stop: int | None = None
) -> dict[str, Any]:
    """Refuse what cannot be validated; see `validate`.

    Returns:
        What builds each model, by name.
    """
    targets = {name: load_model(name) for name in models}
    if not targets or len(targets) < len(models):
        raise InvalidField("models", list(models), "at least one, each once")
    if recording.metadata.length_kind != "unstrained":
        allowed = "'unstrained': relative lengths fix no pose; calibrate the robot first"
        raise InvalidField("length_kind", repr(recording.metadata.length_kind), allowed)
    count = len(recording.time)
    end = count if stop is None else stop
    if not 0 <= start < count:
        raise InvalidField("start", start, f"0 <= start < {count}, the number of samples")
    if not start < end <= count:
        allowed = f"start = {start} < stop <= {count}, the number of samples"
        raise InvalidField("stop", end, allowed)
    if not recording.pose_at(recording.time[start:end]).valid.any():
        allowed = "samples with measured poses nearby in time"
        raise InvalidField("poses", f"none in samples {start}:{end}", allowed)
    return targets


class _Scoring:
    """Inputs that the scores of all models share."""

    def __init__(
        self,
        recording: Recording,
        robot: Robot,
        index: NDArray[np.int64],
        measured: Pose,
        resting: NDArray[np.bool_],
        rests: tuple[tuple[int, int], ...],
        first: Belief | None,
    ) -> None:
        self._recording = recording
        self._robot = robot
        self._index = index
        self._measured = measured
        self._resting = resting
        self._rests = rests
        self._first = first
        poses = recording.poses
        assert poses is not None
        rates = slope(poses.time, poses.position)
        when = recording.time[index]
        columns = [np.interp(when, poses.time, rates[:, axis]) for axis in range(3)]
        self._velocity = np.column_stack(columns)  # (S, 3)

    def result(self, name: str, target: Any, stop: int, seed: int) -> ModelResult:
        """Run and score one model."""
        try:
            offered = uses_of(self._recording.sensors, simulated=False)
            model = build_plugin(target, self._robot, where=name, offered=offered, seed=seed)
            return self._score(name, run_open_loop(model, self._recording, stop, self._first))
        except (Exception, SystemExit) as error:  # a user's model may raise anything
            reason = f"{type(error).__name__}: {error}".splitlines()[0]
            return ModelResult(name=name, reason=reason)

    def _score(self, name: str, run: ModelRun) -> ModelResult:
        """Score one run."""
        pose = Pose(position=run.position[self._index], rotation=run.rotation[self._index])
        error = pose.position - self._measured.position
        angle = rotation_angle(self._measured.rotation, pose.rotation)
        good = run.converged[self._index]
        if not good.any():
            return ModelResult(name=name, reason="it found no pose at any of the samples")
        moving, resting = good & ~self._resting, good & self._resting
        length_error, sag, stretch = self._lengths(run, good)
        delay = find_delay(error[moving], self._velocity[moving])
        rest_error = np.where(good[:, None], error, 0.0)
        return ModelResult(
            name=name,
            pose=pose,
            moves=run.moves,
            converged=good,
            scores=score_poses(error[good], angle[good]),
            moving=score_poses(error[moving], angle[moving]),
            resting=score_poses(error[resting], angle[resting]),
            rmse_with_failures=float(score_poses(error, angle).rmse[3]),
            length_error=length_error,
            length_scores=score_lengths(length_error),
            sag=sag,
            stretch=stretch,
            delay=delay,
            rmse_without_delay=self._undelayed(error, angle, moving, delay.seconds),
            sway=find_sway(self._recording.time[self._index], rest_error, self._solved_rests(good)),
            nees=self._nees(run, pose, good),
            update_time=float(np.median(run.seconds[1:] if len(run.seconds) > 1 else run.seconds)),
        )

    def _nees(self, run: ModelRun, pose: Pose, good: NDArray[np.bool_]) -> float | None:
        """Return how the errors compare with what the model claims; None if it claims nothing.

        A claim that no error can have, a covariance that is not positive definite, is none.
        """
        if run.covariance is None:
            return None
        covariance = run.covariance[self._index]
        some = good & np.isfinite(covariance).all(axis=(1, 2))
        if not some.any():
            return None
        noise = measured_pose_noise(self._robot)
        try:
            squares = normalised_pose_squares(
                _rows(self._measured, some), _rows(pose, some), covariance[some], noise
            )
        except InvalidField:
            return None
        return float(squares.mean())

    def _lengths(
        self, run: ModelRun, good: NDArray[np.bool_]
    ) -> tuple[Array, float | None, float | None]:
        """Return length errors (S, n), mean sag and mean stretch of a model with tensions [m]."""
        from carosac_toolkit.physics.cable.straight_line import straight_length

        known = self._recording.unstrained_length[self._index]
        position, rotation = self._measured.position, self._measured.rotation
        if run.tension is None:
            straight = straight_length(self._robot, position, rotation)
            predicted = np.where(straight.valid & good[:, None], straight.length, np.nan)
            return known - predicted, None, None
        tension = run.tension[self._index]
        taut = tension >= self._robot.tension_min  # of a slack cable it says nothing on the length
        tension = np.where(good[:, None] & taut, tension, np.nan)
        cables = length_at_tension(self._robot, position, rotation, tension)
        if not cables.valid.any():
            return known - cables.unstrained_length, None, None
        sag, stretch = float(np.nanmean(cables.sag)), float(np.nanmean(cables.stretch))
        return known - cables.unstrained_length, sag, stretch

    def _undelayed(
        self, error: Array, angle: Array, moving: NDArray[np.bool_], delay: Array
    ) -> float:
        """Return the RMSE in norm in motion, corrected for the delay [m]."""
        rest = error - np.nan_to_num(delay) * self._velocity
        return float(score_poses(rest[moving], angle[moving]).rmse[3])

    def _solved_rests(self, good: NDArray[np.bool_]) -> list[tuple[int, int]]:
        """Return the rests of which a model solved every sample."""
        return [(a, b) for a, b in self._rests if good[a:b].all()]


def _rows(pose: Pose, which: NDArray[np.bool_]) -> Pose:
    """Return some of the poses."""
    return Pose(position=pose.position[which], rotation=pose.rotation[which])


def _best_moving(models: Mapping[str, ModelResult]) -> ModelResult | None:
    """Return the most accurate model of motion that solved every sample, or None."""
    solved = [m for m in models.values() if m.scores is not None and m.moves and not m.failures]
    return min(solved, key=lambda m: m.rmse_with_failures, default=None)


def _effects(
    recording: Recording, robot: Robot, measured: Pose, model: ModelResult
) -> ResidualEffects | str:
    """Return the effects that the error of a model looks like, or why none can be told."""
    assert measured.time is not None and model.pose is not None
    try:
        run = SimulatedRun(
            recording=recording, time=measured.time, measured=measured, modelled=model.pose
        )
        return residual_effects(robot, [run])
    except CarosacError as error:
        return str(error)


def _kept(
    rests: Sequence[tuple[int, int]], index: NDArray[np.int64]
) -> tuple[tuple[int, int], ...]:
    """Return the rests, counted in the scored samples."""
    ends = [(int(np.searchsorted(index, a)), int(np.searchsorted(index, b))) for a, b in rests]
    return tuple((a, b) for a, b in ends if b > a)
