"""Our plug-ins keep the contract, and each check catches one that does not."""

from __future__ import annotations

import subprocess
import sys
from functools import partial

import pytest

import carosac_toolkit as ct
from carosac_toolkit import conformance
from carosac_toolkit.base.errors import CarosacError, InvalidField
from carosac_toolkit.loop import plugins
from carosac_toolkit.robot.robot import Robot
from tests import broken_plugins as broken
from tests.robots import eight_cable_robot, simple_robot, with_pulleys

ALL = {
    "controllers": conformance.CONTROLLER_CHECKS,
    "estimators": conformance.ESTIMATOR_CHECKS,
    "drivers": conformance.DRIVER_CHECKS,
}
ELSEWHERE = {"ads", "guarded"}  # tests/plc, tests/safety/guard: with a PLC; with their period
OURS = [
    pytest.param(kind, name, check, id=f"{kind}-{name}-{title}")
    for kind, checks in ALL.items()
    for name in sorted(set(plugins.names(kind)) - ELSEWHERE)
    for title, check in checks.items()
]
CAUGHT = {
    "controllers": {
        "period_and_horizon": {broken.NoPeriod: "period: got inf; allowed: a finite number"},
        "command_fits": {
            broken.Wide: r"lengths of shape \(1, 8\); allowed: \(1, 4\)",
            broken.Tuple: "got ndarray; allowed: Command",
            broken.Negative: "allowed: > 0 m",
            broken.OtherClock: "that of the belief",
        },
        "reset_forgets": {broken.Integrates: r"reset\(\): the same inputs gave other commands"},
        "same_seed_same_commands": {broken.Dices: "made with the same seed disagreed"},
        "extremes_stay_finite": {
            broken.NanFarAway: "produced a number that is not finite",
            broken.CrashesFarAway: "LinAlgError: Singular matrix; allowed: a CarosacError",
        },
        "bare_belief_is_enough": {broken.WantsTwist: "without twist.*TypeError"},
        "other_robot_refused": {
            broken.FourCables: "made for 5 cables, it commanded 4",
            broken.FourGains: "a robot of 5 cables: got ValueError",
        },
        "batch_equals_loop": {
            broken.FirstRowOnly: "batch of two and two batches of one: got a difference of",
            broken.OneRowByReshape: "a batch of two: got ValueError: cannot reshape",
        },
    },
    "estimators": {
        "belief_fits": {
            broken.Array: "got ndarray; allowed: Belief",
            broken.Late: "as measured",
            broken.NanTension: "tension: got a number that is not finite",
        },
        "reset_forgets": {broken.Remembers: r"reset\(\): the same measurements gave other beliefs"},
        "same_seed_same_beliefs": {broken.DicesToo: "made with the same seed disagreed"},
        "extremes_stay_finite": {
            broken.DividesByTime: "produced a number that is not finite",
            broken.NanTension: "tension: got a number that is not finite",
        },
        "other_robot_refused": {
            broken.TakesFour: "made for 4 cables, it took lengths of 5",
            broken.AddsPerCable: "lengths of 5 cables: got ValueError",
        },
        "lengths_are_enough": {broken.NeedsPose: "without truth, poses.*AttributeError"},
        "batch_equals_loop": {broken.AveragesBatch: "two batches of one: got a difference of"},
    },
    "drivers": {
        "not_before_connect": {
            broken.MeasuresAlways: r"measure\(\) worked before connect\(\)",
            broken.TracebackBeforeConnect: r"measure\(\) before connect\(\): got AttributeError",
        },
        "stop_and_close_any_time": {
            broken.StopNeedsConnection: r"stop\(\) and close\(\): got CarosacError",
            broken.ClosesOnce: r"stop\(\) and close\(\): got CarosacError",
        },
        "measurement_fits": {
            broken.StandsStill: "after 0.0 s; allowed: later",
            broken.MissesCable: r"got lengths of shape \(1, 3\)",
        },
        "truth_is_withheld": {broken.Leaks: "pose: got a pose; allowed: None"},
        "wrong_cables_refused": {broken.CutsCommand: "it took 5 lengths for 4 cables"},
        "command_says_what_was_sent": {
            broken.Echoes: "lengths sent and measured 2 s later",
            broken.ChangesSilently: "`limited` must say why",
            broken.ReplayEchoes: "a driver that replays returned what was asked",
        },
        "stop_comes_to_rest": {
            broken.IgnoresStop: "lengths are still sent that move",
            broken.StopsDead: "acceleration of what was sent reached .* times its limit",
        },
        "wait_says_when_it_ends": {
            broken.WaitReturnsNone: r"wait\(\): got None at the first cycle; allowed: True",
            broken.IgnoresStop: "never False in",
        },
        "connecting_again_starts_over": {broken.Drifts: "gave other measurements than before"},
        "same_seed_same_data": {broken.Unseeded: "made with the same seed disagreed"},
        "capabilities_fit": {
            broken.StatusWord: "status: got 'following'; allowed: a method that takes",
            broken.OwnStatus: r"status\(\): got 'running'; allowed: one of \['disconnected'",
            broken.FaultText: "FaultSource: fault: got 'drive_trip'; allowed: Fault",
            broken.HoldsAnyFault: r"takes \(\); allowed: a method that takes \(fault\)",
            broken.SetsDownOnly: "got no sets_down; allowed: sets_down and set_down",
            broken.PatienceText: "LinkPatience: lost_after: got '0.1 s'; allowed: float",
        },
    },
}
BROKEN = [
    pytest.param(kind, title, plugin, message, id=f"{kind}-{title}-{plugin.__name__}")
    for kind, titles in CAUGHT.items()
    for title, plugins in titles.items()
    for plugin, message in plugins.items()
]


