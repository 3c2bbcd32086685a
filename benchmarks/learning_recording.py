"""The paper's experiment on real trajectories, as far as a recording allows it.

Lengths are commanded to a simulator that was fitted to the recorded robot, not to the robot.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np

import carosac_toolkit as ct
from benchmarks.results import table
from calibration.identification.open_loop import simulate
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import CarosacError, InvalidField
from carosac_toolkit.physics.cable import straight_line
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.recordings.encoders import readings, unstrained_lengths
from carosac_toolkit.recordings.length_path import LengthPath
from carosac_toolkit.recordings.recording import Recording
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.validation.phases import find_phases
from learned.environment import empty_look, make_actions
from learned.observation import ObservationScales, observe
from learned.pictures.accuracy import errors_over_time, rmse_distribution
from learned.policy_file import Policy
from learned.settings_data import environment_settings

TITLE = "Real trajectories: commanded to a simulator that was fitted to the robot"
FOLDER = Path(__file__).parent
SHARES, OVER_TIME = "learning_recording_{}_rmse.png", "learning_recording_{}_errors.png"
STRETCHES = 10
TIME_STEP = 1.0 / 140.0  # [s], as the identification has it
MM = 1e3
RECORDED = "recorded lengths"
SOLVER = "kinematic solver"
SOLVER_FITTED = "kinematic solver, identified robot"
AT_LIMIT = 1e-3  # [N]


@dataclass(frozen=True, kw_only=True, eq=False)
class Source:
    """Lengths from somewhere.

    Attributes:
        name: For tables.
        reading: What the length sensors of the robot shall read [m], shape (N, n).
        delay: Whether they lead the poses as the recorded ones do; commands do not.
    """

    name: str
    reading: Array
    delay: bool = False


@dataclass(frozen=True, kw_only=True, eq=False)
class Scene:
    """A recording with its robot.

    Attributes:
        recording: As it was recorded.
        robot: As identified.
        position: Measured, in W [m], shape (N, 3).
        rests: First and one past the last sample of each rest of the winches.
        stretches: First and one past the last sample of each.
    """

    recording: Recording
    robot: Robot
    position: Array
    rests: tuple[tuple[int, int], ...]
    stretches: tuple[tuple[int, int], ...]


def scene_of(recording: Recording, robot: Robot) -> Scene:
    """Cut a recording into stretches that begin and end in rests, with as many moves each."""
    if robot.pose_rotation is not None:
        allowed = "none: a policy knows the frame of motion capture alone"
        raise InvalidField("robot.pose_rotation", robot.pose_rotation, allowed)
    found = recording.pose_at(recording.time)
    if not found.valid.all():
        raise CarosacError("some lengths of the recording have no pose near them")
    rests = find_phases(recording.time, recording.unstrained_length).rests
    if len(rests) <= STRETCHES:
        raise CarosacError(f"{len(rests)} rests in the recording; {STRETCHES + 1} are needed")
    cuts = np.round(np.linspace(0, len(rests) - 1, STRETCHES + 1)).astype(int)
    middle = [sum(rests[k]) // 2 for k in cuts]
    middle[0], middle[-1] = rests[0][0], rests[-1][1]
    return Scene(
        recording=recording, robot=robot, position=found.pose.position, rests=rests,
        stretches=tuple(pairwise(middle)),
    )  # fmt: skip


def equilibria(scene: Scene) -> Array:
    """Where the identified robot would rest on the recorded lengths: their path, without sway."""
    time = scene.recording.time - (scene.robot.length_delay or 0.0)
    lengths = unstrained_lengths(scene.robot, LengthPath(scene.recording).at(time))
    rest = statics.forward_kinematics(scene.robot, lengths)
    if not (rest.converged & rest.stable).all():
        raise CarosacError("the identified robot cannot rest on some of the recorded lengths")
    return rest.position


def policy_lengths(policy: Policy, target: Array) -> Array:
    """What a policy of set-points asks for, (N, n) [m].

    It sees itself at the target before, and the lengths that it has asked for last.
    """
    about = policy.description
    if about.period is not None:
        raise CarosacError("the recording has targets without a controller: a policy of set-points")
    robot, settings = about.robot, environment_settings(about.settings)
    scales = ObservationScales.of(robot)
    actions = make_actions(robot, settings, scales)
    look = empty_look(robot, len(settings.preview), actions.size)
    look = replace(look, length=straight_line.inverse_kinematics(robot, target[:1]))
    found = []
    for before, one in zip(target[[0, *range(len(target) - 1)]], target, strict=True):
        look = replace(look, position=before[None], target=one[None])
        action = policy.act(observe(settings.observation, look, scales))
        look = replace(look, length=actions.lengths(action, look), last_action=action)
        found.append(look.length[0])
    return np.array(found)


def solved(robot: Robot, position: Array) -> Array:
    """Catenary inverse kinematics, (N, n) [m]."""
    rest = statics.inverse_kinematics(robot, position)
    if not rest.converged.all():
        row = int((~rest.converged).argmax())
        raise CarosacError(f"{robot.name} cannot rest at {position[row].round(3)} m, sample {row}")
    return rest.unstrained_length


def sources_of(scene: Scene, policies: Sequence[Policy], target: Array) -> list[Source]:
    """All lengths; those of a robot that was not calibrated go to its winches as they are."""
    nominal = policies[0].description.robot
    found = [
        Source(name=name_of(policy), reading=policy_lengths(policy, target)) for policy in policies
    ]
    fitted = readings(scene.robot, solved(scene.robot, target))
    return [
        *found,
        Source(name=SOLVER, reading=solved(nominal, target)),
        Source(name=SOLVER_FITTED, reading=fitted),
        Source(name=RECORDED, reading=scene.recording.unstrained_length, delay=True),
    ]


def name_of(policy: Policy) -> str:
    """Of a policy, for tables."""
    return f"td3 ({policy.description.preset}, seed {policy.description.seed})"


def played(scene: Scene, source: Source) -> Array:
    """Errors of the platform that the lengths move, against motion capture [m], shape (N, 3)."""
    robot = scene.robot if source.delay else replace(scene.robot, length_delay=None)
    path = LengthPath(replace(scene.recording, unstrained_length=source.reading))
    motion = simulate([robot], path, scene.recording.time, time_step=TIME_STEP)
    if motion.failed.any():
        raise CarosacError("the simulation failed")
    error: Array = motion.position[:, 0] - scene.position
    return error


def rmse_of(scene: Scene, error: Array) -> Array:
    """RMSE of each stretch along each axis [m], shape (10, 3)."""
    return np.array([np.sqrt((error[a:b] ** 2).mean(axis=0)) for a, b in scene.stretches])


def held(scene: Scene, source: Source) -> tuple[float, float]:
    """At rest on each set of lengths: least tension [N], and the share that has a slack cable."""
    lengths = unstrained_lengths(scene.robot, source.reading)
    rest = statics.forward_kinematics(scene.robot, lengths)
    good = rest.converged & rest.stable
    least = np.where(good, rest.tension.min(axis=1), -np.inf)  # no rest counts as slack
    low = float(scene.robot.tension_min.max()) - AT_LIMIT
    return float(least.min()), float((least < low).mean())


def outside(policy: Policy, position: Array) -> int:
    """How many positions lie outside the workspace box of a policy's robot."""
    robot = policy.description.robot
    inside = (position >= robot.workspace_min) & (position <= robot.workspace_max)
    return int((~inside.all(axis=1)).sum())


