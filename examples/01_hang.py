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
X = 0.4  # [m], where the section lies
POSES = np.array([[X, -3.3, 1.4], [X, -1.8, 3.0], [X, -0.3, 4.6]])
LABELS = ((0, -26), (-6, -19), (-12, -18))  # [points], from each pose

robot = ct.load_robot("carosac")
low, high = robot.workspace_min, robot.workspace_max

# Statics over the section, and the straight-line model on the same lengths.
y, z = np.meshgrid(np.linspace(low[1], high[1], 61), np.linspace(low[2], high[2], 61))
section = np.stack([np.full(y.size, X), y.ravel(), z.ravel()], axis=1)
rest = ct.statics.inverse_kinematics(robot, section)
assert (rest.converged & rest.stable).all()
fit = ct.straight_line.forward_kinematics(robot, rest.unstrained_length)
error = 1e3 * np.linalg.norm(fit.position - rest.position, axis=1)  # [mm]

figure, (side, area) = plt.subplots(
    1, 2, figsize=(12.0, 4.6), layout="constrained", width_ratios=(1.6, 1.0)
)

# Side view: cables with their sag enlarged, coloured by tension.
poses = ct.statics.inverse_kinematics(robot, POSES)
curves = ct.statics.cable_shape(robot, poses, 60)  # (3, n, 60, 3) [m]
share = np.linspace(0.0, 1.0, 60)[:, None]
chords = curves[:, :, :1] * (1.0 - share) + curves[:, :, -1:] * share
drawn = (chords + SAG_SCALE * (curves - chords))[..., 1:]
cables = LineCollection(list(drawn.reshape(-1, 60, 2)), cmap="plasma_r", linewidths=1.6)
cables.set_array(poses.tension.ravel())
side.add_collection(cables)
figure.colorbar(cables, ax=side, label="cable tension at the platform [N]", shrink=0.8)
half = np.array([[0.0, -0.21, -0.16], [0.0, 0.21, -0.16], [0.0, 0.21, 0.0], [0.0, -0.21, 0.0]])
for k, (position, rotation) in enumerate(zip(poses.position, poses.rotation, strict=True)):
    body = position + half @ rotation.T
    side.fill(body[:, 1], body[:, 2], color="0.25", zorder=3)
    tilt = np.degrees(np.arccos(rotation[2, 2]))
    side.annotate(
        f"{'ABC'[k]}, tilt {tilt:.1f}°", position[1:], xytext=LABELS[k], ha="right",
        textcoords="offset points", fontsize=9,
    )  # fmt: skip
side.plot(*robot.exit_points[:, 1:].T, "s", color="0.25", ms=6, label="exit points")
side.fill(
    *[[low[1], high[1], high[1], low[1]], [low[2], low[2], high[2], high[2]]],
    facecolor="none", edgecolor="0.5", ls="--", label="workspace",
)  # fmt: skip
side.legend(loc="lower right", frameon=False)
side.set(
    xlabel="y [m]", ylabel="z [m]", aspect="equal", xlim=(-9.2, 5.6), ylim=(0.0, 9.2),
    title="carosac at rest in three poses, sag drawn 10 times larger",
)  # fmt: skip

# Map of the error.
filled = area.contourf(y, z, error.reshape(y.shape), levels=np.arange(0, 85, 5), cmap="viridis")
figure.colorbar(filled, ax=area, label="position error [mm]", shrink=0.8)
for name, position in zip("ABC", POSES, strict=True):
    area.plot(*position[1:], "o", color="white", mec="black", ms=5)
    area.annotate(
        name, position[1:], xytext=(6, 5), textcoords="offset points", color="white", weight="bold"
    )
area.set(
    xlabel="y [m]", ylabel="z [m]", aspect="equal",
    title="Error of a straight-line model",
)  # fmt: skip
figure.savefig("01_hang.png", dpi=120)
print(f"median error of the straight-line model: {np.median(error):.1f} mm")
