"""Seeds that run as one batch have the rows that they have alone."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

import carosac_toolkit as ct
from carosac_toolkit.studies.compare.results import LATENCY_COLUMNS
from carosac_toolkit.studies.run.case import Case
from carosac_toolkit.studies.run.run_case import run_case
from carosac_toolkit.studies.run.run_together import group_of, run_together

SEEDS = (0, 1, 3)


def case(seed: int, **changes) -> Case:
    values = {
        "robot": "scampi", "controller": "kinematic_solver", "estimator": "straight_line",
        "sensors": "lengths+imu+pose", "trajectory": "minimum_snap", "perturbation": "nominal-1",
        "settings": {"speed_max": 4.0, "acceleration_max": 4.0, "controller_settings": {
            "period": 0.1}},
    }  # fmt: skip
    return Case(**(values | changes), seed=seed)


@pytest.fixture(scope="module")
def together():
    return run_together([case(seed) for seed in SEEDS])


@pytest.mark.parametrize("row", [0, 2])
def test_paths_plants_wind_and_noise_are_those_of_each_seed(together, row):
    found, alone = together[row], run_case(case(SEEDS[row]))
    assert found.keys() == alone.keys()
    assert [found[name] for name in LATENCY_COLUMNS] == [None] * 3
    for name in alone.keys() - {*LATENCY_COLUMNS, "series"}:
        if isinstance(alone[name], float):
            assert found[name] == pytest.approx(alone[name], rel=1e-6, abs=1e-9), name
        else:
            assert found[name] == alone[name], name
    if alone["series"] is not None:  # of the seed that is shown
        theirs, mine = json.loads(found["series"]), json.loads(alone["series"])
        assert np.array(theirs["position_m"]) == pytest.approx(
            np.array(mine["position_m"]), abs=2e-6
        )
    else:
        assert found["series"] is None


def test_paths_of_seeds_differ_in_their_time(together):
    assert len({row["steps"] for row in together}) == len(SEEDS)


def test_only_the_seed_may_differ():
    first = case(0)
    assert group_of(first) == group_of(case(7)) is not None
    for change in ({"trajectory": "circle"}, {"robot": "carosac"}, {"sensors": "lengths"}):
        assert group_of(case(7, **change)) not in (None, group_of(first))


@pytest.mark.parametrize(
    "changes",
    [{"controller": "mpc"}, {"estimator": "ks_ekf"}, {"settings": {"driver": "quasi_static"}}],
)
def test_what_wants_one_robot_runs_alone(changes):
    assert group_of(case(0, **changes)) is None


def test_plants_that_do_not_share_their_limits_are_refused():
    from sim_warp.driver import SimDriver, SimDriverSettings

    robot = ct.load_robot("scampi")
    quick = replace(robot, speed_max=2.0 * robot.speed_max)
    with pytest.raises(ct.CarosacError, match="robots: speed_max: got several"):
        SimDriver.build_batch([robot, quick], SimDriverSettings(), seeds=[0, 1])
