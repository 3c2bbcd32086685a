"""Arrows in the scene that move a target."""

from __future__ import annotations

from typing import Any

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.rotations import from_matrix
from carosac_toolkit.viewer.geometry import extent
from carosac_toolkit.viewer.page import Page

GIZMO_SIZE = 0.09  # of the frame
GIZMO_NODE = "/target"


def add_gizmo(page: Page, position: Array, rotation: Array | None = None, *,
              rotations: bool) -> Any:  # fmt: skip
    """Add the arrows to a page.

    Args:
        page: The page.
        position: Position in W [m], shape (3,).
        rotation: From it to W, shape (3, 3); by default its axes are those of W.
        rotations: True to let it rotate.
    """
    turn = np.eye(3) if rotation is None else rotation
    return page.server.scene.add_transform_controls(
        GIZMO_NODE, scale=GIZMO_SIZE * float(np.ptp(extent(page.robot), axis=0).max()),
        disable_rotations=not rotations, depth_test=False, position=position,
        wxyz=from_matrix(turn[None])[0], line_width=3.0,
    )  # fmt: skip
