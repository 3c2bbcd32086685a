"""Where a robot with eight cables can hold its platform, by what margin, and what stops it.

A vertical slice through `cogiro` with sagging cables, without and with 100 N of wind from any side.

Writes 10_workspace.png and prints how much of the slice the wind takes.
"""

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.colors import ListedColormap
from matplotlib.patches import Patch

import carosac_toolkit as ct

LIMITS = ct.workspace.Limit
OUTSIDE = {
    LIMITS.NO_EQUILIBRIUM: ("0.75", "cables would push"),
    LIMITS.SLACK: ("#ee8866", "a cable is slack"),
    LIMITS.OVERLOAD: ("#7f3b08", "a cable is overloaded"),
}

robot = ct.load_robot("cogiro")
low, high = ct.workspace.box_of(robot, "frame")
grid = ct.workspace.slice_grid(low, high, "y", 0.0, 1500)
x, z = grid.axes[0], grid.axes[2]

figure, panels = plt.subplots(1, 2, figsize=(11.5, 3.3), layout="constrained", sharey=True)
share = []
for axes, force in zip(panels, (0.0, 100.0), strict=True):
    asked = ct.workspace.WorkspaceSettings(force=(force, force, 0.0))
    found = ct.workspace.compute(robot, grid, settings=asked).verdicts
    margin = np.where(found.inside, found.margin, np.nan).reshape(len(x), len(z)).T
    picture = axes.pcolormesh(x, z, margin, vmin=0.0, vmax=1000.0, shading="nearest")
    for limit, (color, _) in OUTSIDE.items():
        there = np.where(found.limit == limit, 1.0, np.nan).reshape(len(x), len(z)).T
        axes.pcolormesh(x, z, there, cmap=ListedColormap([color]), shading="nearest")
    axes.plot(*robot.exit_points[:, [0, 2]].T, "ks", ms=4, label="exit points")
    share.append(found.inside.mean())
    axes.set(xlabel="x [m]", aspect="equal", title=f"{force:.0f} N of wind: {share[-1]:.0%} inside")
panels[0].set_ylabel("z [m]")
figure.colorbar(picture, ax=panels, label="margin to the tension limits [N]")
marks = [Patch(color=color, label=label) for color, label in OUTSIDE.values()]
marks += [Patch(fc="white", ec="0.5", label="not solved"), panels[0].lines[0]]
figure.legend(handles=marks, loc="outside lower center", ncols=5, frameon=False)
figure.suptitle(f"{robot.name}, y = 0: where eight cables hold the platform")
figure.savefig("10_workspace.png", dpi=110)
print(f"the wind takes {1.0 - share[1] / share[0]:.0%} of the slice")
