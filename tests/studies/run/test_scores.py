"""Scores of estimates, with errors and covariances that are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from carosac_toolkit.loop.consistency import band
from carosac_toolkit.loop.values import Innovations
from carosac_toolkit.studies.compare.findings import conclusions
from carosac_toolkit.studies.compare.tables import header, units
from carosac_toolkit.studies.compare.tables import rows as report_rows
from carosac_toolkit.studies.compare.terminal_table import terminal_table
from carosac_toolkit.studies.run.scores import ESTIMATION_COLUMNS, estimation_scores
from tests.studies.run.test_run_case import made_up
from tests.studies.tables import case, good, study

SIGMA = np.repeat([0.01, 0.02, 0.1, 0.2], 3)  # [m, rad, m/s, rad/s]


def drawn(count=4000, scale=1.0):
    """A log whose beliefs are off by as much as their covariance says, times `scale`."""
    rng = np.random.default_rng(0)
    log = made_up(count=count)
    position = log.position[:, :1]
    error = scale * SIGMA * rng.standard_normal((count, 1, 12))
    turned = Rotation.from_euler("xyz", [0.3, -0.5, 1.0]).as_matrix()
    off = Rotation.from_rotvec(error[:, 0, 3:6]).as_matrix()[:, None]
    return replace(
        log, position=position, rotation=off @ turned,
        belief_rotation=np.tile(turned, (count, 1, 1, 1)),
        belief_position=position - error[..., :3], twist=error[..., 6:],
        belief_twist=np.zeros((count, 1, 6)),
        belief_covariance=np.tile(np.diag(SIGMA**2), (count, 1, 1, 1)),
    )  # fmt: skip


def test_errors_as_large_as_the_covariance_says_have_a_nees_of_one():
    row = estimation_scores(drawn())
    for name, dof in (("nees_pose", 6), ("nees", 12)):
        low, high = band(dof, 4000)
        assert low < row[name] < high
    assert row["orientation_rmse_rad"] == pytest.approx(0.02 * np.sqrt(3.0), rel=0.03)
    assert row["covariance_faults"] == 0
    assert row["nis"] is row["rejected_share"] is None


def test_errors_twice_as_large_have_four_times_the_nees():
    one, two = (estimation_scores(drawn(scale=scale)) for scale in (1.0, 2.0))
    for name in ("nees_pose", "nees", "nees_pose_p95"):
        assert two[name] == pytest.approx(4.0 * one[name], rel=1e-6)
    assert two["estimation_p95_m"] == pytest.approx(2.0 * one["estimation_p95_m"])


def test_without_a_twist_the_pose_is_scored_alone():
    row = estimation_scores(replace(drawn(), belief_twist=None))
    assert row["nees_pose"] == pytest.approx(1.0, abs=0.05) and row["nees"] is None


def test_a_covariance_that_is_none_is_counted_and_left_out():
    log = drawn()
    broken = np.array(log.belief_covariance)
    broken[:10, 0, 0, 0] = -1.0
    row = estimation_scores(replace(log, belief_covariance=broken))
    assert row["covariance_faults"] == 10
    assert row["nees_pose"] == pytest.approx(1.0, abs=0.05)


def test_innovations_are_summed_before_they_are_divided():
    one = np.ones((4, 2))
    found = Innovations(
        squares=one * [[8.0], [0.0], [2.0], [2.0]], dof=one * [[4.0], [0.0], [4.0], [4.0]],
        rejected=one * [[0.0], [3.0], [0.0], [0.0]],
    )  # fmt: skip
    row = estimation_scores(replace(made_up(4), innovations=found))
    assert (row["nis"], row["nis_dof"], row["rejected_share"]) == (1.0, 4.0, 0.25)
    assert row["nees"] is row["nees_pose"] is None


def test_nothing_is_known_without_a_truth():
    row = estimation_scores(replace(drawn(), position=None, rotation=None))
    assert row == dict.fromkeys(ESTIMATION_COLUMNS)


def two_estimators(square=1.2, **more):
    """Filter and solver on the same three seeds and two paths."""
    rows = [
        good(case("a", seed, path, estimator="filter"), (0.02, 0.0, 0.0), nees_pose=square,
             nees=1.0, nis=0.9, nis_dof=4.0, rejected_share=0.01, orientation_rmse_rad=0.1, **more)
        for path in ("circle", "line") for seed in range(3)
    ]  # fmt: skip
    rows += [
        good(case("a", seed, path, estimator="solver"), (0.06, 0.0, 0.0))
        for path in ("circle", "line")
        for seed in range(3)
    ]
    return study(rows)


def test_the_band_of_a_mean_is_that_of_as_many_draws_as_there_are_seeds():
    line, other = two_estimators().summary
    assert line["nees_pose"] == {"mean": 1.2, "band": list(band(6, 3)), "seeds": 3}
    assert line["nees"]["band"] == list(band(12, 3)) and line["nis"]["band"] == list(band(4.0, 3))
    assert line["rejected_share"] == 0.01 and line["orientation_rmse_rad"] == pytest.approx(0.1)
    assert other["nees_pose"] is other["nis"] is other["rejected_share"] is None


def test_estimators_are_ranked_and_their_nees_is_judged():
    said = " ".join(conclusions(two_estimators()))
    assert "The estimation error of solver is 3 times that of filter: 30.0 mm against 10.0" in said
    assert "filter is consistent: NEES of the pose 1.20, in the 95 % band" in said
    above = " ".join(conclusions(two_estimators(square=40.0)))
    assert "filter is overconfident: NEES of the pose 40, outside" in above
    assert "filter is underconfident" in " ".join(conclusions(two_estimators(square=0.01)))
    broken = " ".join(conclusions(two_estimators(covariance_faults=2)))
    assert "In 12 cycles the covariance of filter was not positive definite" in broken


def test_one_estimator_is_not_ranked():
    rows = [good(case(name, seed), (0.01, 0, 0)) for name in "ab" for seed in range(2)]
    assert "estimation error" not in " ".join(conclusions(study(rows)))


def test_many_that_track_alike_are_one_sentence():
    rows = [good(case("a", estimator=name), (0.01, 0, 0)) for name in "efg"]
    said = conclusions(study(rows))
    assert "All track alike: 10.0 mm to 10.0 mm RMSE (e, f, g)." in said


def test_the_table_has_columns_on_covariances_where_there_are_any():
    text = terminal_table(two_estimators(square=40.0), 80)
    assert "NEES" in text and "40+" in text
    full = two_estimators(square=40.0)
    assert "NEES 6" in header(full) and {"40+", "1.0 %"} <= set(report_rows(full)[0])
    assert max(map(len, text.splitlines())) <= 80
    assert "NEES" in units(two_estimators())
    rows = [good(case("a", seed), (0.01, 0, 0)) for seed in range(2)]
    assert "NEES" not in terminal_table(study(rows), 80) + units(study(rows))
