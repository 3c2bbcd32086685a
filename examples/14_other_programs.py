"""A robot of CASPR in this toolkit: what ideal cables from points leave out.

CASPR's XML knows points, pulleys and tension limits; its cables are straight, stiff and weightless.
`docs/files` has an 8-cable robot in that format and a file with what the format does not hold. Both
cable sets are imported, exit points as points and on pulleys, and compared where the robot may go.

Writes 14_other_programs.png and prints by how much the lengths differ.
"""

from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np

import carosac_toolkit as ct
from carosac_toolkit.interchange.completion import complete, robot_and_text
from carosac_toolkit.interchange.robots import read_robot

FILES = Path(__file__).resolve().parents[1] / "docs" / "files"
REST = (FILES / "gantry-rest.yaml").read_text(encoding="utf-8")


def imported(cable_set):
    """The robot with one of its cable sets."""
    draft = read_robot([FILES / "gantry_bodies.xml"], cable_set=cable_set)
    return robot_and_text(complete(draft, fragment=REST, name="gantry-rest.yaml"))[0]


points, pulleys = imported("points"), imported("pulleys")
rng = np.random.default_rng(0)
where = rng.uniform(pulleys.workspace_min, pulleys.workspace_max, (300, 3))  # [m], upright

plain = ct.straight_line.inverse_kinematics(points, where)  # what CASPR computes, shape (B, n)
wound = ct.straight_line.inverse_kinematics(pulleys, where)  # with the arcs on the pulleys
rest = ct.statics.inverse_kinematics(pulleys, where)  # sag and stretch as well
fine = rest.converged & rest.stable
effects = {  # [mm]; a constant of each cable is no error, as homing takes it away
    "pulleys": 1e3 * (wound - plain),
    "sag and stretch": 1e3 * (rest.unstrained_length - wound),
}
effects = {name: (v - np.median(v[fine], axis=0))[fine] for name, v in effects.items()}

COLORS = ("#ee8866", "#77aadd")
figure = plt.figure(figsize=(11.5, 4.4), layout="constrained")
left, right = figure.add_gridspec(1, 2, width_ratios=(1.0, 1.25))
space = figure.add_subplot(left, projection="3d")
hanging = ct.statics.inverse_kinematics(pulleys, [[0.8, 0.4, 0.8]])
shapes = ct.statics.cable_shape(pulleys, hanging)[0]  # (n, samples, 3)
for line in shapes:
    space.plot(*line.T, color="#0072b2", lw=1.0)
    space.scatter(*line[0], color="0.2", s=14)
for ring in ([0, 2, 4, 6, 0], [7, 1, 3, 5, 7]):  # anchor points below and above
    space.plot(*shapes[ring, -1].T, color="0.2", lw=1.6)
space.set(
    xlabel="x [m]", ylabel="y [m]", zlabel="z [m]", title="Gantry from CASPR, at (0.8, 0.4, 0.8) m"
)
space.set_box_aspect((6.3, 4.6, 3.3), zoom=0.9)

axes = figure.add_subplot(right)
for k, (name, values) in enumerate(effects.items()):
    at = np.arange(pulleys.n) + 0.36 * k - 0.18
    box = axes.boxplot(
        values, positions=at, widths=0.3, whis=(0, 100), patch_artist=True, manage_ticks=False
    )
    for patch in box["boxes"]:
        patch.set_facecolor(COLORS[k])
    for median in box["medians"]:
        median.set_color("black")
    axes.plot([], [], color=COLORS[k], lw=8, label=name)
axes.axhline(0.0, color="0.7", lw=0.8, zorder=0)
axes.set_xticks(range(pulleys.n), [name.removeprefix("cable ") for name in pulleys.cable_names])
axes.set(xlabel="cable", ylabel="length beside CASPR's, minus its median [mm]")
axes.set_title(f"At {fine.sum()} positions (boxes: the middle half; whiskers: all)")
axes.legend(frameon=False, loc="upper left", ncols=2)
figure.savefig("14_other_programs.png", dpi=120)
worst = max(float(np.abs(values).max()) for values in effects.values())
print(f"lengths of straight cables from points are wrong by up to {worst:.1f} mm")
