"""Feasibility of paths against a balance of forces by hand, and against exact statics."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from carosac_toolkit import trajectories
from carosac_toolkit.robot.file import load_robot
from carosac_toolkit.studies.compare.feasibility import path_feasibility, slowest_stop
from carosac_toolkit.studies.compare.study import Study

ROBOT = load_robot("carosac")


def path(robot, speed, acceleration, kind="waypoints"):
    return trajectories.build(kind, robot, 1, speed_max=speed, acceleration_max=acceleration)


@pytest.mark.parametrize("name", ["carosac", "scampi", "cogiro", "ipanema1"])
def test_slow_paths_of_the_default_study_are_feasible(name):
    judged = path_feasibility(Study(robots=(name,), seeds=2, trajectories=("waypoints",)).cases())
    assert [(one.paths, one.infeasible, one.reason) for one in judged] == [(2, 0, "")]


def test_the_fastest_feasible_speed_is_feasible_and_a_little_more_is_not():
    fast = path(ROBOT, 6.0, 8.0)
    stop = slowest_stop(ROBOT, fast)
    assert 0.3 < stop.scale < 0.8 and "cable" in stop.reason and "after" in stop.reason
    slower = replace(fast, duration=fast.duration / (0.99 * stop.scale))
    faster = replace(fast, duration=fast.duration / (1.02 * stop.scale))
    assert slowest_stop(ROBOT, slower).scale >= 1.0
    assert slowest_stop(ROBOT, faster).scale < 1.0


def test_a_slow_winch_is_named_with_its_limit():
    slow = replace(ROBOT, speed_max=np.array([2.5, 0.05, 2.5, 2.5]))
    stop = slowest_stop(slow, path(slow, 1.0, 1.0))
    assert stop.reason.startswith(
        f"the winch of cable {ROBOT.cable_names[1]} would have to wind at"
    )
    assert "its limit is 0.05 m/s" in stop.reason


def test_downward_acceleration_of_gravity_leaves_no_tension():
    """A platform in free fall pulls no cable: nothing above g is feasible with suspended cables."""
    drop = path(ROBOT, 20.0, 40.0, "circle")
    stop = slowest_stop(replace(ROBOT, speed_max=np.full(4, 99.0),
                                acceleration_max=np.full(4, 999.0)), drop)  # fmt: skip
    assert stop.scale**2 * drop.peak_acceleration < 9.81
    assert "tension_min" in stop.reason


def test_where_the_robot_cannot_rest_no_speed_is_feasible():
    weak = replace(ROBOT, tension_max=np.full(4, 60.0))
    stop = slowest_stop(weak, path(weak, 1.0, 1.0))
    assert stop.scale == 0.0 and "over its tension_max of 60 N" in stop.reason
    study = Study(trajectories=("waypoints",), seeds=1, speed_max=6.0, acceleration_max=8.0)
    (one,) = path_feasibility(study.cases())
    assert one.sentence().startswith("waypoints is not feasible on carosac: the winch of cable")
    share = f"Feasible up to {100 * one.time_scale:.0f} % of the speed of this study"
    assert f"{share}, at which the platform reaches " in one.sentence()
    assert "cannot even rest" in replace(one, time_scale=None).sentence()


def test_the_factor_of_the_times_in_a_file_makes_its_path_feasible(tmp_path):
    def judged(factor):
        rows = [f"{factor * t},{x},-0.8,2.5" for t, x in ((0, -0.5), (0.4, 0.0), (0.8, 0.5))]
        file = tmp_path / f"{factor}.csv"
        header = "time_s,position_x_m,position_y_m,position_z_m"
        file.write_text("\n".join([header, *rows]) + "\n")
        return path_feasibility(Study(trajectories=(str(file),), seeds=1).cases())[0]

    one = judged(1.0)
    assert one.infeasible and "of this study" not in one.sentence()
    factor = re.search(r"all times in the file multiplied by (\S+) or more", one.sentence())[1]
    assert judged(float(factor)).infeasible == 0
    assert judged(0.97 * float(factor)).infeasible == 1
