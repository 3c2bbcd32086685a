"""Page of a guided calibration: what is known of each exit point shrinks as samples come."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from calibration.guide.fit import GuideFit
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

    def __init__(self, page: Page, known: Knowledge, fit: GuideFit | None = None) -> None:
        """Draw what is known before the next sample.

        Args:
            page: Of the robot.
            known: Knowledge.
            fit: Of earlier samples, or None.
        """
        self._page = page
        scene: Any = page.server.scene
        self._ellipsoids = [
            scene.add_icosphere(
                f"/known/{name}", radius=1.0, color=KNOWN_COLOR, subdivisions=3, opacity=0.35
            )
            for name in known.problem.robot.cable_names
        ]
        robot = known.problem.robot
        self._draw(known, robot.home_position if fit is None else fit.position[-1], None, None, "")
        if fit is not None:
            self._draw_samples(known, fit.position)

    def show(self, progress: Progress) -> None:
        """Draw a sample, all of them where they are by now, and what is known with them."""
        known = progress.fit.known
        self._draw_samples(known, np.vstack([progress.fit.position, progress.position]))
        self._draw(
            known, progress.position, progress.tension, progress.target,
            f"sample {progress.name}: ",
        )  # fmt: skip

    def _draw_samples(self, known: Knowledge, position: Array) -> None:
        """Draw the samples at positions (N, 3)."""
        self._page.server.scene.add_point_cloud(
            "/samples", position, SAMPLE_COLOR, point_shape="circle", precision="float32",
            point_size=SAMPLE_SIZE_SHARE * known.problem.longest,
        )  # fmt: skip

    def _draw(
        self, known: Knowledge, position: Array, tension: Array | None, target: Array | None,
        words: str,
    ) -> None:  # fmt: skip
        """Draw the platform on cables from where they begin by what is known, and ellipsoids."""
        robot = known.problem.robot
        found = replace(robot, exit_points=known.exit_points, exit_covariance=None)
        words += (
            f"exit points are known to {1e3 * known.exit_distance:.3g} mm on average (1 sigma); "
            f"ellipsoids show {SIGMAS_SHOWN:g} sigmas"
        )
        picture = take_picture(
            found, position, robot.home_rotation, tension=tension, target=target, status=words
        )
        self._draw_known(known)
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
