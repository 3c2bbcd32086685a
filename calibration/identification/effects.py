"""Effects that the error of an identified robot looks like."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from calibration.identification.result import Identification, IdentifiedRun
from carosac_toolkit.base.errors import CarosacError
from carosac_toolkit.loop.values import Pose
from carosac_toolkit.recordings.encoders import calibrated
from carosac_toolkit.recordings.recording import Recording
from carosac_toolkit.robot.parameters import turn_between
from carosac_toolkit.validation.residual_effects import ResidualEffects, residual_effects


def remaining_effects(
    recording: Recording, result: Identification, run: IdentifiedRun
) -> ResidualEffects | str:
    """Tell which effects the open-loop error of an identified robot looks like in one recording.

    Args:
        recording: As it was recorded.
        result: The identification.
        run: What it says of this recording.

    Returns:
        Why not, where they cannot be told.
    """
    turn = turn_between(result.before, result.robot)
    poses, errors = run.measured, run.errors
    rotation = poses.rotation @ Rotation.from_rotvec(errors[:, 3:]).as_matrix()
    measured, modelled = (
        Pose(position=np.asarray(position @ turn.T), rotation=turn @ turned)
        for position, turned in (
            (poses.position, poses.rotation),
            (poses.position + errors[:, :3], rotation),
        )
    )
    try:
        material = calibrated(recording, result.robot)
        return residual_effects(material, result.robot, poses.time, measured, modelled)
    except CarosacError as error:
        return str(error)
