"""Which model explains a recorded run: straight cables, or cables that sag.

The bundled recording has cable lengths and motion-capture poses of a simulated `carosac`. Both
models get the lengths alone, in order, and are scored against the measured poses.

Writes 09_validate.png and prints the error of both.
"""

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np

import carosac_toolkit as ct
from carosac_toolkit.recordings.bundled import find_recording

MODELS = {"straight_line": ("#d55e00", "--"), "kinematic_solver": ("#0072b2", "-")}

run = ct.load_recording(find_recording("synthetic")).slice(0, 400)
robot = ct.load_robot("carosac")
found = ct.validate(run, robot, tuple(MODELS))

figure, (path, error) = plt.subplots(1, 2, figsize=(11.0, 4.2), layout="constrained")
path.plot(found.time, found.measured.position[:, 0], "k.", ms=3, label="measured")
rmse = {}
for name, (color, line) in MODELS.items():
    position = found.models[name].pose.position
    away = 1e3 * (position - found.measured.position)
    rmse[name] = float(np.sqrt((away**2).sum(axis=1).mean()))
    label = f"{name}, RMSE {rmse[name]:.0f} mm"
    path.plot(found.time, position[:, 0], color=color, ls=line, lw=1.2, label=label)
    error.plot(found.time, away[:, 0], color=color, ls=line, lw=1.2)
for k, (first, end) in enumerate(found.rests):
    for axes in (path, error):
        shade = axes.axvspan(found.time[first], found.time[end - 1], color="0.9", lw=0, zorder=0)
    shade.set_label("winches at rest" if k == 0 else None)
error.axhline(0.0, color="k", lw=0.6)
path.set(xlabel="time [s]", ylabel="x of the platform [m]", title="Where the lengths say it is")
error.set(xlabel="time [s]", ylabel="x, model minus measured [mm]", title="Error")
figure.legend(loc="outside lower center", ncols=4, frameon=False)
figure.suptitle(f"{robot.name}: models open loop on recorded lengths")
figure.savefig("09_validate.png", dpi=120)
print(", ".join(f"{name}: {value:.0f} mm" for name, value in rmse.items()))
