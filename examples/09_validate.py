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

MODELS = {"straight_line": "tab:orange", "kinematic_solver": "tab:blue"}

run = ct.load_recording(find_recording("synthetic")).slice(0, 400)
found = ct.validate(run, ct.load_robot("carosac"), tuple(MODELS))

figure, (height, error) = plt.subplots(1, 2, figsize=(11.0, 3.8), layout="constrained")
height.plot(found.time, found.measured.position[:, 2], "k.", ms=3, label="measured")
rmse = {}
for name, color in MODELS.items():
    position = found.models[name].pose.position
    away = 1e3 * np.linalg.norm(position - found.measured.position, axis=1)
    rmse[name] = float(np.sqrt((away**2).mean()))
    height.plot(found.time, position[:, 2], color=color, lw=1.0, label=name)
    error.semilogy(found.time, away, color=color, lw=1.0, label=f"{name}, RMSE {rmse[name]:.0f} mm")
rest = np.where(found.resting, 6.0, np.nan)
error.plot(found.time, rest, color="0.6", lw=4, label="winches at rest")
height.set(xlabel="time [s]", ylabel="z of the platform [m]", title="What the lengths say")
error.set(xlabel="time [s]", ylabel="distance from the measured position [mm]", title="Errors")
height.legend(frameon=False)
error.set_ylim(5.0, 2000.0)
error.legend(frameon=False, loc="upper left")
figure.savefig("09_validate.png", dpi=120)
print(", ".join(f"{name}: {value:.0f} mm" for name, value in rmse.items()))
