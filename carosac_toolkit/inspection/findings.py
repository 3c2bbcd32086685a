"""Reasons why a robot cannot work at home, and suspected mistakes in its file, in words."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.numbers import plain
from carosac_toolkit.inspection import contacts, swaps
from carosac_toolkit.inspection.home import HOME_TILT_MAX_DEG, RobotAtHome
from carosac_toolkit.inspection.units import doubtful_units
from carosac_toolkit.robot.checks import unused_parts
from carosac_toolkit.robot.sizes import SURFACE_CABLES

if TYPE_CHECKING:
    from carosac_toolkit.physics.rest.statics import Equilibrium

DEEP_SAG_RATIO = 0.1  # of the length: a cable that sags more is hardly a cable of a robot
RANK_TOLERANCE = 1e-6  # of the largest singular value: smaller ones count as none
FREQUENCY_MIN_HZ = 1e-6  # [Hz]: a slower motion does not oscillate
TENSION_ROUNDING_N = 1e-6  # [N]: what rounding may exceed a tension limit by


def problems(report: RobotAtHome) -> list[str]:
    """Explain why the robot cannot stay at home, or not as it is; empty if it can.

    Args:
        report: The robot and its equilibrium at home.
    """
    findings = [*_inside_pulley(report)]
    home = report.equilibrium
    if not home.converged[0]:
        findings += _no_equilibrium(report)
    elif not home.stable[0]:
        findings.append(_unstable(report))
    touching = [*contacts.touching(report)]
    crossed = [*swaps.swapped(report)] if findings or touching else []
    limits = [*_tension_limits(report, home), *_winch_range(report)]
    return [*findings, *limits, *touching, *crossed]


def warnings(report: RobotAtHome) -> list[str]:
    """List suspected mistakes of a robot that may still work.

    Args:
        report: The robot and its equilibrium at home.
    """
    findings = doubtful_units(report)
    findings += [*_low_rank(report), *_deep_sag(report), *_long_wrap(report)]
    findings += contacts.through_platform(report)
    tilt = float(np.degrees(report.tilt))
    if report.equilibrium.converged[0] and tilt > HOME_TILT_MAX_DEG:
        findings.append(
            f"the platform tilts by {tilt:.0f} degrees at home: is center_of_mass right?"
        )
    if report.file is not None:
        findings += [f"{name} is used by no chain" for name in unused_parts(report.file)]
    return findings


def _unstable(report: RobotAtHome) -> str:
    """Explain an equilibrium that is not stable."""
    growing = [f"{value:.3g} Hz" for value in report.frequencies if value < -FREQUENCY_MIN_HZ]
    if growing:
        return (
            "the equilibrium is not stable: a motion of negative natural frequency grows instead "
            f"of oscillating, here {', '.join(growing)}"
        )
    return (
        "the equilibrium is not stable: a natural frequency is zero, so no force restores the "
        f"pose; the platform {_free_motion(report)}"
    )


def _free_motion(report: RobotAtHome) -> str:
    """Describe the motion of the least stiffness."""
    size = float(np.linalg.norm(report.robot.anchor_points, axis=1).max()) or 1.0
    scale = np.repeat([1.0, 1.0 / size], 3)  # of twists, so that all six are lengths
    stiffness = scale[:, None] * report.equilibrium.stiffness[0] * scale
    values, vectors = np.linalg.eigh(0.5 * (stiffness + stiffness.T))
    motion = vectors[:, int(np.argmin(np.abs(values)))]
    turns = np.linalg.norm(motion[3:]) > np.linalg.norm(motion[:3])
    direction = motion[3:] if turns else motion[:3]
    direction = direction / np.linalg.norm(direction)
    direction = np.round(direction * np.sign(direction[np.argmax(np.abs(direction))]), 2) + 0.0
    text = "(" + ", ".join(f"{value:g}" for value in direction) + ")"
    return f"turns freely about {text}" if turns else f"moves freely along {text}"


def _inside_pulley(report: RobotAtHome) -> Iterator[str]:
    """Find anchor points inside their pulley."""
    for i in np.flatnonzero(~report.straight.valid[0]):
        radius = report.robot.pulley_radius[i]
        name = report.robot.cable_names[i]
        yield (
            f"cable {name} has its anchor point inside its pulley of {radius:g} m radius: is the "
            "radius in mm? A bare number is in metres"
        )


def _no_equilibrium(report: RobotAtHome) -> Iterator[str]:
    """Explain why nothing balances at home."""
    from carosac_toolkit.physics.rest.statics import STATUS_REASONS

    yield STATUS_REASONS[report.equilibrium.status[0]]
    yield from _outside(report)
    if report.robot.n == SURFACE_CABLES:
        yield from _off_plane(report)
    needed = _without_limits(report)
    if needed is not None:
        yield from _tension_limits(report, needed)
    elif report.straight.valid.all():
        yield "no tensions hold it there, whatever their limits"


def _off_plane(report: RobotAtHome) -> Iterator[str]:
    """Name the position of rest of two cables that is nearest to home."""
    from carosac_toolkit.physics.rest.nearest import nearest_rest

    nearest = nearest_rest(report.robot, report.robot.home_position[None])
    rest, distance = nearest.equilibrium, float(nearest.distance[0])
    if rest.converged[0] and rest.stable[0]:
        place = ", ".join(f"{value:.4g}" for value in np.round(rest.position[0], 9) + 0.0)
        yield (
            "two cables let the platform rest in one vertical plane only: the nearest position of "
            f"rest is ({place}) m, {distance:.3g} m from home"
        )


def _without_limits(report: RobotAtHome) -> Equilibrium | None:
    """Solve for rest at home with as few tension limits lifted as possible, upper ones first."""
    from carosac_toolkit.physics.rest import statics

    robot = report.robot
    cables = float(robot.weight_per_length @ report.straight.length[0])
    endless = robot.tension_max + 1e3 * (robot.weight + cables)
    none = np.zeros(robot.n)
    for low, high in (
        (robot.tension_min, endless),
        (none, robot.tension_max),
        (none, endless),
    ):
        wider = replace(robot, tension_min=low, tension_max=high)
        home = statics.inverse_kinematics(wider, robot.home_position[None])
        if home.converged[0]:
            return home
    return None


def _tension_limits(report: RobotAtHome, home: Equilibrium) -> Iterator[str]:
    """Find tensions beyond the limits of the robot."""
    if not home.converged[0]:
        return
    robot = report.robot
    for i, tension in enumerate(home.tension[0]):
        needs = f"cable {robot.cable_names[i]} would need {tension:.1f} N at home"
        if tension > robot.tension_max[i] + TENSION_ROUNDING_N:
            yield f"{needs}, its maximum is {robot.tension_max[i]:g} N"
        elif tension < robot.tension_min[i] - TENSION_ROUNDING_N:
            yield f"{needs}, its minimum is {robot.tension_min[i]:g} N"


def _winch_range(report: RobotAtHome) -> Iterator[str]:
    """Find lengths at home beyond the range of the winches."""
    robot, known = report.robot, report.equilibrium.converged[0]
    lengths = report.equilibrium.unstrained_length[0] if known else report.straight.length[0]
    for i in np.flatnonzero((lengths < robot.length_min) | (lengths > robot.length_max)):
        if known or report.straight.valid[0, i]:
            yield (
                f"cable {robot.cable_names[i]} needs {lengths[i]:.4f} m of unstrained length at "
                f"home{'' if known else ' (if straight)'}; its winch has length_min to length_max "
                f"= {robot.length_min[i]:g} to {robot.length_max[i]:g} m"
            )


def _outside(report: RobotAtHome) -> Iterator[str]:
    """Find a home that no cable pulls to."""
    from scipy.spatial import ConvexHull, QhullError

    robot = report.robot
    center = robot.home_position + robot.home_rotation @ robot.center_of_mass
    anchors = robot.home_position + robot.anchor_points @ robot.home_rotation.T
    if (robot.exit_points[:, 2] <= anchors[:, 2]).all():
        yield "home is above all exit points: no cable pulls up there"
    try:
        sides = ConvexHull(robot.exit_points[:, :2]).equations
    except (QhullError, ValueError):  # exit points on one line
        return
    beyond = float((sides[:, :2] @ center[:2] + sides[:, 2]).max())
    if beyond > 0.0:
        yield (
            f"home is {plain(beyond, 3)} m outside the exit points as seen from above: no cable "
            "pulls the platform there"
        )


def _low_rank(report: RobotAtHome) -> Iterator[str]:
    """Find cables that leave the platform free to move although there are enough of them."""
    from carosac_toolkit.physics.rest.structure import structure_matrix

    robot = report.robot
    if not report.straight.valid.all():
        return
    matrix = structure_matrix(robot, robot.home_position[None], report.rotation[None])[0]
    size = float(np.linalg.norm(robot.anchor_points, axis=1).max()) or 1.0
    scaled = matrix / np.array([1.0, 1.0, 1.0, size, size, size])[:, None]
    values = np.linalg.svd(scaled, compute_uv=False)
    rank, full = int((values > RANK_TOLERANCE * values[0]).sum()), min(6, robot.n)
    if rank < full:
        yield (
            f"the structure matrix at home has rank {rank} of {full}: "
            f"{_cause(robot.anchor_points)}; the cables hold the platform in {rank} directions only"
        )


def _cause(anchors: Array) -> str:
    """Explain why cables are dependent."""
    spread = np.linalg.svd(anchors - anchors.mean(axis=0), compute_uv=False)
    if spread[0] < 1e-9:
        return "anchor points coincide"
    if len(spread) > 1 and spread[1] < RANK_TOLERANCE * spread[0]:
        return "anchor points lie on one line"
    return "the cables' lines of action depend on each other"


def _deep_sag(report: RobotAtHome) -> Iterator[str]:
    """Find cables that sag deeply."""
    lengths = report.equilibrium.unstrained_length[0]
    for i in np.flatnonzero(report.sag > DEEP_SAG_RATIO * lengths):
        yield (
            f"cable {report.robot.cable_names[i]} sags {plain(report.sag[i], 4)} m at home, more "
            f"than a tenth of its {plain(lengths[i], 4)} m: are its weight, length and tension_min "
            "right?"
        )


def _long_wrap(report: RobotAtHome) -> Iterator[str]:
    """Find cables that wrap their pulley the wrong way."""
    robot = report.robot
    for i in np.flatnonzero(report.wrap > np.pi):
        yield (
            f"cable {robot.cable_names[i]} wraps {np.degrees(report.wrap[i]):.0f} degrees of its "
            "pulley at home, more than half a turn: swivel_axis must point the way the cable "
            "travels from the winch into the pulley ([0, 0, 1] where the winch is below)"
        )
