"""Scores of one run against the limits of its robot: tensions, limited commands, workspace box."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.loop.loop import Log
from carosac_toolkit.loop.protocols import FallbackSource, FeedbackSource, RemarkSource
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.robot.robot import Robot

LIMIT_COLUMNS = (
    "tension_min_N", "tension_max_N", "slack_share", "slack_until_share", "overload_share",
    "outside_share",
)  # fmt: skip
CAUSES = ("jump", "length", "box", "speed", "acceleration", "jerk", "length_rate", "coordination")
ROUNDING_RATIO = 1e-6  # of a tension limit, and of a metre: excess that is rounding


def limit_scores(log: Log, robot: Robot, *, replayed: bool = False) -> dict[str, Any]:
    """Score one run against the limits of its robot.

    Args:
        log: Log of the run.
        robot: The nominal robot, whose limits count.
        replayed: True if the driver played a recording, which no command changes.

    Returns:
        * ``limited_share``: share of the commands that a limit changed; ``limited_by``: JSON text
          with the number of such commands by name of the limit; ``limited_first``: the same by
          the limit that began the piece of limited commands (those after it have to catch up);
          ``winch_reach_m``: how far a winch at full speed is behind its command;
        * ``tension_limit_low_N``, ``tension_limit_high_N``: strictest limits of any cable;
        * ``tension_min_N``, ``tension_max_N``: least and largest true tension of any cable;
        * ``slack_share``, ``overload_share``: share of time with any cable below its
          ``tension_min``, above its ``tension_max``;
        * ``slack_until_share``: share of the run after which no cable is slack;
        * ``outside_share``: share of time with the platform origin outside the workspace box.

        None where the truth is not known.
    """
    hits = {(cycle, hit.limit) for cycle, hit in log.limited}
    names = sorted({name for _, name in hits})
    counts = {name: sum(limit == name for _, limit in hits) for name in names}
    row: dict[str, Any] = {
        "tension_limit_low_N": float(robot.tension_min.max()),
        "tension_limit_high_N": float(robot.tension_max.min()),
        "winch_reach_m": Scales(robot).reach(0.0),
        "limited_share": len({cycle for cycle, _ in hits}) / len(log.time),
        "limited_by": json.dumps(counts, separators=(",", ":")),
        "limited_first": json.dumps(_causes(hits), separators=(",", ":")),
        **dict.fromkeys(LIMIT_COLUMNS),
    }
    if replayed or log.position is None:
        return row
    row["outside_share"] = float((outside(robot, log.position) > ROUNDING_RATIO).mean())
    if log.tension is not None:
        below = slack(robot, log.tension).any(axis=-1)
        last = np.flatnonzero(below.any(axis=-1))
        over = log.tension > robot.tension_max * (1.0 + ROUNDING_RATIO)
        row |= {
            "tension_min_N": float(log.tension.min()),
            "tension_max_N": float(log.tension.max()),
            "slack_share": float(below.mean()),
            "slack_until_share": float(last[-1] + 1) / len(log.time) if len(last) else 0.0,
            "overload_share": float(over.any(axis=-1).mean()),
        }
    return row


def _causes(hits: set[tuple[int, str]]) -> dict[str, int]:
    """Count limited commands by the limit that was met first in their unbroken piece."""
    by_cycle: dict[int, set[str]] = {}
    for cycle, name in hits:
        by_cycle.setdefault(cycle, set()).add(name)
    counts: dict[str, int] = {}
    cause = ""
    for cycle in sorted(by_cycle):
        if cycle - 1 not in by_cycle:
            names = by_cycle[cycle]
            cause = next((name for name in CAUSES if name in names), min(names))
        counts[cause] = counts.get(cause, 0) + 1
    return counts


def own_words(controller: object) -> dict[str, Any]:
    """Return what a controller tells: a remark, feedback or not, commands by fallback as JSON."""
    remark = controller.remark if isinstance(controller, RemarkSource) else None
    counts = dict(controller.fallbacks) if isinstance(controller, FallbackSource) else None
    return {
        "feedback": controller.feedback if isinstance(controller, FeedbackSource) else None,
        "remark": None if remark is None else str(remark),
        "fallbacks": None if counts is None else int(sum(counts.values())),
        "fallbacks_by": None if counts is None else json.dumps(counts, separators=(",", ":")),
    }


def slack(robot: Robot, tension: Array) -> NDArray[np.bool_]:
    """Return which cables are below their `tension_min`, shape (..., n)."""
    below: NDArray[np.bool_] = tension < robot.tension_min * (1.0 - ROUNDING_RATIO)
    return below


def outside(robot: Robot, position: Array) -> Array:
    """Return the largest distance of positions (..., 3) beyond a face of the box [m]."""
    beyond = np.maximum(robot.workspace_min - position, position - robot.workspace_max)
    farthest: Array = beyond.max(axis=-1)
    return farthest
