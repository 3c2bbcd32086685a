"""Learned controllers beside exact statics: the same move, the same plant, wind and noise.

The kinematic solver computes equilibrium lengths by exact statics, as if the platform stood still.
``carosac-settle`` learned the same lengths by trial and error (preset `carosac`), and goes the same
way. ``carosac-residual``, what the robot gets by default, learned in real time to push the platform
so that it follows and does not sway, with what the estimator believes (preset `residual`).

Writes 08_learned_control.png and prints how far each is off the path, and how far the platform
still sways two seconds after the move.
"""

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np

import carosac_toolkit as ct
from baselines import DynamicEstimator, KinematicSolverController
from carosac_toolkit import trajectories
from carosac_toolkit.loop.loop import run
from carosac_toolkit.robot.perturbations import CONDITIONS_BY_NAME, draw_plant
from learned import PolicyController, PolicySettings
from sim_warp import SimDriver, SimDriverSettings

SEED = 3
LATE = 2.0  # [s] after the move
LINES = (("#d55e00", "-"), ("#44aa99", "--"), ("#0072b2", "-"))

robot = ct.load_robot("carosac")
condition = CONDITIONS_BY_NAME["nominal-1"].of(robot)
plant = draw_plant(robot, condition, np.random.default_rng(SEED))
start, goal = (0.9, -1.8, 2.6), (-0.3, -1.8, 3.0)  # [m]
path = trajectories.line(start, goal, speed_max=1.5, acceleration_max=2.0)


def go(controller):
    """The log of one run on the same plant, wind and noise."""
    settings = SimDriverSettings(
        suite="lengths+imu", start_position=start, wind_force=condition.wind_force,
        period=controller.period,
    )  # fmt: skip
    driver = SimDriver.build(plant, settings, seed=SEED)
    estimator = DynamicEstimator.build(robot)
    return run(driver, estimator, controller, path, duration=path.duration + 4.0)


logs = {
    "kinematic solver": go(KinematicSolverController.build(robot)),
    "learned lengths": go(PolicyController.build(robot, PolicySettings(policy="carosac-settle"))),
    "learned in real time": go(PolicyController.build(robot)),
}

figure, (space, time) = plt.subplots(1, 2, figsize=(12, 4.2), layout="constrained")
said = []
for (name, log), (color, line) in zip(logs.items(), LINES, strict=True):
    where, error = log.position[:, 0], log.position[:, 0] - log.reference[:, 0]
    late = where[log.time > path.duration + LATE]
    sway = 1e3 * np.linalg.norm(late.std(axis=0))
    rmse = 1e3 * np.sqrt((error**2).sum(axis=1).mean())
    said.append(f"{name} {rmse:.0f} / {sway:.0f} mm")
    space.plot(where[:, 0], where[:, 2], color=color, ls=line, lw=1.2, label=name)
    time.plot(log.time, 1e3 * error[:, 0], color=color, ls=line, lw=1.4, label=name)
target = logs["learned in real time"].reference[:, 0]
space.plot(target[:, 0], target[:, 2], color="black", lw=1.2, ls="--", label="target")
space.set(xlabel="x [m]", ylabel="z [m]", title=f"{robot.name}: where the platform goes")
time.axvspan(0.0, path.duration, color="0.93", zorder=0)
time.set(xlabel="time [s]", ylabel="x, platform minus path [mm]", title="What is left of the sway")
figure.legend(*space.get_legend_handles_labels(), loc="outside lower center", ncols=4)
figure.savefig("08_learned_control.png", dpi=120)
print("tracking RMSE / sway after the move: " + ", ".join(said))
