"""A policy is not driven by code under which its numbers mean something else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from carosac_toolkit.base.errors import InvalidField
from learned import environment, length_map, observation
from learned.environment import EnvironmentSettings
from learned.observation import ObservationUnits
from learned.policy_probe import PROBE_TOLERANCES, check_probe, make_probe
from learned.target_paths import PathSettings
from tests.robots import eight_cable_robot, simple_robot

ROBOT = simple_robot()
ABSOLUTE = EnvironmentSettings(observation=("length", "target"))
PUSH = EnvironmentSettings(
    world="realtime", observation=("error", "velocity", "preview", "last_action"), preview=(2, 5),
    action="push", share=0.5, path=PathSettings(kind="minimum_snap", period=0.05),
)  # fmt: skip


@pytest.mark.parametrize("settings", [ABSOLUTE, PUSH])
@pytest.mark.parametrize("robot", [ROBOT, eight_cable_robot()])
def test_the_same_code_agrees_with_itself(robot, settings):
    probe = make_probe(robot, settings)
    assert probe == make_probe(robot, settings)
    assert np.isfinite(probe["length"]).all() and np.shape(probe["length"]) == (6, robot.n)
    check_probe(probe, robot, settings)


def test_a_push_is_seen_in_the_lengths():
    """Ten times as much as what would be noticed, at home, from rest."""
    still, pushed = (make_probe(ROBOT, replace(PUSH, reach=reach)) for reach in (1e-9, 3.0))
    apart = np.subtract(pushed["length"][0], still["length"][0])
    assert np.abs(apart).max() > 10 * PROBE_TOLERANCES["length"]


@pytest.mark.parametrize(
    ("settings", "module", "name", "value", "message"),
    [
        (ABSOLUTE, observation, "LENGTH_MARGIN_RATIO", 0.03, "differ by up to"),
        (PUSH, length_map, "POLYNOMIAL_DEGREE", 5, r"lengths differ by up to .* mm"),
        (PUSH, environment, "make_actions", None, r"lengths differ by up to .* mm"),
    ],
)
def test_changed_code_is_noticed(monkeypatch, settings, module, name, value, message):
    """Of the lengths that a policy's actions come to, or of what it sees."""
    probe = make_probe(ROBOT, settings)
    if name == "make_actions":  # another lead
        monkeypatch.setattr(
            "learned.policy_probe.make_actions",
            lambda robot, *rest: environment.make_actions(
                replace(robot, winch_lag=2.0 * robot.winch_lag), *rest
            ),
        )
    else:
        monkeypatch.setattr(module, name, value)
    with pytest.raises(InvalidField, match="trained with another version: .*" + message):
        check_probe(probe, ROBOT, settings)


def test_lengths_may_differ_by_a_tenth_of_a_millimetre_and_no_more():
    probe = make_probe(ROBOT, ABSOLUTE)
    for change, refused in ((0.9e-4, False), (-0.9e-4, False), (1.2e-4, True), (-1.2e-4, True)):
        other = probe | {"length": [list(row) for row in probe["length"]]}
        other["length"][3][2] += change
        if not refused:
            check_probe(other, ROBOT, ABSOLUTE)
            continue
        with pytest.raises(InvalidField, match=r"lengths differ by up to 0\.12 mm"):
            check_probe(other, ROBOT, ABSOLUTE)


def test_other_units_of_an_observation_are_noticed():
    probe = make_probe(ROBOT, PUSH)
    with pytest.raises(InvalidField, match=r"observations differ by up to \d"):
        check_probe(probe, ROBOT, replace(PUSH, units=ObservationUnits(error=0.2)))


@pytest.mark.parametrize(
    "probe", [None, {}, [1.0], {"observation": "x", "length": [[1.0]]}, {"observation": [[1.0]]}]
)
def test_what_is_no_probe_is_refused(probe):
    with pytest.raises(InvalidField, match=r"policy.probe: .*train it again"):
        check_probe(probe, ROBOT, ABSOLUTE)
    size = make_probe(ROBOT, replace(ABSOLUTE, observation=("target",)))
    with pytest.raises(InvalidField, match="observations of another size"):
        check_probe(size, ROBOT, ABSOLUTE)
    with pytest.raises(InvalidField, match="lengths differ"):
        nan = make_probe(ROBOT, ABSOLUTE) | {"length": np.full((6, 4), np.nan).tolist()}
        check_probe(nan, ROBOT, ABSOLUTE)
