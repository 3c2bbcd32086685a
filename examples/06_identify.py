"""Identify a swaying robot from half a minute of motion, and see what it was worth.

A plant that differs from the bundled robot ``carosac`` by the condition `nominal-2` moves through
drawn places, in wind, with noisy sensors. All that may be wrong about it is fitted on the first
70 % of the run; the rest was not fitted.

Writes 06_identify.png and prints the open-loop error on the rest, before and after.
"""

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np

import carosac_toolkit as ct
from calibration import RunSettings, identify, simulate_run
from carosac_toolkit.robot.parameters import values_of

robot = ct.load_robot("carosac")
run = simulate_run(robot, seed=6, settings=RunSettings(moves=6, rate=20.0))
count = len(run.recording.time)
cut = round(0.7 * count)
found = identify(run.recording, robot, train=(0, cut), test=(cut, count))

figure, (motion, learnt) = plt.subplots(
    1, 2, figsize=(13.0, 4.4), layout="constrained", width_ratios=(1.6, 1.0)
)
fitted = found.runs[0]
time, measured = fitted.measured.time, fitted.measured.position
for label, position, color in (
    ("nominal robot", fitted.position_before, "0.6"),
    ("identified robot", fitted.position_after, "#0072b2"),
):  # fmt: skip
    motion.plot(time, 1e3 * (position - measured)[:, 0], color=color, lw=1.2, label=label)
motion.axvline(run.recording.time[cut], color="#d55e00", lw=1.5)
motion.text(
    run.recording.time[cut], 1.01, "not fitted", transform=motion.get_xaxis_transform(),
    color="#d55e00",
)  # fmt: skip
motion.set(
    xlabel="time [s]", ylabel="x, simulated minus measured [mm]", title=f"{robot.name}, open loop"
)
motion.legend(frameon=False, loc="lower left")
motion.grid(alpha=0.3)

names = [name for name in found.estimate.names if "[" not in name]  # those of no single cable
estimate = found.estimate.select(names)
truth = (values_of(run.plant, names) - estimate.value) / estimate.sigma
rows = np.arange(len(names))
learnt.errorbar(np.zeros(len(names)), rows, xerr=1.0, fmt="o", color="#0072b2", label="estimate")
learnt.plot(truth, rows, "k|", ms=14, mew=2.0, label="truth")
learnt.set_yticks(rows, names)
learnt.set(xlabel="in its sigmas", title="Estimated and true parameters", xlim=(-4.0, 4.0))
learnt.legend(frameon=False, loc="lower right")
learnt.grid(alpha=0.3)

figure.savefig("06_identify.png", dpi=110)
before, after = (1e3 * scores.rmse[3] for scores in (found.test.before, found.test.after))
print(f"open-loop error on what was not fitted: {before:.1f} mm before, {after:.1f} mm after")
