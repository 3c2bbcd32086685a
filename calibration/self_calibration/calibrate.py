"""Self-calibration: exit points, drums and all positions from motor angles."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calibration.estimate import ParameterEstimate
from calibration.self_calibration.blunder_tests import SettledFit, cautious, settle
from calibration.self_calibration.contradictions import contradictions
from calibration.self_calibration.frame import Frame, find_frame
from calibration.self_calibration.motor_angles import MotorAngles
from calibration.self_calibration.problem import MotorAngleProblem
from calibration.self_calibration.result import LeftOut, SampleBlunder, SelfCalibration
from calibration.self_calibration.rigid_motions import around, independent
from calibration.self_calibration.rivals import Rival, better_rival, find_rivals, fits_better
from calibration.self_calibration.scale import find_scale
from calibration.self_calibration.settings import SelfCalibrationSettings
from calibration.self_calibration.solver import SampleFit, Trust, equations, fit
from calibration.self_calibration.starting_points import starts
from calibration.self_calibration.suspects import suspects
from calibration.self_calibration.verdict import (
    check_determined,
    check_reference,
    check_rotation,
    warnings_of,
)
from calibration.self_calibration.vertical import find_vertical
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.rotations import from_rotation_vector
from carosac_toolkit.robot.robot import Robot

HEADING_STEPS = 5
ADOPTIONS_MAX = 4  # times that a better solution takes the place of the best one
SURE_NOISE_SHARE = 2e-4  # of the longest cable: with that noise what stays free is refused early
PREDICTED_SHARE_MAX = 0.02  # of the longest cable: a known position predicted worse tells nothing


def calibrate_motor_angles(
    motor_angles: MotorAngles, robot: Robot, settings: SelfCalibrationSettings | None = None
) -> SelfCalibration:
    """Find what the motor angles of a resting platform tell of a robot.

    Cables are straight and stiff, as no tensions are known: what a constant tension stretches is
    taken for a larger drum. The rotation of the platform is that at home, but for seven cables or
    more that end apart, which tell it.

    Args:
        motor_angles: N samples. Without known positions the frame of the result is one of
            convention, in `SelfCalibration.frame`.
        robot: As known before: exit points, drums, home and workspace.
        settings: Priors of all else.

    Returns:
        Parameters with covariances, positions with sigmas, residuals and blunders.

    Raises:
        InvalidField: The motors are not those of the robot, its drums are unknown, or there are too
            few samples to tell the noise.
        Unobservable: The data leave the exit points or the origin free.
    """
    settings = settings or SelfCalibrationSettings()
    angles = motor_angles.in_order_of(robot.cable_names)
    problem = MotorAngleProblem(robot, angles, settings)
    check_rotation(problem)
    first = starts(independent(problem))
    everything = np.ones(len(angles.samples), dtype=np.bool_)
    line = settings.line_sigma or SURE_NOISE_SHARE * problem.longest
    rough = Trust(line_sigma=line, lengths=everything, known=problem.is_known, robust=False)
    problem = around(problem, first[0].shared, _frame(problem, first[0], rough).free)
    frame = _frame(problem, first[0], rough)
    check_determined(problem, first[0], rough, frame)
    before = problem.points(problem.prior.mean)
    first = [frame.aligned(problem, start, before) for start in first]
    settled = settle(problem, first[0], settings)
    frame = _frame(problem, settled.fit, settled.trust)
    rivals = find_rivals(problem, settled, frame, first[1:])
    others = first[1:]
    for _ in range(ADOPTIONS_MAX):
        better = better_rival(problem, settled, rivals)
        if better is None:
            break
        other = settle(problem, better.fit, settings)
        if better.better and not fits_better(other, settled):
            break
        others, settled = [*others, settled.fit], other
        frame = _frame(problem, settled.fit, settled.trust)
        rivals = find_rivals(problem, settled, frame, others)
    check_reference(problem, settled.trust)
    upright = frame.level
    if upright and frame.vertical is not None:
        problem, settled = _turned(problem, settled, _upright(frame.vertical.up))
        frame = _frame(problem, settled.fit, settled.trust, upright=True)
    if settings.x_through is not None:
        problem, settled = _headed(problem, settled, settings.x_through)
        frame = _frame(problem, settled.fit, settled.trust, upright=upright)
    check_determined(problem, settled.fit, settled.trust, frame)
    return _result(problem, settled, frame, rivals)


def _headed(
    problem: MotorAngleProblem, settled: SettledFit, cable: str
) -> tuple[MotorAngleProblem, SettledFit]:
    """Turn everything about the vertical through home until an exit point is over the x axis."""
    home = problem.robot.home_position
    row = problem.exits[problem.robot.cable_names.index(cable)]
    # Turning the exit point about home moves its anchor point's offset along; a few steps suffice.
    rotation = np.eye(3)
    for _ in range(HEADING_STEPS):
        shared = problem.turned_values(rotation, settled.fit.shared)
        x, y, _ = shared[row] - home
        cosine, sine = np.array([x, y]) / np.hypot(x, y)
        step = np.array([[cosine, sine, 0.0], [-sine, cosine, 0.0], [0.0, 0.0, 1.0]])
        rotation = step @ rotation
    return _turned(problem, settled, rotation)


def _upright(up: Array) -> Array:
    """Return the shortest turn that brings a unit vector upwards, shape (3, 3)."""
    axis = np.cross(up, [0.0, 0.0, 1.0])
    sine = float(np.linalg.norm(axis))
    angle = np.arctan2(sine, up[2])
    return np.asarray(from_rotation_vector(axis * (angle / max(sine, np.finfo(float).tiny))))


def _turned(
    problem: MotorAngleProblem, settled: SettledFit, rotation: Array
) -> tuple[MotorAngleProblem, SettledFit]:
    """Turn everything about home, and settle again."""
    home = problem.robot.home_position
    turned = problem.turned(rotation)
    start = replace(
        settled.fit,
        shared=problem.turned_values(rotation, settled.fit.shared),
        position=(settled.fit.position - home) @ rotation.T + home,
    )
    return turned, settle(turned, start, problem.settings)


def _frame(
    problem: MotorAngleProblem, solution: SampleFit, trust: Trust, *, upright: bool = False
) -> Frame:
    """Return the frame of a solution; `upright`: it was turned by measured tensions."""
    system = equations(problem, solution.shared, solution.position, trust)
    data = system.information - problem.before(solution.shared).information
    vertical = find_vertical(
        problem, solution.shared, solution.position, system.by_shared, trust.lengths
    )
    return find_frame(problem, solution.shared, data, vertical, upright=upright)


def _result(
    problem: MotorAngleProblem,
    settled: SettledFit,
    frame: Frame,
    rivals: list[Rival],
) -> SelfCalibration:
    """Put everything together."""
    angles, trust = problem.angles, settled.trust
    shared, position = settled.fit.shared, settled.fit.position
    system = equations(problem, shared, position, cautious(problem, settled))
    lost = ~trust.lengths & ~trust.known
    covariance = frame.covariance(system.information)
    place = position[:, :3]
    slope = frame.position_slope(system.by_shared[:, :3], place)
    spread = system.position_covariance[:, :3, :3] + slope @ covariance @ slope.swapaxes(1, 2)
    each = np.sqrt(np.diagonal(spread, axis1=1, axis2=2))
    scale = find_scale(problem, shared, covariance, trust)
    return SelfCalibration(
        before=problem.robot,
        estimate=_parameters(problem, shared, covariance),
        samples=angles.samples,
        position=place,
        rotation=problem.rotations(position),
        position_sigma=np.where(lost[:, None], np.inf, each),
        residual=problem.linearize(shared, position).residual,
        used=trust.lengths,
        is_known=angles.is_known,
        known_axes=angles.coordinates_known,
        known_position=angles.known_position,
        advantage=problem.advantage,
        length_at_zero=shared[problem.zeros],
        length_at_zero_sigma=np.sqrt(np.diag(covariance))[problem.zeros],
        line_sigma=trust.line_sigma,
        redundancy=settled.redundancy,
        blunders=_blunders(problem, settled),
        left_out=_left_out(problem, settled),
        frame=frame,
        scale=scale,
        rivals=tuple(rivals),
        observability=problem.prior.judge(
            frame.held(system.information - problem.prior.information)
        ),
        warnings=(
            *warnings_of(problem, settled, rivals, frame, covariance),
            *contradictions(problem, settled, frame, scale),
            *suspects(problem, settled),
        ),
    )


def _parameters(
    problem: MotorAngleProblem, shared: Array, shared_covariance: Array
) -> ParameterEstimate:
    """Return the parameters of the robot, each cable with its own drum."""
    robot = problem.robot
    before, slope_before = problem.drum_radius(problem.prior.mean)
    radius, slope = problem.drum_radius(shared)
    exits = np.eye(problem.size)[problem.exits.ravel()]
    buildup = np.eye(problem.size)[problem.buildups]
    soft = np.eye(problem.size)[problem.compliances]
    stiffness = robot.axial_stiffness[: len(soft)]
    after = stiffness / (1.0 + shared[problem.compliances])
    stiff = [-(value**2 / stiffness)[:, None] * soft for value in (after, stiffness)]
    to_robot = np.vstack([exits, slope, buildup, stiff[0]])
    prior = problem.prior.covariance
    from_before = np.vstack([exits, slope_before, buildup, stiff[1]])
    names = (
        *problem.prior.names[: problem.exits.size],
        *(f"drum_radius[{cable}]" for cable in robot.cable_names),
        *(f"drum_buildup[{cable}]" for cable in robot.cable_names),
        *(f"axial_stiffness[{cable}]" for cable in robot.cable_names[: len(soft)]),
    )
    covariance = to_robot @ shared_covariance @ to_robot.T
    return ParameterEstimate(
        names=names,
        value=np.concatenate(
            [shared[problem.exits].ravel(), radius, shared[problem.buildups], after]
        ),
        covariance=0.5 * (covariance + covariance.T),
        start=np.concatenate(
            [
                problem.prior.mean[problem.exits].ravel(),
                before,
                problem.prior.mean[problem.buildups],
                stiffness,
            ]
        ),
        prior_sigma=np.sqrt(np.diag(from_before @ prior @ from_before.T)),
    )


def _blunders(problem: MotorAngleProblem, settled: SettledFit) -> tuple[SampleBlunder, ...]:
    """Name the samples that were left out."""
    tests, trust, angles = settled.tests, settled.trust, problem.angles
    blunders = []
    for k, name in enumerate(angles.samples):
        if not trust.lengths[k]:
            sigmas = float(np.sqrt(tests.closure[k] / max(tests.closure_free[k], 1.0)))
            blunders.append(SampleBlunder(sample=name, what="motor angles", sigmas=sigmas))
        if angles.is_known[k] and not trust.known[k]:
            sigmas = float(np.sqrt(tests.place[k] / max(tests.place_free[k], 1.0)))
            blunders.append(SampleBlunder(sample=name, what="known position", sigmas=sigmas))
    return tuple(blunders)


def _left_out(problem: MotorAngleProblem, settled: SettledFit) -> tuple[LeftOut, ...]:
    """Predict each known position from everything else."""
    trust, angles, left_out = cautious(problem, settled), problem.angles, []
    for k in np.flatnonzero(trust.known & trust.lengths & angles.is_known):
        axes = angles.coordinates_known[k]
        known = trust.known.copy()
        known[k] = False
        less = replace(trust, known=known)
        other = fit(problem, settled.fit.shared, settled.fit.position, less)
        sigma = np.sqrt(
            np.diag(_position_covariance(problem, other, less, int(k)))
            + problem.known_sigma[k, :3] ** 2
        )
        if (sigma < PREDICTED_SHARE_MAX * problem.longest)[axes].all():
            error = other.position[k, :3] - angles.known_position[k]
            left_out.append(
                LeftOut(
                    sample=angles.samples[k],
                    error=np.where(axes, error, np.nan),
                    sigma=np.where(axes, sigma, np.nan),
                )
            )
    return tuple(left_out)


def _position_covariance(
    problem: MotorAngleProblem, solution: SampleFit, trust: Trust, row: int
) -> Array:
    """Return the covariance of one position [m^2], shape (3, 3)."""
    system = equations(problem, solution.shared, solution.position, trust)
    slope = system.by_shared[row, :3]
    covariance: Array = system.position_covariance[row, :3, :3] + slope @ np.linalg.solve(
        system.information, slope.T
    )
    return covariance
