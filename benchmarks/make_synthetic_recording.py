"""Make the bundled recording ``synthetic``: a simulated run of a robot we know wrongly.

Run it from the project's root: ``python benchmarks/make_synthetic_recording.py``. It takes seconds
and always writes the same numbers.

The plant is the bundled robot ``carosac`` with parameters drawn at random. Its winches follow
commands that were computed for the nominal robot; the platform hangs in static equilibrium on
catenaries, plus the small motion d about it (sway). With M and K, mass and stiffness at the
equilibrium of each instant, C the damping of cables and air (D: of air alone), xi and a twist and
acceleration of the equilibrium,

    M d'' + C d' + K d = -M a - D xi + wind.

Linear, so it is a stand-in for the real dynamics only while the sway stays small.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

import carosac_toolkit as ct
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.loop.values import Stamped
from carosac_toolkit.physics.rest.modes import mass_matrix
from carosac_toolkit.recordings.metadata import RecordingMetadata
from carosac_toolkit.recordings.poses import PoseSamples
from carosac_toolkit.robot.robot import Robot

TARGET = Path("carosac_toolkit/recordings/data/synthetic.parquet")
DESCRIPTION = (
    "SYNTHETIC: made by a program, not measured. Straight minimum-snap moves with rests in the "
    "workspace of robot carosac. The plant is that robot with seeded random errors (one standard "
    "deviation: mass 3 %, centre of mass 1 cm an axis, inertia 10 %, EA 20 %, linear density 2 %, "
    "exit points 5 mm an axis, anchor points 1 mm, winch lag 20 %; air drag a factor 1.5). Lengths "
    "are commanded for the nominal robot and wound with a first-order lag; the platform hangs in "
    "static equilibrium on elastic catenaries plus linear small motion about it (sway), driven by "
    "the acceleration of the equilibrium, air drag and a wind of 1 N with 2 s correlation. "
    "Encoders: 0.2 mm noise, 0.05 mm resolution, one constant bias a cable of 5 mm standard "
    "deviation, 10 ms late. Poses: 1 mm and 0.5 mrad noise, 40 ms late. Nothing in it is evidence "
    "about a real robot."
)


@dataclass(frozen=True)
class Settings:
    """Settings of the generator."""

    seed: int = 7
    """Of all draws."""
    points: int = 12
    """Places where the platform stops."""
    speed: float = 1.2
    """Highest speed of the moves [m/s]."""
    acceleration: float = 1.2
    """Highest acceleration of the moves [m/s^2]."""
    rest: float = 3.0
    """Length of the rests [s]."""
    step: float = 0.005
    """Of the integration [s]."""
    rate: float = 20.0
    """Of the recording [Hz]."""
    encoder_delay: float = 0.010
    """[s]."""
    pose_delay: float = 0.040
    """[s]."""


def main() -> None:
    """Write the recording."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--output", type=Path, default=TARGET)
    path = parser.parse_args().output
    recording = make_recording(Settings())
    ct.save_recording(recording, path)
    print(f"{path}: {len(recording.time)} samples, {path.stat().st_size / 1e3:.0f} kB")


def make_recording(settings: Settings) -> ct.Recording:
    """Simulate the run and what its sensors say."""
    rng = np.random.default_rng(settings.seed)
    nominal = ct.load_robot("carosac")
    plant = perturbed(nominal, rng)
    time, command = commanded(nominal, settings, rng)
    length = wound(command, plant.winch_lag, settings.step)
    position, rotation = hanging(plant, length, settings.step, rng)
    return recorded(settings, rng, time, command, length, position, rotation)


def perturbed(robot: Robot, rng: np.random.Generator) -> Robot:
    """Draw the plant about the nominal robot, as in condition nominal-1 of the comparisons."""
    n = robot.n

    def factor(deviation: float, size: int = 1) -> Array:
        return np.clip(1.0 + deviation * rng.standard_normal(size), 0.2, None)

    return replace(
        robot,
        mass=robot.mass * float(factor(0.03)[0]),
        center_of_mass=robot.center_of_mass + 0.01 * rng.standard_normal(3),
        inertia=robot.inertia * factor(0.10),
        axial_stiffness=robot.axial_stiffness * factor(0.20),
        linear_density=robot.linear_density * factor(0.02),
        exit_points=robot.exit_points + 0.005 * rng.standard_normal((n, 3)),
        anchor_points=robot.anchor_points + 0.001 * rng.standard_normal((n, 3)),
        winch_lag=robot.winch_lag * factor(0.20, n),
        drag=1.5 * robot.drag,
        angular_drag=1.5 * robot.angular_drag,
    )


def commanded(robot: Robot, settings: Settings, rng: np.random.Generator) -> tuple[Array, Array]:
    """Times [s], (N,), and commanded lengths [m], (N, n), which suit the nominal robot at rest."""
    drawn = ct.trajectories.draws.draw_points(robot, rng, count=settings.points, distance_min=1.2)
    middle = (robot.workspace_min + robot.workspace_max) / 2
    points = np.vstack([robot.home_position, middle + 0.85 * (drawn - middle)])
    trajectory = ct.trajectories.waypoints(
        points,
        speed_max=settings.speed,
        acceleration_max=settings.acceleration,
        rest=settings.rest,
    )
    whole = trajectory.duration + 2 * settings.rest
    coarse = np.arange(0.0, whole + 0.04, 0.04)
    position = trajectory.sample(coarse - settings.rest).position
    found = ct.statics.inverse_kinematics(robot, position)
    if not found.converged.all():
        raise SystemExit(f"no tensions at {position[~found.converged][0]}: draw other points")
    time = np.arange(0.0, whole, settings.step)
    return time, CubicSpline(coarse, found.unstrained_length)(time)


