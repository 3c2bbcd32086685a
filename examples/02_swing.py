"""What a fast move does to a suspended platform: 64 simulated robots that differ a little.

The winches of the bundled robot ``carosac`` follow the exact static lengths of a path of 1.5 m.
The simulator adds what statics does not know: inertia, sway, cables that fall slack, winches that
lag, plants drawn from the condition `nominal-2`, wind. A second, slower move shows the difference.

Writes 02_swing.png and prints how far the platforms still sway two seconds after the fast move.
"""

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np

import carosac_toolkit as ct
from sim_warp import Simulator

START, GOAL = np.array([1.1, -1.8, 2.8]), np.array([-0.4, -1.8, 2.8])  # [m]
WORLDS = 64
PERIOD = 0.02  # [s] between commands
END = 6.0  # [s]
MOVES = {"in 1.5 s": (1.5, "#d55e00", "-"), "in 3.5 s": (3.5, "#0072b2", "--")}

robot = ct.load_robot("carosac")
time = np.arange(0.0, END, PERIOD)
figure, (sway, pull, shape) = plt.subplots(
    1, 3, figsize=(13.5, 4.2), layout="constrained", width_ratios=(1.3, 1.3, 1.0)
)
residual = {}
for label, (duration, color, line) in MOVES.items():
    share = np.clip(time / duration, 0.0, 1.0)
    share = share**3 * (10.0 - 15.0 * share + 6.0 * share**2)  # least jerk
    path = START + share[:, None] * (GOAL - START)
    length = ct.statics.inverse_kinematics(robot, path).unstrained_length  # (K, n)
    robots = Simulator(robot, worlds=WORLDS, perturbation="nominal-2", seed=1)
    robots.reset(np.tile(START, (WORLDS, 1)))
    own = robots.state.numpy().unstrained_length - length[0]  # each hangs on its own lengths
    position, tension, shapes = [], [], []
    for k in range(len(time)):
        robots.step(length[k] + own, PERIOD)
        state = robots.state.numpy()
        position.append(state.position)
        tension.append(state.tension.min(axis=1))
        shapes.append((state.position[0], state.rotation[0], state.particles[0]))
    error = np.array(position)[..., 0] - path[:, None, 0]  # (K, B) [m]
    late = error[time > duration + 2.0]
    residual[label] = 1e3 * (late - late.mean(axis=0)).std()
    for panel, values in ((sway, 1e3 * error), (pull, np.array(tension))):
        low, middle, high = np.quantile(values, [0.05, 0.5, 0.95], axis=1)
        panel.fill_between(time, low, high, color=color, alpha=0.2, lw=0.0)
        panel.plot(time, middle, color=color, ls=line, lw=1.3, label=f"1.5 m {label}")
    if label == "in 1.5 s":
        fast = shapes

sway.set(
    xlabel="time [s]", ylabel="x, platform minus path [mm]", title="Sway (median and 90 % of 64)"
)
sway.set_ylim(-950.0, 1150.0)
sway.legend(frameon=False, loc="upper center", ncols=2)
pull.axhline(robot.tension_min[0], color="0.4", ls="--", lw=1)
pull.set(xlabel="time [s]", ylabel="lowest cable tension [N]", yscale="symlog", ylim=(0, None))
pull.set_title("Slack cables (dashed: the robot's limit)")

# The cables of the first world, seen along y, at four instants of the fast move.
for when, tone in ((0.0, 0.75), (0.5, 0.55), (0.9, 0.3), (1.4, 0.0)):
    position, rotation, nodes = fast[round(when / PERIOD)]
    for i in range(robot.n):
        anchor = position + rotation @ robot.anchor_points[i]
        line = np.vstack([robot.exit_points[i], nodes[i], anchor])
        shape.plot(line[:, 0], line[:, 2], color=str(tone), lw=1.0)
    outline = np.array([[-0.21, 0, 0], [0.21, 0, 0], [0.21, 0, -0.16], [-0.21, 0, -0.16]])
    corners = position + outline @ rotation.T
    shape.fill(corners[:, 0], corners[:, 2], color=str(tone), label=f"{when:g} s")
shape.set(xlabel="x [m]", ylabel="z [m]", title="One carosac, fast move", aspect="equal")
shape.legend(frameon=False, loc="upper center", fontsize=8)
figure.savefig("02_swing.png", dpi=120)
print(f"sway two seconds after the fast move: {residual['in 1.5 s']:.0f} mm")
