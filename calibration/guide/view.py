"""Page of a guided calibration: what is known of each exit point shrinks as samples come."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from calibration.guide.guide import Progress
from calibration.self_calibration.knowledge import Knowledge
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.rotations import from_matrix
from carosac_toolkit.viewer.colors import Rgb
from carosac_toolkit.viewer.page import Page
from carosac_toolkit.viewer.picture import take_picture

SIGMAS_SHOWN = 2.0  # semi-axes of an ellipsoid: 74 % of a normal distribution in space
KNOWN_COLOR: Rgb = (123, 79, 163)
SAMPLE_COLOR: Rgb = (20, 120, 60)
SAMPLE_SIZE_SHARE = 0.012  # of the longest cable


class GuideView:
    """Draws the robot as it is known by now, on a page that shows its file."""

    def __init__(self, page: Page, known: Knowledge) -> None:
        """Draw what is known before the first sample."""
        self._page, self._samples = page, np.zeros((0, 3))
        scene: Any = page.server.scene
        self._ellipsoids = [
            scene.add_icosphere(
                f"/known/{name}", radius=1.0, color=KNOWN_COLOR, subdivisions=3, opacity=0.35
            )
            for name in known.problem.robot.cable_names
        ]
        self._draw_known(known)

    def show(self, progress: Progress) -> None:
        """Draw a sample, and what is known with it."""
        known = progress.fit.known
        robot = known.problem.robot
        found = replace(robot, exit_points=known.exit_points, exit_covariance=None)
        self._draw_known(known)
        self._samples = np.vstack([self._samples, progress.position])
        self._page.server.scene.add_point_cloud(
            "/samples", self._samples, SAMPLE_COLOR, point_shape="circle", precision="float32",
            point_size=SAMPLE_SIZE_SHARE * known.problem.longest,
        )  # fmt: skip
        words = (
            f"sample {progress.name}: exit points are known to {1e3 * known.exit_distance:.3g} mm "
            f"on average (1 sigma); ellipsoids show {SIGMAS_SHOWN:g} sigmas"
        )
        picture = take_picture(
            found, progress.position, robot.home_rotation, tension=progress.tension,
            target=progress.target, status=words,
        )  # fmt: skip
        self._page.draw(picture)
        self._page.settle()  # each is the last one for a while

    def _draw_known(self, known: Knowledge) -> None:
        """Draw an ellipsoid at each exit point."""
        n = known.problem.robot.n
        blocks = known.exit_covariance.reshape(n, 3, n, 3)
        for i, handle in enumerate(self._ellipsoids):
            axes, sigma = principal_axes(blocks[i, :, i])
            handle.position = known.exit_points[i]
            handle.wxyz = from_matrix(axes[None])[0]
            handle.scale = tuple(SIGMAS_SHOWN * sigma)


def principal_axes(covariance: Array) -> tuple[Array, Array]:
    """Return a rotation whose columns are the axes of a covariance (3, 3), and sigmas (3,)."""
    variance, axes = np.linalg.eigh(covariance)
    axes[:, 0] *= np.linalg.det(axes)
    return axes, np.sqrt(np.maximum(variance, 0.0))
