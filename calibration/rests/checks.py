"""Checks that refuse recordings whose rests tell too little."""

from __future__ import annotations

import numpy as np

from calibration.normal_equations import solve
from calibration.observability import Unobservable
from calibration.rest_readings import RestReadings
from calibration.rests.fit import first_lengths
from calibration.rests.model import RestModel
from calibration.rests.start import RestStart
from calibration.sensor_errors import SENSOR_WORDS

POSE_SIGMA_SHARE_MAX = 0.02  # of the size of the frame: a first rest known worse is not known


def no_rests(readings: RestReadings) -> str:
    """Say why there is no rest to use."""
    if readings.skipped:
        names = " and ".join(readings.skipped)
        return f"no rest has samples of all sensors: {names} lack some"
    return "the winches never rest: record poses of rest, each at least half a second long"


def check_observable(model: RestModel, start: RestStart) -> None:
    """Refuse rests that leave the pose of the first one unknown."""
    value, length, rest = first_lengths(model, start)
    robot, count = model.unknowns.robot, len(length)
    if not rest.converged.all():
        bad = int((~rest.converged).sum())
        raise Unobservable(
            f"robot {robot.name} cannot rest at {bad} of the {count} rests with the lengths that "
            "fit best: are robot, units, order of the cables and signs of the angles right?"
        )
    prior = model.unknowns.prior
    linear = model.linear(value, length, rest)
    solution = solve(linear, prior.information, np.zeros(len(value)))
    covariance = solution.joint_covariance(*model.pose_derivatives(value, length, rest))[0]
    values, vectors = np.linalg.eigh(covariance[:3, :3])
    limit = POSE_SIGMA_SHARE_MAX * float(np.ptp(robot.exit_points, axis=0).max())
    sigma = float(np.sqrt(values[-1]))
    if sigma <= limit:
        return
    sensors = " and ".join(SENSOR_WORDS[name][0] for name in model.columns)
    helpful = {"tension": "load cells", "attitude": "an AHRS"}
    if len(model.pulleys):
        helpful["swivel_angle"] = "swivel angles"
    missing = [words for name, words in helpful.items() if name not in model.columns]
    unknown = (
        "by more than the frame is wide"
        if sigma > limit / POSE_SIGMA_SHARE_MAX
        else (
            f"by {1e3 * sigma:.0f} mm along {np.array2string(np.abs(vectors[:, -1]), precision=2)}"
        )
    )
    advice = "record more rests, spread over the whole workspace" + (
        f", or {' or '.join(missing)}" if missing else ""
    )
    raise Unobservable(
        f"{count} rests with {sensors} leave the first pose unknown {unknown}, and nothing else "
        f"measures it:\n  {advice}, or measure poses"
    )
