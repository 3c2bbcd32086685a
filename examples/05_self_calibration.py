"""A robot finds its own geometry: motor angles of 40 places, six of which are known.

A synthetic Hangprinter v4: exit points guessed to half a metre, drums to 2 mm. Its mover is dragged
to 40 places; a camera knows five on the bed and a pole one above it. One line slips off its drum
on the way, and one known position was written down wrong. Exit points, drums and all 40 positions
come out with their sigmas, and the two mistakes are named.

Writes 05_self_calibration.png and prints the median error of the positions that nobody knew.
"""

from dataclasses import replace

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np

import carosac_toolkit as ct
from calibration import (
    MeasurementNoise,
    calibrate_motor_angles,
    draw_positions,
    measure_motor_angles,
)

EXITS = [[0.02, -1.59, -0.11], [1.29, 1.23, -0.16], [-1.42, 0.74, -0.15], [0.02, 0.0, 2.35]]  # [m]
KNOWN = [[0, 0, 0], [-0.3, -0.3, 0], [0.3, 0, 0], [0.3, 0.4, 0], [-0.2, 0.4, 0], [0.1, -0.1, 1.4]]
SLIPPED, MISWRITTEN = 17, 3  # samples

guess = ct.load_robot("hangprinter")
truth = replace(guess, exit_points=EXITS, drum_radius=guess.drum_radius + 1e-3)
rng = np.random.default_rng(5)
place = draw_positions(truth, 40, rng)
place[: len(KNOWN)] = KNOWN
angles = measure_motor_angles(
    truth, place, np.arange(len(KNOWN)), MeasurementNoise(line=1e-3, known=1e-3), rng,
    blunders={(SLIPPED, 1): 0.15},
)  # fmt: skip
written = angles.known_position.copy()
written[MISWRITTEN, 0] += 0.1
result = calibrate_motor_angles(replace(angles, known_position=written), guess)

exits = result.estimate.value[:12].reshape(4, 3)
unknown = ~angles.is_known & result.used
error = 1e3 * np.linalg.norm(result.position - place, axis=1)  # [mm]
sigma = 1e3 * np.linalg.norm(result.position_sigma, axis=1)

figure, (above, side, sizes) = plt.subplots(1, 3, figsize=(14.5, 4.8), layout="constrained")
for panel, axis in ((above, 1), (side, 2)):
    rows = [0, axis]
    for start, end in zip(guess.exit_points[:, rows], exits[:, rows], strict=True):
        panel.annotate("", end, start, arrowprops={"arrowstyle": "->", "color": "0.6"})
    panel.plot(*guess.exit_points[:, rows].T, "^", color="0.6", label="exit points, guessed")
    panel.plot(*exits[:, rows].T, "^", color="#0072b2", label="exit points, found")
    panel.plot(*np.array(EXITS)[:, rows].T, "k+", ms=11, label="exit points, true")
    panel.plot(*result.position[unknown][:, rows].T, ".", color="0.3", label="positions, found")
    panel.plot(*written[: len(KNOWN), rows].T, "s", mfc="none", color="#44aa99", label="known")
    wrong = np.array([result.position[SLIPPED, rows], written[MISWRITTEN, rows]])
    panel.plot(*wrong.T, "x", color="#d55e00", ms=8, mew=2, label="left out")
    panel.set(xlabel="x [m]", ylabel=f"{'xyz'[axis]} [m]", aspect="equal")
above.set_title("From above")
side.set_title("From the side")
handles, labels = side.get_legend_handles_labels()
figure.legend(handles, labels, loc="outside lower center", ncols=6, frameon=False)

order = np.argsort(sigma)
order = order[unknown[order]]
count = np.arange(len(order))
sizes.bar(count, error[order], color="#77aadd", label="error")
sizes.plot(count, sigma[order], "k_", ms=6, label="1 sigma (norm)")
sizes.set(
    xlabel="unknown positions, surest first",
    ylabel="position error [mm]",
    title="Positions nobody knew",
)
sizes.legend(frameon=False)
named = "; ".join(f"sample {b.sample}: {b.what}, {b.sigmas:.0f} sigma" for b in result.blunders)
figure.suptitle(f"hangprinter, calibrated from its motor angles. Left out as blunders: {named}")
figure.savefig("05_self_calibration.png", dpi=110)
print(f"median error of {len(order)} unknown positions: {np.median(error[order]):.2f} mm")