def wound(command: Array, lag: Array, step: float) -> Array:
    """Lengths that first-order winches have wound [m], shape (N, n)."""
    keep = np.exp(-step / lag)
    length = np.empty_like(command)
    length[0] = command[0]
    for k in range(1, len(command)):
        length[k] = keep * length[k - 1] + (1.0 - keep) * command[k - 1]
    return length


def hanging(
    robot: Robot, length: Array, step: float, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Poses: equilibrium at every instant, and small motion about it by Newmark's method."""
    rest = ct.statics.forward_kinematics(robot, length)
    if not (rest.converged & rest.stable).all():
        raise SystemExit("the plant has no equilibrium somewhere")
    turn = Rotation.from_matrix(rest.rotation)
    twist = np.hstack([
        np.gradient(rest.position, step, axis=0),
        np.vstack([np.zeros(3), (turn[1:] * turn[:-1].inv()).as_rotvec() / step]),
    ])  # fmt: skip
    acceleration = np.gradient(twist, step, axis=0)
    mass = mass_matrix(robot, rest.rotation)
    air = np.diag([robot.drag] * 3 + [robot.angular_drag] * 3)
    damping = air + cable_damping(robot, rest.position, rest.rotation, length)
    load = -np.einsum("bij,bj->bi", mass, acceleration) - twist @ air
    load[:, :3] += wind(len(length), step, rng)
    offset = newmark(mass, damping, rest.stiffness, load, step)
    swung = Rotation.from_rotvec(offset[:, 3:]) * turn
    return rest.position + offset[:, :3], swung.as_matrix()


def cable_damping(robot: Robot, position: Array, rotation: Array, length: Array) -> Array:
    """Damping of the cables' length rates as a matrix on twists, (N, 6, 6)."""
    arm = np.einsum("bij,nj->bni", rotation, robot.anchor_points)
    cable = robot.exit_points - (position[:, None] + arm)
    unit = cable / np.linalg.norm(cable, axis=-1, keepdims=True)
    structure = np.concatenate([unit, np.cross(arm, unit)], axis=-1)  # (N, n, 6)
    per_rate = robot.axial_damping / (length + robot.run_length)  # [N s/m]
    damping: Array = np.einsum("bni,bn,bnj->bij", structure, per_rate, structure)
    return damping


def wind(count: int, step: float, rng: np.random.Generator) -> Array:
    """Force of 1 N standard deviation an axis with 2 s correlation, (N, 3)."""
    keep = np.exp(-step / 2.0)
    force = rng.standard_normal((count, 3))
    for k in range(1, count):
        force[k] = keep * force[k - 1] + np.sqrt(1.0 - keep**2) * force[k]
    return force


def newmark(mass: Array, damping: Array, stiffness: Array, load: Array, step: float) -> Array:
    """Displacements (N, 6) from rest by the average-acceleration method, unconditionally stable."""
    x, v, a = np.zeros(6), np.zeros(6), np.zeros(6)
    path = np.zeros((len(load), 6))
    for k in range(1, len(load)):
        predicted_x = x + step * v + 0.25 * step**2 * a
        predicted_v = v + 0.5 * step * a
        matrix = mass[k] + 0.5 * step * damping[k] + 0.25 * step**2 * stiffness[k]
        a = np.linalg.solve(matrix, load[k] - damping[k] @ predicted_v - stiffness[k] @ predicted_x)
        x, v = predicted_x + 0.25 * step**2 * a, predicted_v + 0.5 * step * a
        path[k] = x
    return path


def recorded(
    settings: Settings,
    rng: np.random.Generator,
    time: Array,
    command: Array,
    length: Array,
    position: Array,
    rotation: Array,
) -> ct.Recording:
    """What encoders and motion capture say, at the rate of the recording."""
    when = np.round(np.arange(0.1, float(time[-1]), 1.0 / settings.rate, dtype=np.float64), 6)
    encoder = CubicSpline(time, length)(when - settings.encoder_delay)
    encoder += 0.005 * rng.standard_normal(length.shape[1])
    encoder += 0.0002 * rng.standard_normal(encoder.shape)
    late = np.searchsorted(time, when - settings.pose_delay + 1e-9) - 1
    noisy = position[late] + 0.001 * rng.standard_normal((len(late), 3))
    turned = Rotation.from_rotvec(0.0005 * rng.standard_normal((len(late), 3)))
    quaternion = (turned * Rotation.from_matrix(rotation[late])).as_quat(scalar_first=True)
    now = np.searchsorted(time, when + 1e-9) - 1
    return ct.Recording(
        time=when,
        unstrained_length=np.round(np.round(encoder / 5e-5) * 5e-5, 6),
        command=Stamped(time=when, value=np.round(command[now], 6)),
        poses=PoseSamples(
            time=when,
            position=np.round(noisy, 5),
            quaternion=np.round(quaternion, 6),
        ),
        metadata=RecordingMetadata(
            robot="carosac",
            description=DESCRIPTION,
            source="benchmarks/make_synthetic_recording.py of the CaRoSaC Toolkit",
            licence="Apache-2.0",
            citation="the CaRoSaC Toolkit",
            created_by=f"carosac-toolkit {ct.__version__}, seed {settings.seed}",
        ),
    )


if __name__ == "__main__":
    main()
