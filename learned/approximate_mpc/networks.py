"""Networks of `approximate_mpc`: those that come with the toolkit, and files."""

from __future__ import annotations

from pathlib import Path

from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.robot.robot import Robot
from learned.approximate_mpc.family_network import FAMILY_KIND, FamilyNetwork
from learned.approximate_mpc.family_robots import FAMILY, not_of_family
from learned.approximate_mpc.plan_network import PLAN_FILE_NAME, PlanNetwork
from learned.bundled_files import find_bundled, list_bundled
from learned.policy_file import METADATA_PREFIX, open_network

FOLDER = "plans"
BUNDLED = {"carosac": "carosac-mpc", "scampi": "scampi-mpc"}  # by the name of the robot


def load_network(name_or_path: str) -> PlanNetwork | FamilyNetwork:
    """Read a network of one robot or of a family, a bundled one by its name.

    Raises:
        MissingFile: There is no such file.
        InvalidField: There is no bundled one of that name, or the file is none that
            ``carosac distill`` wrote.
        MissingExtra: onnxruntime is not installed.
    """
    path = find_network(name_or_path)
    opened = open_network(path, PLAN_FILE_NAME)
    schema = opened.session.get_modelmeta().custom_metadata_map.get(METADATA_PREFIX + "schema")
    kind = FamilyNetwork if str(schema).startswith(FAMILY_KIND) else PlanNetwork
    return kind.of(path, opened)


def network_for(robot: Robot) -> PlanNetwork | FamilyNetwork:
    """Return the bundled network that a robot gets by default, checked.

    That is its own, if one was trained for just this robot, or else the one of the family.

    Raises:
        InvalidField: There is neither.
    """
    reasons = []
    if robot.name in BUNDLED:
        own = load_network(BUNDLED[robot.name])
        try:
            own.check(robot)
        except InvalidField as differs:
            reasons = [f"{differs.value}, unlike the robot of {BUNDLED[robot.name]}"]
        else:
            return own
    reason = not_of_family(robot)
    if not reason:
        return load_network(FAMILY)
    reasons.append(reason)
    allowed = f"one of {sorted(BUNDLED)} or of the family {FAMILY}"
    allowed += (
        ", or a network of its own: `carosac distill`, then --set "
        "controller.approximate_mpc.policy=FILE"
        if robot.n < 6
        else ": use mpc, as robots of six or more cables do not sway"
    )
    name = "" if len(reasons) > 1 else f"{robot.name!r} with "
    raise InvalidField("robot", name + ", and with ".join(reasons), allowed)


def list_networks() -> tuple[str, ...]:
    """Return the names of the networks that come with the toolkit, sorted."""
    return list_bundled(FOLDER)


def find_network(name_or_path: str) -> Path:
    """Find the file of a network, a bundled one by its name; see `find_bundled`."""
    return find_bundled(name_or_path, FOLDER)
