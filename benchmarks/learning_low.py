"""Policies after short moves to low positions, where a platform hangs softly: does it calm down?"""

from __future__ import annotations

import multiprocessing
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.controllers import SUITE, Task, make
from benchmarks.learning_drive import named, td3
from benchmarks.results import table
from carosac_toolkit import trajectories
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import CarosacError
from carosac_toolkit.loop.loop import run
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.robot.robot import Robot
from learned.policy_controller import DEFAULT_POLICIES, find_policy
from learned.policy_file import Policy

TITLE = "Learned control, low in the box"
ESTIMATORS = ("dynamic_estimator", "ks_ekf")
PLACES = 30
LOWEST = (-1.0, -0.5)  # of the half box: its lowest quarter
MARGIN = 1.5  # least tensions that a place must have, over those allowed
STEP = 0.3  # [m] sideways and down that a move goes
SPEED, ACCELERATION = 1.0, 1.0  # [m/s, m/s^2]
WATCHED = 8.0  # [s] after the move
EARLY, LATE = (2.0, 4.0), (6.0, 8.0)  # [s] after it, between which sway is compared
CALM = 5e-3  # [m] of sway that counts as none
GROWTH = 1.5  # of the sway, from which on it grows
MM = 1e3


@dataclass(frozen=True, kw_only=True)
class Place:
    """One run.

    Attributes:
        policy: File.
        estimator: By name.
        number: Of place and plant, the same for all.
    """

    policy: str
    estimator: str
    number: int


def drawn(robot: Robot, number: int) -> tuple[Array, Array]:
    """Both ends of a move in W [m], the last one low in the box."""
    rng = np.random.default_rng([number, 77])
    middle = 0.5 * (robot.workspace_min + robot.workspace_max)
    half = 0.5 * (robot.workspace_max - robot.workspace_min)
    while True:
        share = rng.uniform(-0.9, 0.9, 3)
        share[2] = rng.uniform(*LOWEST)
        end = middle + half * share
        start = end + np.array([0.0, -STEP * np.sign(share[1]), STEP])
        rest = statics.inverse_kinematics(robot, np.stack([start, end]))
        if rest.converged.all() and (rest.tension[1] > MARGIN * robot.tension_min).all():
            return start, end


def sway(place: Place) -> tuple[float, float] | str:
    """Sway soon after the move and later [m], or the error that the run ended in."""
    robot = Policy.load(Path(place.policy)).description.robot
    start, end = drawn(robot, place.number)
    path = trajectories.line(start, end, speed_max=SPEED, acceleration_max=ACCELERATION)
    task = Task(
        robot=robot.name, controller=td3(), policy=place.policy, estimator=place.estimator,
        path=TITLE, seed=place.number, wind=False,
    )  # fmt: skip
    driver, estimator, controller = make(task, robot, path)
    try:
        log = run(driver, estimator, controller, path, duration=path.duration + WATCHED)
    except CarosacError as failure:
        return str(failure)
    assert log.position is not None
    after, position = log.time - path.duration, log.position[:, 0]
    parts = (position[(after > first) & (after < last)] for first, last in (EARLY, LATE))
    early, late = (float(np.linalg.norm(part.std(axis=0))) for part in parts)
    return early, late


def low(policies: Sequence[Path], processes: int) -> str:
    """Run all and make the section; without policies those that are bundled for real time."""
    names = DEFAULT_POLICIES.values()
    files = [str(p) for p in policies] or [str(find_policy(name)) for name in names]
    groups = [(policy, estimator) for policy in files for estimator in ESTIMATORS]
    places = [Place(policy=p, estimator=e, number=k) for p, e in groups for k in range(PLACES)]
    with multiprocessing.get_context("spawn").Pool(processes) as pool:
        found = pool.map(sway, places, chunksize=1)
    lines = []
    for k, (policy, estimator) in enumerate(groups):
        about = Policy.load(Path(policy)).description
        mine = found[PLACES * k : PLACES * (k + 1)]
        ended = {number: x for number, x in enumerate(mine) if not isinstance(x, str)}
        grown = [n for n, (a, b) in ended.items() if b > max(CALM, GROWTH * a)]
        stopped = [n for n in range(PLACES) if n not in ended]
        late = [b for _, b in ended.values()]
        lines.append((
            about.robot.name, named(about), estimator,
            f"{len(ended) - len(grown)} of {PLACES}", _names(grown), _names(stopped),
            f"{MM * float(np.median(late)):.1f}", f"{MM * max(late):.1f}",
        ))  # fmt: skip
    header = ("robot", "policy", "estimator", "calm", "swing up", "ended in an error",
              "sway, median [mm]", "largest [mm]")  # fmt: skip
    return (
        f"Driver `simulator`, cables of particles, `nominal-1` without its wind, suite `{SUITE}`. "
        f"{PLACES} positions in the lowest quarter of the box, each with a plant of its own, at "
        f"the end of a move {STEP:g} m sideways and down, at {SPEED:g} m/s. Sway is that from "
        f"{LATE[0]:g} to {LATE[1]:g} s after the move; it swings up if that is more than "
        f"{MM * CALM:g} mm and {GROWTH:g} times that from {EARLY[0]:g} to {EARLY[1]:g} s.\n\n"
        + table(header, lines)
    )


def _names(numbers: Sequence[int]) -> str:
    """Numbers of places, or that there are none."""
    return ", ".join(str(n) for n in numbers) or "-"
