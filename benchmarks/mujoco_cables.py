"""Cables of MuJoCo 4 beside ours: what a general simulator makes of the same robot.

Two models, both with a free platform of the robot's mass, centre of mass and inertia:

* `point_masses`: point bodies on unilateral spring tendons, integrator `discrete`, the only one of
  MuJoCo that takes stiff tendons implicitly.
* `massless_tendons`: one unilateral spring tendon a cable, straight and without weight.

MuJoCo is no dependency of the toolkit: ``pip install 'mujoco>=4.0'`` (the extra `bench`).
``python -m benchmarks.mujoco_cables`` prints the table.

What MuJoCo cannot have, and this file refuses: pulleys and cable between winch and exit. What it
does differently: the damper of a tendon sees the speed of its ends alone, so winding counts as
strain rate, and it acts on a slack tendon too.
"""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

import numpy as np

import carosac_toolkit as ct
from benchmarks.results import table
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.robot.robot import Robot

INSTALL = "MuJoCo 4 is needed for this benchmark only: pip install 'mujoco>=4.0'"
CONTROL_PERIOD = 0.01  # s between new lengths
PATH = 2.0  # s
REPEATS = 5
KICK = np.array([0.30, 0.15, 0.0])  # m/s
SWING = 12.0  # s
CABLE_DRAG = 0.5  # 1/s, in the swing
SETTLE = 6.0  # s
EDGE = np.array([2.0, -3.4, 2.0])  # m, near a corner of the workspace of `carosac`
LET_OUT = 0.30  # m, of the first cable at home: near slack
REFERENCE_STEP = 1.6e-5  # s, RK4 with 10 segments: 1e-5 s moves the swing by less than 0.001 mm


