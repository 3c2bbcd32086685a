import pytest

from carosac_toolkit.studies.compare.headlines import headlines, tensions
from tests.studies.compare.test_surprises import rows
from tests.studies.tables import case, good, study


def swinging(name, error, sway, **more):
    return [row | {"residual_sway_m": sway} for row in rows(name, error, **more)]


def test_three_sentences_say_who_is_best_how_it_swings_and_what_the_tensions_were():
    loose = {"slack_share": 0.34, "tension_min_N": 0.01}
    results = study(
        [
            *swinging("a", 0.3, 0.2, **loose),
            *swinging("b", 0.1, 0.05),
            *swinging("c", 0.01, 0.002, tension_min_N=15.0, slack_share=0.0004),
        ]
    )
    error, sway, tension = headlines(results)
    assert error.startswith("The tracking error of a is 29 times that of c: 300.5 mm against 10.5")
    assert sway == (
        "At the end the platform still swings: by 2.0 mm after c and 200.0 mm after a (RMS)."
    )
    assert tension == (
        "A cable was slack, below 20 N, for 34 % of the time under a, never under b."
    )


@pytest.mark.parametrize(
    ("more", "text"),
    [
        ({}, "All tensions were within 20 to 500 N."),
        ({"tension_max_N": 700.0}, "The highest tension was 700 N, under b."),
        (
            {"tension_max_N": 700.0, "slack_share": 0.34, "tension_min_N": 1.0},
            "A cable was slack, below 20 N, for 34 % of the time under b, never under a; the "
            "highest tension was 700 N, under b.",
        ),
    ],
)
def test_tensions_within_and_above_their_limits(more, text):
    assert tensions(study([*rows("a"), *rows("b", 0.02, **more)])) == text


def test_where_all_were_slack_the_least_is_named():
    both = [*rows("a", slack_share=0.004), *rows("b", 0.02, slack_share=0.3)]
    assert tensions(study(both)).endswith("for 30 % of the time under b and <1 % under a.")


def test_unknown_tensions_are_no_sentence():
    results = study([good(case(name), (0.01, 0, 0)) for name in "ab"])
    assert tensions(results) is None and len(headlines(results)) == 1


def test_estimators_are_compared_before_controllers():
    both = [
        good(
            case("a", estimator=name), (0.01, 0, 0),
            estimation_rmse_x_m=size, estimation_rmse_norm_m=size,
        )
        for name, size in (("one", 0.02), ("two", 0.04))
    ]  # fmt: skip
    first = headlines(study(both))[0]
    assert first.startswith("The estimation error of two is 2 times that of one")


def test_each_robot_gets_a_sentence():
    two = [good(case(name, robot=robot), (size, 0, 0)) for robot in ("carosac", "scampi")
           for name, size in (("a", 0.01), ("b", 0.02))]  # fmt: skip
    said = headlines(study(two))
    assert [text.partition(":")[0] for text in said] == [
        "On carosac, condition none",
        "On scampi, condition none",
    ]
