"""List the robots that come with the toolkit."""

from __future__ import annotations

from dataclasses import dataclass

from carosac_toolkit.base.tables import format_table
from carosac_toolkit.cli.common import CommandResult, CommonOptions
from carosac_toolkit.robot.bundled_names import list_robots
from carosac_toolkit.robot.file import load_robot


@dataclass(frozen=True, kw_only=True)
class Options(CommonOptions):
    """Options of ``carosac robots``."""


def run(options: Options) -> CommandResult:
    """Print the table of bundled robots."""
    robots = [load_robot(name) for name in list_robots()]
    rows = [(robot.name, robot.n, robot.mass, robot.description) for robot in robots]
    print(format_table(("name", "cables", "mass [kg]", "description"), rows))
    print("\nAny other robot: write a YAML file; `carosac check FILE.yaml` tells what is wrong.")
    data = [
        {
            "name": robot.name,
            "cables": robot.n,
            "mass_kg": robot.mass,
            "description": robot.description,
            "licence": robot.licence,
        }
        for robot in robots
    ]
    return CommandResult({"robots": data})
