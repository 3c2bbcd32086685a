"""Batch of cases that differ in the seed alone, so that the overhead of Python is paid once.

Each row is what `run_case` gives, to rounding, but for the latencies, which a batch does not have.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from carosac_toolkit.base.errors import CarosacError
from carosac_toolkit.loop import plugins
from carosac_toolkit.loop.loop import run
from carosac_toolkit.loop.protocols import replays
from carosac_toolkit.loop.values import Reference
from carosac_toolkit.physics.motion.winch import PaidOutLengths
from carosac_toolkit.studies.run.case import TRUTH, Case, canonical
from carosac_toolkit.studies.run.divergence import DIVERGED, divergence
from carosac_toolkit.studies.run.limit_scores import own_words
from carosac_toolkit.studies.run.rows import LATENCY_COLUMNS
from carosac_toolkit.studies.run.run_case import (
    DEFAULT_DRIVER,
    build_part,
    condition_of,
    digest_of,
    estimator_of,
    example_series,
    final_rest,
    given_to_driver,
    known_settings,
    path_of,
    period_of,
    plant_of,
    plugin_name,
    robot_of,
)
from carosac_toolkit.studies.run.scores import score
from carosac_toolkit.trajectories.trajectory import Trajectory


def group_of(case: Case) -> str | None:
    """Return the key that cases of one batch share; None if any plug-in needs a single robot.

    The driver has to have `build_batch`, controller and estimator have to be `batched`.
    """
    settings = known_settings(case.settings)
    driver = plugins.load("drivers", str(settings.get("driver", DEFAULT_DRIVER)))
    parts = [plugins.load("controllers", plugin_name(case.controller))]
    if case.estimator != TRUTH:
        parts.append(plugins.load("estimators", plugin_name(case.estimator)))
    together = all(getattr(part, "batched", False) for part in parts)
    if replays(driver) or not hasattr(driver, "build_batch") or not together:
        return None
    return canonical(case.to_dict() | {"seed": None})


def run_together(cases: Sequence[Case]) -> list[dict[str, Any]]:
    """Run and score cases of one group.

    Args:
        cases: Cases of one `group_of`, which differ in their seeds.

    Returns:
        A row for each, as `run_case`; the latencies are None.

    Raises:
        CarosacError: Anything that goes wrong in any of them; then run each alone.
    """
    first = cases[0]
    settings = known_settings(first.settings)
    robot = robot_of(first.robot, digest_of(first))
    condition = condition_of(first).of(robot)
    plants = [plant_of(case, robot) for case in cases]
    paths = Paths(tuple(path_of(case, robot) for case in cases))
    controller = build_part("controllers", first.controller, robot, first, "controller_settings")
    driver = build_part(
        "drivers", str(settings.get("driver", DEFAULT_DRIVER)), plants, first, "driver_settings",
        given_to_driver(first, condition, period_of(controller), paths.starts),
        seeds=[case.sensor_seed for case in cases], nominal=robot,
    )  # fmt: skip
    if getattr(driver, "real_time", False):
        raise CarosacError("a driver in real time runs one case at a time")
    estimator = estimator_of(first, robot, driver)
    rest = final_rest(robot)
    log = run(
        driver, estimator, controller, paths, duration=rest + paths.duration,
        paid_out=PaidOutLengths.of(robot),
    )  # fmt: skip
    if not log.completed:
        raise CarosacError("the driver stopped before the end")
    rows = []
    for b, (case, path) in enumerate(zip(cases, paths.paths, strict=True)):
        cycles = max(1, round((rest + path.duration) / controller.period))
        alone = log.world(b, cycles)
        row = score(alone, robot, path.duration) | dict.fromkeys(LATENCY_COLUMNS)
        row |= own_words(controller) | {"path_moved_m": path.moved, "final_rest_s": rest}
        row[DIVERGED] = divergence(alone, robot)
        rows.append(row | {"series": example_series(case, alone)})
    return rows


@dataclass(frozen=True)
class Paths:
    """Reference paths of B robots, each its own; the shorter ones rest at their end.

    Attributes:
        paths: One for each robot.
    """

    paths: tuple[Trajectory, ...]

    @property
    def duration(self) -> float:
        """Duration of the longest [s]."""
        return max(path.duration for path in self.paths)

    @property
    def starts(self) -> tuple[tuple[float, ...], ...]:
        """Starting positions in W [m]."""
        places = (path.sample(np.zeros(1)).position[0] for path in self.paths)
        return tuple(tuple(float(x) for x in place) for place in places)

    def window(self, time: float, horizon: float, period: float) -> Reference:
        """Return the references as `Trajectory.window` does, a row for each robot."""
        each = [path.window(time, horizon, period) for path in self.paths]
        names = ("time", "position", "velocity", "acceleration")
        return Reference(
            **{name: np.concatenate([getattr(one, name) for one in each]) for name in names}
        )