def recording(file: Path, robot_file: Path, policy_files: Sequence[Path]) -> str:
    """Play all lengths, draw the pictures, make the section."""
    scene = scene_of(ct.load_recording(file), ct.load_robot(str(robot_file)))
    policies = [Policy.load(path) for path in policy_files]
    for policy in policies:
        scene.recording.require_cables(policy.description.robot)
    targets = {"rest": equilibria(scene), "measured": scene.position}
    return section(scene, policies, targets)


def compared(scene: Scene, policies: Sequence[Policy], target: Array, name: str) -> str:
    """Table and pictures for some targets."""
    exact = solved(policies[0].description.robot, target)
    errors: dict[str, Array] = {}
    rows: list[tuple[str, ...]] = []
    for source in sources_of(scene, policies, target):
        low, slack = held(scene, source)
        off = f"{MM * np.median(np.abs(source.reading - exact).max(axis=1)):.1f}"
        tensions = (off, f"{low:.1f}", f"{100 * slack:.1f}")
        try:
            errors[source.name] = played(scene, source)
        except CarosacError as failure:
            rows.append((source.name, f"failed: {failure}", "-", "-", "-", *tensions))
            continue
        rows.append((source.name, *cells(scene, errors[source.name]), *tensions))
        print(name, *rows[-1], flush=True)
    draw(scene, errors, name)
    header = (
        "lengths of", "RMSE x / y / z, mean of the stretches [mm]", "its standard deviation [mm]",
        "norm: mean, standard deviation [mm]", "RMS of all samples [mm]",
        "off the first solver, largest cable, median [mm]", "least tension at rest [N]",
        "samples with a slack cable at rest [%]",
    )  # fmt: skip
    paper = (
        ("paper, real robot: TD3", "23 / 32 / 9", "2.18 in all", *["-"] * 5),
        ("paper, real robot: kinematic solver", "31 / 44 / 24", "11.64 in all", *["-"] * 5),
    )
    shares, over_time = (pattern.format(name) for pattern in (SHARES, OVER_TIME))
    return (
        f"{table(header, [*rows, *paper])}\n\n"
        f"![RMSE of the stretches]({shares})\n\n![Error over time]({over_time})"
    )


