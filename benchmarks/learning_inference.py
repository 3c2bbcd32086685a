"""How much CPU time a policy takes to answer: warm, and at its pace on a core awake or asleep."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np

import carosac_toolkit as ct
from benchmarks.controllers import SMOOTH, Task, path_of
from benchmarks.learning_drive import LIMIT_LATENCY, MS, td3
from benchmarks.results import table
from carosac_toolkit.loop import plugins
from carosac_toolkit.loop.values import Belief, Reference
from carosac_toolkit.robot.robot import Robot
from learned.policy_controller import DEFAULT_POLICIES, find_policy, list_policies
from learned.policy_file import Policy

TITLE = "Inference"
BASELINE = "kinematic_solver"
WARM, PACED = 2000, 200  # calls of each kind
UNTIMED = 20  # calls before them
OFF = 0.01  # [m] of the belief from the reference

Cycle = tuple[Belief, Reference]
Wait = Callable[[float], None]


def inference() -> str:
    """All bundled policies, and what catenary inverse kinematics takes for the same."""
    rows = []
    for name in list_policies():
        policy = Policy.load(find_policy(name))
        robot = policy.description.robot
        rows.append(_row(robot, f"`{name}`", _controller(robot, td3(), policy=name), policy))
    for name in DEFAULT_POLICIES:
        robot = ct.load_robot(name)
        rows.append(_row(robot, BASELINE, _controller(robot, BASELINE), None))
    header = (
        "robot", "controller", "network alone: warm [ms]", "network alone: asleep [ms]",
        *(text for kind in ("warm", "awake", "asleep") for text in (
            f"command: {kind} [ms]", f"{kind}, 95 % [ms]", f"{kind}, {LIMIT_LATENCY:g} ms")),
    )  # fmt: skip
    return (
        "CPU time on one core, medians, beliefs and references along a minimum-snap path. A "
        "command is all from belief and reference to lengths: observation, network, lengths of "
        f"the action, checks. Warm: {WARM} calls, one upon the other. Awake and asleep: {PACED} "
        "calls at the pace of the controller, the core waiting busily for a period before each, or "
        "sleeping; what a call takes longer after a sleep is the core waking up, which differs "
        "several times over between hours on a virtual machine.\n\n"
        f"{table(header, rows)}"
    )


def _controller(robot: Robot, name: str, **settings: Any) -> Any:
    chosen = plugins.load("controllers", name)
    return chosen.build(robot, chosen.Settings(**settings) if settings else None)


def _row(robot: Robot, name: str, controller: Any, policy: Policy | None) -> tuple[str, ...]:
    """Time a controller, and its network where it has one."""
    cycles = _cycles(robot, controller)
    controller.reset(cycles[0][0])
    cells = []
    if policy is None:
        cells += ["-", "-"]
    else:
        seen = np.random.default_rng(0).uniform(-1.0, 1.0, (WARM, 1, policy.observation_size))
        for wait in (None, time.sleep):
            found = _times(lambda k: policy.act(seen[k]), WARM, controller.period, wait)
            cells.append(f"{found[0]:.3f}")
    for wait in (None, _busy, time.sleep):
        median, slow = _times(
            lambda k: controller.command(*cycles[k]), len(cycles), controller.period, wait
        )
        cells += [f"{median:.3f}", f"{slow:.3f}"]
        met = "passed" if median < LIMIT_LATENCY else "**missed**"
        cells.append("-" if policy is None else met)
    print(robot.name, name, *cells, flush=True)
    return robot.name, name, *cells


def _cycles(robot: Robot, controller: Any) -> list[Cycle]:
    """What the controller is given along a path."""
    path = path_of(Task(robot=robot.name, controller="", path=SMOOTH, seed=0), robot)
    found = []
    for now in np.arange(0.0, path.duration, controller.period):
        reference = path.window(now, controller.horizon, controller.period)
        belief = Belief(
            time=reference.time[:, 0],
            position=reference.position[:, 0] + OFF,
            rotation=robot.home_rotation[None],
            twist=np.concatenate([reference.velocity[:, 0], np.zeros((1, 3))], axis=1),
        )
        found.append((belief, reference))
    return found


def _busy(seconds: float) -> None:
    """Wait without letting the core sleep."""
    end = time.perf_counter() + seconds
    while time.perf_counter() < end:
        pass


def _times(
    call: Callable[[int], object], size: int, period: float, wait: Wait | None
) -> tuple[float, float]:
    """Median and 95th percentile [ms] of calls with numbers below `size`, in turn.

    Args:
        call: What is timed.
        size: How many numbers there are.
        period: Between two calls [s].
        wait: How that is waited for; None: not at all.
    """
    found = []
    for k in range(UNTIMED + (PACED if wait else WARM)):
        if wait:
            wait(period)
        start = time.thread_time_ns()
        call(k % size)
        found.append(1e-9 * (time.thread_time_ns() - start))
    timed = found[UNTIMED:]
    return MS * float(np.median(timed)), MS * float(np.quantile(timed, 0.95))
