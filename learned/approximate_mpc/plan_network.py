"""The network of `approximate_mpc` in its ONNX file, with the robot that it was trained for."""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from baselines.mpc.settings import MpcSettings
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import MALFORMED, InvalidField
from carosac_toolkit.base.files import replacing
from carosac_toolkit.base.numbers import check_positive, check_whole
from carosac_toolkit.robot.robot import Robot
from learned.approximate_mpc.perceptron import ACTIVATION, Perceptron, perceptron_of
from learned.approximate_mpc.plan_inputs import (
    PlanCallback,
    PlanNumbers,
    input_count,
    usual_tension,
)
from learned.policy_controller import differing_fields
from learned.policy_file import (
    OpenedNetwork,
    checked_layers,
    described_network,
    network_model,
    open_network,
    read_record,
    record_of,
)
from learned.policy_network import Layers

PLAN_SCHEMA = "carosac-plan/2"
PLAN_FILE_NAME = "an ONNX file that `carosac distill` wrote"


@dataclass(frozen=True, kw_only=True, eq=False)
class PlanDescription:
    """Description of what a network was trained for, and how.

    Attributes:
        robot: The nominal robot.
        mpc: Settings of the controller that it learned from; all that was chosen.
        tension_scale: Change of tensions, from the usual ones, for an output of 1 [N].
        excess_scale: Sag less stretch for an output of 1 [m].
        seed: Of the training.
        commit: Of the code that trained it.
        training: Numbers of the training, by name.
        scores: What was found at its end, by name with its unit.
    """

    robot: Robot
    mpc: dict[str, Any]
    tension_scale: float
    excess_scale: float
    seed: int
    commit: str
    training: dict[str, float]
    scores: dict[str, float]


def check_share(name: str, value: float) -> None:
    """Refuse what is no share of a way.

    Raises:
        InvalidField: It is one.
    """
    if not (isinstance(value, int | float) and 0.0 < value <= 1.0):
        raise InvalidField(name, repr(value), "0 < share <= 1")


class PlanNetwork:
    """First tensions of a plan, and sag less stretch that belong to them.

    It tells by how much tensions differ from the usual ones: a platform that rests where it should
    needs no change, whatever its place, load and wind.

    Attributes:
        description: What it was trained for.
        settings: Of MPC, for `PlanFollower`.
        tension_share: The same.
        turns_back: The same.
    """

    turns_back = True

    def __init__(self, tell: Perceptron, description: PlanDescription) -> None:
        self.description, self._tell = description, tell
        self.settings = MpcSettings(**description.mpc)
        self.tension_share = description.training["tension_share"]
        check_share("tension_share", self.tension_share)
        robot = description.robot
        self._scale = np.repeat([description.tension_scale, description.excess_scale], robot.n)
        self._least, self._most = robot.tension_min, robot.tension_max
        self._reader: tuple[Robot, PlanNumbers] | None = None  # of the last robot

    @classmethod
    def load(cls, path: str | Path) -> PlanNetwork:
        """Read a network with onnxruntime alone, to run on one core.

        Raises:
            MissingFile: There is no such file.
            InvalidField: It is no file that `write_plan_network` wrote, or a damaged one.
            MissingExtra: onnxruntime is not installed.
        """
        return cls.of(path, open_network(path, PLAN_FILE_NAME))

    @classmethod
    def of(cls, path: str | Path, opened: OpenedNetwork) -> PlanNetwork:
        """Take the network of a file that is open; see `load`."""
        try:
            record = read_record(
                path, opened.session.get_modelmeta().custom_metadata_map, PLAN_SCHEMA,
                [f.name for f in fields(PlanDescription)],
                wanted=PLAN_FILE_NAME, command="carosac distill",
            )  # fmt: skip
            check_positive("tension_scale", record["tension_scale"], "N")
            check_positive("excess_scale", record["excess_scale"], "m")
            check_whole("seed", record["seed"], 0)
            description = PlanDescription(**record)
            robot, stages = description.robot, MpcSettings(**description.mpc).stages
            count = input_count(robot, stages)
            tell = perceptron_of(path, opened, count, 2 * robot.n, PLAN_FILE_NAME)
            return cls(tell, description)
        except MALFORMED as error:
            got = f"{path} with damaged metadata: {error}"
            raise InvalidField("path", got, PLAN_FILE_NAME) from error

    def plan(self, numbers: Array) -> tuple[Array, Array]:
        """Return tensions [N] within the limits and sag less stretch [m], each (n,).

        Args:
            numbers: As `PlanNumbers` gives them.

        Raises:
            InvalidField: One of them is not finite, or far from all that a robot does.
        """
        told, n = self._scale * self._tell(numbers), len(self._least)
        tension = usual_tension(self.description.robot, numbers) + told[:n]
        return np.minimum(np.maximum(tension, self._least), self._most), told[n:]

    def settings_of(self, robot: Robot) -> MpcSettings:
        """Return the settings of MPC; they are of the robot that it was trained for."""
        return self.settings

    def planner(self, robot: Robot) -> PlanCallback:
        """Return what plans for a robot."""
        if self._reader is None or self._reader[0] is not robot:
            settings = self.settings
            self._reader = robot, PlanNumbers(robot, settings.stages, settings.compiled)
        _, numbers = self._reader
        return lambda inputs: self.plan(numbers.of(inputs))

    def check(self, robot: Robot) -> None:
        """Refuse a robot that the network was not trained for.

        Raises:
            InvalidField: Names the fields that differ.
        """
        trained = self.description.robot
        if trained.n != robot.n:
            other = "`carosac distill`" if robot.n < 6 else "use mpc"
            allowed = f"{trained.n}, as the robot of the network: {other}"
            raise InvalidField("robot", f"{robot.n} cables", allowed)
        names = differing_fields(trained, robot, moving=True)
        if names:
            raise InvalidField(
                "robot", f"{robot.name!r} with other values of {', '.join(names)}",
                f"{trained.name!r} as the network was trained for it; or train one with "
                "`carosac distill`",
            )  # fmt: skip


def write_plan_network(path: str | Path, layers: Layers, description: PlanDescription) -> None:
    """Write a perceptron with silu in between and tanh at its end, as a whole or not at all.

    Raises:
        InvalidField: Layers that do not fit.
        MissingExtra: onnx is not installed.
    """
    model = network_model(checked_layers(layers), ACTIVATION)
    record = {f.name: getattr(description, f.name) for f in fields(PlanDescription)}
    data = described_network(model, PLAN_SCHEMA, record | {"robot": record_of(description.robot)})
    with replacing(Path(path)) as temporary:
        temporary.write_bytes(data)


def settings_record(settings: MpcSettings) -> dict[str, Any]:
    """Return settings of MPC as JSON holds them; numbers of the robot's size as they are."""
    return asdict(replace(settings, compiled="auto"))
