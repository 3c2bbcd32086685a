"""Grouping of the cases of a study that run together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from carosac_toolkit.base.numbers import check_whole
from carosac_toolkit.studies.run.case import Case
from carosac_toolkit.studies.run.execution import find_function


@dataclass(frozen=True, kw_only=True)
class Batching:
    """Grouping of cases that run together.

    Attributes:
        group: ``module:name`` of a function of a `Case`: a text that cases of one batch share, or
            None for a case that runs alone.
        function: ``module:name`` of a function of several cases: their dicts in the same order.
        size: Most cases of a batch.
    """

    group: str
    function: str
    size: int

    def __post_init__(self) -> None:
        """Refuse functions that do not exist, and empty batches."""
        find_function(self.group)
        find_function(self.function)
        check_whole("batch", self.size, 1, None)

    def parts(self, cases: Sequence[Case]) -> list[list[Case]]:
        """Return the cases in batches, in the order of their first ones."""
        group = find_function(self.group)
        parts: list[list[Case]] = []
        open_parts: dict[str, list[Case]] = {}
        for case in cases:
            name = group(case)
            part = open_parts.get(name) if name is not None else None
            if part is None or len(part) == self.size:
                part = []
                parts.append(part)
                if name is not None:
                    open_parts[name] = part
            part.append(case)
        return parts
