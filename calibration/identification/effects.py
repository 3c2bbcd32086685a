"""Effects that the error of an identified robot looks like."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from calibration.identification.result import Identification, IdentifiedRun
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import CarosacError
from carosac_toolkit.loop.values import Pose
from carosac_toolkit.recordings.encoders import calibrated
from carosac_toolkit.recordings.recording import Recording
from carosac_toolkit.robot.parameters import turn_between
from carosac_toolkit.validation.residual_effects import (
    ResidualEffects,
    SimulatedRun,
    residual_effects,
)


def remaining_effects(
    recordings: Sequence[Recording], result: Identification
) -> ResidualEffects | str:
    """Tell which effects the open-loop errors of an identified robot look like.

    Args:
        recordings: As they were recorded, in the order of the result.
        result: The identification.

    Returns:
        Why not, where they cannot be told.
    """
    turn = turn_between(result.before, result.robot)
    try:
        runs = [
            _simulated(calibrated(recording, result.robot), run, turn)
            for recording, run in zip(recordings, result.runs, strict=True)
        ]
        return residual_effects(result.robot, runs)
    except CarosacError as error:
        return str(error)


def _simulated(recording: Recording, run: IdentifiedRun, turn: Array) -> SimulatedRun:
    """Return a recording with its poses, in the frame of the identified robot.

    Args:
        recording: As calibrated.
        run: What the identification says of it.
        turn: From the frame before to that of the identified robot, shape (3, 3).
    """
    poses, errors = run.measured, run.errors
    rotation = poses.rotation @ Rotation.from_rotvec(errors[:, 3:]).as_matrix()
    measured, modelled = (
        Pose(position=np.asarray(position @ turn.T), rotation=turn @ turned)
        for position, turned in (
            (poses.position, poses.rotation),
            (poses.position + errors[:, :3], rotation),
        )
    )
    return SimulatedRun(recording=recording, time=poses.time, measured=measured, modelled=modelled)
