"""Reference suite: fixed studies that anybody's controllers and estimators can enter."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from importlib.resources import files
from pathlib import Path
from typing import Any

from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.robot.condition_file import find_condition
from carosac_toolkit.studies.compare.study import Study
from carosac_toolkit.studies.run.case import canonical
from carosac_toolkit.studies.run.run_case import robot_digest

LATEST_SUITE = "reference-1"
LATEST_SUITE_ALIAS = "reference"  # the name of whatever is the latest
REFERENCE_QUICK_SEEDS = 2
TRACKING, ESTIMATION = "tracking", "estimation"


@dataclass(frozen=True, kw_only=True)
class SuiteTask:
    """Study of a suite: a part of it on one robot.

    Attributes:
        part: ``tracking`` or ``estimation``.
        robot: On which.
        study: All cases; it has no folder yet.
    """

    part: str
    robot: str
    study: Study

    @property
    def baseline(self) -> tuple[str, str]:
        """Controller and estimator that all others are compared with."""
        return self.study.controllers[0], self.study.estimators[0]


@dataclass(frozen=True, kw_only=True)
class ReferenceSuite:
    """Definition of the studies of a suite, independent of their execution.

    Attributes:
        name: With its version.
        definition: Content of its file: names and numbers.
    """

    name: str
    definition: Mapping[str, Any]

    @classmethod
    def load(cls, name: str) -> ReferenceSuite:
        """Return the suite of a name.

        Raises:
            InvalidField: There is none.
        """
        from carosac_toolkit.base.yaml import load_yaml

        name = LATEST_SUITE if name == LATEST_SUITE_ALIAS else name
        if name not in suites():
            allowed = f"one of {[LATEST_SUITE_ALIAS, *suites()]}; sensors are chosen with --sensors"
            raise InvalidField("suite", repr(name), allowed)
        return cls(name=name, definition=load_yaml(_file(name).read_text(encoding="utf-8")))

    @cached_property
    def digest(self) -> str:
        """Sixteen hexadecimal digits of all that decides the draws; equal ones are comparable."""
        whole = {
            "definition": dict(self.definition),
            "robots": {name: robot_digest(name) for name in self.definition["robots"]},
            "condition": asdict(find_condition(self.definition["perturbation"])),
        }
        return hashlib.sha256(canonical(whole).encode()).hexdigest()[:16]

    def quick(self) -> ReferenceSuite:
        """Return two seeds of one trajectory: another definition, to see that all runs."""
        fewer = {
            "seeds": self.definition["seeds"][:REFERENCE_QUICK_SEEDS],
            "trajectories": self.definition["trajectories"][:1],
        }
        return replace(self, name=f"{self.name}-quick", definition={**self.definition, **fewer})

    def tasks(
        self, controllers: Sequence[str] = (), estimators: Sequence[str] = (), **more: Any
    ) -> list[SuiteTask]:
        """Return the studies of the suite, or those that some entries need.

        Args:
            controllers: Entries, which run beside the baseline of the part ``tracking``; with
                none here and among the estimators, all of the suite run.
            estimators: The same for the part ``estimation``.
            **more: Fields of `Study` that decide nothing of the draws, such as ``workers``.
        """
        entries = {TRACKING: tuple(controllers), ESTIMATION: tuple(estimators)}
        everything = not any(entries.values())
        return [
            SuiteTask(part=part, robot=robot, study=self._study(part, robot, entries[part], more))
            for part in self.definition["parts"]
            for robot in self.definition["robots"]
            if everything or any(self._may_run(name, robot) for name in entries[part])
        ]

    def _may_run(self, name: str, robot: str) -> bool:
        """Return whether a plug-in works for this robot."""
        return robot in self.definition.get("only", {}).get(name, [robot])

    def _study(
        self, part: str, robot: str, entries: Sequence[str], more: Mapping[str, Any]
    ) -> Study:
        """Return the study of one part on one robot."""
        ways = dict(self.definition["parts"][part])
        axis = "controllers" if part == TRACKING else "estimators"
        if entries:
            ways[axis] = list(dict.fromkeys([ways[axis][0], *entries]))
        ways[axis] = [name for name in ways[axis] if self._may_run(name, robot)]
        fixed = {
            name: self.definition[name]
            for name in (
                "trajectories", "speed_max", "acceleration_max", "seeds", "driver",
                "driver_settings",
            )
        }  # fmt: skip
        known = set(ways["controllers"]) | set(ways["estimators"])
        settings = {
            name: {k: v for k, v in more[name].items() if k in known}
            for name in ("controller_settings", "estimator_settings")
            if name in more
        }
        return Study(
            robots=(robot,),
            sensors=(self.definition["suite"],),
            perturbations=(self.definition["perturbation"],),
            **{**fixed, **ways, **more, **settings},
        )


def suites() -> list[str]:
    """Return the names of all suites, oldest first."""
    names = (item.name for item in files("carosac_toolkit.studies.reference").iterdir())
    return sorted(name.removesuffix(".yaml") for name in names if name.endswith(".yaml"))


def _file(name: str) -> Path:
    """Return the path of a suite's definition."""
    return Path(str(files("carosac_toolkit.studies.reference") / f"{name}.yaml"))
