"""The network of a family of robots in its ONNX file, with the ranges that it was trained in."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from baselines.mpc.geometry import excess_at, geometry_at
from baselines.mpc.settings import MpcSettings
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import MALFORMED, InvalidField
from carosac_toolkit.base.files import replacing
from carosac_toolkit.base.numbers import check_whole
from carosac_toolkit.robot.robot import Robot
from learned.approximate_mpc.family_numbers import COUNT, FamilyNumbers
from learned.approximate_mpc.family_robots import (
    CABLES,
    RANGES,
    check_family,
    family_settings,
)
from learned.approximate_mpc.perceptron import ACTIVATION, Perceptron, perceptron_of
from learned.approximate_mpc.plan_inputs import PlanCallback, PlanInputs, TensionCallback
from learned.approximate_mpc.plan_network import PLAN_FILE_NAME
from learned.policy_file import (
    OpenedNetwork,
    checked_layers,
    described_network,
    network_model,
    open_network,
    read_record,
)
from learned.policy_network import Layers

FAMILY_KIND = "carosac-plan-family/"
FAMILY_SCHEMA = FAMILY_KIND + "2"
TENSION_SHARE = 0.9  # of 0.7, 0.8, 0.9 and 1 on thirty drawn robots, that of the least errors


@dataclass(frozen=True, kw_only=True, eq=False)
class FamilyDescription:
    """Description of what a network was trained for, and how.

    Attributes:
        ranges: Least and largest value of each quantity of a robot, by its name.
        seed: Of the training.
        commit: Of the code that trained it.
        training: Numbers of the training, by name.
        scores: What was found at its end, by name with its unit.
    """

    ranges: dict[str, list[float]]
    seed: int
    commit: str
    training: dict[str, float]
    scores: dict[str, float]


class FamilyNetwork:
    """First tensions of a plan, for any robot of the family.

    Attributes:
        description: What it was trained for.
        tension_share: See `PlanFollower`.
        turns_back: The same; how it does over the whole family was not measured.
    """

    tension_share = TENSION_SHARE
    turns_back = False

    def __init__(self, tell: Perceptron, description: FamilyDescription) -> None:
        self.description, self._tell = description, tell

    @classmethod
    def load(cls, path: str | Path) -> FamilyNetwork:
        """Read a network with onnxruntime alone.

        Raises:
            MissingFile: There is no such file.
            InvalidField: It is no file that `write_family_network` wrote, or a damaged one, or one
                of other ranges than this version has.
            MissingExtra: onnxruntime is not installed.
        """
        return cls.of(path, open_network(path, PLAN_FILE_NAME))

    @classmethod
    def of(cls, path: str | Path, opened: OpenedNetwork) -> FamilyNetwork:
        """Take the network of a file that is open; see `load`."""
        try:
            record = read_record(
                path, opened.session.get_modelmeta().custom_metadata_map, FAMILY_SCHEMA,
                [f.name for f in fields(FamilyDescription)],
                wanted=PLAN_FILE_NAME, command="carosac distill --family",
            )  # fmt: skip
            check_whole("seed", record["seed"], 0)
            description = FamilyDescription(**record)
            tell = perceptron_of(path, opened, COUNT, CABLES, PLAN_FILE_NAME)
        except MALFORMED as error:
            got = f"{path} with damaged metadata: {error}"
            raise InvalidField("path", got, PLAN_FILE_NAME) from error
        if description.ranges != ranges_record():
            allowed = f"{PLAN_FILE_NAME} of this version: train it again"
            raise InvalidField("path", f"{path} of other ranges of robots", allowed)
        return cls(tell, description)

    def settings_of(self, robot: Robot) -> MpcSettings:
        """Return the settings of MPC for a robot."""
        return family_settings(robot)

    def planner(self, robot: Robot) -> PlanCallback:
        """Return what plans for a robot."""
        tensions = self.tensions(robot)

        def plan(inputs: PlanInputs) -> tuple[Array, Array]:
            tension = np.clip(tensions(inputs), robot.tension_min, robot.tension_max)
            geometry = geometry_at(robot, inputs.position, inputs.rotation)
            excess = excess_at(robot, inputs.position, inputs.rotation, tension, geometry)
            return tension, excess

        return plan

    def tensions(self, robot: Robot) -> TensionCallback:
        """Return what plans the tensions alone."""
        reader = FamilyNumbers(robot)

        def plan(inputs: PlanInputs) -> Array:
            numbers = reader.of(inputs)
            return reader.tension(numbers, self._tell(numbers))

        return plan

    def check(self, robot: Robot) -> None:
        """Refuse a robot that is not of the family.

        Raises:
            InvalidField: Names the quantity that is outside of its range.
        """
        check_family(robot)


def write_family_network(path: str | Path, layers: Layers, description: FamilyDescription) -> None:
    """Write a perceptron with silu in between and tanh at its end, as a whole or not at all.

    Raises:
        InvalidField: Layers that do not fit.
        MissingExtra: onnx is not installed.
    """
    model = network_model(checked_layers(layers), ACTIVATION)
    record = {f.name: getattr(description, f.name) for f in fields(FamilyDescription)}
    with replacing(Path(path)) as temporary:
        temporary.write_bytes(described_network(model, FAMILY_SCHEMA, record))


def ranges_record() -> dict[str, list[float]]:
    """Return the ranges of the family as JSON holds them."""
    return {name: list(bounds) for name, bounds in RANGES.items()}
