"""Scores of an evaluation as one file beside its pictures, so that others can be drawn from it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from carosac_toolkit.base.npz import read_npz, write_npz
from carosac_toolkit.robot.robot import Robot
from learned.scores import PolicyScores

SCORES_FILE, ROBOT_FILE = "scores.npz", "robot.npz"
SCORES_KEY = "evaluation"


@dataclass(frozen=True, kw_only=True, eq=False)
class SavedScores:
    """Scores of one run of ``carosac evaluate``.

    Attributes:
        policy: As it was named.
        protocol: Which.
        robot: On which.
        scores: Of the policy, and of what it was compared with, by name.
    """

    policy: str
    protocol: str
    robot: Robot
    scores: Mapping[str, PolicyScores]

    def write(self, folder: Path) -> None:
        """Write it into a folder that exists."""
        arrays = {
            f"{number}.{field.name}": value
            for number, scores in enumerate(self.scores.values())
            for field in fields(scores)
            if (value := getattr(scores, field.name)) is not None
        }
        rest = {"policy": self.policy, "protocol": self.protocol, "names": list(self.scores)}
        self.robot.to_npz(folder / ROBOT_FILE)
        write_npz(folder / SCORES_FILE, SCORES_KEY, rest, arrays)

    @classmethod
    def read(cls, folder: Path) -> SavedScores:
        """Read what `write` wrote.

        Raises:
            MissingFile: There is nothing.
            InvalidField: ``carosac evaluate`` did not write it.
        """
        robot = Robot.from_npz(folder / ROBOT_FILE)

        def build(rest: Any, arrays: dict[str, NDArray[Any]]) -> SavedScores:
            scores = {
                name: PolicyScores(
                    **{x.name: arrays.get(f"{number}.{x.name}") for x in fields(PolicyScores)}  # type: ignore[arg-type]
                )
                for number, name in enumerate(rest["names"])
            }
            return cls(policy=rest["policy"], protocol=rest["protocol"], robot=robot, scores=scores)

        return read_npz(folder / SCORES_FILE, SCORES_KEY, "carosac evaluate", build)
