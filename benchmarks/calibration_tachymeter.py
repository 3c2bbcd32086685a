"""Tachymeter calibration on drawn surveys: errors, consistency of covariances, blunders named.

Each scenario draws a hall: exit points 5 cm off the robot file, two set-ups of random place,
heading and residual tilt, six reference points whose known coordinates are drawn with their stated
sigma, noise of every reading, and blunders. NEES is the squared error of all exit points in their
joint covariance; an over-confident covariance makes it large. Run as
``python -m benchmarks.calibration_tachymeter``.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

import carosac_toolkit as ct
from benchmarks.results import table, write_section
from calibration import Sighting, SurveyPlan, calibrate_tachymeter, draw_survey
from calibration.tachymeter.observations import READING_NAMES
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.robot.robot import Robot

COMMAND = "python -m benchmarks.calibration_tachymeter"
SCENARIOS = 100
SEED = 2026


@dataclass(frozen=True)
class Score:
    """What many scenarios gave.

    Attributes:
        error: Distance of every exit point from the truth [m], shape (scenarios, n).
        nees: Of each scenario, shape (scenarios,).
        chi2: Sum over the scenarios, and its degrees of freedom.
        blunders: Drawn, of them over 10 sigma, of those named, and good readings left out.
        seconds: CPU time of a scenario.
    """

    error: Array
    nees: Array
    chi2: tuple[float, int]
    blunders: tuple[int, int, int, int]
    seconds: float

    @property
    def consistency(self) -> str:
        """Mean NEES per unknown with its 95 % band."""
        unknowns = 3 * self.error.size
        low, high = np.array(chi2.interval(0.95, unknowns)) / unknowns
        return f"{self.nees.sum() / unknowns:.3f} ({low:.3f} to {high:.3f})"


def score(robot: Robot, plan: SurveyPlan, scenarios: int = SCENARIOS) -> Score:
    """Draw, calibrate and compare with the truth."""
    error, nees, seconds = [], [], 0.0
    total, freedom = 0.0, 0
    drawn = large = named = good = 0
    for number in range(scenarios):
        scene = draw_survey(robot, np.random.default_rng([SEED, number]), plan)
        start = time.process_time()
        result = calibrate_tachymeter(robot, scene.survey)
        seconds += time.process_time() - start
        off = result.exit_points - scene.truth.exit_points
        error.append(np.linalg.norm(off, axis=1))
        nees.append(off.ravel() @ np.linalg.solve(result.exit_covariance, off.ravel()))
        total, freedom = total + result.chi2, freedom + result.freedom
        found = {(b.shot, b.reading) for b in result.blunders}
        wrong = {(i + 1, READING_NAMES[column]): size for i, column, size in scene.wrong}
        sigma = result.residuals.sigma
        big = {
            key for key, size in wrong.items()
            if abs(size) > 10.0 * sigma[key[0] - 1, READING_NAMES.index(key[1])]
        }  # fmt: skip
        drawn, large, named = drawn + len(wrong), large + len(big), named + len(big & found)
        good += len(found - set(wrong))
    return Score(
        np.array(error), np.array(nees), (total, freedom), (drawn, large, named, good),
        seconds / scenarios,
    )  # fmt: skip


def rows_of(
    what: str, found: Score, median: str = "reported", worst: str = "reported",
    nees: str = "reported", naming: str = "all",
) -> list[list[str]]:  # fmt: skip
    """Lines of the table; a bar that is held is given."""
    mm = 1e3 * found.error
    rows = [
        [f"{what}: error, median", median, f"{np.median(mm):.2f} mm"],
        [f"{what}: error, 95 % and largest", worst,
         f"{np.quantile(mm, 0.95):.2f}, {mm.max():.2f} mm"],
        [f"{what}: NEES per unknown", nees, found.consistency],
        [f"{what}: chi2 per degree of freedom; CPU time", "1; reported",
         f"{found.chi2[0] / found.chi2[1]:.3f}; {1e3 * found.seconds:.0f} ms"],
    ]  # fmt: skip
    drawn, large, named, good = found.blunders
    left = f"{good} good readings left out"
    if drawn:
        rows.append([f"{what}: blunders over 10 sigma named", naming,
                     f"{named} of {large} ({drawn} drawn); {left}"])  # fmt: skip
    else:
        rows.append([f"{what}: false alarms", "reported", left])
    return rows


def main() -> None:
    """Measure and write."""
    robot = ct.load_robot("carosac")
    pulleys = replace(
        robot, pulley_radius=np.full(robot.n, 0.05), swivel_axis=np.tile([0, 0, 1.0], (robot.n, 1))
    )
    band = "inside its 95 % band"
    gross = SurveyPlan(blunders=0.05)
    rows = rows_of("no blunders", score(robot, SurveyPlan()), "0.8 mm", nees=band)
    rows += rows_of("5 % blunders", score(robot, gross), "2 mm", "2 mm")
    rows += rows_of("5 % blunders, one face only", score(robot, replace(gross, faces=1)))
    rough = SurveyPlan(reference_sigma=1e-3)
    rows += rows_of("known points to 1 mm instead of 0.5 mm", score(robot, rough), nees=band)
    axle = SurveyPlan(sighting=Sighting("axle"), swivel_sigma=float(np.deg2rad(0.5)))
    rows += rows_of("axles of 5 cm pulleys, swivels to 0.5 deg", score(pulleys, axle), nees=band)
    long = score(robot, SurveyPlan(), 10 * SCENARIOS)
    rows += rows_of(f"no blunders, {10 * SCENARIOS} scenarios", long, nees=band)
    text = (
        f"{SCENARIOS} random scenarios a line, robot carosac: two set-ups, both faces, six known "
        "points (0.5 mm per axis, drawn), 3 arcsec, 1 mm + 1.5 ppm, 0.3 mm pointing and centring, "
        "compensator 2 arcsec, exit points 5 cm off at the start. Blunders: one reading of a shot "
        "off by 0.02 rad or 0.5 m.\n\n"
    )
    body = text + table(["what", "bar", "measured"], rows)
    write_section("calibration-tachymeter", "Calibration: tachymeter", COMMAND, body)
    print(body)


if __name__ == "__main__":
    main()
