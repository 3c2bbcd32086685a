"""Workspace on a grid: its volume and what bounds it, in numbers and words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.base.numbers import plain
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.workspace.grid import Grid
from carosac_toolkit.workspace.judgement import Verdicts, judge
from carosac_toolkit.workspace.limits import LIMIT_LABELS, Limit, cable_of, describe
from carosac_toolkit.workspace.settings import WorkspaceSettings

PAIRS_SHOWN = 2  # of cables that come too near each other


@dataclass(frozen=True, kw_only=True, eq=False)
class Region:
    """Verdicts on a grid of positions.

    Attributes:
        robot: The robot.
        grid: The positions.
        settings: Demands on a pose.
        verdicts: One for each position of `grid.positions`; with several orientations the worst.
    """

    robot: Robot
    grid: Grid
    settings: WorkspaceSettings
    verdicts: Verdicts

    @property
    def share(self) -> float:
        """Share of the positions inside."""
        return float(self.verdicts.inside.mean())

    @property
    def volume(self) -> float:
        """Cells whose middle is inside [m^3]; on a plane of rest [m^2]."""
        return float(self.verdicts.inside.sum()) * self.grid.cell

    @property
    def unknown(self) -> int:
        """Positions where the computation did not converge; they count as outside."""
        return int((self.verdicts.limit == Limit.NOT_CONVERGED).sum())

    def causes(self, *, at_the_end: bool = False) -> list[tuple[int, int, int]]:
        """Return limit, cable (-1: none) and number of positions it excludes, the largest first.

        Args:
            at_the_end: Only of the positions beside one that is inside, where a platform that
                leaves the workspace meets its limits.
        """
        out = self.verdicts
        chosen = self._beside() if at_the_end else ~out.inside
        pairs = np.stack([out.limit, out.cable], axis=1)[chosen]
        if len(pairs) == 0:
            return []
        groups, counts = np.unique(pairs, axis=0, return_counts=True)
        order = np.argsort(-counts, kind="stable")
        return [(int(groups[k, 0]), int(groups[k, 1]), int(counts[k])) for k in order]

    def colliding(self) -> list[tuple[str, str, int]]:
        """Return the pairs of cables that keep positions out, with their number, most first."""
        out = self.verdicts
        pairs = out.pair[out.limit == Limit.COLLISION]
        if len(pairs) == 0:
            return []
        groups, counts = np.unique(pairs, axis=0, return_counts=True)
        names = self.robot.cable_names
        return [
            (names[groups[k, 0]], names[groups[k, 1]], int(counts[k]))
            for k in np.argsort(-counts, kind="stable")
        ]

    def cable_words(self, limit: int, cable: int) -> str | None:
        """Name the cable that a limit is about, the pairs that come too near, or None."""
        if limit != Limit.COLLISION:
            return cable_of(limit, cable, self.robot.cable_names)
        pairs = [f"{one} and {other}" for one, other, _ in self.colliding()]
        more = f", {len(pairs) - PAIRS_SHOWN} more pairs" if len(pairs) > PAIRS_SHOWN else ""
        return f"{', '.join(pairs[:PAIRS_SHOWN])}{more}" if pairs else None

    def _beside(self) -> NDArray[np.bool_]:
        """Return positions outside, next to one inside along x, y or z."""
        inside = self.verdicts.inside.reshape(self.grid.shape)
        near = np.zeros_like(inside)
        for axis in range(3):
            ahead = [slice(None)] * 3
            behind = [slice(None)] * 3
            ahead[axis], behind[axis] = slice(1, None), slice(None, -1)
            near[tuple(ahead)] |= inside[tuple(behind)]
            near[tuple(behind)] |= inside[tuple(ahead)]
        return (near & ~inside).ravel()

    def sentence(self) -> str:
        """Return the result in words."""
        name = self.robot.name
        share = f"{self.share:.1%}".replace("%", " %")
        place = "plane" if self.grid.rests else "box"
        if self.verdicts.inside.all():
            count = len(self.verdicts.margin)
            text = f"{name} can hold its platform at all {count} positions in the {place}"
            return f"{text}; {self._nearest()}"
        if not self.verdicts.inside.any():
            text = f"{name} can hold its platform nowhere in the {place}: {self._words(False)}"
        else:
            text = (
                f"{name} can hold its platform in {share} of the {place}; "
                f"where that ends, mostly {self._words(True)}"
            )
        if self.unknown:
            text += f"; {self.unknown} positions did not converge and count as outside"
        return text

    def _nearest(self) -> str:
        """Describe the limit nearest to the positions inside."""
        out = self.verdicts
        k = int(np.nanargmin(np.where(np.isfinite(out.margin), out.margin, np.nan)))
        which = describe(out.nearest[k], out.nearest_cable[k], self.robot.cable_names)
        verb = {Limit.SLACK: "first to fall slack", Limit.OVERLOAD: "first to be overloaded"}
        cable = self.robot.cable_names[out.nearest_cable[k]]
        place = ", ".join(f"{x:.2f}" for x in out.rest.position[k])
        text = verb.get(Limit(int(out.nearest[k])), which)
        return f"the least margin is {plain(out.margin[k], 3)} N at ({place}) m, {cable} {text}"

    def _words(self, at_the_end: bool) -> str:
        """Describe what excludes positions, the three most frequent causes."""
        causes = self.causes(at_the_end=at_the_end)
        total = sum(count for _, _, count in causes)
        return ", ".join(
            f"{self._described(limit, cable)} ({100.0 * count / total:.0f} %)"
            for limit, cable, count in causes[:3]
        )

    def _described(self, limit: int, cable: int) -> str:
        """Describe a limit in words, with its cable or its pair of cables."""
        text = describe(limit, cable, self.robot.cable_names)
        pairs = self.colliding() if limit == Limit.COLLISION else []
        return f"{text}, {pairs[0][0]} and {pairs[0][1]}" if pairs else text

    def data(self) -> dict[str, Any]:
        """Return the numbers, ready for JSON."""
        out = self.verdicts
        finite = out.margin[np.isfinite(out.margin)]
        inside = out.margin[out.inside]
        return {
            "model": "sag" if self.settings.sag else "straight",
            "positions": len(out.margin),
            "inside": int(out.inside.sum()),
            "share": self.share,
            **self._sizes(),
            "not_converged": self.unknown,
            "margin_N": {
                "least_inside": float(inside.min()) if len(inside) else None,
                "median_inside": float(np.median(inside)) if len(inside) else None,
                "largest": float(finite.max()) if len(finite) else None,
            },
            "limits": self._listed(at_the_end=False),
            "colliding": [
                {"cables": [one, other], "positions": count}
                for one, other, count in self.colliding()
            ],
            "limits_at_the_end": self._listed(at_the_end=True),
            "sentence": self.sentence(),
        }

    def _sizes(self) -> dict[str, Any]:
        """Return what is inside and all that was searched: volumes, on a plane of rest areas."""
        searched = self.grid.cell * len(self.verdicts.margin)
        if self.grid.rests:
            return {"plane": self.grid.title, "area_m2": self.volume, "plane_m2": searched}
        return {"volume_m3": self.volume, "box_m3": searched}

    def _listed(self, *, at_the_end: bool) -> list[dict[str, Any]]:
        """Return the causes, ready for JSON."""
        return [
            {
                "limit": LIMIT_LABELS[Limit(limit)],
                "cable": cable_of(limit, cable, self.robot.cable_names),
                "positions": count,
            }
            for limit, cable, count in self.causes(at_the_end=at_the_end)
        ]


def compute(
    robot: Robot,
    grid: Grid,
    *,
    settings: WorkspaceSettings | None = None,
    orientations: Sequence[Array] | None = None,
) -> Region:
    """Judge all positions of a grid.

    Args:
        robot: Robot description, n cables.
        grid: Positions; see `box_grid` and `slice_grid`.
        settings: Demands on a pose; None: the defaults.
        orientations: Rotations from P to W, each (3, 3), with all of which a position must be held
            (n >= 6 only); None: the home rotation, or with n < 6 the one that is found.

    Returns:
        The verdicts, and with them volume and words.
    """
    asked = settings or WorkspaceSettings()
    where = grid.positions
    if orientations is None:
        verdicts = judge(robot, where, settings=asked, lines=grid.lines)
        return Region(robot=robot, grid=grid, settings=asked, verdicts=verdicts)
    if len(orientations) == 0:
        raise InvalidField("orientations", "none", "at least one rotation, or None")
    judged = [
        judge(robot, where, np.broadcast_to(turn, (len(where), 3, 3)), settings=asked)
        for turn in orientations
    ]
    return Region(robot=robot, grid=grid, settings=asked, verdicts=_worst(judged))


def _worst(verdicts: Sequence[Verdicts]) -> Verdicts:
    """Return row by row the verdict that is outside, or has the least margin."""
    margin = np.stack([np.where(np.isnan(v.margin), -np.inf, v.margin) for v in verdicts])
    chosen = np.lexsort((margin, np.stack([v.inside for v in verdicts])), axis=0)[0]
    worst: Verdicts = _choose(verdicts, chosen)
    return worst


def _choose(records: Sequence[Any], chosen: NDArray[np.intp]) -> Any:
    """Return row by row one of several records of equal arrays."""
    rows = np.arange(len(chosen))
    values = {}
    for field in fields(records[0]):
        parts = [getattr(record, field.name) for record in records]
        values[field.name] = (
            np.stack(parts)[chosen, rows]
            if isinstance(parts[0], np.ndarray)
            else _choose(parts, chosen)
        )
    return type(records[0])(**values)
