"""From a survey to exit points in the robot's frame, with covariances and named blunders."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from calibration.estimate import ParameterEstimate
from calibration.observability import Observability, judge
from calibration.tachymeter.first_values import first_values
from calibration.tachymeter.network import Network
from calibration.tachymeter.observations import READING_NAMES, Survey
from calibration.tachymeter.result import ReadingBlunder, Residuals, Station, TachymeterResult
from calibration.tachymeter.sightings import SightedPulley, elevation
from calibration.tachymeter.survey_fit import CHECKED_REDUNDANCY, SurveyFit, fit
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.base.extras import require
from carosac_toolkit.robot.parameter_names import point_names
from carosac_toolkit.robot.parameters import values_of
from carosac_toolkit.robot.robot import Robot

EXIT_SCALE_M = (
    0.05  # [m] by which an exit point may be off before it is surveyed: a scale, no prior
)
EDGE_ON_RAD = 0.03  # [rad], beside what the swivel may be off, within which a wheel shows no side


def calibrate_tachymeter(
    robot: Robot, survey: Survey, *, frame_tilt: float = 0.0, use_prior: bool = False
) -> TachymeterResult:
    """Estimate the exit points of a robot from a survey.

    Args:
        robot: Tells cables, pulleys and the exit points before; those are no prior, unless asked.
        survey: The measurements.
        frame_tilt: Standard deviation of the tilt of the references' frame against W, whose z is
            up, about x and y [rad]; it is estimated then. 0: the references' frame is level.
        use_prior: Take the exit points' covariances in the robot as prior knowledge.

    Returns:
        Exit points of the sighted cables, with evidence.

    Raises:
        InvalidField: Targets, sightings or pulleys do not fit the robot.
        Unobservable: The survey has no place in the robot's frame, or is not held together.
    """
    require("the tachymeter calibration", "gtsam")
    check_targets(robot, survey)
    stations, points = first_values(survey)
    pulleys = _pulleys(robot, survey)
    network = Network(
        survey=survey,
        sides=_sides(survey, pulleys, stations, points),
        pulleys=pulleys,
        exit_prior=_exit_prior(robot, survey) if use_prior else {},
        frame_tilt=frame_tilt,
    )
    return _result(robot, network, fit(network, _start(network, stations, points)))


def check_targets(robot: Robot, survey: Survey) -> None:
    """Refuse targets that are neither cable nor reference, and pulley points where none is.

    Raises:
        InvalidField: Names the first shot that does not fit.
    """
    both = [name for name in survey.references if name in robot.cable_names]
    if both:
        raise InvalidField("references", both[0], "names that no cable of the robot has")
    for shot in survey.shots:
        if shot.target not in robot.cable_names and shot.target not in survey.references:
            allowed = f"a cable ({', '.join(robot.cable_names)}) or a reference point"
            raise InvalidField(f"{shot.where}: target", repr(shot.target), allowed)
        if not shot.sighting.on_pulley:
            continue
        field = f"{shot.where}: sighted"
        if shot.target not in robot.cable_names:
            allowed = "centre: only a cable has a pulley"
            raise InvalidField(field, shot.sighting.kind, allowed)
        if robot.pulley_radius[robot.cable_names.index(shot.target)] <= 0.0:
            allowed = f"centre: cable {shot.target} has no pulley in the robot file"
            raise InvalidField(field, shot.sighting.kind, allowed)
        if shot.target not in survey.towards:
            allowed = (
                "with the anchor point to which the cable ran during the survey, since the pulley "
                "swivels towards it: give platform_position in the targets file"
            )
            raise InvalidField(field, shot.sighting.kind, allowed)
    if not any(shot.target in robot.cable_names for shot in survey.shots):
        raise InvalidField("shots", "none to a cable", "at least one shot to an exit point")


def _pulleys(robot: Robot, survey: Survey) -> dict[str, SightedPulley]:
    """Return the pulleys of which something off the datum was sighted."""
    names = dict.fromkeys(shot.target for shot in survey.shots if shot.sighting.on_pulley)
    pulleys = {}
    for name in names:
        i = robot.cable_names.index(name)
        pulleys[name] = SightedPulley(
            cable=name,
            radius=float(robot.pulley_radius[i]),
            axis=robot.swivel_axis[i],
            towards=np.asarray(survey.towards[name]),
        )
    return pulleys


def _sides(
    survey: Survey,
    pulleys: Mapping[str, SightedPulley],
    stations: Mapping[str, Array],
    points: Mapping[str, Array],
) -> tuple[float, ...]:
    """Return on which side of its wheel each shot was taken; refuse wheels seen edge-on."""
    sides = []
    for shot in survey.shots:
        side = 1.0
        if shot.sighting.side != 0.0:
            station = stations[shot.setup][:3]
            angle = elevation(points[shot.target], pulleys[shot.target], station)
            least = EDGE_ON_RAD + 3.0 * survey.swivel_sigma
            if abs(angle) < least:
                allowed = (
                    f"0: from {shot.setup} the pulley is seen edge-on (within "
                    f"{np.rad2deg(least):.0f} degrees), so the side that was sighted is unclear"
                )
                raise InvalidField(f"{shot.where}: side", f"{shot.sighting.side} m", allowed)
            side = float(np.sign(angle))
        sides.append(side)
    return tuple(sides)


def _exit_prior(robot: Robot, survey: Survey) -> dict[str, tuple[Array, Array]]:
    """Return the sighted exit points as the robot file knows them."""
    if robot.exit_covariance is None:
        allowed = "a robot whose exit points have sigma or covariance"
        raise InvalidField("use_prior", f"robot {robot.name} without them", allowed)
    blind = [
        name for name, c in zip(robot.cable_names, robot.exit_covariance, strict=True)
        if name in survey.targets and np.linalg.eigvalsh(c)[0] <= 0.0
    ]  # fmt: skip
    if blind:
        allowed = "a positive definite covariance to take as prior"
        raise InvalidField(f"exit_points[{blind[0]}]", "a singular covariance", allowed)
    return {
        name: (robot.exit_points[i], robot.exit_covariance[i])
        for i, name in enumerate(robot.cable_names)
        if name in survey.targets
    }


def _start(network: Network, stations: Mapping[str, Array], points: Mapping[str, Array]) -> Any:
    """Return the first values for gtsam."""
    import gtsam

    values = gtsam.Values()
    for name, key in network.keys.items():
        kind, _, owner = name.partition(" ")
        if kind == "setup":
            values.insert(key, stations[owner])
        elif kind == "point":
            values.insert(key, np.asarray(points[owner], dtype=np.float64))
        else:
            values.insert(key, np.zeros(1 if kind == "swivel" else 2))
    return values


def _result(robot: Robot, network: Network, solution: SurveyFit) -> TachymeterResult:
    """Read the result out of the fit."""
    survey = network.survey
    cables = tuple(name for name in robot.cable_names if name in survey.targets)
    estimate = _estimate(robot, network, solution, cables)
    stations = {}
    for name in survey.setups:
        stations[name] = Station(
            values=np.array(solution.values.atVector(network.keys[f"setup {name}"])),
            sigma=np.sqrt(np.diag(solution.covariance)[network.columns[f"setup {name}"]]),
        )
    points = {
        name: np.array(solution.values.atVector(network.keys[f"point {name}"]))
        for name in survey.targets
    }
    return TachymeterResult(
        before=robot,
        survey=survey,
        cables=cables,
        estimate=estimate,
        points=points,
        stations=stations,
        swivels={
            name: float(solution.values.atVector(network.keys[f"swivel {name}"])[0])
            for name in network.pulleys
        },
        blunders=_blunders(network, solution),
        unchecked=_unchecked(network, solution),
        residuals=_residuals(network, solution),
        observability=_observability(network, estimate, cables),
        chi2=solution.chi2,
        freedom=solution.freedom,
        converged=solution.converged,
    )


def _estimate(
    robot: Robot, network: Network, solution: SurveyFit, cables: Sequence[str]
) -> ParameterEstimate:
    """Return the exit points, and the tilt of the references' frame where it was estimated."""
    keys = [network.keys[f"point {name}"] for name in cables]
    names = point_names("exit_points", cables)
    start = [robot.exit_points[robot.cable_names.index(name)] for name in cables]
    prior = [
        np.sqrt(np.diag(network.exit_prior[name][1])) if name in network.exit_prior
        else np.full(3, np.inf)
        for name in cables
    ]  # fmt: skip
    if network.frame_tilt > 0.0:
        keys.append(network.keys["tilt"])
        names += ["pose_tilt.x", "pose_tilt.y"]
        start.append(values_of(robot, names[-2:]))
        prior.append(np.full(2, network.frame_tilt))
    columns = _columns_of(network, keys)
    return ParameterEstimate(
        names=tuple(names),
        value=np.concatenate([solution.values.atVector(key) for key in keys]),
        covariance=solution.covariance[np.ix_(columns, columns)],
        start=np.concatenate(start),
        prior_sigma=np.concatenate(prior),
    )


