"""A recorded run of a swaying robot: what its lengths say of each moment, and of the whole run.

The bundled recording has cable lengths and motion-capture poses of a simulated `carosac`. The
kinematic solver sees the lengths of each moment alone; the smoother goes through the whole run, and
uses every second pose. Both are scored at the other poses, which neither of them gets.

Writes 15_smooth.png and prints both errors.
"""

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np

import carosac_toolkit as ct
from baselines import SmootherSettings, smooth
from carosac_toolkit.recordings.bundled import find_recording

SAMPLES = 240  # 12 s

robot = ct.load_robot("carosac")
run = ct.load_recording(find_recording("synthetic")).slice(0, SAMPLES)
found = smooth(run, robot, SmootherSettings(poses="half"))
measured, compared = found.measured, found.compared  # withheld poses, and the estimate there

rest = ct.statics.forward_kinematics(robot, run.unstrained_length).position
solver = np.column_stack([np.interp(measured.time, run.time, rest[:, i]) for i in range(3)])
errors = {
    "kinematic solver, lengths alone": (solver - measured.position, "#d55e00"),
    "smoother, with the other poses": (compared.position - measured.position, "#0072b2"),
}
rmse = {name: 1e3 * np.sqrt((e**2).sum(axis=1).mean()) for name, (e, _) in errors.items()}

figure, (path, error, spread) = plt.subplots(
    1, 3, figsize=(13.5, 4.0), layout="constrained", width_ratios=(1.2, 1.2, 0.8)
)
path.plot(measured.time, measured.position[:, 0], "k.", ms=3, label="withheld poses")
path.plot(measured.time, solver[:, 0], color="#d55e00", ls="--", lw=1.2, label="kinematic solver")
path.plot(found.time, found.position[:, 0], color="#0072b2", lw=1.2, label="smoother")
path.set(xlabel="time [s]", ylabel="x [m]", title="carosac, across the sway")
path.legend(frameon=False)

sigma = np.sqrt(found.covariance[:, :3, :3].diagonal(axis1=1, axis2=2).sum(axis=1))
for name, (values, color) in errors.items():
    norm = 1e3 * np.linalg.norm(values, axis=1)
    error.plot(measured.time, norm, color=color, lw=1.0, label=f"{name}: {rmse[name]:.1f} mm RMS")
    spread.hist(norm, bins=np.geomspace(0.2, 500.0, 40), color=color, alpha=0.7)
error.plot(
    found.time, 2e3 * sigma, "k--", lw=0.9, label="two sigma of the smoother (poses: 1 mm an axis)"
)
error.set(xlabel="time [s]", ylabel="position error [mm]", yscale="log", ylim=(0.2, 5000.0))
error.set_title("Distance from withheld poses")
error.legend(frameon=False, loc="upper right", fontsize=8)
spread.set(xlabel="position error [mm]", ylabel="poses", xscale="log", title="Withheld poses")
figure.savefig("15_smooth.png", dpi=120)
print("error at withheld poses: " + ", ".join(f"{n} {value:.1f} mm" for n, value in rmse.items()))