@pytest.mark.parametrize(("kind", "name", "check"), OURS)
def test_our_plug_in_keeps_its_contract(kind, name, check):
    loaded = plugins.load(kind, name)
    build = loaded.build
    if name == "td3":  # the policy that it takes by default needs an estimator with a twist
        build = partial(loaded.build, settings=loaded.Settings(policy="carosac-settle"))
    check(build, ct.load_robot("carosac"))


@pytest.mark.parametrize("robot", [eight_cable_robot(), with_pulleys(simple_robot())],
                         ids=["eight cables", "pulleys"])  # fmt: skip
@pytest.mark.parametrize("kind", ["controllers", "estimators", "drivers"])
def test_our_plug_ins_keep_it_for_other_robots(kind, robot: Robot):
    # there is no recording of these robots, and no policy was trained for them
    for name in set(plugins.names(kind)) - {"replay", "td3", "approximate_mpc"} - ELSEWHERE:
        for check in ALL[kind].values():
            check(plugins.load(kind, name).build, robot)


def test_a_policy_refuses_a_robot_that_it_was_not_trained_for():
    with pytest.raises(InvalidField, match="a robot with a bundled policy"):
        plugins.load("controllers", "td3").build(eight_cable_robot())


@pytest.mark.parametrize(("kind", "title", "plugin", "message"), BROKEN)
def test_a_broken_plug_in_is_caught(kind, title, plugin, message, monkeypatch):
    monkeypatch.setattr("carosac_toolkit.conformance.drivers.CYCLES_MAX", 300)
    with pytest.raises(AssertionError, match=message) as caught:
        ALL[kind][title](plugin.build, ct.load_robot("carosac"))
    assert isinstance(caught.value, CarosacError)


def test_every_check_has_a_plug_in_that_it_catches():
    assert {kind: set(titles) for kind, titles in CAUGHT.items()} == {
        kind: set(checks) for kind, checks in ALL.items()
    }


def test_what_wraps_is_not_what_breaks():
    robot = ct.load_robot("carosac")
    conformance.check_controller(broken.Control.build, robot)
    conformance.check_estimator(broken.Estimate.build, robot)
    conformance.check_driver(broken.Drive.build, robot)


def test_all_faults_come_in_one_message():
    with pytest.raises(conformance.NotConforming) as caught:
        conformance.check_controller(broken.DicesByAnotherClock.build, ct.load_robot("carosac"))
    first, *faults = str(caught.value).split("\n  ")
    assert first == "controller: 4 of its checks failed"
    names = ["command_fits", "reset_forgets", "same_seed_same_commands", "batch_equals_loop"]
    assert [fault.partition(":")[0] for fault in faults] == names


def test_checks_can_be_left_out_by_name():
    robot = ct.load_robot("carosac")
    left_out = ("connecting_again_starts_over", "command_says_what_was_sent")
    conformance.check_driver(broken.Drifts.build, robot, skip=left_out)
    with pytest.raises(InvalidField, match=r"skip: got 'drfits'; allowed: some of \['not_before"):
        conformance.check_driver(broken.Drifts.build, robot, skip=("drfits",))


def test_a_robot_that_cannot_rest_at_home_is_no_robot_to_check_with():
    robot = simple_robot(tension_max=[6.0] * 4)
    with pytest.raises(InvalidField, match="a robot that can rest at home and near it"):
        conformance.CONTROLLER_CHECKS["command_fits"](broken.Control.build, robot)


@conformance.each(conformance.CONTROLLER_CHECKS)
def test_a_users_three_lines(check):
    check(broken.Control.build, ct.load_robot("carosac"))


def test_pytest_is_not_imported_until_it_is_needed():
    program = (
        "import sys; from carosac_toolkit import conformance; print('pytest' in sys.modules);"
        "conformance.each(conformance.DRIVER_CHECKS); print('pytest' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.stdout.split() == ["False", "True"], done.stderr
