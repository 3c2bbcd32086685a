"""A fast move, and the platform swings for seconds: who sees it, and who stops it.

The simulated robot ``carosac`` is a plant drawn from the condition `nominal-2`, with wind, biased
encoders and an IMU. Three controllers send it 1.2 m to the side: exact statics, input shaping, and
model predictive control on the belief of the dynamic estimator.

Writes 07_stop_the_sway.png and prints how far the platform still sways two seconds after the move.
"""

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np

import carosac_toolkit as ct
from baselines import (
    DynamicEstimator,
    InputShaping,
    KinematicSolver,
    KinematicSolverController,
    Mpc,
)
from carosac_toolkit import trajectories
from carosac_toolkit.loop.loop import run
from carosac_toolkit.robot.perturbations import CONDITIONS_BY_NAME, draw_plant
from sim_warp import SimDriver, SimDriverSettings

SEED = 3
LATE = 2.0  # [s] after the move

robot = ct.load_robot("carosac")
condition = CONDITIONS_BY_NAME["nominal-2"].of(robot)
plant = draw_plant(robot, condition, np.random.default_rng(SEED))
start, goal = (0.9, -1.8, 2.6), (-0.3, -1.8, 2.6)  # [m]
path = trajectories.line(start, goal, speed_max=1.5, acceleration_max=2.0)
settings = SimDriverSettings(
    suite="lengths+imu", start_position=start, wind_force=condition.wind_force
)


def go(controller, estimator):
    """The log of one run on the same plant, wind and noise."""
    driver = SimDriver.build(plant, settings, seed=SEED)
    return run(driver, estimator, controller, path, duration=path.duration + 5.0)


logs = {
    "exact statics": go(KinematicSolverController.build(robot), KinematicSolver.build(robot)),
    "input shaping": go(InputShaping.build(robot), DynamicEstimator.build(robot)),
    "MPC": go(Mpc.build(robot), DynamicEstimator.build(robot)),
}

figure, (where, seen) = plt.subplots(1, 2, figsize=(12, 4.2), layout="constrained", sharex=True)
residual = {}
LINES = (("#d55e00", "-"), ("#44aa99", "--"), ("#0072b2", "-"))
for (name, log), (color, line) in zip(logs.items(), LINES, strict=True):
    error = log.position[:, 0, 0] - log.reference[:, 0, 0]
    late = log.position[log.time > path.duration + LATE, 0]
    residual[name] = 1e3 * np.linalg.norm(late.std(axis=0))
    where.plot(log.time, 1e3 * error, color=color, ls=line, lw=1.4, label=name)
where.axvspan(0.0, path.duration, color="0.93", zorder=0)
where.set(
    xlabel="time [s]",
    ylabel="x, platform minus path [mm]",
    title=f"{robot.name}: who stops the sway",
)
where.set_ylim(-750.0, 650.0)
where.legend(frameon=False, loc="upper center", ncols=3)

solver, filtered = logs["exact statics"], logs["input shaping"]
for name, log, color in (
    ("kinematic solver", solver, "#d55e00"),
    ("dynamic estimator", filtered, "#0072b2"),
):
    error = log.belief_position[:, 0, 0] - log.position[:, 0, 0]
    seen.plot(log.time, 1e3 * error, color=color, lw=1.4, label=name)
seen.axvspan(0.0, path.duration, color="0.93", zorder=0)
seen.set(xlabel="time [s]", ylabel="x, estimate minus platform [mm]", title="Who sees it")
seen.set_ylim(-750.0, 1000.0)
seen.legend(frameon=False, loc="upper center", ncols=2)
figure.savefig("07_stop_the_sway.png", dpi=120)
print("sway two seconds after the move:", ", ".join(f"{k} {v:.0f} mm" for k, v in residual.items()))
