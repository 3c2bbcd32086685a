"""The page of a guided calibration."""

from __future__ import annotations

import numpy as np
import pytest

from calibration.guide.fit import exit_distances
from calibration.guide.view import SIGMAS_SHOWN, GuideView, principal_axes
from carosac_toolkit.viewer.page import Page
from tests.calibration.guide.scenes import ROBOT, by_hand


def test_an_ellipsoid_has_the_axes_of_its_covariance():
    covariance = np.array([[4.0, 1.0, 0.5], [1.0, 3.0, -0.2], [0.5, -0.2, 1.0]])
    axes, sigma = principal_axes(covariance)
    assert axes @ np.diag(sigma**2) @ axes.T == pytest.approx(covariance)
    assert np.linalg.det(axes) == pytest.approx(1.0)


def test_ellipsoids_shrink_around_the_exit_points_as_samples_come(tmp_path):
    guide, _ = by_hand(tmp_path / "samples.csv", 1)
    guide.resume()
    page = Page(ROBOT, "guide", port=8490, moves=False)
    try:
        view = GuideView(page, guide.known)
        sizes, shown = [], []
        for progress in guide.collect():
            view.show(progress)
            known = progress.fit.known
            sizes.append(np.array([handle.scale for handle in view._ellipsoids]))
            shown.append(page.picture)
            labels = [handle.text for handle in page.scene._names]
            words = zip(ROBOT.cable_names, shown[-1].tension, strict=True)
            assert labels == [f"{name}: {value:.0f} N" for name, value in words]
            found = np.array([handle.position for handle in view._ellipsoids])
            assert found == pytest.approx(known.exit_points, abs=1e-4)
            assert shown[-1].points[:, 0] == pytest.approx(known.exit_points, abs=0.01)
    finally:
        page.close()
    reach = np.sqrt((sizes[-1] ** 2).sum(axis=1)) / SIGMAS_SHOWN
    assert reach == pytest.approx(exit_distances(known), rel=1e-3)
    assert sizes[-1].mean() < 0.3 * sizes[0].mean()
    assert f"sample {progress.name}" in shown[-1].status
