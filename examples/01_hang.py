"""How a suspended robot hangs, and what a model of straight cables makes of it.

Exact statics of the bundled robot ``carosac`` give lengths, tensions and tilt at each position of
a vertical section through its workspace. The same lengths then go to straight-line forward
kinematics, which knows neither sag nor stretch nor tilt.

Writes 01_hang.png and prints the median position error of the straight-line model.
"""

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.collections import LineCollection

import carosac_toolkit as ct

SAG_SCALE = 10.0  # cables are drawn with ten times their sag
Y = -1.8  # [m], where the section lies
POSES = np.array([[-0.5, Y, 1.5], [0.4, Y, 3.0], [1.3, Y, 4.5]])
SHARE = np.linspace(0.0, 1.0, 60)[:, None]

robot = ct.load_robot("carosac")
low, high = robot.workspace_min, robot.workspace_max

# Statics over the section, and the straight-line model on the same lengths.
x, z = np.meshgrid(np.linspace(low[0], high[0], 81), np.linspace(low[2], high[2], 81))
section = np.stack([x.ravel(), np.full(x.size, Y), z.ravel()], axis=1)
rest = ct.statics.inverse_kinematics(robot, section)
known = rest.converged & rest.stable
fit = ct.straight_line.forward_kinematics(robot, rest.unstrained_length)
error = 1e3 * np.linalg.norm(fit.position - rest.position, axis=1)  # [mm]
error[~known] = np.nan

# Three poses: cables with their sag enlarged, platform outlines, tilts.
poses = ct.statics.inverse_kinematics(robot, POSES)
curves = ct.statics.cable_shape(robot, poses, len(SHARE))  # (3, n, samples, 3) [m]
chords = curves[:, :, :1] * (1.0 - SHARE) + curves[:, :, -1:] * SHARE
curves = chords + SAG_SCALE * (curves - chords)
tilt = np.degrees(np.arccos(poses.rotation[:, 2, 2]))
top = np.array([[-0.21, 0.21, 0.21, -0.21], [-0.21, 0.21, 0.21, -0.21], [0.0, 0.0, -0.16, -0.16]])

figure, (side, front, area) = plt.subplots(
    1, 3, figsize=(13.5, 4.4), layout="constrained", width_ratios=(1.62, 0.65, 1.1)
)
for axes, i, name in ((side, 1, "y"), (front, 0, "x")):
    cables = LineCollection(
        list(curves[..., [i, 2]].reshape(-1, len(SHARE), 2)), cmap="plasma_r", linewidths=1.5
    )
    cables.set_array(poses.tension.ravel())
    axes.add_collection(cables)
    outline = top * (np.arange(3) != 1 - i)[:, None]
    for position, rotation in zip(poses.position, poses.rotation, strict=True):
        corners = position[:, None] + rotation @ outline
        axes.fill(corners[i], corners[2], color="0.25", zorder=3)
    axes.plot(*robot.exit_points[:, [i, 2]].T, "s", color="0.25", ms=5, label="exit points")
    box = [[low[i], high[i], high[i], low[i]], [low[2], low[2], high[2], high[2]]]
    axes.fill(*box, facecolor="none", edgecolor="0.5", ls="--", label="workspace")
    ends = robot.exit_points[:, i]
    axes.set(
        xlabel=f"{name} [m]", ylabel="z [m]", aspect="equal", ylim=(0.0, 9.0),
        xlim=(ends.min() - 0.7, ends.max() + 0.7), title=f"seen along {'yx'[i]}",
    )  # fmt: skip
side.legend(loc="lower right", frameon=False)
side.set_title("carosac at rest in three poses, sag drawn 10 times larger")
for k, position in enumerate(POSES):
    label = {"textcoords": "offset points", "weight": "bold"}
    beside = ((-24, -6), (-20, -12), (7, -14))[k]
    side.annotate("ABC"[k], position[[1, 2]], xytext=(0, -22), ha="center", **label)
    front.annotate("ABC"[k], position[[0, 2]], xytext=beside, **label)
    area.annotate("ABC"[k], position[[0, 2]], xytext=(7, 7), color="white", **label)
    area.plot(*position[[0, 2]], "o", color="white", mec="black", ms=5)
text = "\n".join(f"{name}  tilt {angle:.0f}°" for name, angle in zip("ABC", tilt, strict=True))
side.text(0.02, 0.04, text, transform=side.transAxes)
figure.colorbar(cables, ax=[side, front], label="cable tension at the platform [N]", shrink=0.8)

filled = area.contourf(x, z, error.reshape(x.shape), levels=np.arange(0, 851, 50), cmap="viridis")
figure.colorbar(filled, ax=area, label="position error [mm]", shrink=0.8)
area.set(xlabel="x [m]", ylabel="z [m]", aspect="equal", title="Error of a straight-line model")
figure.savefig("01_hang.png", dpi=120)
print(f"median error of the straight-line model: {np.nanmedian(error):.0f} mm")
