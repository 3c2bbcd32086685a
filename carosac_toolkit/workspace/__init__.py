"""Workspace of a robot: its extent, its margins, and the limit that ends it."""

from __future__ import annotations

from carosac_toolkit.workspace.grid import Grid, box_grid, box_of, search_grid, slice_grid
from carosac_toolkit.workspace.judgement import Verdicts, judge
from carosac_toolkit.workspace.limits import Limit
from carosac_toolkit.workspace.maps import Maps, maps
from carosac_toolkit.workspace.region import Region, compute
from carosac_toolkit.workspace.settings import WorkspaceSettings

__all__ = [
    "Grid",
    "Limit",
    "Maps",
    "Region",
    "Verdicts",
    "WorkspaceSettings",
    "box_grid",
    "box_of",
    "compute",
    "judge",
    "maps",
    "search_grid",
    "slice_grid",
]
