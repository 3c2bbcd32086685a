"""Probe of a policy: results of fixed observations and actions, to notice changed code.

What numbers of an observation and of an action mean is computed from the robot and the settings,
with constants of the code that a policy does not keep. A policy keeps a probe instead: what came
out where it was trained.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.physics.cable import straight_line
from carosac_toolkit.robot.robot import Robot
from learned.environment import EnvironmentSettings, empty_look, make_actions
from learned.observation import ObservationInputs, ObservationScales, observe

PROBE_SEED = 5
PROBE_ROWS = 6  # the first one rests at home
INNER_BOX_RATIO = 0.5  # share of the workspace box in which they lie
PROBE_TOLERANCES = {"observation": 1e-3, "length": 1e-4}  # [-] and [m]: what counts as the same
PROBE_DECIMALS = 7  # digits behind the point


def make_probe(robot: Robot, settings: EnvironmentSettings) -> dict[str, list[list[float]]]:
    """Compute the observations and lengths [m] of fixed inputs, by name, a row for each.

    Args:
        robot: The nominal robot.
        settings: Of the environment of the policy.
    """
    scales = ObservationScales.of(robot, settings.units)
    actions = make_actions(robot, settings, scales)
    rng = np.random.default_rng(PROBE_SEED)
    look = _looks(robot, len(settings.preview), actions.size, rng)
    if settings.path.period is None:  # of set-points the target is due
        look = replace(look, due=look.target, due_velocity=look.target_velocity)
    action = rng.uniform(-1.0, 1.0, (PROBE_ROWS, actions.size))
    results = {
        "observation": observe(settings.observation, look, scales),
        "length": actions.lengths(actions.applied(action, look), look),
    }
    return {name: values.round(PROBE_DECIMALS).tolist() for name, values in results.items()}


def check_probe(kept: Any, robot: Robot, settings: EnvironmentSettings) -> None:
    """Make sure that a policy sees and does what it saw and did where it was trained.

    Args:
        kept: Its probe.
        robot: The robot that it was trained for.
        settings: Of the environment that it was trained in.

    Raises:
        InvalidField: Another version trained it; says by how much it differs.
    """
    mine = make_probe(robot, settings)
    allowed = "a policy of this version: train it again with `carosac train`"
    try:
        theirs = {name: np.array(kept[name], dtype=np.float64) for name in mine}
    except (TypeError, KeyError, ValueError) as error:
        raise InvalidField("policy.probe", repr(kept)[:40], allowed) from error
    for name, values in mine.items():
        if theirs[name].shape != np.shape(values):
            raise InvalidField("policy", f"{name}s of another size", allowed)
        apart = float(np.abs(theirs[name] - values).max())
        if not apart <= PROBE_TOLERANCES[name]:
            difference = f"{1e3 * apart:.2g} mm" if name == "length" else f"{apart:.2g}"
            got = f"trained with another version: {name}s differ by up to {difference}"
            raise InvalidField("policy", got, allowed)


def _looks(
    robot: Robot, previews: int, actions: int, rng: np.random.Generator
) -> ObservationInputs:
    """Draw inputs in the inner part of the workspace box; the first one is at rest at home."""
    center = (robot.workspace_min + robot.workspace_max) / 2
    half = INNER_BOX_RATIO * (robot.workspace_max - robot.workspace_min) / 2
    count = PROBE_ROWS - 1
    later = np.random.default_rng(
        [PROBE_SEED, 1]
    )  # of parts that came later; older probes stay as is

    def inside(*shape: int) -> Array:
        return center + half * rng.uniform(-1.0, 1.0, (count, *shape, 3))

    position = inside()
    rotation = Rotation.from_rotvec(0.1 * rng.standard_normal((count, 3))).as_matrix()
    anyhow = ObservationInputs(
        position=position,
        rotation=rotation,
        twist=0.3 * rng.standard_normal((count, 6)),
        length=straight_line.straight_length(robot, position, rotation).length,
        target=inside(),
        target_velocity=inside() - center,  # across the inner part in a second
        target_acceleration=inside() - center,
        preview=inside(previews),
        last_action=rng.uniform(-1.0, 1.0, (count, actions)),
        mean_error=0.1 * later.standard_normal((count, 3)),
        lasting_error=0.1 * later.standard_normal((count, 3)),
        due=position + 0.1 * later.standard_normal((count, 3)),
        due_velocity=0.3 * later.standard_normal((count, 3)),
        aimed_acceleration=later.standard_normal((count, 3)),
    )
    rest = empty_look(robot, previews, actions)
    both = {
        name: np.concatenate([getattr(rest, name), getattr(anyhow, name)])
        for name in ObservationInputs.__dataclass_fields__
    }
    return replace(anyhow, **both)
