"""Results of a smoother in sentences."""

from __future__ import annotations

import numpy as np

from baselines.smoother.result import Smoothed
from baselines.smoother.scores import SmoothingScores
from carosac_toolkit.base.rotations import from_rotation_vector
from carosac_toolkit.base.tables import counted
from carosac_toolkit.validation.plausibility import doubt_exit_points, exit_point_distance
from carosac_toolkit.validation.scores import rotation_angle

IMPLAUSIBLE_DEVIATIONS = 3.0  # sigma
ANGLE_NAMES = {
    "swivel_angle": "readings of swivel angles",
    "attitude": "orientations by an AHRS",
    "inclination": "readings of an inclinometer",
}
PHASE_NAMES = {"all": "in all", "moving": "winches in motion", "resting": "winches at rest"}


def sentences(result: Smoothed) -> list[str]:
    """Describe the data used, the estimates, and their quality."""
    return [
        _used(result),
        _sigma(result),
        *([] if result.scores is None else _scored(result, result.scores)),
        *_found(result),
        _passes(result),
    ]


def warnings(result: Smoothed) -> list[str]:
    """Describe everything that must not be overlooked."""
    distance = exit_point_distance(result.recording, result.robot)
    lines = [*result.misfits, *doubt_exit_points(distance)]
    if not result.converged:
        passes = counted(result.passes, "pass", "passes")
        lines.append(
            f"not settled after {passes}: the last one would still change a position by "
            f"{result.change * 1e3:.2g} mm"
        )
    lines += _implausible(result)
    if result.settings.poses != "used" and result.recording.poses and result.scores is None:
        lines.append("no score: no measured pose that was not used lies within the lengths")
    if result.outliers:
        lines.append(
            f"{result.outliers} of {len(result.time)} length samples are not what winches can do "
            "and were left out"
        )
    if result.doubted:
        lines.append(f"{result.doubted} of {result.poses} poses are far off and count little")
    for name, count in result.doubted_readings.items():
        used = f"{result.readings[name]} {ANGLE_NAMES[name]}"
        lines.append(f"{count} of {used} are far off and count little")
    return lines


def _implausible(result: Smoothed) -> list[str]:
    """Describe constants that were estimated far from their assumed values."""
    dynamics, robot, lines = result.settings.dynamics, result.robot, []
    why = "the model is wrong" + ("" if result.converged else ", or it did not settle")
    away = abs(float(np.log(result.mass / robot.mass)))
    if away > IMPLAUSIBLE_DEVIATIONS * dynamics.mass > 0.0:
        lines.append(
            f"the mass found, {result.mass:.3f} kg for {robot.mass:.3f} kg, is "
            f"{away / dynamics.mass:.1f} sigma away: {why}"
        )
    turned = _turned(result)
    if turned > IMPLAUSIBLE_DEVIATIONS * dynamics.attitude_mounting > 0.0:
        lines.append(
            f"the AHRS or inclinometer is turned by {np.degrees(turned):.2g} degrees, "
            f"{turned / dynamics.attitude_mounting:.1f} sigma, from how --mounting states it: {why}"
        )
    moved = float(np.abs(result.center_of_mass - robot.center_of_mass).max())
    if moved > IMPLAUSIBLE_DEVIATIONS * dynamics.center_of_mass > 0.0:
        lines.append(
            f"the centre of mass found is {moved * 1e3:.1f} mm, "
            f"{moved / dynamics.center_of_mass:.1f} sigma, away from that of the robot: {why}"
        )
    wind = float(np.sqrt((result.wind**2).mean()))
    if wind > IMPLAUSIBLE_DEVIATIONS * dynamics.wind_force > 0.0:
        lines.append(
            f"the wind found is {wind:.1f} N per axis, {wind / dynamics.wind_force:.1f} times what "
            "was taken for granted: the model does not sway as the platform did, and mass and "
            "centre of mass may be off by more than their sigmas"
        )
    return lines


