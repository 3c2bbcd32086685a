"""Networks of `approximate_mpc`: those that come with the toolkit, and files."""

from __future__ import annotations

from pathlib import Path

from carosac_toolkit.base.errors import InvalidField, MissingFile
from carosac_toolkit.robot.robot import Robot
from learned.approximate_mpc.family_network import FAMILY_SCHEMA, FamilyNetwork
from learned.approximate_mpc.family_robots import CABLES, FAMILY
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
    if not path.is_file():
        raise MissingFile(path)
    opened = open_network(path, PLAN_FILE_NAME)
    schema = opened.session.get_modelmeta().custom_metadata_map.get(METADATA_PREFIX + "schema")
    kind = FamilyNetwork if schema == FAMILY_SCHEMA else PlanNetwork
    return kind.of(path, opened)


def network_for(robot: Robot) -> PlanNetwork | FamilyNetwork:
    """Return the bundled network that a robot gets by default, checked.

    That is the one that was trained for it; if there is none, or the robot has other values, that
    of its family.

    Raises:
        InvalidField: There is none.
    """
    own = BUNDLED.get(robot.name)
    if own is not None:
        network = load_network(own)
        try:
            network.check(robot)
        except InvalidField:
            if robot.n != CABLES:
                raise
        else:
            return network
    if robot.n != CABLES or FAMILY not in list_networks():
        allowed = f"a robot with a bundled network, as it is, of {sorted(BUNDLED)}"
        raise InvalidField("robot", repr(robot.name), allowed + instead(robot))
    family = load_network(FAMILY)
    try:
        family.check(robot)
    except InvalidField as error:
        raise InvalidField("robot", error.value, error.allowed + instead(robot)) from error
    return family


def instead(robot: Robot) -> str:
    """Return what else a robot without a network can do, as the end of a sentence."""
    if robot.n >= 6:
        return ": use mpc, as robots of six or more cables do not sway"
    return (
        ", or a network of its own: `carosac distill`, then --set "
        "controller.approximate_mpc.policy=FILE"
    )


def list_networks() -> tuple[str, ...]:
    """Return the names of the networks that come with the toolkit, sorted."""
    return list_bundled(FOLDER)


def find_network(name_or_path: str) -> Path:
    """Find the file of a network, a bundled one by its name; see `find_bundled`."""
    return find_bundled(name_or_path, FOLDER)