class MujocoCables:
    """One MuJoCo model of a robot and its state.

    The free body lies with its frame at the centre of mass, so that damping of its six degrees of
    freedom is the robot's drag at the centre of mass; `discrete` takes that damping implicitly.
    Its linear solve iterates: 5 iterations a segment are enough for a swing to 0.01 mm, where 2
    are faster, fine at rest and up to 0.1 m wrong in motion; MuJoCo warns of all that reach the
    limit.

    Attributes:
        name: Of the model, for tables.
        robot: Robot described, n cables.
        segments: Tendons per cable; 1 stands for a massless cable.
        model: `mujoco.MjModel`.
        data: `mujoco.MjData`.
    """

    def __init__(
        self, robot: Robot, segments: int, timestep: float, cable_drag: float, integrator: str
    ) -> None:
        """Compile the model; see `point_masses` for the arguments."""
        mujoco = _mujoco()
        if robot.run_length.any() or robot.pulley_radius.any():
            raise ValueError("MuJoCo has neither cable before the exit nor pulleys: set both to 0")
        if segments != 1 and segments % 2:
            raise ValueError(f"segments: got {segments}; allowed: 1 or even, for a middle node")
        self.name = f"points, {segments} segments" if segments > 1 else "massless tendons"
        self.robot, self.segments, self._drag = robot, segments, cable_drag
        self.model = mujoco.MjModel.from_xml_string(_xml(robot, segments, timestep, integrator))
        self.data = mujoco.MjData(self.model)
        self._mujoco = mujoco
        self._nodes = np.arange(7, 7 + 3 * robot.n * (segments - 1))  # in qpos; one less in qvel
        self.model.opt.iterations = max(20, 5 * segments)
        self.model.dof_damping[:3] = robot.drag
        self.model.dof_damping[3:6] = robot.angular_drag * robot.angular_drag_axes  # of P

    def reset(self, position: Array, rotation: Array, unstrained_length: Array) -> None:
        """Put the platform there at rest, and the nodes on the hanging cables.

        Args:
            position: Platform origin in W [m], shape (3,).
            rotation: Rotation from P to W, shape (3, 3).
            unstrained_length: [m], shape (n,); from it come the masses of the nodes as well.
        """
        robot, n, k = self.robot, self.robot.n, self.segments
        self._mujoco.mj_resetData(self.model, self.data)
        if k > 1:
            node_mass = robot.linear_density * unstrained_length / k
            bodies = np.arange(2, 2 + n)  # the half segments at the anchors, then the nodes
            self.model.body_mass[bodies] = node_mass / 2.0
            self.model.body_mass[2 + n :] = np.repeat(node_mass, k - 1)
            self.model.dof_damping[6:] = self._drag * np.repeat(node_mass, 3 * (k - 1))
            self._mujoco.mj_setConst(self.model, self.data)
        pose = ct.Pose(
            time=np.zeros(1),
            position=np.asarray(position)[None],
            rotation=np.asarray(rotation)[None],
        )
        found = ct.statics.forward_kinematics(robot, unstrained_length[None], guess=pose)
        points = ct.statics.cable_shape(robot, found, k + 1)[0]
        miss = position + robot.anchor_points @ rotation.T - points[:, -1]
        points += np.linspace(0.0, 1.0, k + 1)[:, None] * miss[:, None]
        self.data.qpos[:3] = position + rotation @ robot.center_of_mass
        self._mujoco.mju_mat2Quat(self.data.qpos[3:7], np.ascontiguousarray(rotation).ravel())
        self.data.qpos[self._nodes] = points[:, 1:-1].ravel()
        self.data.qvel[:] = 0.0
        self.set_lengths(unstrained_length)
        self._mujoco.mj_forward(self.model, self.data)

    def set_lengths(self, unstrained_length: Array) -> None:
        """Wind to these lengths [m], shape (n,): all segments of a cable grow alike.

        The masses stay those of `reset`: material is not wound on or off.
        """
        robot, k = self.robot, self.segments
        piece = unstrained_length / k
        self.model.tendon_lengthspring[:, 1] = np.repeat(piece, k)
        self.model.tendon_stiffness[:] = np.repeat(robot.axial_stiffness / piece, k)
        self.model.tendon_damping[:] = np.repeat(robot.axial_damping / piece, k)

    def kick(self, linear_velocity: Array) -> None:
        """Add a velocity [m/s], shape (3,), to the platform, not to its cables."""
        self.data.qvel[:3] += linear_velocity

    def step(self, duration: float) -> None:
        """Simulate this long [s], a multiple of the step."""
        steps = round(duration / self.model.opt.timestep)
        if steps < 1 or abs(steps * self.model.opt.timestep - duration) > 1e-9:
            raise ValueError(f"duration: got {duration} s; allowed: a multiple of the step")
        self._mujoco.mj_step(self.model, self.data, nstep=steps)

    @property
    def rotation(self) -> Array:
        """Rotation from P to W, shape (3, 3)."""
        matrix = np.empty(9)
        self._mujoco.mju_quat2Mat(matrix, self.data.qpos[3:7])
        return matrix.reshape(3, 3)

    @property
    def position(self) -> Array:
        """Platform origin in W [m], shape (3,)."""
        return np.asarray(self.data.qpos[:3] - self.rotation @ self.robot.center_of_mass)

    @property
    def tension(self) -> Array:
        """Spring force of the segment at the platform [N], shape (n,)."""
        self._mujoco.mj_kinematics(self.model, self.data)
        self._mujoco.mj_tendon(self.model, self.data)
        stretch = self.data.ten_length - self.model.tendon_lengthspring[:, 1]
        force = self.model.tendon_stiffness * np.maximum(stretch, 0.0)
        return np.asarray(force.reshape(self.robot.n, self.segments)[:, -1])

    @property
    def warnings(self) -> int:
        """Warnings of MuJoCo since `reset`: solves that did not converge, numbers not finite."""
        return int(sum(entry.number for entry in self.data.warning))

    @property
    def mid_sag(self) -> Array:
        """Distance of the middle node from the chord [m], shape (n,); 0 for massless tendons."""
        robot, k = self.robot, self.segments
        if k == 1:
            return np.zeros(robot.n)
        nodes = self.data.qpos[self._nodes].reshape(robot.n, k - 1, 3)
        anchor = self.position + robot.anchor_points @ self.rotation.T
        return distance_to_chord(nodes[:, k // 2 - 1], robot.exit_points, anchor)


def point_masses(
    robot: Robot,
    segments: int = 10,
    timestep: float = 2e-3,
    *,
    cable_drag: float = 0.0,
    integrator: str = "discrete",
) -> MujocoCables:
    """Point bodies on N unilateral spring tendons a cable; half a segment's mass at the anchor.

    Args:
        robot: Robot description without pulleys and `run_length`.
        segments: N per cable, even.
        timestep: [s].
        cable_drag: Air drag of the nodes per mass and speed [1/s].
        integrator: As MuJoCo calls it.
    """
    return MujocoCables(robot, segments, timestep, cable_drag, integrator)


def massless_tendons(
    robot: Robot, timestep: float = 2e-3, *, integrator: str = "discrete"
) -> MujocoCables:
    """One unilateral spring tendon a cable, without mass; arguments as in `point_masses`."""
    return MujocoCables(robot, 1, timestep, 0.0, integrator)


def measure(robot: Robot) -> list[dict[str, Any]]:
    """Accuracy and CPU time of the models, one row each; about a minute of CPU time.

    Args:
        robot: Whose home and `EDGE` are poses of rest; its `run_length` is set to 0 here.

    Returns:
        Rows of `model` and `step_s`; `cpu_s_per_s`: CPU time per simulated second along a path;
        `settle_mm`, `slack_mm`: from our statics after settling, at home or `EDGE` (the worse) and
        with a cable let out; `sag_mm`, `sag_slack_mm`: error of the sag at the middle of a cable
        there, the worst cable; `swing_rms_mm`: against the same physics at a tiny step;
        `swing_points_mm`: against points at a tiny step; `warnings`: of MuJoCo, in all of this.
    """
    bare = replace(robot, run_length=np.zeros(robot.n))
    calm = replace(bare, drag=0.0, angular_drag=0.0)
    points = swing_path(
        point_masses(calm, 10, REFERENCE_STEP, cable_drag=CABLE_DRAG, integrator="RK4")
    )
    straight = swing_path(massless_tendons(calm, 1e-4, integrator="RK4"))
    rows = []
    for segments, timestep in ((10, 2e-3), (10, 1e-3), (20, 1e-3), (1, 2e-3), (1, 1e-3)):

        def build(robot: Robot, drag: float, k: int = segments, h: float = timestep) -> Any:
            return MujocoCables(robot, k, h, drag, "discrete")

        swinging = build(calm, CABLE_DRAG)
        path = swing_path(swinging)
        following = build(bare, CABLE_DRAG)
        damped = build(replace(bare, drag=60.0, angular_drag=10.0), 5.0)
        rows.append(
            {
                "model": swinging.name,
                "step_s": timestep,
                "cpu_s_per_s": cpu_time(following),
                **settle_errors(damped, bare),
                "swing_rms_mm": rms(path, straight if segments == 1 else points),
                "swing_points_mm": rms(path, points),
            }
        )
        rows[-1]["warnings"] += swinging.warnings + following.warnings
    return rows


def distance_to_chord(point: Array, start: Array, end: Array) -> Array:
    """Distance of points from the lines through start and end [m], shape (n,)."""
    unit = (end - start) / np.linalg.norm(end - start, axis=-1, keepdims=True)
    return np.asarray(np.linalg.norm(np.cross(point - start, unit), axis=-1))


def settle_errors(model: MujocoCables, robot: Robot) -> dict[str, Any]:
    """Distance from our statics after settling from there with strong damping [mm]."""
    there = ct.statics.inverse_kinematics(robot, np.stack([robot.home_position, EDGE]))
    length = np.vstack([there.unstrained_length, there.unstrained_length[:1]])
    length[2, 0] += LET_OUT
    rest = ct.statics.forward_kinematics(robot, length)
    if not (rest.converged & rest.stable).all():
        raise ValueError("robot: no stable rest at home, at EDGE or with a cable let out")
    middle = ct.statics.cable_shape(robot, rest, 3)
    miss, sag, warnings = np.zeros(3), np.zeros(3), 0
    for b in range(3):
        model.reset(rest.position[b], rest.rotation[b], length[b])
        model.step(SETTLE)
        miss[b] = 1e3 * np.linalg.norm(model.position - rest.position[b])
        true = distance_to_chord(middle[b, :, 1], middle[b, :, 0], middle[b, :, 2])
        sag[b] = 1e3 * np.abs(model.mid_sag - true).max()
        warnings += model.warnings
    return {
        "settle_mm": miss[:2].max(), "slack_mm": miss[2], "sag_mm": sag[:2].max(),
        "sag_slack_mm": sag[2], "warnings": warnings,
    }  # fmt: skip


def swing_path(model: MujocoCables) -> Array:
    """Path of a platform kicked at home [m], shape (K, 3), 50 points a second.

    The kick leaves two cables of `carosac` slack for moments.
    """
    home = ct.statics.inverse_kinematics(model.robot, model.robot.home_position[None])
    model.reset(home.position[0], home.rotation[0], home.unstrained_length[0])
    model.kick(KICK)
    path = np.empty((round(SWING / 0.02), 3))
    for row in path:
        model.step(0.02)
        row[:] = model.position
    return path


def rms(path: Array, other: Array) -> float:
    """Root mean square distance [mm]."""
    return float(1e3 * np.sqrt(((path - other) ** 2).sum(axis=1).mean()))


def cpu_time(model: MujocoCables) -> float:
    """CPU time per simulated second while following a smooth path 0.3 m out and back, median."""
    phase = 2.0 * np.pi * np.arange(0.0, PATH, CONTROL_PERIOD) / PATH
    out = 0.3 * np.array([0.6, 0.64, 0.48])
    position = model.robot.home_position + (0.5 - 0.5 * np.cos(phase))[:, None] * out
    path = ct.statics.inverse_kinematics(model.robot, position)
    times = []
    for _ in range(REPEATS):
        model.reset(path.position[0], path.rotation[0], path.unstrained_length[0])
        start = time.process_time()
        for length in path.unstrained_length:
            model.set_lengths(length)
            model.step(CONTROL_PERIOD)
        times.append((time.process_time() - start) / PATH)
    return float(np.median(times))


def _mujoco() -> Any:
    """MuJoCo 4, or how to get it."""
    try:
        import mujoco
    except ImportError as error:
        raise SystemExit(INSTALL) from error
    if int(mujoco.__version__.split(".")[0]) < 4:
        raise SystemExit(f"{INSTALL} (found {mujoco.__version__})")
    mujoco.set_mju_user_warning(lambda text: None)  # or it writes a file; `warnings` counts them
    return mujoco


def _xml(robot: Robot, segments: int, timestep: float, integrator: str) -> str:
    """The model; masses of nodes, lengths and stiffnesses are set by `reset`."""
    point = '<inertial pos="0 0 0" mass="1e-3" diaginertia="1e-12 1e-12 1e-12"/>'
    xx, xy, xz, _, yy, yz, _, _, zz = robot.inertia.ravel()
    inertia = _text([xx, yy, zz, xy, xz, yz])
    axes = ("1 0 0", "0 1 0", "0 0 1")
    slides = "".join(f'<joint type="slide" axis="{axis}"/>' for axis in axes)
    exits, anchors, nodes, tendons = [], [], [], []
    for i in range(robot.n):
        exits.append(f'<site name="c{i}_0" pos="{_text(robot.exit_points[i])}"/>')
        arm = _text(robot.anchor_points[i] - robot.center_of_mass)
        site = f'<site name="c{i}_{segments}"/>'
        anchors.append(f'<body pos="{arm}">{point if segments > 1 else ""}{site}</body>')
        for k in range(1, segments):
            slides = "".join(
                f'<joint type="slide" axis="{a}"/>' for a in ("1 0 0", "0 1 0", "0 0 1")
            )
            nodes.append(f'<body>{point}{slides}<site name="c{i}_{k}"/></body>')
        tendons += [
            '<spatial springlength="0 1" stiffness="1" damping="1">'
            f'<site site="c{i}_{k}"/><site site="c{i}_{k + 1}"/></spatial>'
            for k in range(segments)
        ]
    return f"""
<mujoco>
  <option timestep="{timestep}" integrator="{integrator}" solver="Newton" jacobian="sparse"
    gravity="0 0 {-robot.gravity!r}"><flag contact="disable" autoreset="disable"/></option>
  <worldbody>{"".join(exits)}
    <body><joint type="free"/>
      <inertial pos="0 0 0" mass="{robot.mass!r}" fullinertia="{inertia}"/>{"".join(anchors)}
    </body>{"".join(nodes)}
  </worldbody>
  <tendon>{"".join(tendons)}</tendon>
</mujoco>"""


def _text(numbers: Any) -> str:
    """Numbers as MuJoCo reads them, to the last digit."""
    return " ".join(repr(float(x)) for x in numbers)


def main() -> None:
    """Measure and print the table."""
    rows = measure(ct.load_robot("carosac"))
    texts = [[x if isinstance(x, str) else f"{x:.3g}" for x in row.values()] for row in rows]
    print(table(list(rows[0]), texts))


if __name__ == "__main__":
    main()
