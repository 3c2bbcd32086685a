"""Slow acceptance measurements of the simulator; figures go to RESULTS.md."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

import carosac_toolkit as ct
from benchmarks.results import table, write_section
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.physics.rest.statics import Equilibrium
from carosac_toolkit.robot.robot import Robot
from sim_warp import Simulator
from tests.reference import equilibrium

COMMAND = "python -m benchmarks.simulator_bars"
CENTER = np.array([0.2, -1.5, 3.0])  # m
OFF_CENTER = np.array([1.4, 0.0, 3.6])
HIGH = np.array([0.2, -1.5, 4.8])
LET_OUT = 0.35  # m, of one cable
KICK = np.array([[0.30, 0.15, 0.0, 0.0, 0.0, 0.0]])  # m/s, rad/s
SWING = 12.0  # s
STEPS = (1 / 60, 1 / 120, 1 / 240)
WORLDS = 64
ENDS = np.array([13 / 12, 7 / 8, 25 / 24])  # lengths of the first and last segments over the mean
SHARES = np.concatenate([ENDS, np.ones(10), ENDS[::-1]])  # with 16 segments


def damped(robot: Robot) -> Robot:
    """The same robot in thick air, to come to rest soon; it rests where it did."""
    return replace(robot, drag=60.0, angular_drag=12.0)


def undamped(robot: Robot) -> Robot:
    """The same robot without air."""
    return replace(robot, drag=0.0, angular_drag=0.0)


def rest_cases(robot: Robot) -> Iterator[tuple[str, Array, Equilibrium]]:
    """Names, lengths and our equilibria of taut poses and of one with a slack cable."""
    for name, where in (("center", CENTER), ("off center", OFF_CENTER), ("high", HIGH)):
        rest = statics.inverse_kinematics(robot, where[None])
        yield name, rest.unstrained_length, rest
    for i in range(robot.n):
        length = statics.inverse_kinematics(robot, CENTER[None]).unstrained_length.copy()
        length[0, i] += LET_OUT
        yield f"slack cable {i}", length, statics.forward_kinematics(robot, length)


def mid_sag(upper: Array, lower: Array, middle: Array) -> Array:
    """Distance of the middle of each cable from its chord [m]."""
    chord = lower - upper
    unit = chord / np.linalg.norm(chord, axis=-1, keepdims=True)
    across = (middle - upper) - ((middle - upper) * unit).sum(-1, keepdims=True) * unit
    distance: Array = np.linalg.norm(across, axis=-1)
    return distance


def settled(robot: Robot) -> list[list[str]]:
    """Kicked and left alone in thick air for 40 s, against independent equilibria."""
    rows = []
    for name, length, rest in rest_cases(robot):
        truth = equilibrium(robot, length[0], rest.position[0], rest.rotation[0])
        points = statics.cable_shape(robot, rest, 17)[0]
        sag = mid_sag(points[:, 0], points[:, -1], points[:, 8])
        errors = []
        for segments in (8, 16, 32):
            for step in (*STEPS, 1 / 1000) if segments == 16 else (1 / 120,):
                simulator = Simulator(
                    damped(robot), segments=segments, time_step=step, cable_drag=2.0
                )
                simulator.reset(unstrained_length=length, twist=0.3 * KICK)
                for _ in range(40):
                    simulator.follow(length, 1.0)
                state = simulator.state.numpy()
                shape = simulator.cable_points()[0]
                found = mid_sag(shape[:, 0], shape[:, -1], shape[:, segments // 2])
                errors.append(
                    (
                        segments,
                        1e3 * np.linalg.norm(state.position[0] - truth.position),
                        np.abs(state.tension[0] - rest.tension[0]).max(),
                        1e3 * np.abs(found - sag).max(),
                    )
                )
        sixteen = np.array([e[1:] for e in errors if e[0] == 16])
        spread = np.ptp(sixteen[:, 0])
        coarse, fine = (next(e[1] for e in errors if e[0] == k) for k in (8, 32))
        pulls = ", ".join(f"{x:.1f}" for x in rest.tension[0])
        taut = not name.startswith("slack")
        rows += [
            [f"{name}: position, N = 16, steps 1/60 to 1/1000 s", "0.005 mm" if taut else "0.01 mm",
             f"{sixteen[:, 0].max():.1e} mm"],
            [f"{name} ({pulls} N): tension, mid sag", "0.01 N, 0.01 mm" if taut else "reported",
             f"{sixteen[:, 1].max():.1e} N, {sixteen[:, 2].max():.1e} mm"],
            [f"{name}: position differs between steps by", "reported", f"{spread:.1e} mm"],
        ]  # fmt: skip
        if not taut:  # taut ones have errors of the size of rounding
            ratios = f"{coarse / sixteen[:, 0].mean():.1f}, {sixteen[:, 0].mean() / fine:.1f}"
            title = f"{name}: position error N = 8 over N = 16, N = 16 over N = 32"
            rows.append([title, "4 (second order)", ratios])
    return rows


def swing_path(robot: Robot, step: float, cables: str = "particles", period: float = 0.1) -> Array:
    """Positions of the kicked platform every `period` [m]."""
    simulator = Simulator(undamped(robot), cables=cables, time_step=step)
    simulator.reset(CENTER[None], twist=KICK)
    length = simulator.state.numpy().unstrained_length
    path = []
    for _ in range(round(SWING / period)):
        simulator.follow(length, period)
        path.append(simulator.state.numpy().position[0])
    return np.array(path)


def rms(path: Array, other: Array) -> float:
    """Root mean square distance [mm]."""
    return 1e3 * float(np.sqrt(((path - other) ** 2).sum(axis=1).mean()))


def swings(robot: Robot) -> list[list[str]]:
    """A free swing against the same with tiny steps; catenaries against particles."""
    fine = swing_path(robot, 2e-4)
    rows = [
        [f"swing of {SWING:g} s at 1/{1 / step:.0f} s against 0.2 ms, RMS", bar,
         f"{rms(swing_path(robot, step), fine):.3f} mm"]
        for step, bar in zip(STEPS, ("2 mm", "0.6 mm", "0.25 mm"), strict=True)
    ]  # fmt: skip
    catenary = swing_path(robot, 1 / 70, "catenary")
    own = swing_path(robot, 2e-4, "catenary")
    return [
        *rows,
        ["catenary at 1/70 s against particles, RMS", "1.5 mm", f"{rms(catenary, fine):.3f} mm"],
        ["catenary at 0.2 ms against particles, RMS", "reported", f"{rms(own, fine):.3f} mm"],
    ]


def sway_frequency(robot: Robot) -> list[list[str]]:
    """The first natural frequency, from the phase of a long small swing in its mode."""
    bare = undamped(robot)
    rest = statics.inverse_kinematics(bare, CENTER[None])
    frequency = float(ct.modes.natural_frequencies(bare, rest)[0].min())
    rows = []
    for cables, step in (("particles", 1 / 240), ("particles", 1 / 120), ("catenary", 1 / 70)):
        simulator = Simulator(bare, cables=cables, time_step=step, cable_drag=0.0)
        simulator.reset(CENTER[None], twist=0.01 * KICK)
        length = simulator.state.numpy().unstrained_length
        path = []
        for _ in range(4000):
            simulator.follow(length, 0.05)
            path.append(simulator.state.numpy().position[0])
        found = fitted_frequency(np.array(path), 0.05, frequency)
        rows.append(
            [f"first sway frequency, {cables} at 1/{1 / step:.0f} s, against {frequency:.5f} Hz",
             "0.2 %", f"{100.0 * (found / frequency - 1.0):+.3f} %"]
        )  # fmt: skip
    return rows


def fitted_frequency(path: Array, period: float, near: float) -> float:
    """Frequency at which a sinusoid takes most out of a path [Hz]."""
    time = period * np.arange(len(path))
    swing = path - path.mean(axis=0)
    window = np.hanning(len(path))[:, None]

    def power(f: float) -> float:
        wave = np.exp(-2j * np.pi * f * time)[:, None]
        return float((np.abs((window * wave * swing).sum(axis=0)) ** 2).sum())

    grid = near * np.linspace(0.97, 1.03, 2001)
    best = int(np.argmax([power(f) for f in grid]))
    return float(grid[best])


def energy_growth(robot: Robot) -> list[list[str]]:
    """Mechanical energy of a swing in no air, after start-up.

    Energy sloshes between its forms with an error of second order in the step, so its trend is
    what can grow; how far it ever rises above its value after start-up is reported.
    """
    rows = []
    bare = undamped(robot)
    for step in STEPS:
        simulator = Simulator(bare, time_step=step, cable_drag=0.0)
        simulator.reset(CENTER[None])
        low = energy(simulator, bare)
        simulator.reset(CENTER[None], twist=KICK)
        length = simulator.state.numpy().unstrained_length
        values = []
        for _ in range(round(SWING / step)):
            simulator.follow(length, step)
            values.append(energy(simulator, bare))
        late = np.array(values)[round(2.0 / step) :]
        swing = late[0] - low
        slope = np.polyfit(np.arange(len(late)), late, 1)[0] / swing
        rise = (late.max() - late[0]) / swing
        rows.append(
            [f"energy per step at 1/{1 / step:.0f} s, trend, of the swing's (largest rise)",
             "+1e-6", f"{slope:+.1e} ({rise:.1e})"]
        )  # fmt: skip
    return rows


def energy(simulator: Simulator, robot: Robot) -> float:
    """Kinetic, gravitational and elastic energy of platform and particles of world 0 [J]."""
    state = simulator.state.numpy()
    rotation, omega = state.rotation[0], state.twist[0, 3:]
    lever = rotation @ robot.center_of_mass
    velocity = state.twist[0, :3] + np.cross(omega, lever)
    inertia = rotation @ robot.inertia @ rotation.T
    total = 0.5 * robot.mass * velocity @ velocity + 0.5 * omega @ inertia @ omega
    total += robot.weight * (state.position[0] + lever)[2]
    node_velocity = simulator.save().arrays["cable_velocity"][0]
    count = simulator.segments
    for i in range(robot.n):
        arm = rotation @ robot.anchor_points[i]
        anchor = state.position[0] + arm
        points = np.vstack([robot.exit_points[i], state.particles[0, i], anchor])
        speeds = np.vstack([node_velocity[i], state.twist[0, :3] + np.cross(omega, arm)])
        mean = state.unstrained_length[0, i] / count
        rest = mean * SHARES
        mass = np.full(count, robot.linear_density[i] * mean)
        mass[-1] *= 0.5
        total += 0.5 * mass @ (speeds**2).sum(axis=1) + robot.gravity * mass @ points[1:, 2]
        stretch = np.maximum(np.linalg.norm(np.diff(points, axis=0), axis=1) - rest, 0.0)
        soft = rest + np.where(np.arange(count) == 0, robot.run_length[i], 0.0)
        total += 0.5 * robot.axial_stiffness[i] * (stretch**2 / soft).sum()
    return float(total)


def random_winches(robot: Robot) -> list[list[str]]:
    """Winches to random lengths every half second, which throws the platform about; then rest."""
    rows = []
    for segments, step in ((16, 1 / 60), (16, 1 / 120), (16, 1 / 240), (8, 1 / 120)):
        options = {
            "worlds": WORLDS, "segments": segments, "time_step": step, "cable_drag": 1.0,
        }  # fmt: skip
        rng = np.random.default_rng(0)
        simulator = Simulator(robot, **options)
        start = simulator.state.numpy()
        length = start.unstrained_length
        slack, tension, capped = 0, 0.0, 0
        for _ in range(120):
            simulator.step(length + rng.uniform(-0.3, 0.3, length.shape), 0.5)
            state = simulator.state.numpy()
            slack += int((state.tension < 5.0).any(axis=1).sum())
            tension = max(tension, float(state.tension.max()))
            capped += int(state.capped.sum())
        calm = Simulator(damped(robot), **options)
        calm.restore(simulator.save())
        for _ in range(60):
            calm.step(length, 1.0)
        end = calm.state.numpy()
        miss = np.linalg.norm(end.position - start.position, axis=1)
        rows.append(
            [f"random winches, {WORLDS} worlds, 60 s, N = {segments}, 1/{1 / step:.0f} s: "
             "failed, lost, farthest after 60 s of rest", "0, 0, 0.001 mm",
             f"{state.failed.sum()}, {(miss > 1.0).sum()}, {1e3 * miss.max():.1e} mm "
             f"(slack in {slack / (120 * WORLDS):.0%} of the looks, peaks of {tension:.0f} N, "
             f"{capped * step / (60 * WORLDS):.1e} of the steps unsolved)"]
        )  # fmt: skip
    return rows


def winding(robot: Robot) -> list[list[str]]:
    """Straight up and down with cables wound at up to 1 m/s, against rest at the same lengths."""
    rows = []
    speed, low, high = 1.5, 1.2, 5.4
    for cables in ("particles", "catenary"):
        worst, fastest = 0.0, 0.0
        for sign in (1.0, -1.0):
            period = 0.02
            ease = 2.0
            time = np.arange(0.0, (high - low) / speed + ease, period)
            way = np.where(
                time < ease, speed * (time / 2 - ease / (2 * np.pi) * np.sin(np.pi * time / ease)),
                speed * (time - ease / 2),
            )  # fmt: skip
            z = low + way if sign > 0 else high - way
            keep = (z > low - 1e-9) & (z < high + 1e-9)
            where = np.tile([0.4, -1.8, 0.0], (len(z), 1))
            where[:, 2] = z
            rest = statics.inverse_kinematics(robot, where[keep])
            simulator = Simulator(robot, cables=cables, cable_drag=0.5)
            simulator.reset(unstrained_length=rest.unstrained_length[:1])
            rate = np.gradient(rest.unstrained_length, period, axis=0)
            for k in range(1, len(rest.position)):
                simulator.follow(rest.unstrained_length[k : k + 1], period)
                state = simulator.state.numpy()
                there = statics.forward_kinematics(
                    robot, rest.unstrained_length[k : k + 1], guess=None
                )
                if time[k] > ease:
                    error = np.abs(state.tension / there.tension - 1.0).max()
                    worst = max(worst, float(error))
                    fastest = max(fastest, float(np.abs(rate[k]).max()))
        rows.append(
            [f"winding at up to {fastest:.2f} m/s both ways, {cables}: tension against rest",
             "2 %", f"{100 * worst:.2f} %"]
        )  # fmt: skip
    return rows


def recording(_: Robot) -> list[list[str]]:
    """Open loop over the whole real recording, if it is there."""
    from carosac_toolkit.validation import validate

    data = Path(os.environ.get("CAROSAC_DATA", "../shared/data"))
    path = data / "scampi_run_part.csv"
    if not path.is_file():
        return [["real recording, open loop", "29 mm", "not run: no data"]]
    robot = ct.load_robot("scampi")
    result = validate(ct.load_recording(path), robot, ["kinematic_solver", "simulator"]).data()
    rows = []
    for name, bar in (("kinematic_solver", "reported"), ("simulator", "29 mm")):
        model = result["models"][name]
        rmse = model["rmse_m"]
        axes = " / ".join(f"{rmse[k] * 1e3:.1f}" for k in ("x", "y", "z"))
        rows.append(
            [f"real recording, {name}: RMSE x/y/z, norm; lengths", bar,
             f"{axes}, {rmse['norm'] * 1e3:.1f} mm; {model['length_rmse_m'] * 1e3:.1f} mm"]
        )  # fmt: skip
    return rows


def memory(robot: Robot) -> list[list[str]]:
    """Device memory of a world, from its arrays."""
    one, many = (Simulator(robot, worlds=k) for k in (1, 101))

    def size(simulator: Simulator) -> int:
        return sum(array.nbytes for array in simulator.save().arrays.values())

    world = (size(many) - size(one)) / 100 / 1e3
    scratch = 19 * 8 * robot.n * 16 / 1e3  # kB, on a GPU for each world: 19 numbers a segment
    return [
        ["memory of a world, N = 16: on a CPU; with its scratch, on a GPU", "16 kB",
         f"{world:.1f} kB; {world + scratch:.1f} kB"]
    ]  # fmt: skip


def main() -> None:
    """Measure and write."""
    robot = ct.load_robot("carosac")
    rows = []
    for part in (settled, swings, sway_frequency, energy_growth, random_winches, winding, memory):
        rows += part(robot)
        print(table(["what", "bar", "measured"], rows[-4:]), flush=True)
    rows += recording(robot)
    body = table(["what", "bar", "measured"], rows)
    write_section("simulator-bars", "Simulator: acceptance", COMMAND, body)
    print(body)


if __name__ == "__main__":
    main()
