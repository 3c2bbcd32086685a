"""The network of a family of robots in its ONNX file, with the ranges that it was trained in."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from baselines.mpc.geometry import excess_at, geometry_at
from baselines.mpc.settings import MpcSettings
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import MALFORMED, InvalidField, MissingFile
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
from learned.approximate_mpc.perceptron import ACTIVATION, Perceptron
from learned.approximate_mpc.plan_inputs import PlanCallback, PlanInputs, TensionCallback
from learned.approximate_mpc.plan_network import INPUT_MAX, PLAN_FILE_NAME
from learned.policy_file import (
    OpenedNetwork,
    checked_layers,
    described_network,
    network_model,
    open_network,
    read_record,
)
from learned.policy_network import Layers

FAMILY_SCHEMA = "carosac-plan-family/1"


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
        tension_share: All of the way to new tensions.
    """

    tension_share = 1.0

    def __init__(self, opened: OpenedNetwork, description: FamilyDescription) -> None:
        self.description = description
        self._tell = Perceptron(opened.layers)

    @classmethod
    def load(cls, path: str | Path) -> FamilyNetwork:
        """Read a network with onnxruntime alone.

        Raises:
            MissingFile: There is no such file.
            InvalidField: It is no file that `write_family_network` wrote, or a damaged one, or one
                of other ranges than this version has.
            MissingExtra: onnxruntime is not installed.
        """
        if not Path(path).is_file():
            raise MissingFile(path)
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
            network = cls(opened, FamilyDescription(**record))
            network._check(path, opened)
        except MALFORMED as error:
            got = f"{path} with damaged metadata: {error}"
            raise InvalidField("path", got, PLAN_FILE_NAME) from error
        return network

    def tell(self, numbers: Array) -> Array:
        """Return what the network tells, shape (4,); see `FamilyNumbers.tension`.

        Raises:
            InvalidField: A number is not finite, or far from all that a robot does.
        """
        if not np.abs(numbers).max() <= INPUT_MAX:
            raise InvalidField("plan inputs", f"{np.abs(numbers).max():g}", f"up to {INPUT_MAX:g}")
        return self._tell(numbers)

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
            return reader.tension(numbers, self.tell(numbers))

        return plan

    def check(self, robot: Robot) -> None:
        """Refuse a robot that is not of the family.

        Raises:
            InvalidField: Names the quantity that is outside of its range.
        """
        check_family(robot)

    def _check(self, path: str | Path, opened: OpenedNetwork) -> None:
        """Refuse a network that does not fit, gives no numbers, or was trained in other ranges."""
        sizes = (opened.layers[0][0].shape[1], len(opened.layers[-1][1]))
        if sizes != (COUNT, CABLES):
            got = f"{path} of {sizes[0]} to {sizes[1]} numbers"
            raise InvalidField("path", got, f"{COUNT} to {CABLES}")
        if len(opened.layers) > 1 and opened.activation != ACTIVATION:
            raise InvalidField("path", f"{path} with {opened.activation}", ACTIVATION)
        if self.description.ranges != ranges_record():
            allowed = f"{PLAN_FILE_NAME} of this version: train it again"
            raise InvalidField("path", f"{path} of other ranges of robots", allowed)
        for scale in (0.0, 1.0, 1e3):
            if not np.isfinite(self.tell(np.full(COUNT, scale))).all():
                raise InvalidField("path", f"{path}, which gives no numbers", PLAN_FILE_NAME)


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