def _columns_of(network: Network, keys: Sequence[int]) -> list[int]:
    """Return the columns of unknowns in the order of their keys."""
    by_key = {key: network.columns[name] for name, key in network.keys.items()}
    return [i for key in keys for i in range(by_key[key].start, by_key[key].stop)]


def _observability(
    network: Network, estimate: ParameterEstimate, cables: Sequence[str]
) -> Observability:
    """Judge how well the survey alone determines the exit points."""
    names = [name for name in estimate.names if name.startswith("exit_points")]
    information = np.asarray(np.linalg.inv(estimate.select(names).covariance), dtype=np.float64)
    for i, cable in enumerate(cables):
        if cable in network.exit_prior:
            block = slice(3 * i, 3 * i + 3)
            information[block, block] -= np.linalg.inv(network.exit_prior[cable][1])
    return judge(names, information, np.full(len(names), EXIT_SCALE_M))


def _blunders(network: Network, solution: SurveyFit) -> tuple[ReadingBlunder, ...]:
    """Return the rows left out, the worst first."""
    blunders = [
        ReadingBlunder(
            **_place(network, int(row)),
            # measured minus model: by how much the reading is too large
            error=float(-solution.residual[row] * network.sigma[row]),
            sigmas=float(abs(solution.test[row])),
            or_else=_words(network, int(solution.alike[row])) if solution.alike[row] >= 0 else "",
        )
        for row in np.flatnonzero(~solution.used)
    ]
    return tuple(sorted(blunders, key=lambda blunder: -blunder.sigmas))