def cells(scene: Scene, error: Array) -> tuple[str, ...]:
    """Numbers of one source."""
    each = rmse_of(scene, error)
    norm = np.sqrt((each**2).sum(axis=1))
    mean, spread = each.mean(axis=0), each.std(axis=0, ddof=1)
    total = float(np.sqrt((error**2).sum(axis=1).mean()))
    return (
        " / ".join(f"{MM * x:.1f}" for x in mean), " / ".join(f"{MM * x:.1f}" for x in spread),
        f"{MM * norm.mean():.1f}, {MM * norm.std(ddof=1):.1f}", f"{MM * total:.1f}",
    )  # fmt: skip


def draw(scene: Scene, errors: dict[str, Array], name: str) -> None:
    """Both pictures."""
    time = scene.recording.time
    if not errors:
        return
    shares, over_time = (FOLDER / pattern.format(name) for pattern in (SHARES, OVER_TIME))
    rmse_distribution({source: rmse_of(scene, e) for source, e in errors.items()}, shares)
    errors_over_time(
        time, errors, over_time, marks=[time[a] for a, _ in scene.stretches[1:]],
        rests=[(float(time[a]), float(time[b - 1])) for a, b in scene.rests],
    )  # fmt: skip


def section(scene: Scene, policies: Sequence[Policy], targets: dict[str, Array]) -> str:
    """The text."""
    moves = len(scene.rests) - 1
    seconds = scene.recording.time[-1] - scene.recording.time[0]
    lies = "; ".join(
        f"{name_of(p)}: " + ", ".join(str(outside(p, target)) for target in targets.values())
        for p in policies
    )
    apart = np.linalg.norm(targets["measured"] - targets["rest"], axis=1)
    rest, measured = (compared(scene, policies, targets[name], name) for name in targets)
    return (
        f"{moves} moves of a real recording, {len(scene.position)} samples in {seconds:.0f} s, in "
        f"{STRETCHES} stretches that begin and end while the winches rest. **No robot was driven**:"
        " lengths were commanded to a simulator (catenary cables, one open-loop run) that was "
        "fitted to this robot on a part of this recording, and its platform is scored against "
        "motion capture. Policies and the first solver know the robot as it was before the fit, "
        "and their lengths go through its encoders. `recorded lengths` show what the fit leaves. "
        "The paper's rows are of its own robot and trajectories.\n\n"
        "The wanted positions were not recorded. Two stand in for them, which are "
        f"{MM * np.median(apart):.0f} mm apart in the median and up to {MM * apart.max():.0f} mm, "
        "by the platform's sway. Targets outside the workspace box of a policy's robot, of "
        f"{len(scene.position)}, first and second kind (none is clipped): {lies}.\n\n"
        "Targets: where the identified robot would rest on the recorded lengths, so the path that "
        "the winches followed. The solver that knows the identified robot gives the recorded "
        f"lengths back, by construction, but for what sampling costs.\n\n{rest}\n\n"
        "Targets: the measured positions. Sway is asked for as if it were wanted, which shakes the "
        f"platform at its own frequency, whoever computes the lengths.\n\n{measured}"
    )
