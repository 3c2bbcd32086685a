"""Exit points from a total station: two set-ups, both faces, two gross errors among 40 shots.

A survey of the bundled robot ``carosac`` is drawn from the full measurement model. Exit points in
the robot file are 5 cm off; the calibration finds them, and names the gross errors.

Writes 03_tachymeter.png and prints the median error of the calibrated exit points.
"""

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np

import carosac_toolkit as ct
from calibration import SurveyPlan, calibrate_tachymeter, draw_survey

MAGNIFIED = 500.0  # times that the ellipses are drawn
COLORS = {"A": "#0072b2", "B": "#44aa99"}
WRONG = "#d55e00"
READINGS = {"Hz": ("o", "#00425a"), "V": ("D", "#77aadd"), "distance": ("s", "#7f3b08")}

robot = ct.load_robot("carosac")
scene = draw_survey(robot, np.random.default_rng(3), SurveyPlan(blunders=0.05))
result = calibrate_tachymeter(robot, scene.survey)
shots, used = scene.survey.shots, result.residuals.used

figure, (site, tests, errors) = plt.subplots(
    1, 3, figsize=(13.5, 5.0), layout="constrained", width_ratios=(1.1, 1.5, 1.1)
)

# The hall from above: lines of sight, and what the survey says of the exit points.
for shot, good in zip(shots, used.all(axis=1), strict=True):
    ends = np.array([result.stations[shot.setup].values[:3], result.points[shot.target]])
    color, width = (COLORS[shot.setup], 0.5) if good else (WRONG, 1.6)
    site.plot(ends[:, 0], ends[:, 1], color=color, lw=width, zorder=1 if good else 2)
for name, station in result.stations.items():
    site.plot(*station.values[:2], "^", color=COLORS[name], ms=9, label=f"set-up {name}")
known = np.array([result.points[reference.name] for reference in scene.survey.known])
site.plot(known[:, 0], known[:, 1], "s", color="0.4", ms=5, label="known point")
for i, point in enumerate(result.exit_points):
    block = result.exit_covariance[3 * i : 3 * i + 2, 3 * i : 3 * i + 2]
    turn = np.linspace(0.0, 2.0 * np.pi, 73)
    ring = np.linalg.cholesky(block) @ np.array([np.cos(turn), np.sin(turn)])
    site.plot(*(point[:2, None] + MAGNIFIED * ring), color="black", lw=1.2)
    site.plot(*point[:2], "o", color="black", ms=4, label="exit point" if i == 0 else None)
site.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
site.set_title(f"From above (1 sigma, {MAGNIFIED:.0f} times larger)", fontsize=10)
site.legend(fontsize=8, loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False)

# Every reading against all others, in standard deviations of its own residual.
for column, (name, (marker, color)) in enumerate(READINGS.items()):
    value, good = result.residuals.test[:, column], used[:, column]
    number = np.arange(1, len(shots) + 1)
    tests.plot(number[good], value[good], marker, ms=4, color=color, label=name)
    tests.plot(number[~good], value[~good], marker, ms=8, color=WRONG)
for blunder in result.blunders:
    text = f"shot {blunder.shot}, {blunder.target}:\n{blunder.reading} off by {blunder.size}"
    tests.annotate(
        text, (blunder.shot, np.sign(blunder.error) * blunder.sigmas), xytext=(9, 0),
        textcoords="offset points", va="center", fontsize=8, color=WRONG,
    )  # fmt: skip
for limit in (-4.0, 4.0):
    tests.axhline(limit, color="0.4", ls="--", lw=1)
tests.set_yscale("symlog", linthresh=4.0)  # linear between the limits
tests.set(xlabel="shot", ylabel="residual [its sigmas]", ylim=(-2e3, 100.0))
tests.set_title("Gross errors are named, and left out (dashed: the limit)", fontsize=10)
tests.legend(fontsize=8, loc="upper center", ncols=3, frameon=False)

before = 1e3 * np.linalg.norm(robot.exit_points - scene.truth.exit_points, axis=1)
after = 1e3 * np.linalg.norm(result.exit_points - scene.truth.exit_points, axis=1)
place = np.arange(robot.n)
errors.bar(place - 0.2, before, 0.4, color="0.7", label="robot file")
errors.bar(place + 0.2, after, 0.4, color="#0072b2", label="calibrated")
errors.set(ylabel="distance from the truth [mm]", yscale="log", ylim=(0.1, 1000.0))
errors.set_xticks(place, [name.replace("_", "\n") for name in robot.cable_names])
for x, y in zip([*(place - 0.2), *(place + 0.2)], [*before, *after], strict=True):
    errors.annotate(f"{y:.0f}" if y > 10.0 else f"{y:.2f}", (x, y * 1.05), ha="center", fontsize=8)
errors.set_title("Exit points", fontsize=10)
errors.legend(fontsize=8, loc="upper center", ncols=2, frameon=False)
figure.suptitle(f"{robot.name}: {len(shots)} shots from two set-ups, two gross errors among them")
figure.savefig("03_tachymeter.png", dpi=120)
print(f"median error of the calibrated exit points: {np.median(after):.2f} mm")
