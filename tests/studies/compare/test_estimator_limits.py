"""What the estimator costs a controller, and the estimator `truth`, which costs nothing."""

from carosac_toolkit.studies.compare.findings import conclusions
from carosac_toolkit.studies.compare.headlines import headlines
from carosac_toolkit.studies.compare.surprises import grave_surprises, surprises
from tests.studies.tables import case, good, study


def rows(controller, estimator, tracking, estimation):
    more = {"estimation_rmse_x_m": estimation, "estimation_rmse_norm_m": estimation}
    return [
        good(case(controller, seed, estimator=estimator), (tracking, 0, 0), **more)
        for seed in (0, 1)
    ]


def test_a_better_row_with_the_true_state_shows_that_the_estimator_limits():
    results = study(
        [
            *rows("mpc", "filter", 0.012, 0.011), *rows("mpc", "truth", 0.004, 0.0),
            *rows("ik", "filter", 0.030, 0.011), *rows("ik", "truth", 0.030, 0.0),
        ]
    )  # fmt: skip
    (text,) = surprises(results)
    assert text == (
        "The estimator limits tracking: with the true state in place of the estimate, the RMSE "
        "falls from 12.0 mm to 4.0 mm for mpc / filter."
    )
    assert grave_surprises(results) == [text]


def test_without_a_row_of_truth_the_best_is_suspected_where_its_estimate_is_as_wrong():
    results = study([*rows("mpc", "filter", 0.012, 0.011), *rows("ik", "filter", 0.030, 0.029)])
    (text,) = surprises(results)
    start = "mpc tracks with 12.0 mm RMSE, and the position that it is given is off by 11.0 mm."
    assert text.startswith(start) and "estimator truth (--estimators)" in text
    open_loop = [row | {"feedback": False} for row in rows("mpc", "filter", 0.012, 0.011)]
    assert surprises(study([*open_loop, *rows("ik", "filter", 0.030, 0.029)])) == []
    good_estimate = [*rows("mpc", "filter", 0.012, 0.004), *rows("ik", "filter", 0.03, 0.029)]
    assert surprises(study(good_estimate)) == []


def test_the_true_state_is_not_ranked_as_an_estimate():
    results = study([*rows("mpc", "filter", 0.012, 0.011), *rows("mpc", "truth", 0.004, 0.0)])
    assert not any("estimat" in text for text in (*conclusions(results), *headlines(results)))
    three = study([*rows("mpc", "filter", 0.012, 0.011), *rows("mpc", "truth", 0.004, 0.0),
                   *rows("mpc", "solver", 0.018, 0.022)])  # fmt: skip
    for text in (conclusions(three)[0], headlines(three)[0]):
        assert text.startswith("The estimation error of solver is 2 times that of filter")
