"""Calibrate a robot from its cable lengths and 100 seconds of motion capture.

The bundled robot ``cogiro`` is built a little differently from its file: exit points off by 5 cm,
anchor points by 2 mm, encoders with unknown zeros, readings that come early. It is driven through
its workspace; 5 % of the readings are blunders. The calibration finds what is different, says how
well, names the blunders, and asks for the poses that would teach most.

Writes 04_lengths.png and prints how far the exit points are off before and after.
"""

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np

import carosac_toolkit as ct
from calibration import calibrate_lengths, draw_length_scene, suggest_poses

BLUE, ORANGE = "#0072b2", "#d55e00"

robot = ct.load_robot("cogiro")
scene = draw_length_scene(robot, np.random.default_rng(4))
found = calibrate_lengths(scene.recording, robot)
further = suggest_poses(found, 8, rng=np.random.default_rng(4))

truth = np.array([[scene.truth[f"exit_points[{c}].{a}"] for a in "xyz"] for c in robot.cable_names])
before = 1e3 * np.linalg.norm(robot.exit_points - truth, axis=1)  # (n,) [mm]
after = 1e3 * np.linalg.norm(found.robot.exit_points - truth, axis=1)
sigma = 1e3 * np.sqrt(np.trace(found.robot.exit_covariance, axis1=1, axis2=2))

figure, (points, rest, places, plan) = plt.subplots(
    1, 4, figsize=(16.0, 4.6), layout="constrained", width_ratios=(1.2, 1.3, 1.0, 0.9)
)
place = np.arange(robot.n)
points.bar(place - 0.2, before, 0.4, color="0.7", label="before")
points.bar(place + 0.2, after, 0.4, color=BLUE, label="after")
points.plot(place + 0.2, sigma, "k_", ms=9, mew=1.5)
points.set_xticks(place, robot.cable_names, rotation=40)
points.set(yscale="log", ylabel="exit point, distance from the truth [mm]", ylim=(0.3, 500.0))
points.set_title("Exit points (cap: stated 1 sigma)")
points.legend(frameon=False, loc="upper center", ncols=2)

residual, reach = 1e3 * found.residual, 12.0
inside, outside = np.where(found.outlier, np.nan, residual), residual[found.outlier]
when = np.broadcast_to(found.time[:, None], residual.shape)[found.outlier]
rest.plot(found.time, inside, ".", color=BLUE, ms=2)
rest.plot(when, np.clip(outside, -reach, reach), "x", color=ORANGE, ms=4)
rest.set(xlabel="time [s]", ylabel="reading minus model [mm]", ylim=(-1.05 * reach, 1.05 * reach))
rest.set_title(f"{found.outlier.sum()} blunders named (crosses), {scene.outlier.sum()} made")

places.plot(*found.position[:, :2].T, ".", color="0.6", ms=2, label="measured")
places.plot(*further.position[:, :2].T, "*", color=ORANGE, ms=10, label="suggested")
places.set(xlabel="x [m]", ylabel="y [m]", aspect="equal", title="Poses, from above")
places.legend(frameon=False, loc="lower center", bbox_to_anchor=(0.5, 1.12), ncols=2)

number = np.arange(len(further.sigma))
plan.plot(number, 1e3 * further.worst, "s--", color=ORANGE, label="worst coordinate")
plan.plot(number, 1e3 * further.sigma, "o-", color=BLUE, label="mean (RMS)")
plan.set(xlabel="further poses", ylabel="1 sigma of the exit points [mm]", ylim=(0.0, None))
plan.set_title("What they would teach")
plan.legend(frameon=False, loc="lower left")
figure.suptitle(f"{robot.name}, calibrated from its cable lengths and measured poses")
figure.savefig("04_lengths.png", dpi=110)
print(
    f"exit points: {np.median(before):.0f} mm off before, {np.median(after):.1f} mm after (median)"
)