def _turned(result: Smoothed) -> float:
    """Return by how much a sensor is mounted otherwise than stated [rad]; 0 where none is used."""
    stated = result.settings.dynamics.attitude_rotation
    if stated is None or result.mounting is None:
        return 0.0
    begun = from_rotation_vector(np.array([stated]))
    return float(rotation_angle(begun, result.mounting[None])[0])


def _used(result: Smoothed) -> str:
    """Describe the data used."""
    parts = ["lengths"]
    if result.inertial:
        parts.append(f"{result.inertial} inertial measurements")
    parts += [
        f"{result.readings[name]} {what}"
        for name, what in ANGLE_NAMES.items()
        if result.readings.get(name)
    ]
    if result.poses:
        parts.append(f"{result.poses} measured poses")
    lag = result.settings.lag
    run = result.recording
    unmounted = run.attitude is not None or run.inclination is not None
    left = ""
    if unmounted and result.settings.angles and result.mounting is None:
        left = " Not used: the AHRS or inclinometer, as --mounting does not say how it is mounted."
    until = "of the whole recording" if lag is None else f"up to at least {lag:g} s later"
    return f"Used: {', '.join(parts)}, {until}.{left}"


def _sigma(result: Smoothed) -> str:
    """Describe the uncertainty of the estimate."""
    sigma = np.sqrt((result.sigma**2).mean(axis=0))
    position = " / ".join(f"{value * 1e3:.1f}" for value in sigma[:3])
    turn = " / ".join(f"{np.degrees(value):.2f}" for value in sigma[3:6])
    return f"One sigma of the estimate: {position} mm in x / y / z, {turn} degrees about them."


def _scored(result: Smoothed, scores: SmoothingScores) -> list[str]:
    """Describe the errors against poses that were not used."""
    lines = []
    for name, part in scores.parts.items():
        axes = " / ".join(f"{value * 1e3:.1f}" for value in part.rmse[:3])
        lines.append(
            f"RMSE on {part.samples} poses that were not used, {PHASE_NAMES[name]}: {axes} mm in "
            f"x / y / z, {part.rmse[3] * 1e3:.1f} mm in norm, "
            f"{np.degrees(part.orientation_rmse):.2f} degrees; NEES {scores.nees[name]:.2f} "
            "(1: as large as the covariance says)."
        )
    return lines


def _found(result: Smoothed) -> list[str]:
    """Describe the constants that the data determined, and those only assumed."""
    bias = ", ".join(
        f"{value * 1e3:+.1f} +-{sigma * 1e3:.1f}"
        for value, sigma in zip(
            result.length_bias.mean(axis=0),
            np.sqrt((result.length_bias_sigma**2).mean(axis=0)),
            strict=True,
        )
    )
    center = ", ".join(
        f"{value * 1e3:.1f} +-{sigma * 1e3:.1f}"
        for value, sigma in zip(result.center_of_mass, result.center_sigma, strict=True)
    )
    told, wind = result.told, np.linalg.norm(result.wind, axis=1)
    blown = f"wind {np.sqrt((wind**2).mean()):.2f} N RMS, {wind.max():.2f} N at most"
    unknown = f"wind of 0 +-{result.wind_sigma.max():.2g} N per axis"
    ahead = f" +-{result.delay_sigma * 1e3:.1f}" if result.delay_sigma else ""
    words = {
        "length_bias": f"readings too long by {bias} mm",
        "mass": f"mass {result.mass:.3f} +-{result.mass_sigma:.3f} kg",
        "center_of_mass": f"centre of mass at {center} mm in P",
        "wind": blown if told["wind"] else unknown,
        "delay": f"lengths lead by {result.delay * 1e3:.1f}{ahead} ms",
    }
    determined = [words[name] for name in words if told[name]]
    left = [words[name] for name in words if not told[name]]
    lines = [f"Told by the data: {'; '.join(determined)}."] if determined else []
    return [*lines, *([f"Taken for granted: {'; '.join(left)}."] if left else [])]


def _passes(result: Smoothed) -> str:
    """Describe whether the passes settled."""
    state = "settled" if result.converged else "did not settle"
    return f"It {state} in {counted(result.passes, 'pass', 'passes')}."