def _place(network: Network, row: int) -> dict[str, Any]:
    """Say which reading a row is."""
    shots = network.survey.shots
    if row < 3 * len(shots):
        shot = shots[row // 3]
        return {
            "shot": row // 3 + 1, "setup": shot.setup, "target": shot.target,
            "reading": READING_NAMES[row % 3], "source": shot.source,
        }  # fmt: skip
    index = row - 3 * len(shots)
    name = network.survey.known[index // 3].name
    return {
        "shot": None, "setup": "", "target": name,
        "reading": f"known {'xyz'[index % 3]}", "source": "",
    }  # fmt: skip


def _words(network: Network, row: int) -> str:
    """Name a reading."""
    place = _place(network, row)
    if place["shot"] is None:
        return f"{place['reading']} of {place['target']}"
    return f"{place['reading']} of shot {place['shot']}"


def _unchecked(network: Network, solution: SurveyFit) -> tuple[str, ...]:
    """Return the readings in use that nothing checks: a blunder in them would pass unseen."""
    rows = np.flatnonzero(solution.used & (solution.redundancy < CHECKED_REDUNDANCY))
    places = [_place(network, int(row)) for row in rows]
    by_target: dict[str, list[str]] = {}
    for place in places:
        who = f"shot {place['shot']} " if place["shot"] else ""
        by_target.setdefault(str(place["target"]), []).append(f"{who}{place['reading']}")
    return tuple(f"{target} ({', '.join(what)})" for target, what in by_target.items())


def _residuals(network: Network, solution: SurveyFit) -> Residuals:
    """Return the residuals of all shots."""
    count = 3 * len(network.survey.shots)
    sigma = network.sigma[:count].reshape(-1, 3)
    return Residuals(
        value=-solution.residual[:count].reshape(-1, 3) * sigma,
        sigma=sigma,
        test=-solution.test[:count].reshape(-1, 3),
        used=solution.used[:count].reshape(-1, 3),
        redundancy=solution.redundancy[:count].reshape(-1, 3),
    )
