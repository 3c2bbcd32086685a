"""From an estimate to a new robot, and to its file."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from calibration.estimate import ParameterEstimate
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.base.files import check_writable, replacing
from carosac_toolkit.robot.file import parse_robot, robot_path, robot_text
from carosac_toolkit.robot.model_error import ModelError
from carosac_toolkit.robot.parameter_names import point_names
from carosac_toolkit.robot.parameters import with_values
from carosac_toolkit.robot.robot import Robot


def prior_covariance(robot: Robot, names: tuple[str, ...], sigma: Array) -> Array:
    """Return what a robot file knows: its calibration, its exit covariances, or else `sigma`.

    Args:
        robot: The robot.
        names: k parameters.
        sigma: One standard deviation of each where the robot says nothing, shape (k,); finite.

    Returns:
        Joint covariance, shape (k, k).
    """
    covariance = np.diag(np.square(sigma))
    if robot.exit_covariance is not None:
        for cable, block in zip(robot.cable_names, robot.exit_covariance, strict=True):
            rows = [
                (names.index(n), a)
                for a, n in enumerate(point_names("exit_points", [cable]))
                if n in names
            ]
            for i, a in rows:
                for j, b in rows:
                    covariance[i, j] = block[a, b]
    if robot.calibrated is not None and robot.calibration_covariance is not None:
        known = [name for name in names if name in robot.calibrated]
        mine = [names.index(name) for name in known]
        theirs = [robot.calibrated.index(name) for name in known]
        covariance[mine] = covariance[:, mine] = 0.0
        covariance[np.ix_(mine, mine)] = robot.calibration_covariance[np.ix_(theirs, theirs)]
    return covariance


def updated(robot: Robot, estimate: ParameterEstimate) -> Robot:
    """Return the robot with estimated parameters and their covariance.

    What an earlier calibration knew of other parameters stays, as independent of the new ones.

    Args:
        robot: The robot that was calibrated.
        estimate: Of some of its parameters.

    Raises:
        InvalidField: A value that a robot cannot have.
    """
    names, covariance = list(estimate.names), estimate.covariance
    if robot.calibrated is not None and robot.calibration_covariance is not None:
        rest = [i for i, name in enumerate(robot.calibrated) if name not in names]
        older = robot.calibration_covariance[np.ix_(rest, rest)]
        names += [robot.calibrated[i] for i in rest]
        covariance = np.block(
            [
                [covariance, np.zeros((len(covariance), len(older)))],
                [np.zeros((len(older), len(covariance))), older],
            ]
        )
    changed = with_values(robot, estimate.names, estimate.value)
    return replace(
        changed,
        calibrated=tuple(names),
        calibration_covariance=covariance,
        exit_covariance=_exit_covariance(robot, names, covariance),
        model_error=None,  # the model is another one
    )


def check_output(option: str, output: Path | None, robot: str) -> None:
    """Refuse to write a new robot over the one that was calibrated, before any work is done.

    Args:
        option: The option that names the output.
        output: Where the new robot file is to go.
        robot: Bundled name or path of the old one.
    """
    check_writable(option, output, (".yaml", ".yml"))
    original = robot_path(robot)
    if output is not None and output.exists() and original.exists() and output.samefile(original):
        allowed = "a new file: the robot file that was calibrated is never overwritten"
        raise InvalidField(option, f"'{output}'", allowed)


def write_robot(
    source: str,
    estimate: ParameterEstimate,
    output: Path,
    *,
    provenance: str,
    name: str | None = None,
    model_error: ModelError | None = None,
) -> Robot:
    """Write a robot file with estimated parameters and covariances; comments of the old one stay.

    Args:
        source: Bundled name or path of the robot that was calibrated.
        estimate: Of some of its parameters.
        output: The new file.
        provenance: Where the numbers come from, one line.
        name: Of the new robot; None keeps the old one.
        model_error: What the model with the new numbers misses; None: not known.

    Returns:
        The robot in the new file.

    Raises:
        InvalidField: The output is the old file, or a value is one that no robot can have.
    """
    from carosac_toolkit.robot.writer import robot_document

    check_output("output", output, source)
    text = robot_text(source)
    robot = replace(updated(parse_robot(text, source=source), estimate), model_error=model_error)
    if name is not None:
        robot = replace(robot, name=name)
    document = robot_document(text, robot, provenance=provenance)
    with replacing(output) as temporary:
        temporary.write_text(document, encoding="utf-8")
    return robot


def _exit_covariance(robot: Robot, names: list[str], covariance: Array) -> Array | None:
    """Return the blocks of the exit points; those of before where a point was not estimated."""
    blocks = []
    for i, cable in enumerate(robot.cable_names):
        rows = [names.index(name) for name in point_names("exit_points", [cable]) if name in names]
        if len(rows) == 3:
            blocks.append(covariance[np.ix_(rows, rows)])
        elif robot.exit_covariance is not None and not rows:
            blocks.append(robot.exit_covariance[i])
        else:
            return robot.exit_covariance
    return np.array(blocks)
