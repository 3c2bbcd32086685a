"""Your own controller in a study, beside the straight line and the kinematic solver.

`Tilted` is twenty lines: straight cables, as on most cable robots, but at the orientation that the
estimator believes, where the plain straight line takes the platform to be upright. A suspended
robot with four cables tilts, and that is most of the straight line's error; what is left is the
weight and the stretch of the cables, which the kinematic solver knows.

Writes my_controller.png and prints the tracking error of `Tilted` on one drawn robot; more seeds
make an answer of it.
"""

import json
import tempfile

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np

import carosac_toolkit as ct


class Tilted:
    """Straight cables at the believed orientation."""

    def __init__(self, robot):
        self.robot = robot
        self.period = 0.02  # [s]
        self.horizon = 0.06  # [s], what winches and the hold of a command take

    @classmethod
    def build(cls, robot, settings=None, *, seed=0):
        """Make one for the nominal robot."""
        return cls(robot)

    def reset(self, belief):
        """There is nothing to forget."""

    def command(self, belief, reference):
        """Straight-line lengths of the last row of the reference, `horizon` ahead of now."""
        length = ct.straight_line.inverse_kinematics(
            self.robot, reference.position[:, -1], belief.rotation
        )
        return ct.Command(time=belief.time, unstrained_length=length)


LABELS = ("straight line", "my controller: straight line, tilted", "kinematic solver")
LINES = (("#d55e00", "--"), ("#44aa99", "-"), ("#0072b2", ":"))
SEEDS = (0,)


def main():
    """Run the study and draw it."""
    controllers = ("straight_line", Tilted, "kinematic_solver")
    with tempfile.TemporaryDirectory() as folder:
        study = ct.Study(
            controllers=controllers, estimators=["kinematic_solver"], sensors=["lengths"],
            trajectories=["circle"], seeds=SEEDS, workers=0, output=folder,
        )  # fmt: skip
        rows = study.run(progress=False).rows
    assert all(row["status"] == "ok" for row in rows), [row["reason"] for row in rows]
    error = {
        name: 1e3 * np.array([r["tracking_rmse_norm_m"] for r in rows if r["controller"] == name])
        for name in study.controllers
    }  # [mm], one per seed

    figure, (seen, over) = plt.subplots(1, 2, figsize=(11.0, 4.4), layout="constrained")
    for name, label, (color, line) in zip(study.controllers, LABELS, LINES, strict=True):
        first = next(row for row in rows if row["controller"] == name and row["seed"] == 0)
        series = {k: np.array(v) for k, v in json.loads(first["series"]).items()}
        path, asked = series["position_m"], series["reference_m"]
        label = f"{label}, RMSE {error[name].mean():.0f} mm"
        seen.plot(path[:, 0], path[:, 1], color=color, ls=line, label=label)
        off = 1e3 * np.linalg.norm(path - asked, axis=1)
        over.plot(series["time_s"], off, color=color, ls=line)
    seen.plot(asked[:, 0], asked[:, 1], color="k", ls="--", lw=1.0, label="reference")
    seen.set(xlabel="x [m]", ylabel="y [m]", aspect="equal", title="carosac from above, seed 0")
    over.set(xlabel="time [s]", ylabel="distance from the reference [mm]", yscale="log",
             ylim=(1.0, 600.0), title="Tracking error")  # fmt: skip
    figure.legend(loc="outside lower center", ncols=2, frameon=False)
    figure.savefig("my_controller.png", dpi=120)
    print(f"tracking error of my controller: {error[study.controllers[1]].mean():.0f} mm")


if __name__ == "__main__":
    main()
